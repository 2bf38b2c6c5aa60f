"""Chunks of lanes: rectangles of the grid of axes that hold consecutive lanes, so that one chunk is one Zarr chunk.

The last axis varies fastest. A chunk spans all axes behind the axis `along` in full, `rows` positions of that axis (fewer at
its end), and one position of every axis before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Chunks:
    """How the lanes of a sweep are cut. shape: lengths of the axes. along: number of the axis that is cut. rows: positions."""

    shape: tuple[int, ...]
    along: int
    rows: int

    @property
    def lanes(self) -> int:
        """Number of lanes of the sweep."""
        return math.prod(self.shape)

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of chunks along each axis."""
        return (*self.shape[: self.along], self._parts, *[1] * (len(self.shape) - self.along - 1))

    @property
    def chunk_shape(self) -> tuple[int, ...]:
        """Lengths of a full chunk along each axis."""
        return (*[1] * self.along, self.rows, *self.shape[self.along + 1 :])

    @property
    def size(self) -> int:
        """Number of lanes in a full chunk."""
        return self.rows * self._inner

    def __len__(self) -> int:
        return math.prod(self.shape[: self.along]) * self._parts

    def bounds(self, index: int) -> tuple[int, int]:
        """First lane of a chunk and the one after its last."""
        outer, part = divmod(index, self._parts)
        start = outer * self.shape[self.along]
        return tuple((start + min(row, self.shape[self.along])) * self._inner for row in _ends(part, self.rows))  # type: ignore

    def count(self, index: int) -> int:
        """Number of lanes in a chunk."""
        first, end = self.bounds(index)
        return end - first

    def place(self, index: int) -> tuple[int, ...]:
        """Number of a chunk along each axis."""
        outer, part = divmod(index, self._parts)
        found = [part]
        for length in reversed(self.shape[: self.along]):
            outer, position = divmod(outer, length)
            found.insert(0, position)
        return (*found, *[0] * (len(self.shape) - self.along - 1))

    @property
    def _inner(self) -> int:
        return math.prod(self.shape[self.along + 1 :])

    @property
    def _parts(self) -> int:
        return -(-self.shape[self.along] // self.rows)


def cut(shape: tuple[int, ...], lanes: int) -> Chunks:
    """Return the chunks of a grid of this shape that hold at most `lanes` lanes each, and equally many where they can."""
    along, inner = len(shape) - 1, 1
    while along > 0 and inner * shape[along] <= lanes:
        inner *= shape[along]
        along -= 1
    parts = -(-shape[along] // max(1, min(lanes // inner, shape[along])))
    return Chunks(shape, along, -(-shape[along] // parts))


def _ends(part: int, rows: int) -> tuple[int, int]:
    return part * rows, (part + 1) * rows
