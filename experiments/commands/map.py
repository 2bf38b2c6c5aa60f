"""`jaxsphere map`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxsphere as js
from experiments import climbing_axes as axes
from experiments import climbing_map as maps
from experiments import climbing_plots as plots
from experiments.records import Record
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.files import write_atomically

if TYPE_CHECKING:
    from experiments.cli import Map

SAMPLE = 100


def draw(options: Map) -> None:
    """Find the map, print what it took, save it as numbers and as a picture."""
    wanted = options.map
    require_choice("of", wanted.of, ("bound", "outcome"))
    require_choice("dtype", wanted.dtype, ("float64", "float32"))
    require_count("size", wanted.size)
    if wanted.coarse is not None:
        require_count("coarse", wanted.coarse)
    require_scalar("tolerance", wanted.tolerance, above=0.0, unit="rad")
    require_scalar("slope_deg", wanted.slope_deg, above=-90.0, below=90.0, unit="deg")
    if wanted.x == wanted.y:
        raise ValueError(f"x and y are both {wanted.x}; type two different axes, e.g. --x z_u --y pendulum_mass")
    if wanted.of == "bound" and "slope" in (wanted.x, wanted.y):
        raise ValueError("slope is what a map of the bound finds; type --of outcome, or another axis")
    x, y = (
        axes.axis(name, wanted.size, *(ends or ())) for name, ends in ((wanted.x, wanted.x_range), (wanted.y, wanted.y_range))
    )
    climb = js.Climb(
        robot=options.robot.make(),
        gains=options.gains.make(),
        travel=wanted.travel,
        torque_limit=wanted.torque_limit,
        smoothing=wanted.smoothing,
        duration=wanted.duration,
        control_period=wanted.control_period,
    )
    climb = replace(climb, dt=wanted.dt or axes.stable_step(climb, x, y))
    setting = axes.Setting(climb, float(np.deg2rad(wanted.slope_deg)), wanted.dtype)
    axes.check(setting, x, y)
    record = Record(options.out)
    numbers = (_bound if wanted.of == "bound" else _outcome)(record, setting, x, y, options)
    settings = {**vars(wanted), "dt": climb.dt}
    record.finish({"map": numbers}, robot=climb.robot, gains=climb.gains, settings=settings)
    for name, value in numbers.items():
        print(f"  {name:<36}{value}")
    print(f"map.png, map.npz, metrics.json and manifest.json are in {record.folder}")


def _bound(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, options: Map) -> dict[str, Any]:
    wanted = options.map
    found = maps.bound_map(setting, x, y, wanted.tolerance, options.progress)
    _save(record, x, y, bound=found.value, lower=found.lower, upper=found.upper, status=found.status)
    record.picture("map", plots.bound_figure(found, "Steepest slope that the closed loop climbs"))
    done = int(np.sum(found.status >= 0))
    numbers = {
        "finished": str(found.finished).lower(),
        "bounds": done,
        "rollouts": found.rollouts,
        "rollouts_per_bound": found.rollouts / max(done, 1),
        "simulated_seconds": found.seconds,
    }
    climbed = np.isfinite(found.value)
    if climbed.any():
        numbers |= {
            "least_deg": float(np.rad2deg(np.nanmin(found.value))),
            "largest_deg": float(np.rad2deg(np.nanmax(found.value))),
        }
    if climbed.any() and found.finished:
        confirmed, asked = maps.confirm(setting, found, SAMPLE)
        odd, looked = maps.not_monotone(setting, found, SAMPLE)
        numbers |= {"bracket_ends_confirmed_in_full": f"{confirmed} of {asked}", "not_monotone_in_slope": f"{odd} of {looked}"}
    return numbers


def _outcome(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, options: Map) -> dict[str, Any]:
    coarse = options.map.coarse if options.map.refine else None
    found = maps.outcome_map(setting, x, y, coarse)
    _save(record, x, y, outcome=found.outcome, simulated=found.simulated)
    at = "" if "slope" in (x.name, y.name) else f" on {options.map.slope_deg:g}°"
    record.picture("map", plots.outcome_figure(found, f"How climbs end{at}"))
    rollouts = int(found.simulated.sum())
    counts = {plots.CLASSES[code][0]: int(np.sum(found.outcome == code)) for code in np.unique(found.outcome)}
    return {"nodes": found.outcome.size, "simulated": rollouts, "times_fewer": found.outcome.size / rollouts, **counts}


def _save(record: Record, x: axes.Axis, y: axes.Axis, **arrays: np.ndarray) -> None:
    content = {**arrays, "x": x.values, "y": y.values, "x_name": np.array(x.name), "y_name": np.array(y.name)}
    write_atomically(record.folder / "map.npz", lambda path: np.savez_compressed(path, **content))  # type: ignore[arg-type]
