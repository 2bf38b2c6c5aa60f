"""`jaxsphere simulate planar` and `jaxsphere tune planar`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import jax.numpy as jnp

import jaxsphere as js
from experiments import fig4, planar_tuning, plotting, report
from experiments.commands.printing import print_numbers
from experiments.records import Record
from jaxsphere.checks import require_scalar

if TYPE_CHECKING:
    from experiments.cli import SimulatePlanar, TunePlanar


def simulate(options: SimulatePlanar) -> None:
    """Simulate one move, print its figures of merit and draw it."""
    motion = options.motion
    robot = options.robot.make()
    plant = options.plant.make(robot, "plant")
    gains = options.gains.make()
    require_scalar("slope_deg", motion.slope_deg, above=-90.0, below=90.0, unit="deg")
    js.require_holdable(robot, motion.slope)
    record = Record(options.out)
    trajectory = js.rest_to_rest(
        robot,
        motion.slope,
        gains,
        motion.travel,
        motion.duration,
        motion.dt,
        motion.smoothing,
        motion.torque_limit,
        plant=plant,
        initial_state=None if motion.initial_state is None else jnp.array(motion.initial_state),
        control_period=motion.control_period,
        convention=motion.convention,
        method=motion.method,
        throw=False,
    )
    numbers = fig4.figures(trajectory)
    title = f"Rest to rest over {motion.travel:g} rad on a {motion.slope_deg:g}° slope: {numbers['status'].replace('_', ' ')}"
    shown = [plotting.Run("simulated", trajectory, gains)]
    until = float(trajectory.end_time)
    record.picture("simulation", plotting.regulation_figure(title, shown, robot, motion.slope, motion.travel, until))
    record.finish({"simulation": numbers}, robot=robot, plant=plant, gains=gains, settings=motion)
    print_numbers(numbers)
    print(f"simulation.png, metrics.json and manifest.json are in {record.folder}")


def tune(options: TunePlanar) -> None:
    """Tune the gains, score them with the hard sign and a 1 kHz hold, and draw one page."""
    settings = options.tuning
    planar_tuning.check(options)
    record = Record(options.out)
    found = planar_tuning.study(replace(options, checkpoint=options.checkpoint or str(record.folder / "checkpoint.npz")))
    found.result.save(record.folder / "tuning.json")
    many = f", {options.uncertainty.scenarios} drawn robots" if options.uncertainty.scenarios else ""
    title = f"Tuning of the planar controller on a {settings.slope_deg:g}° slope{many}"
    subject = {"robot": found.robot, "gains": found.result.initial_gains, "settings": settings}
    record.finish({"tuning": planar_tuning.numbers(found)}, **subject, uncertainty=options.uncertainty)
    record.picture("tuning", report.planar_page(found, title))
    print(found.result.report())
    for name, trajectory in found.scored.items():
        print(f"\n{name}, scored with the hard sign and a 1 kHz hold:")
        print_numbers(fig4.figures(trajectory))
    print()
    for sentence in planar_tuning.sentences(found):
        print(sentence)
    print(f"\ntuning.png, tuning.json, metrics.json and manifest.json are in {record.folder}")
