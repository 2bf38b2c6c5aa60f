"""What a sweep found: arrays over its named axes, read from the shards when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsphere.simulation.sweeps import axes as ax
from jaxsphere.simulation.sweeps import store as st
from jaxsphere.simulation.sweeps.axes import Axis, Column
from jaxsphere.simulation.sweeps.store import Shards
from jaxsphere.status import Status


class Coordinate(NamedTuple):
    """Values of one leaf over the dimensions that it depends on, in `unit`."""

    dimensions: tuple[str, ...]
    values: np.ndarray
    unit: str


class Chunk(NamedTuple):
    """Some lanes of a sweep: their numbers, the values of their leaves and their outputs, (n,) or (n, ...) each."""

    lanes: np.ndarray
    leaves: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]


@dataclass(frozen=True)
class Values(Mapping[str, np.ndarray]):
    """Output name -> its array over the axes, (*shape, ...); each is read from the shards when it is asked for."""

    shape: tuple[int, ...]
    shards: Shards

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._layout().names:
            raise KeyError(f"{name!r} is no output; type one of {', '.join(self)}")
        kind = self._layout()[name]
        found = np.empty((self.shards.lanes, *kind.shape), kind.base)
        for index in range(st.shard_count(self.shards)):
            first, end = st.bounds(self.shards, index)
            found[first:end] = self.shards.read(index)[name]
        return found.reshape(*self.shape, *kind.shape)

    def __iter__(self) -> Iterator[str]:
        return iter(self._layout().names)

    def __len__(self) -> int:
        return len(self._layout().names)

    def __contains__(self, name: object) -> bool:
        return name in self._layout().names

    def _layout(self) -> Any:
        return self.shards.read(0).dtype


@dataclass(frozen=True)
class SweepResults:
    """Results of `sweep` in named axes.

    axes: of the sweep; the last varies fastest. shards: where the results lie. repaired: numbers of the shards that this
    process found damaged and computed again.
    """

    axes: tuple[Axis, ...]
    shards: Shards = field(repr=False)
    repaired: tuple[int, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return ax.shape(self.axes)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(axis.name for axis in self.axes)

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return ax.lane_count(self.axes)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Every swept leaf, with its unit."""
        return tuple(column for axis in self.axes for column in axis.columns)

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """Leaf -> its values along its axis, or over all axes where every lane has its own."""
        found = {}
        for axis in self.axes:
            for column in axis.columns:
                along = self.dimensions if ax.differs_by_lane(column) else (axis.name,)
                found[column.leaf] = Coordinate(along, ax.coordinate(self.axes, column), column.unit)
        return found

    @property
    def values(self) -> Values:
        """Output name -> array over the axes."""
        return Values(self.shape, self.shards)

    @property
    def status(self) -> np.ndarray:
        """Status codes over the axes. Raises ValueError when the lane function returns no status."""
        self._require_status()
        return self.values["status"]

    def counts(self) -> dict[Status, int]:
        """How many lanes ended with each status; statuses that do not occur are left out. Raises ValueError as `status`."""
        self._require_status()
        totals: dict[Status, int] = {}
        for chunk in range(st.shard_count(self.shards)):
            for code, count in zip(*np.unique(self.shards.read(chunk)["status"], return_counts=True), strict=True):
                if code not in tuple(Status):
                    raise ValueError(
                        f"status = {code} is none of jaxsphere.Status; let the lane function return one of 0 ... 7"
                    )
                totals[Status(code)] = totals.get(Status(code), 0) + int(count)
        return dict(sorted(totals.items()))

    def chunks(self) -> Iterator[Chunk]:
        """All lanes in order, a shard at a time, for results that do not fit into memory."""
        for index in range(st.shard_count(self.shards)):
            lanes = np.arange(*st.bounds(self.shards, index))
            record = self.shards.read(index)
            yield Chunk(lanes, ax.values_at(self.axes, lanes), {name: record[name] for name in record.dtype.names or ()})

    def to_xarray(self) -> Any:
        """Dataset with the axes as dimensions, units as attributes. Raises ValueError when xarray is not installed."""
        try:
            import xarray  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise ValueError("to_xarray needs xarray; type pip install 'jaxsphere[xarray]'") from None
        coordinates = {
            leaf: (found.dimensions, found.values, {"units": found.unit}) for leaf, found in self.coordinates.items()
        }
        outputs = {}
        for name, array in self.values.items():
            inner = tuple(f"{name}_{number}" for number in range(array.ndim - len(self.shape)))
            outputs[name] = ((*self.dimensions, *inner), array, {"units": ax.unit_of(name)})
        return xarray.Dataset(outputs, coordinates)

    def _require_status(self) -> None:
        if "status" not in self.values:
            raise ValueError("the lane function returns no status; let it return {'status': trajectory.status, ...}")


def open_sweep(folder: str | Path) -> SweepResults:
    """Results of a finished sweep from its store, without the lane function.

    Raises:
        ValueError: there is no sweep, or one that is not finished. SweepError, on reading: a shard is damaged.
    """
    shards = st.load(Path(folder))
    if "checksums" not in shards.manifest:
        done, total = len(shards.files()), st.shard_count(shards)
        raise ValueError(f"store = {str(folder)!r} has {done} of {total} shards; {st.RESUME}")
    return SweepResults(_axes(shards.manifest["spec"]["axes"]), shards)


def _axes(described: Sequence[Mapping[str, Any]]) -> tuple[Axis, ...]:
    return tuple(Axis(one["name"], one["length"], tuple(_column(**part) for part in one["columns"])) for one in described)


def _column(type: str, numbers: Sequence[float], **others: Any) -> Column:
    return Column(numbers=tuple(numbers), **others)
