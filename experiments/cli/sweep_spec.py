"""A sweep as a TOML file: the task, its robot, gains and settings, and the axes along which they vary.

    task = "rest_to_rest"                  # or "track_line"
    outputs = ["settling_time"]            # all of the task by default
    dtype = "float64"                      # or "float32"
    [robot], [plant], [gains], [settings]  # options of `jaxsphere simulate`, under the same names with underscores
    [[axes]]                               # one or more; all combinations are swept, the last axis varies fastest

An axis is one of

    name = "slope_deg"             grid = {from = 0, to = 20, count = 41, scale = "log"}      (linear by default)
    name = "robot.pendulum_mass"   values = [1.8, 2.0, 2.2]
    zip = [{name = "gains.c1", values = [0.4, 0.8]}, {name = "gains.c2", values = [2, 4]}]
    latin_hypercube = {"gains.c1" = [0.4, 0.8], "gains.c2" = [2, 4]}   count = 100   seed = 0   scale = "log"
    uniform = {"initial_state.2" = [0, 0.5]}                           count = 100   seed = 0
    normal = {"robot.pendulum_mass" = [2.05, 0.1]}                     count = 100   seed = 0     (mean, standard deviation)

A name that ends in _deg is in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

import jaxsphere as js
from experiments.cli import options
from experiments.cli.simulate import SPATIAL_OBJECTS, PlanarGains, PlanarMotion, SpatialGains
from experiments.cli.spec import fill, read_toml
from jaxsphere.checks import require_choice
from jaxsphere.sweep.axes import Axis

KINDS = ("grid", "values", "zip", "latin_hypercube", "uniform", "normal")


@dataclass(frozen=True)
class SweepSpec:
    """What `js.sweep` needs, and the names of the outputs to keep (none for all)."""

    task: Callable[..., js.Trajectory]
    base: dict[str, Any]
    axes: tuple[Axis, ...]
    outputs: tuple[str, ...]
    chunk: int | None


def read_spec(path: str | Path) -> SweepSpec:
    """Read a sweep from a TOML file. Raises ValueError with one sentence for what is not admissible."""
    content = read_toml(str(path))
    _require_known("the spec", content, ("task", "outputs", "dtype", "chunk", "robot", "plant", "gains", "settings", "axes"))
    task = content.get("task", "rest_to_rest")
    require_choice("task", task, tuple(_TASKS))
    dtype = content.get("dtype", "float64")
    require_choice("dtype", dtype, ("float64", "float32"))
    outputs = content.get("outputs", [])
    if not isinstance(outputs, list) or not all(isinstance(name, str) for name in outputs):
        raise ValueError(f"outputs = {outputs!r} is no list of names; type e.g. ['settling_time']")
    base = _base(content, task) | {"dtype": np.dtype(dtype).type, "save_every": None, "throw": False}
    tables = content.get("axes", [])
    if not isinstance(tables, list) or not tables:
        raise ValueError("the spec has no axes and gives no lanes; type [[axes]] with e.g. name and values")
    axes = js.axes.product(*(_axis(table) for table in tables))
    for leaf in (column.leaf for axis in axes for column in axis.columns):
        require_choice("name of an axis", leaf.split(".")[0], tuple(name for name in base if name not in _FIXED))
    return SweepSpec(_TASKS[task], base, axes, tuple(outputs), content.get("chunk"))


def _base(content: Mapping[str, Any], task: str) -> dict[str, Any]:
    """Return the arguments of a task that the spec's tables give."""
    spatial = task == "track_line"
    robot = options.robot(_section("robot", content, options.RobotOptions))
    if spatial:
        js.spatial.check_spatial_robot(robot)
    check: Any
    kind: Any
    check, kind = (js.tracking.check_gains, js.TrackingGains) if spatial else (js.sliding_mode.check_gains, js.SlidingModeGains)
    gains = options.arguments(_section("gains", content, SpatialGains if spatial else PlanarGains))
    plant = options.robot(_section("plant", content, options.RobotOptions), robot, "plant") if "plant" in content else None
    settings = options.arguments(_section("settings", content, LineSettings if spatial else PlanarMotion))
    return {"robot": robot, "plant": plant, **settings, "gains": check(kind(**gains))}


LineSettings = options.options("LineSettings", js.track_line, js.track, without=SPATIAL_OBJECTS)
_TASKS = {"rest_to_rest": js.rest_to_rest, "track_line": js.track_line}
_FIXED = ("duration", "dt", "convention", "method", "realisation", "control_period", "dtype", "save_every", "throw")


def _section(name: str, content: Mapping[str, Any], kind: type) -> Any:
    """Options of one TOML table. Raises ValueError for a key that is none of them and for a value of another kind."""
    table = content.get(name, {})
    _require_known(f"[{name}]", table, tuple(leaf.name for leaf in fields(kind)))
    return fill(kind(), table, f"[{name}]")


def _axis(table: Any) -> Axis:
    kind = next((kind for kind in KINDS if isinstance(table, dict) and kind in table), None)
    if kind is None:
        raise ValueError(f"axis {table!r} is not admissible; give it one of {', '.join(KINDS)}")
    if kind == "zip":
        _require_known("a zip axis", table, ("zip", "name"))
        if not isinstance(table["zip"], list):
            raise ValueError(f"zip = {table['zip']!r} is no list of axes; type zip = [{{name = ..., values = ...}}, ...]")
        return js.axes.zipped(*(_axis(inner) for inner in table["zip"]), name=table.get("name"))
    if kind in ("grid", "values"):
        _require_known(f"a {kind} axis", table, ("name", kind))
        name = _wanted(table, "name", f"a {kind} axis")
        leaf, unit = _leaf(name)
        return js.axes.listed(leaf, table["values"], unit) if kind == "values" else _grid(name, table["grid"], leaf, unit)
    known = (kind, "count", "seed", "name") + (("scale",) if kind == "latin_hypercube" else ())
    _require_known(f"a {kind} axis", table, known)
    if not isinstance(table[kind], dict) or not table[kind]:
        raise ValueError(f'{kind} = {table[kind]!r} names no leaf; type e.g. {kind} = {{"gains.c1" = [0.4, 0.8]}}')
    count = _wanted(table, "count", f"a {kind} axis")
    make: Any = getattr(js.axes, kind)
    options = {"log": _is_log(table)} if kind == "latin_hypercube" else {}
    # Every leaf has draws of its own name, so that one axis for each, zipped, is one axis for all.
    parts = []
    for name, ends in table[kind].items():
        leaf, unit = _leaf(name)
        parts.append(make({leaf: ends}, count, table.get("seed", 0), unit=unit, **options))
    return js.axes.zipped(*parts, name=table.get("name", parts[0].name))


def _grid(name: str, grid: Any, leaf: str, unit: str | None) -> Axis:
    where = f"grid of {name!r}"
    _require_known(where, grid, ("from", "to", "count", "scale"))
    make = js.axes.logarithmic if _is_log(grid) else js.axes.linear
    return make(leaf, _wanted(grid, "from", where), _wanted(grid, "to", where), _wanted(grid, "count", where), unit)


def _is_log(table: Mapping[str, Any]) -> bool:
    scale = table.get("scale", "linear")
    require_choice("scale", scale, ("linear", "log"))
    return scale == "log"


def _leaf(name: Any) -> tuple[str, str | None]:
    if not isinstance(name, str):
        raise ValueError(f"name = {name!r} of an axis is no name; type e.g. 'slope_deg' or 'robot.pendulum_mass'")
    return (name.removesuffix("_deg"), "deg") if name.endswith("_deg") else (name, None)


def _wanted(table: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in table:
        raise ValueError(f"{where} has no {key!r}; type it")
    return table[key]


def _require_known(where: str, table: Any, known: tuple[str, ...]) -> None:
    if not isinstance(table, dict):
        raise ValueError(f"{where} = {table!r} is no table; type some of {', '.join(known)}")
    unknown = next((key for key in table if key not in known), None)
    if unknown is not None:
        raise ValueError(f"{unknown!r} in {where} is unknown; type one of {', '.join(known)}")
