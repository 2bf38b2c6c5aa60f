"""Two axes from coarse to fine: outcomes refined at their boundaries, and lanes that begin at what their neighbours found.

A plan is a generator over the nodes of a grid: it yields rows (n,), columns (n,) and guesses (n,), None for `Boundaries`, and
is sent what was found there (n,). It returns the outcomes of the whole grid where it has left some nodes out.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxsphere.checks import require_count

Plan = Generator[tuple[np.ndarray, np.ndarray, np.ndarray | None], np.ndarray, "Refined | None"]

_UNKNOWN = np.iinfo(np.int32).min


@dataclass(frozen=True)
class Boundaries:
    """Compute lanes only where neighbours disagree.

    The grid begins as rectangles `coarse` nodes apart. A rectangle that holds two different outcomes, at its corners or at
    any node of its edges that a neighbour has asked for, is cut into four, until nothing is left to cut; the inside of the
    others has the outcome of their corners. An island that fits between the coarse nodes is overlooked.

    output: a whole number, whose boundaries are wanted; it is filled in everywhere, the other outputs only where "simulated".
    coarse: nodes between two of the first lines.
    """

    output: str = "status"
    coarse: int = 16

    def plan(self, shape: tuple[int, int]) -> Plan:
        """Plan for a grid of this shape."""
        return _boundaries(shape, self.coarse)


@dataclass(frozen=True)
class Guesses:
    """Compute every lane, from coarse to fine, with the mean of its known neighbours as one more argument.

    output: what is guessed, NaN where there is none. argument: of the lane, that the guess is given to.
    first: guess at the nodes of the coarsest level, one number or an array over the two axes.
    coarsest: nodes between those of the coarsest level, a power of two.
    """

    output: str = "value"
    argument: str = "guess"
    first: Any = 0.0
    coarsest: int = 16

    def plan(self, shape: tuple[int, int]) -> Plan:
        """Plan for a grid of this shape."""
        return _levels(np.broadcast_to(np.asarray(self.first, np.float64), shape), self.coarsest)


def require_refinable(refine: Any, shape: tuple[int, ...], outputs: Any) -> None:
    """Require a refinement that fits the sweep. Raises ValueError with one sentence otherwise."""
    if not isinstance(refine, Boundaries | Guesses):
        raise ValueError(f"refine = {refine!r} is not admissible; type jaxsphere.Boundaries() or jaxsphere.Guesses()")
    if len(shape) != 2:
        raise ValueError(f"refine works over two axes, and there are {len(shape)}; leave it out, or type two axes")
    if refine.output not in outputs:
        raise ValueError(f"refine.output = {refine.output!r} is no output; type one of {', '.join(outputs)}")
    count = refine.coarse if isinstance(refine, Boundaries) else refine.coarsest
    require_count("coarse" if isinstance(refine, Boundaries) else "coarsest", count)
    if isinstance(refine, Guesses) and count & (count - 1):
        raise ValueError(f"coarsest = {count} is not admissible; type a power of two, e.g. 16")
    if isinstance(refine, Guesses) and np.shape(refine.first) not in ((), shape):
        raise ValueError(f"first has the shape {np.shape(refine.first)}; type one number or an array of the shape {shape}")


class Refined(NamedTuple):
    """Outcomes (rows, columns) of a whole grid, and which of them were simulated (bool); the others are filled in."""

    outcomes: np.ndarray
    simulated: np.ndarray


def _boundaries(shape: tuple[int, int], coarse: int) -> Plan:
    outcomes = np.full(shape, _UNKNOWN, np.int64)
    rectangles = _rectangles(*(_lines(side, coarse) for side in shape))
    while True:
        rows, columns = _unknown_corners(outcomes, rectangles)
        if len(rows):
            outcomes[rows, columns] = yield rows, columns, None
        mixed = np.array([_is_mixed(outcomes, rectangle) for rectangle in rectangles])
        large = (np.ptp(rectangles[:, :2], axis=1) > 1) | (np.ptp(rectangles[:, 2:], axis=1) > 1)
        split = mixed & large
        if not split.any():
            break
        rectangles = np.concatenate([rectangles[~split], *(_quarters(r) for r in rectangles[split])])
    simulated = outcomes != _UNKNOWN
    for top, bottom, left, right in rectangles:
        inside = outcomes[top : bottom + 1, left : right + 1]
        inside[inside == _UNKNOWN] = outcomes[top, left]
    return Refined(outcomes, simulated)


def _levels(first: np.ndarray, stride: int) -> Plan:
    value, done = np.full(first.shape, np.nan), np.zeros(first.shape, bool)
    while stride >= 1:
        rows, columns = (one.ravel() for one in np.meshgrid(*(np.arange(0, n, stride) for n in first.shape), indexing="ij"))
        new = ~done[rows, columns]
        rows, columns = rows[new], columns[new]
        guess = from_neighbours(value, 2 * stride) if done.any() else first
        if len(rows):
            value[rows, columns] = yield rows, columns, guess[rows, columns]
            done[rows, columns] = True
        stride //= 2
    return None


def from_neighbours(value: np.ndarray, stride: int) -> np.ndarray:
    """Return the known nodes (rows, columns), `stride` apart, interpolated linearly to all; 0 where all around are NaN."""
    known = value[::stride, ::stride]
    places = [np.minimum(np.arange(side) / stride, count - 1.0) for side, count in zip(value.shape, known.shape, strict=True)]
    low = [np.floor(place).astype(int) for place in places]
    high = [np.minimum(first + 1, count - 1) for first, count in zip(low, known.shape, strict=True)]
    share = [place - first for place, first in zip(places, low, strict=True)]
    weights, total = np.zeros(value.shape), np.zeros(value.shape)
    for row, by_row in ((low[0], 1.0 - share[0]), (high[0], share[0])):
        for column, by_column in ((low[1], 1.0 - share[1]), (high[1], share[1])):
            corner, weight = known[np.ix_(row, column)], np.outer(by_row, by_column)
            weight = np.where(np.isnan(corner), 0.0, weight)
            weights += weight
            total += weight * np.nan_to_num(corner)
    return np.where(weights > 0.0, total / np.where(weights > 0.0, weights, 1.0), 0.0)


def _lines(side: int, coarse: int) -> np.ndarray:
    return np.unique(np.append(np.arange(0, side, coarse), side - 1))


def _rectangles(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Rectangles (n, 4) of top, bottom, left and right node between the lines; a grid of one line has flat ones."""
    spans = [np.stack([lines[: max(len(lines) - 1, 1)], lines[min(1, len(lines) - 1) :]], 1) for lines in (rows, columns)]
    return np.array([[*vertical, *horizontal] for vertical in spans[0] for horizontal in spans[1]])


def _unknown_corners(outcomes: np.ndarray, rectangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = np.concatenate([rectangles[:, [row, column]] for row in (0, 1) for column in (2, 3)])
    corners = np.unique(corners, axis=0)
    new = corners[outcomes[corners[:, 0], corners[:, 1]] == _UNKNOWN]
    return new[:, 0], new[:, 1]


def _is_mixed(outcomes: np.ndarray, rectangle: np.ndarray) -> bool:
    top, bottom, left, right = rectangle
    inside = outcomes[top : bottom + 1, left : right + 1]
    return bool(np.any((inside != outcomes[top, left]) & (inside != _UNKNOWN)))


def _quarters(rectangle: np.ndarray) -> np.ndarray:
    rows, columns = (np.unique([low, (low + high) // 2, high]) for low, high in rectangle.reshape(2, 2))
    return _rectangles(rows, columns)
