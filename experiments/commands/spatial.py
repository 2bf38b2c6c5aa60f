"""`jaxsphere simulate spatial` and `jaxsphere tune spatial`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import jaxsphere as js
import tuning
from experiments import fig5, lines, plotting, spatial_plots
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
    """Tune the tracking gains on lines, score them at these and at held-out speeds, and draw before and after."""
    settings = options.tuning
    robot, initial = js.spatial.check_spatial_robot(options.robot.make()), options.gains.make()
    require_scalar("slope_deg", settings.slope_deg, above=-90.0, below=90.0, unit="deg")
    slope = math.radians(settings.slope_deg)
    js.require_holdable(robot, slope)
    record = Record(options.out)
    objective = tuning.FollowLine(
        robot,
        slope,
        settings.speeds,
        settings.duration,
        settings.dt,
        settings.torque_limit,
        lean_limit=math.radians(settings.lean_limit_deg),
        friction_limit=settings.friction_limit,
        starts=lines.TRAINING_STARTS,
        settled_after=0.5 * settings.duration,
    )
    objective.check()
    for name in ("validation_speeds", "held_out_speeds"):
        if not getattr(settings, name):
            raise ValueError(f"{name} = () leaves nothing to score; type at least one speed in m/s, e.g. 0.35")
    result = lines.search(
        objective,
        initial,
        settings.validation_speeds,
        optimiser=settings.optimiser,
        iterations=settings.iterations,
        starts=settings.starts,
        learning_rate=settings.learning_rate,
        seed=settings.seed,
        gradient=settings.gradient,
        frozen=settings.frozen,
        progress=settings.progress,
        checkpoint=settings.checkpoint,
        resume=settings.resume,
    )
    result.save(record.folder / "tuning.json")
    runs = {"before": initial, "after": result.gains}
    sets = {"tuned on": (settings.speeds, lines.TRAINING_STARTS), "held out": (settings.held_out_speeds, lines.HELD_OUT_STARTS)}
    scored = {
        name: lines.score(robot, slope, list(runs.values()), speeds, settings.torque_limit, starts)
        for name, (speeds, starts) in sets.items()
    }
    middle = settings.speeds[len(settings.speeds) // 2]
    tracks = [
        fig5.named(name, fig5.score(robot, slope, gains, middle, settings.torque_limit), middle) for name, gains in runs.items()
    ]
    numbers = {name: lines.numbers(sets[name][0], found) for name, found in scored.items()}
    terms = {name: objective.terms(gains)._asdict() for name, gains in runs.items()}
    title = f"Before and after tuning, {middle:g} m/s on a {settings.slope_deg:g}° slope, 1 kHz hold"
    record.picture("tuning", spatial_plots.tracking_figure(title, tracks, settings.torque_limit))
    curves = [(name, sets[name][0], *lines.means(found)[:2]) for name, found in scored.items()]
    title = f"Speeds tuned on and held out, {settings.slope_deg:g}° slope, |τ| ≤ {settings.torque_limit:g} N m, 1 kHz hold"
    record.picture("tuning_speeds", spatial_plots.speeds_figure(title, curves))
    record.picture("tuning_convergence", plotting.convergence_figure(result))
    record.finish({"tuning": {"gains": result.gains, "terms": terms, **numbers}}, robot=robot, gains=initial, settings=settings)
    print(result.report())
    print(f"chosen among the starts' answers at {', '.join(f'{v:g}' for v in settings.validation_speeds)} m/s")
    print("\nscored over 20 s with a 1 kHz hold from 2 starts (tuned on) or 3 (held out); means over the lanes that end early")
    print("with neither gains:")
    for name, found in scored.items():
        print("\n".join(["", *lines.table(name, sets[name][0], found)]))
    print(f"\npictures, tuning.json, metrics.json and manifest.json are in {record.folder}")
