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

SAMPLE = 100
STORE = "map.zarr"


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
    names = ("slope", "travel", "torque_limit", "smoothing", "control_period", "initial_state", "delayed", "sensor_bias")
    task = js.PlanarTask(robot=robot(chosen.robot), **{name: settings[name] for name in names})
    setting = axes.Setting(task, gains, js.Numerics(duration=wanted.duration, dtype=wanted.dtype))
    setting = setting._replace(numerics=replace(setting.numerics, dt=wanted.dt or axes.stable_step(setting, x, y)))
    axes.check(setting, x, y)
    record = Record(chosen.out)
    numbers = (_bound if wanted.of == "bound" else _outcome)(record, setting, x, y, chosen)
    settings = {**vars(wanted), "dt": setting.numerics.dt}
    record.finish({"map": numbers}, robot=task.robot, gains=gains, settings=settings)
    for name, value in numbers.items():
        print(f"  {name:<36}{value}")
    print(f"map.png, metrics.json and manifest.json are in {record.folder}, all nodes in {STORE} there, for js.open_sweep")


def _bound(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, chosen: Any) -> dict[str, Any]:
    wanted = chosen.map
    store = record.folder / STORE
    found = maps.bound_map(setting, x, y, wanted.tolerance, chosen.progress, store, chosen.resume)
    record.picture("map", plots.bound_figure(found, "Steepest slope that the closed loop climbs"))
    numbers: dict[str, Any] = {
        "bounds": found.value.size,
        "rollouts": found.rollouts,
        "rollouts_per_bound": found.rollouts / found.value.size,
        "simulated_seconds": found.seconds,
    }
    climbed = np.isfinite(found.value)
    if climbed.any():
        numbers |= {
            "least_deg": float(np.rad2deg(np.nanmin(found.value))),
            "largest_deg": float(np.rad2deg(np.nanmax(found.value))),
        }
        confirmed, asked = maps.confirm(setting, found, SAMPLE)
        odd, looked = maps.not_monotone(setting, found, SAMPLE)
        numbers |= {"bracket_ends_confirmed_in_full": f"{confirmed} of {asked}", "not_monotone_in_slope": f"{odd} of {looked}"}
    return numbers


def _outcome(record: Record, setting: axes.Setting, x: axes.Axis, y: axes.Axis, chosen: Any) -> dict[str, Any]:
    coarse = chosen.map.coarse if chosen.map.refine else None
    found = maps.outcome_map(setting, x, y, coarse, chosen.progress, record.folder / STORE, chosen.resume)
    at = "" if "slope" in (x.name, y.name) else f" on {chosen.map.slope_deg:g}°"
    record.picture("map", plots.outcome_figure(found, f"How climbs end{at}"))
    rollouts = int(found.simulated.sum())
    counts = {plots.CLASSES[code][0]: int(np.sum(found.outcome == code)) for code in np.unique(found.outcome)}
    return {"nodes": found.outcome.size, "simulated": rollouts, "times_fewer": found.outcome.size / rollouts, **counts}


MapOptions = options("MapOptions", Map, js.PlanarTask, without=("robot", "plant", "disturbance", "convention"))
COMMANDS = {
    "map": command(
        draw,
        robot=RobotOptions,
        gains=PlanarGains,
        map=MapOptions,
        resume=(bool, False, f"Finish the map that OUT/{STORE} holds"),
        progress=(bool, True, "Show a progress bar"),
    )
}
