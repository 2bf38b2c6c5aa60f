"""`jaxsphere map`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import jaxsphere as js
from experiments.cli.options import RobotOptions, arguments, command, options, robot
from experiments.cli.simulate import PlanarGains
from experiments.plots import climbing as plots
from experiments.records import Record
from experiments.studies import climbing_axes as axes
from experiments.studies import climbing_map as maps
from experiments.studies.settings import Map
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.files import write_atomically

SAMPLE = 100


def draw(chosen: Any) -> None:
    """Find the map, print what it took, save it as numbers and as a picture."""
    wanted, settings = chosen.map, arguments(chosen.map)
    require_choice("of", wanted.of, ("bound", "outcome"))
    require_choice("dtype", wanted.dtype, ("float64", "float32"))
    require_count("size", wanted.size)
    if wanted.coarse is not None:
        require_count("coarse", wanted.coarse)
    require_scalar("tolerance", wanted.tolerance, above=0.0, unit="rad")
    if wanted.x == wanted.y:
        raise ValueError(f"x and y are both {wanted.x}; type two different axes, e.g. --x z_u --y pendulum_mass")
    if wanted.of == "bound" and "slope" in (wanted.x, wanted.y):
        raise ValueError("slope is what a map of the bound finds; type --of outcome, or another axis")
    x, y = (
        axes.axis(name, wanted.size, *(ends or ())) for name, ends in ((wanted.x, wanted.x_range), (wanted.y, wanted.y_range))
    )
    gains = js.SlidingModeGains(**arguments(chosen.gains))
    names = ("travel", "torque_limit", "smoothing", "duration", "control_period")
    climb = js.Climb(robot=robot(chosen.robot), gains=gains, **{name: settings[name] for name in names})
    climb = replace(climb, dt=wanted.dt or axes.stable_step(climb, x, y))
    setting = axes.Setting(climb, settings["slope"], wanted.dtype)
    axes.check(setting, x, y)
    record = Record(chosen.out)
    numbers = (_bound if wanted.of == "bound" else _outcome)(record, setting, x, y, chosen)
    settings = {**vars(wanted), "dt": climb.dt}
    record.finish({"map": numbers}, robot=climb.robot, gains=climb.gains, settings=settings)
    for name, value in numbers.items():
        print(f"  {name:<36}{value}")
    print(f"map.png, map.npz, metrics.json and manifest.json are in {record.folder}")


def _bound(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, chosen: Any) -> dict[str, Any]:
    wanted = chosen.map
    found = maps.bound_map(setting, x, y, wanted.tolerance, chosen.progress)
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


def _outcome(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, chosen: Any) -> dict[str, Any]:
    coarse = chosen.map.coarse if chosen.map.refine else None
    found = maps.outcome_map(setting, x, y, coarse)
    _save(record, x, y, outcome=found.outcome, simulated=found.simulated)
    at = "" if "slope" in (x.name, y.name) else f" on {chosen.map.slope_deg:g}°"
    record.picture("map", plots.outcome_figure(found, f"How climbs end{at}"))
    rollouts = int(found.simulated.sum())
    counts = {plots.CLASSES[code][0]: int(np.sum(found.outcome == code)) for code in np.unique(found.outcome)}
    return {"nodes": found.outcome.size, "simulated": rollouts, "times_fewer": found.outcome.size / rollouts, **counts}


def _save(record: Record, x: axes.Axis, y: axes.Axis, **arrays: np.ndarray) -> None:
    content = {**arrays, "x": x.values, "y": y.values, "x_name": np.array(x.name), "y_name": np.array(y.name)}
    write_atomically(record.folder / "map.npz", lambda path: np.savez_compressed(path, **content))  # type: ignore[arg-type]


MapOptions = options("MapOptions", Map, js.Climb, without=("robot", "gains", "plant", "early", "disturbance"))
COMMANDS = {
    "map": command(draw, robot=RobotOptions, gains=PlanarGains, map=MapOptions, progress=(bool, True, "Show a progress bar"))
}
