"""Outcomes on a grid of two parameters, simulated only where neighbours disagree."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxsphere.checks import require_count

# (rows (n,), columns (n,)) -> outcomes (n,), whole numbers
Evaluate = Callable[[np.ndarray, np.ndarray], np.ndarray]

_UNKNOWN = np.iinfo(np.int32).min


class Refined(NamedTuple):
    """Outcomes (rows, columns) of a whole grid, and which of them were simulated (bool); the others are filled in."""

    outcomes: np.ndarray
    simulated: np.ndarray


def refine(evaluate: Evaluate, shape: tuple[int, int], coarse: int = 16) -> Refined:
    """Find the outcome at every node of a grid from simulations near the boundaries between outcomes.

    The grid begins as rectangles `coarse` nodes apart. A rectangle that holds two different outcomes, at its corners or at
    any node of its edges that a neighbour has asked for, is cut into four, until nothing is left to cut; the inside of the
    others has the outcome of their corners. An island that fits between the coarse nodes is overlooked.

    Args:
        evaluate: (rows (n,), columns (n,)) -> outcomes (n,), whole numbers; called once per round with nodes not seen before.
        shape: rows and columns of the grid. coarse: nodes between two of the first lines.

    Raises:
        ValueError: `coarse` or a side of the grid is not a whole number of at least one.
    """
    require_count("coarse", coarse)
    for side in shape:
        require_count("shape", side)
    outcomes = np.full(shape, _UNKNOWN, np.int64)
    rectangles = _rectangles(*(_lines(side, coarse) for side in shape))
    while True:
        _simulate(evaluate, outcomes, rectangles)
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


def _lines(side: int, coarse: int) -> np.ndarray:
    return np.unique(np.append(np.arange(0, side, coarse), side - 1))


def _rectangles(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Rectangles (n, 4) of top, bottom, left and right node between the lines; a grid of one line has flat ones."""
    spans = [np.stack([lines[: max(len(lines) - 1, 1)], lines[min(1, len(lines) - 1) :]], 1) for lines in (rows, columns)]
    return np.array([[*vertical, *horizontal] for vertical in spans[0] for horizontal in spans[1]])


def _simulate(evaluate: Evaluate, outcomes: np.ndarray, rectangles: np.ndarray) -> None:
    corners = np.concatenate([rectangles[:, [row, column]] for row in (0, 1) for column in (2, 3)])
    corners = np.unique(corners, axis=0)
    new = corners[outcomes[corners[:, 0], corners[:, 1]] == _UNKNOWN]
    if len(new):
        outcomes[new[:, 0], new[:, 1]] = evaluate(new[:, 0], new[:, 1])


def _is_mixed(outcomes: np.ndarray, rectangle: np.ndarray) -> bool:
    top, bottom, left, right = rectangle
    inside = outcomes[top : bottom + 1, left : right + 1]
    return bool(np.any((inside != outcomes[top, left]) & (inside != _UNKNOWN)))


def _quarters(rectangle: np.ndarray) -> np.ndarray:
    rows, columns = (np.unique([low, (low + high) // 2, high]) for low, high in rectangle.reshape(2, 2))
    return _rectangles(rows, columns)
