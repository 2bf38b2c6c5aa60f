"""Fig. 5: tracking y = x on 10 degrees. The paper's claim, each reading of its controller on the robot, and tuned gains."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments.plots import tracking
from experiments.plots.search import convergence_figure
from experiments.plots.tracking import Track
from experiments.records import Record
from experiments.studies import lines
from experiments.studies.settings import TRAINING_SPEEDS

SLOPE = float(np.deg2rad(10.0))
SPEEDS = (0.2, 0.5, 1.0)
DURATION = 20.0
TORQUE_LIMIT = 5.0
CONTROL_PERIOD = 1e-3
START = (0.3, 0.1)  # Table 4, m
SETTLED = 5.0  # s, when the first errors that count as late are looked at

ZOOM = 2.0  # m of the path

# Of the search, the first of them Table 4; `jaxsphere tune spatial` takes more.
TUNING_STARTS = 3


def reproduce(record: Record, progress: bool = True) -> dict[str, Any]:
    """Run the experiment, save its pictures into `record` and return its numbers."""
    table = js.TABLE_4
    ideal = {speed: _line(table, speed, "ideal") for speed in SPEEDS}
    robot = {speed: _line(table, speed, diagnostics=True) for speed in SPEEDS}
    aligned = {speed: _line(js.TrackingGains(), speed, "axis_aligned", diagnostics=True) for speed in SPEEDS}
    readings = {name: _line(table, 0.5, name) for name in ("exact", "pseudo_inverse")}
    objective = tuning.FollowLine(slope=SLOPE, speeds=TRAINING_SPEEDS, starts=lines.TRAINING_STARTS)
    settings: dict[str, Any] = {"starts": TUNING_STARTS, "progress": progress}
    result = lines.search(objective, js.TrackingGains(), iterations=10, **settings)
    result.save(record.folder / "fig5_tuning.json")
    tuned = {speed: _line(result.gains, speed, "axis_aligned") for speed in SPEEDS}

    pictures = _pictures(ideal, robot, aligned, tuned, readings) | {"fig5_tuning": convergence_figure(result)}
    for name, picture in pictures.items():
        record.picture(name, picture)
    runs = {
        "ideal": {f"{v:g} m/s": figures(run) | {"largest_deviation_from_59_m": _from_59(run, v)} for v, run in ideal.items()},
        "pendulum_attitude": {f"{v:g} m/s": figures(run) for v, run in robot.items()},
        "axis_aligned": {f"{v:g} m/s": figures(run) for v, run in aligned.items()},
        **{name: figures(run) for name, run in readings.items()},
        "tuned": {f"{v:g} m/s": figures(run) for v, run in tuned.items()},
        "curves, pendulum_attitude": {name: figures(run) for name, run in _curves(table, "pendulum_attitude").items()},
        "curves, axis_aligned": {name: figures(run) for name, run in _curves(js.TrackingGains(), "axis_aligned").items()},
    }
    return {
        "summary": _summary(runs),
        **runs,
        "tuned_gains": result.gains,
        "zero_dynamics_poles": jnp.real(js.tracking.zero_dynamics_poles(js.Robot(), SLOPE)),
    }


Runs = dict[float, js.Trajectory]


def _pictures(ideal: Runs, robot: Runs, aligned: Runs, tuned: Runs, readings: dict[str, js.Trajectory]) -> dict[str, Any]:
    return {
        "fig5_ideal": tracking.tracking_figure(
            "The claim: v' = u with no torques (“ideal”), Table 4",
            [named(f"{v:g} m/s", ideal[v], v) for v in SPEEDS],
            zoom=ZOOM,
        ),
        "fig5": _robot_figure("pendulum attitude, Table 4", robot),
        "fig5_realisations": tracking.realisations_figure(
            "Three readings of the controller on the robot at 0.5 m/s, |τ| ≤ 5 N m",
            [named(name.replace("_", " "), run, 0.5) for name, run in {**readings, "pendulum_attitude": robot[0.5]}.items()],
            until=2.5,
        ),
        "fig5_aligned": _robot_figure("axis aligned", aligned),
        "fig5_tuned": tracking.tracking_figure(
            "Pendulum attitude with Table 4 against axis aligned at 0.5 m/s, |τ| ≤ 5 N m, 1 kHz hold",
            [
                named("pendulum attitude, Table 4", robot[0.5], 0.5),
                named("axis aligned", aligned[0.5], 0.5),
                named("axis aligned, tuned", tuned[0.5], 0.5),
            ],
            TORQUE_LIMIT,
            ZOOM,
        ),
        "fig5_friction": tracking.friction_figure(
            "Friction that rolling without slip needs: axis aligned, 10° slope",
            [named(f"{v:g} m/s", aligned[v], v) for v in SPEEDS],
        ),
    }


def _robot_figure(law: str, runs: dict[float, js.Trajectory]) -> Any:
    title = f"The robot: {law}, |τ| ≤ 5 N m, 1 kHz hold, 10° slope"
    return tracking.tracking_figure(title, [named(f"{v:g} m/s", run, v) for v, run in runs.items()], TORQUE_LIMIT, ZOOM)


def figures(trajectory: js.Trajectory) -> dict[str, Any]:
    """Name the figures of merit of one tracking trajectory."""
    metrics = trajectory.metrics
    numbers: dict[str, Any] = {
        "status": js.Status(int(trajectory.status)).name.lower(),
        "end_time_s": trajectory.end_time,
        "rms_error_cm": 100.0 * metrics.rms_error,
        "largest_error_after_5_s_cm": 100.0 * float(metrics.late_error) if trajectory.end_time > SETTLED else None,
        "final_error_cm": 100.0 * metrics.final_error,
        "largest_lean_deg": jnp.rad2deg(metrics.peak_lean),
    }
    if trajectory.torque.shape[-1] == 2:
        numbers["peak_torque_Nm"] = metrics.peak_torque
    if trajectory.diagnostics is not None and trajectory.diagnostics.contact is not None:
        numbers["friction_coefficient_needed"] = jnp.max(trajectory.diagnostics.contact.friction_coefficient)
        numbers["least_lean_margin"] = jnp.min(trajectory.diagnostics.signals.lean.margin)
    return numbers


def score(robot: js.Robot, slope: float, gains: js.TrackingGains, speed: float, torque_limit: float) -> js.Trajectory:
    """Follow y = x from Table 4's start for 20 s with a 1 kHz hold, whatever the gains were tuned with."""
    options: dict[str, Any] = {"control_period": CONTROL_PERIOD, "save_every": 10, "throw": False}
    return js.track_line(robot, slope, gains, speed, duration=DURATION, torque_limit=torque_limit, **options)


def _line(gains: js.TrackingGains, speed: float, realisation: str = "pendulum_attitude", **options: Any) -> js.Trajectory:
    hold = None if realisation == "ideal" else CONTROL_PERIOD
    run = partial(js.track_line, js.Robot(), SLOPE, gains, speed, realisation, DURATION, torque_limit=TORQUE_LIMIT)
    return run(control_period=hold, save_every=10, throw=False, **options)


def _curves(gains: js.TrackingGains, realisation: str) -> dict[str, js.Trajectory]:
    law = {"gains": gains, "realisation": realisation}
    run = partial(js.track, js.Robot(), SLOPE, **law, duration=DURATION, torque_limit=TORQUE_LIMIT)
    curves = {
        "circle of 1 m at 0.5 m/s": js.references.circle(1.0, 0.5),
        "eight in 15 s": js.references.figure_eight(1.0, 15.0),
        "eight in 10 s": js.references.figure_eight(1.0, 10.0),
    }
    options: dict[str, Any] = {"control_period": CONTROL_PERIOD, "save_every": 10, "throw": False}
    return {name: run(reference=reference, **options) for name, reference in curves.items()}


def positions(reference: js.references.ReferenceFunction, time: jax.Array) -> np.ndarray:
    """Positions (T, 2) of a reference at the times (T,), m."""
    return np.stack([np.asarray(x) for x in jax.vmap(reference)(time).position], axis=-1)


def named(label: str, trajectory: js.Trajectory, speed: float) -> Track:
    """Trajectory along y = x with its label and reference."""
    return Track(label, trajectory, positions(js.references.line(speed), trajectory.time))


def _from_59(trajectory: js.Trajectory, speed: float) -> float:
    """Largest distance (m) of e(t) from the solution of (59) with Table 4's double pole at -7 1/s."""
    time = np.asarray(trajectory.time)[:, None]
    rate = -speed * np.sqrt(0.5) * np.ones(2)
    solution = (np.array(START) + (rate + 7.0 * np.array(START)) * time) * np.exp(-7.0 * time)
    error = np.asarray(trajectory.state)[:, :2] - named("", trajectory, speed).reference
    return float(np.max(np.hypot(*(error - solution).T)))


def _summary(runs: dict[str, Any]) -> list[str]:
    rows = [f"{'run':<46} {'status':<19}    ends        rms     worst after 5 s"]
    flat = {name: run for name, run in runs.items() if "status" in run}
    nested = {f"{name}, {key}": run for name, group in runs.items() if "status" not in group for key, run in group.items()}
    for name, run in {**nested, **flat}.items():
        worst = run["largest_error_after_5_s_cm"]
        late = "        -" if worst is None else f"{worst:9.3f} cm"
        rows.append(
            f"{name:<46} {run['status']:<19} {float(run['end_time_s']):5.2f} s {float(run['rms_error_cm']):7.2f} cm {late}"
        )
    return rows
