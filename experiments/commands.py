"""What each subcommand does, in terms of the library."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp

import jaxsphere as js
import tuning
from experiments import benchmark, fig4, fig5, plotting, spatial_plots
from experiments.records import Record
from jaxsphere.checks import require_choice, require_count, require_scalar

if TYPE_CHECKING:
    from experiments.cli import SimulatePlanar, SimulateSpatial, TunePlanar, TuneSpatial

EXPERIMENTS = {"fig4": fig4.reproduce, "fig5": fig5.reproduce}


def reproduce(names: tuple[str, ...], out: str, progress: bool) -> None:
    """Run the named experiments, or all."""
    for name in names:
        require_choice("experiment", name, tuple(EXPERIMENTS))
    record = Record(out)
    metrics = {}
    for name in names or EXPERIMENTS:
        print(f"reproducing {name} ...", flush=True)
        metrics[name] = EXPERIMENTS[name](record, progress)
        print(_summary(name, metrics[name]))
        record.finish(metrics, robot=js.Robot(), gains=js.SlidingModeGains())
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


def simulate_planar(options: SimulatePlanar) -> None:
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
    _print_numbers(numbers)
    print(f"simulation.png, metrics.json and manifest.json are in {record.folder}")


def tune_planar(options: TunePlanar) -> None:
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
        _print_numbers(figures)
    print(f"\npictures, tuning.json, metrics.json and manifest.json are in {record.folder}")


def simulate_spatial(options: SimulateSpatial) -> None:
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
    _print_numbers(numbers)
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


def tune_spatial(options: TuneSpatial) -> None:
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


def bench(case: str, lanes: int | None, steps: int, out: str) -> None:
    """Run one benchmark."""
    require_choice("case", case, tuple(benchmark.CASES))
    if lanes is not None:
        require_count("lanes", lanes)
    require_count("steps", steps)
    record = Record(out)
    run, default = benchmark.CASES[case]
    lanes = lanes or default
    record.finish({case: run(record, lanes, steps)}, settings={"case": case, "lanes": lanes, "steps": steps})


def _print_numbers(numbers: dict[str, Any]) -> None:
    for name, value in numbers.items():
        print(f"  {name:<36}{_shown(value)}")


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return value
    array = jnp.asarray(value)
    return f"{float(array):.4g}" if array.ndim == 0 else " ... ".join(f"{float(entry):.4g}" for entry in array)


def _summary(name: str, metrics: dict[str, Any]) -> str:
    lines = [f"{name}:"]
    for row in metrics.pop("summary"):
        lines.append("  " + row)
    return "\n".join(lines)
