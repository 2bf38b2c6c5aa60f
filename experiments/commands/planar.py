"""`jaxsphere simulate planar` and `jaxsphere tune planar`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import jax.numpy as jnp

import jaxsphere as js
import tuning
from experiments import fig4, plotting
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
    """Tune the gains, score them with the hard sign and a 1 kHz hold, and draw before and after."""
    settings = options.tuning
    robot, initial = options.robot.make(), options.gains.make()
    for name in ("tracking_weight", "swing_weight", "torque_weight", "chatter_weight"):
        require_scalar(name, getattr(settings, name), above=0.0, or_equal=True)
    require_scalar("swing_limit_deg", settings.swing_limit_deg, above=0.0, unit="deg")
    require_scalar("slope_deg", settings.slope_deg, above=-90.0, below=90.0, unit="deg")
    slope = math.radians(settings.slope_deg)
    js.require_holdable(robot, slope)
    record = Record(options.out)
    objective = tuning.RestToRest(
        robot,
        slope,
        settings.travel,
        settings.duration,
        settings.dt,
        settings.smoothing,
        settings.torque_limit,
        math.radians(settings.swing_limit_deg),
        weights=tuning.Weights(
            settings.tracking_weight, settings.swing_weight, settings.torque_weight, settings.chatter_weight
        ),
    )
    result = tuning.tune(
        objective,
        initial,
        optimiser=settings.optimiser,
        iterations=settings.iterations,
        starts=settings.starts,
        bounds={name: ends for name, ends in tuning.BOUNDS.items() if name not in settings.frozen},
        learning_rate=settings.learning_rate,
        seed=settings.seed,
        gradient=settings.gradient,
        frozen=settings.frozen,
        progress=settings.progress,
        checkpoint=settings.checkpoint,
        resume=settings.resume,
    )
    result.save(record.folder / "tuning.json")
    scoring = fig4.SCORING | {"torque_limit": settings.torque_limit, "throw": False}
    runs = {"before": initial, "after": result.gains}
    scored = {name: js.rest_to_rest(robot, slope, gains, settings.travel, **scoring) for name, gains in runs.items()}
    numbers = {name: fig4.figures(trajectory) for name, trajectory in scored.items()}
    shown = [plotting.Run(name, scored[name], gains) for name, gains in runs.items()]
    title = f"Before and after tuning, {settings.slope_deg:g}° slope, hard sign, 1 kHz hold"
    record.picture("tuning", plotting.regulation_figure(title, shown, robot, slope, settings.travel, until=10.0))
    record.picture("tuning_convergence", plotting.convergence_figure(result))
    record.finish({"tuning": {"gains": result.gains, **numbers}}, robot=robot, gains=initial, settings=settings)
    print(result.report())
    for name, figures in numbers.items():
        print(f"\n{name}, scored with the hard sign and a 1 kHz hold:")
        print_numbers(figures)
    print(f"\npictures, tuning.json, metrics.json and manifest.json are in {record.folder}")
