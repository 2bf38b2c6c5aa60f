"""Axes of a sweep: which numbers of a lane's arguments vary, and the value of each from the number of the lane alone.

    lane       absolute number of a lane, 0 ... lanes - 1; the last axis varies fastest
    position   of a lane along one axis, 0 ... length - 1
    leaf       dotted name of one number among the arguments: "slope", "robot.pendulum_mass", "initial_state.2"

An axis is a handful of numbers however long it is. Values are in the unit of the leaf (rad, kg, m, s, N m), or in degrees with
unit="deg"; lanes then get radians.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from jaxsphere.checks import require_count
from jaxsphere.sweep import draws
from jaxsphere.units import unit_of

Ends = tuple[float, float]
_UNIT = re.compile(r"(\d|deg|rad|kg|m|s|N|J|W|A|V|Hz|[ ()/*^-])*")  # what an SI unit is written with


@dataclass(frozen=True)
class Column:
    """The values of one leaf along an axis.

    leaf: its name. kind: one of `_KINDS`. numbers: the ends of a range, mean and standard deviation, or the listed values, in
    `unit`. count: of positions. seed: of draws.
    """

    leaf: str
    kind: str
    numbers: tuple[float, ...]
    count: int
    unit: str
    seed: int = 0


@dataclass(frozen=True)
class Axis:
    """One dimension of a sweep: its name, its length and the columns (one a leaf) that vary together along it."""

    name: str
    length: int
    columns: tuple[Column, ...]


class _Kind(NamedTuple):
    values: Callable[[Column, np.ndarray, np.ndarray], np.ndarray]  # (column, positions, lanes) -> values, in its unit
    by_lane: bool = False  # a value of its own in every lane, not in every position


def linear(leaf: str, start: float, stop: float, count: int, unit: str | None = None) -> Axis:
    """Axis of `count` values evenly from `start` to `stop`, both included."""
    return _single(leaf, "linear", (start, stop), count, unit)


def logarithmic(leaf: str, start: float, stop: float, count: int, unit: str | None = None) -> Axis:
    """Axis of `count` values from `start` to `stop` at a constant ratio. Raises ValueError unless both are positive."""
    _require_positive(leaf, (start, stop))
    return _single(leaf, "logarithmic", (start, stop), count, unit)


def listed(leaf: str, values: Sequence[float], unit: str | None = None) -> Axis:
    """Axis of the listed values. Raises ValueError when there are none."""
    numbers = tuple(np.ravel(np.asarray(_numbers(leaf, values))).tolist())
    if not numbers:
        raise ValueError(f"axis {leaf!r} has no values and gives zero lanes; type at least one value")
    return _single(leaf, "listed", numbers, len(numbers), unit)


def latin_hypercube(
    ranges: Mapping[str, Ends],
    count: int,
    seed: int = 0,
    *,
    log: bool = False,
    unit: str | None = None,
    name: str = "sample",
) -> Axis:
    """Axis of `count` samples of several leaves: each of `count` equal cells of every range holds exactly one sample.

    The sample depends on the position along this axis, so other axes meet the same samples. ranges: leaf -> (low, high).
    log: cells equal in the logarithm. name: of the axis.
    """
    kind = "latin_logarithmic" if log else "latin"
    return _drawn(name, kind, {leaf: _range(leaf, ends, log) for leaf, ends in ranges.items()}, count, seed, unit)


def uniform(ranges: Mapping[str, Ends], count: int, seed: int = 0, *, unit: str | None = None, name: str = "draw") -> Axis:
    """Axis of `count` independent draws of every leaf of `ranges` (leaf -> (low, high)), another one in every lane."""
    return _drawn(name, "uniform", {leaf: _range(leaf, ends) for leaf, ends in ranges.items()}, count, seed, unit)


def normal(spreads: Mapping[str, Ends], count: int, seed: int = 0, *, unit: str | None = None, name: str = "draw") -> Axis:
    """Axis of `count` normal draws of every leaf of `spreads` (leaf -> (mean, deviation)), another one in every lane."""
    numbers = {leaf: _numbers(leaf, pair, 2) for leaf, pair in spreads.items()}
    for leaf, (_, deviation) in numbers.items():
        if deviation < 0.0:
            raise ValueError(f"axis {leaf!r} has the standard deviation {deviation:g}; type one of at least 0")
    return _drawn(name, "normal", numbers, count, seed, unit)


def zipped(*axes: Axis, name: str | None = None) -> Axis:
    """Vary several axes of equal length together, as one. Raises ValueError when their lengths differ."""
    if len({axis.length for axis in axes}) != 1:
        listing = ", ".join(f"{axis.name!r} has {axis.length}" for axis in axes) or "there are none"
        raise ValueError(f"zipped axes must be equally long, but {listing}; type axes of one length, or js.axes.product")
    columns = tuple(column for axis in axes for column in axis.columns)
    return Axis(name or " & ".join(dict.fromkeys(axis.name for axis in axes)), axes[0].length, columns)


def product(*axes: Axis | Sequence[Axis]) -> tuple[Axis, ...]:
    """Every combination of the axes; the last varies fastest. Raises ValueError for a leaf or an axis that comes twice."""
    flat: list[Axis] = []
    for axis in axes:
        flat.extend([axis] if isinstance(axis, Axis) else axis)
    if not flat:
        raise ValueError("axes = () give no lanes; type at least one, e.g. js.axes.linear('slope', 0.0, 0.3, 31)")
    for axis in flat:
        if not isinstance(axis, Axis):
            raise TypeError(f"axis = {axis!r} is no axis; type e.g. js.axes.linear('slope', 0.0, 0.3, 31)")
    _require_distinct("leaf", [column.leaf for axis in flat for column in axis.columns], "vary it along one axis only")
    _require_distinct("axis", [axis.name for axis in flat], "type name=... to tell them apart")
    return tuple(flat)


def shape(axes: Sequence[Axis]) -> tuple[int, ...]:
    """Lengths of the axes."""
    return tuple(axis.length for axis in axes)


def lane_count(axes: Sequence[Axis]) -> int:
    """How many lanes the product of the axes has."""
    return math.prod(shape(axes))


def values_at(axes: Sequence[Axis], lanes: np.ndarray) -> dict[str, np.ndarray]:
    """Leaf -> its values (n,) in the lanes (n,), in the unit of the axis."""
    positions = np.unravel_index(lanes, shape(axes))
    return {
        column.leaf: _KINDS[column.kind].values(column, position, lanes)
        for axis, position in zip(axes, positions, strict=True)
        for column in axis.columns
    }


def arguments_at(axes: Sequence[Axis], lanes: np.ndarray) -> dict[str, np.ndarray]:
    """Leaf -> what the lanes (n,) are given, (n,) each: the values with degrees as radians."""
    return in_radians(axes, values_at(axes, lanes))


def in_radians(axes: Sequence[Axis], values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Leaf -> its values with degrees as radians."""
    degrees = {column.leaf for axis in axes for column in axis.columns if column.unit == "deg"}
    return {leaf: np.deg2rad(at) if leaf in degrees else at for leaf, at in values.items()}


def coordinate(axes: Sequence[Axis], column: Column) -> np.ndarray:
    """Values of a column along its axis, (length,), or over all axes, `shape(axes)`, when every lane has its own."""
    if _KINDS[column.kind].by_lane:
        return values_at(axes, np.arange(lane_count(axes)))[column.leaf].reshape(shape(axes))
    positions = np.arange(column.count)
    return _KINDS[column.kind].values(column, positions, positions)


def with_units(axes: Sequence[Axis], declared: Mapping[str, str]) -> tuple[Axis, ...]:
    """Return the axes with the units that the classes of the lane's arguments declare.

    Args:
        axes: of the sweep.
        declared: dotted name -> unit, see `jaxsphere.units.declared_units`.

    Raises:
        ValueError: an axis was given a unit that is not that of its leaf.
    """
    return tuple(
        replace(axis, columns=tuple(replace(column, unit=_fitting(column, declared)) for column in axis.columns))
        for axis in axes
    )


def differs_by_lane(column: Column) -> bool:
    """Tell whether every lane has a value of its own, whatever its position along the axis."""
    return _KINDS[column.kind].by_lane


def _between(column: Column, part: np.ndarray) -> np.ndarray:
    start, stop = column.numbers
    inside = start * (1.0 - part) + stop * part
    return np.where(part == 0.0, start, np.where(part == 1.0, stop, inside))  # the ends exactly


def _between_logarithms(column: Column, part: np.ndarray) -> np.ndarray:
    start, stop = column.numbers
    inside = start * np.exp(part * math.log(stop / start))
    return np.where(part == 0.0, start, np.where(part == 1.0, stop, inside))


def _steps(column: Column, position: np.ndarray) -> np.ndarray:
    return position / max(column.count - 1, 1)


def _cells(column: Column, position: np.ndarray) -> np.ndarray:
    cell = draws.permutation(column.seed, column.leaf, position, column.count)
    return (cell + draws.uniform(column.seed, column.leaf, position)) / column.count


_KINDS = {
    "linear": _Kind(lambda column, position, lane: _between(column, _steps(column, position))),
    "logarithmic": _Kind(lambda column, position, lane: _between_logarithms(column, _steps(column, position))),
    "listed": _Kind(lambda column, position, lane: np.asarray(column.numbers)[position]),
    "latin": _Kind(lambda column, position, lane: _between(column, _cells(column, position))),
    "latin_logarithmic": _Kind(lambda column, position, lane: _between_logarithms(column, _cells(column, position))),
    "uniform": _Kind(lambda column, position, lane: _between(column, draws.uniform(column.seed, column.leaf, lane)), True),
    "normal": _Kind(
        lambda column, position, lane: column.numbers[0] + column.numbers[1] * draws.normal(column.seed, column.leaf, lane),
        True,
    ),
}


def _single(leaf: str, kind: str, numbers: Any, count: int, unit: str | None) -> Axis:
    require_count(f"count of axis {leaf!r}", count)
    return Axis(leaf, int(count), (Column(leaf, kind, _numbers(leaf, numbers), int(count), _unit(leaf, unit)),))


def _drawn(name: str, kind: str, numbers: Mapping[str, Any], count: int, seed: int, unit: str | None) -> Axis:
    if not numbers:
        raise ValueError(f"axis {name!r} varies no leaf; type e.g. {{'robot.pendulum_mass': (1.8, 2.2)}}")
    require_count(f"count of axis {name!r}", count)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**64:
        raise ValueError(f"seed = {seed!r} of axis {name!r} is not admissible; type a whole number from 0 to 2**64 - 1")
    columns = (Column(leaf, kind, pair, int(count), _unit(leaf, unit), int(seed)) for leaf, pair in numbers.items())
    return Axis(name, int(count), tuple(columns))


def _numbers(leaf: str, numbers: Any, length: int | None = None) -> tuple[float, ...]:
    if not isinstance(leaf, str) or not leaf:
        raise ValueError(f"axis {leaf!r} is no name of a leaf; type e.g. 'slope' or 'robot.pendulum_mass'")
    try:
        values = np.atleast_1d(np.asarray(numbers, np.float64))
    except (TypeError, ValueError):
        raise ValueError(f"axis {leaf!r} has the values {numbers!r}; type numbers") from None
    if values.ndim != 1 or not np.all(np.isfinite(values)) or (length is not None and len(values) != length):
        raise ValueError(f"axis {leaf!r} has the values {numbers!r}; type {length or 'a list of'} finite numbers")
    return tuple(values.tolist())


def _range(leaf: str, ends: Any, log: bool = False) -> tuple[float, ...]:
    low, high = numbers = _numbers(leaf, ends, 2)
    if not low < high:
        raise ValueError(f"axis {leaf!r} has the range ({low:g}, {high:g}); type the lower end first")
    if log:
        _require_positive(leaf, numbers)
    return numbers


def _require_positive(leaf: str, ends: Any) -> None:
    if not all(end > 0.0 for end in _numbers(leaf, ends)):
        raise ValueError(f"axis {leaf!r} is logarithmic from {ends[0]:g} to {ends[1]:g}; type positive ends, or a linear axis")


def _unit(leaf: str, unit: str | None) -> str:
    if unit is not None and not (isinstance(unit, str) and _UNIT.fullmatch(unit)):
        raise ValueError(f"unit = {unit!r} of axis {leaf!r} is not admissible; type unit='deg' for degrees, or leave it out")
    known = unit_of(leaf)
    _require_fitting(leaf, unit or known, known)
    return known if unit is None else unit


def _fitting(column: Column, declared: Mapping[str, str]) -> str:
    known = unit_of(column.leaf, declared)
    _require_fitting(column.leaf, column.unit, known)
    return column.unit or known


def _require_fitting(leaf: str, unit: str, known: str) -> None:
    if known and unit not in ("", known) and not (unit == "deg" and known == "rad"):
        raise ValueError(f"unit = {unit!r} does not fit axis {leaf!r}; leave it out for {known}")


def _require_distinct(kind: str, names: list[str], fix: str) -> None:
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise ValueError(f"{kind} {doubled!r} comes twice among the axes; {fix}")
