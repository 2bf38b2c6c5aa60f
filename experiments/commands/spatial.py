"""`jaxsphere simulate spatial` and `jaxsphere tune spatial`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import jaxsphere as js
import tuning
from experiments import fig5, plotting, spatial_plots
from experiments.commands.printing import print_numbers
from experiments.records import Record
from jaxsphere.checks import require_scalar

if TYPE_CHECKING:
    from experiments.cli import SimulateSpatial, TuneSpatial


def simulate(options: SimulateSpatial) -> None:
    """Follow one path, print how well, and draw it."""
    motion = options.motion
    robot = js.spatial.check_spatial_robot(options.robot.make())
    plant = js.spatial.check_spatial_robot(options.plant.make(robot, "plant"), "plant")
    gains, reference = options.gains.make(), motion.reference()
    require_scalar("slope_deg", motion.slope_deg, above=-90.0, below=90.0, unit="deg")
    if motion.realisation != "ideal":
        js.require_holdable(robot, motion.slope)
    record = Record(options.out)
    on_line: dict[str, Any] = {"start": motion.start, "heading": math.pi / 4} if motion.path == "line" else {}
    trajectory = js.track(
        robot,
        motion.slope,
        reference,
        gains,
        motion.realisation,
        motion.duration,
        motion.dt,
        motion.torque_limit,
        plant=plant,
        control_period=motion.control_period,
        method=motion.method,
        diagnostics=True,
        throw=False,
        **on_line,
    )
    numbers = fig5.figures(trajectory)
    title = f"Following a {motion.path} on a {motion.slope_deg:g}° slope: {numbers['status'].replace('_', ' ')}"
    track = spatial_plots.Track(motion.realisation.replace("_", " "), trajectory, fig5.positions(reference, trajectory.time))
    record.picture("simulation", spatial_plots.tracking_figure(title, [track], motion.torque_limit))
    if motion.realisation != "ideal":
        record.picture("simulation_friction", spatial_plots.friction_figure([track]))
    record.finish({"simulation": numbers}, robot=robot, plant=plant, gains=gains, settings=motion)
    print_numbers(numbers)
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


def tune(options: TuneSpatial) -> None:
    """Tune the tracking gains on lines, score them over 20 s with a 1 kHz hold, and draw before and after."""
    settings = options.tuning
    robot, initial = js.spatial.check_spatial_robot(options.robot.make()), options.gains.make()
    require_scalar("slope_deg", settings.slope_deg, above=-90.0, below=90.0, unit="deg")
    slope = math.radians(settings.slope_deg)
    js.require_holdable(robot, slope)
    record = Record(options.out)
    objective = tuning.FollowLine(robot, slope, settings.speeds, settings.duration, settings.dt, settings.torque_limit)
    result = tuning.tune(
        objective,
        initial,
        iterations=settings.iterations,
        starts=settings.starts,
        learning_rate=settings.learning_rate,
        seed=settings.seed,
        gradient=settings.gradient,
        frozen=settings.frozen,
        transforms=fig5.INNER,
        progress=settings.progress,
    )
    result.save(record.folder / "tuning.json")
    runs = {"before": initial, "after": result.gains}
    scored = {
        (name, speed): fig5.score(robot, slope, gains, speed, settings.torque_limit)
        for name, gains in runs.items()
        for speed in settings.speeds
    }
    numbers = {f"{name}, {speed:g} m/s": fig5.figures(run) for (name, speed), run in scored.items()}
    middle = settings.speeds[len(settings.speeds) // 2]
    tracks = [fig5.named(name, scored[name, middle], middle) for name in runs]
    title = f"Before and after tuning, {middle:g} m/s on a {settings.slope_deg:g}° slope, 1 kHz hold"
    record.picture("tuning", spatial_plots.tracking_figure(title, tracks, settings.torque_limit))
    record.picture("tuning_convergence", plotting.convergence_figure(result))
    record.finish({"tuning": {"gains": result.gains, **numbers}}, robot=robot, gains=initial, settings=settings)
    print(result.report())
    print("\nscored over 20 s with a 1 kHz hold:")
    for name, figures in numbers.items():
        rms, worst = float(figures["rms_error_cm"]), float(figures["largest_error_after_5_s_cm"])
        print(f"  {name:<18}{figures['status']:<22} rms {rms:6.2f} cm   worst after 5 s {worst:6.2f} cm")
    print(f"\npictures, tuning.json, metrics.json and manifest.json are in {record.folder}")
