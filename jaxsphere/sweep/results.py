"""Results of a sweep: arrays over its named axes, read chunk by chunk when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxsphere.status import Status
from jaxsphere.sweep import axes as ax
from jaxsphere.sweep import schema
from jaxsphere.sweep import store as st
from jaxsphere.sweep.axes import Axis, Column
from jaxsphere.sweep.memory import Shards


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

    shards: Shards

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self:
            raise KeyError(f"{name!r} is no output; type one of {', '.join(self)}")
        kind, chunks = self.shards.layout[name], self.shards.chunks
        found = np.empty((chunks.lanes, *kind.shape), kind.base)
        for index in range(len(chunks)):
            first, end = chunks.bounds(index)
            found[first:end] = self.shards.read(index, name)
        return found.reshape(*chunks.shape, *kind.shape)

    def __iter__(self) -> Iterator[str]:
        return iter(self.shards.layout.names or ())

    def __len__(self) -> int:
        return len(self.shards.layout.names or ())

    def __contains__(self, name: object) -> bool:
        return name in (self.shards.layout.names or ())


@dataclass(frozen=True)
class SweepResults:
    """Results of `sweep` in named axes.

    axes: of the sweep; the last varies fastest.
    shards: where the results lie, cut into chunks of lanes.
    repaired: numbers of the chunks that this process found damaged and computed again.
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
        return Values(self.shards)

    @property
    def units(self) -> Mapping[str, str]:
        """Output name -> unit, "" where it is unknown."""
        return self.shards.units

    @property
    def status(self) -> np.ndarray:
        """Status codes over the axes. Raises ValueError when the lane function returns no status."""
        self._require_status()
        return self.values["status"]

    def counts(self) -> dict[Status, int]:
        """How many lanes ended with each status; statuses that do not occur are left out. Raises ValueError as `status`."""
        self._require_status()
        totals: dict[Status, int] = {}
        for chunk in range(len(self.shards.chunks)):
            for code, count in zip(*np.unique(self.shards.read(chunk, "status"), return_counts=True), strict=True):
                if code not in tuple(Status):
                    raise ValueError(
                        f"status = {code} is none of jaxsphere.Status; let the lane function return one of 0 ... {max(Status)}"
                    )
                totals[Status(code)] = totals.get(Status(code), 0) + int(count)
        return dict(sorted(totals.items()))

    def chunks(self) -> Iterator[Chunk]:
        """All lanes in order, a chunk at a time, for results that do not fit into memory."""
        for index in range(len(self.shards.chunks)):
            lanes = np.arange(*self.shards.chunks.bounds(index))
            yield Chunk(lanes, ax.values_at(self.axes, lanes), {name: self.shards.read(index, name) for name in self.values})

    def to_xarray(self) -> Any:
        """Dataset with the axes as dimensions and units as attributes, as `xarray.open_zarr` gives it for a store."""
        import xarray

        coordinates = {
            leaf: (found.dimensions, found.values, {"units": found.unit}) for leaf, found in self.coordinates.items()
        }
        outputs = {}
        for name, array in self.values.items():
            inner = tuple(f"{name}_{number}" for number in range(array.ndim - len(self.shape)))
            outputs[name] = ((*self.dimensions, *inner), array, schema.attributes(name, self.units[name]))
        return xarray.Dataset(outputs, coordinates)

    def _require_status(self) -> None:
        if "status" not in self.values:
            raise ValueError("the lane function returns no status; let it return {'status': trajectory.status, ...}")


def open_sweep(folder: str | Path) -> SweepResults:
    """Results of a finished sweep from its store, without the lane function; every byte is checked when it is read.

    Args:
        folder: the store, as `sweep` was given it.

    Raises:
        ValueError: there is no sweep, or one that is not finished.
        SweepError: the store is damaged; for a chunk of lanes, when it is read.
    """
    shards = st.load(Path(folder))
    if changed := st.changed_files(shards):
        raise st.SweepError(f"{changed[0]} of store = {str(folder)!r} is damaged; {st.RESUME}")
    if (done := shards.done()) < len(shards.chunks):
        raise ValueError(f"store = {str(folder)!r} has {done} of {len(shards.chunks)} chunks; {st.RESUME}")
    return SweepResults(schema.axes_of(shards.manifest["spec"]["axes"]), shards)
