"""Pareto front of settling, swing and effort: many weightings of one objective, tuned in one batched run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_count
from tuning import starts as drawn
from tuning.objectives.following import FollowLine
from tuning.objectives.objective import members_of
from tuning.objectives.regulation import RestToRest
from tuning.optimisers.levenberg_marquardt import levenberg_marquardt, linearise
from tuning.transforms import bounded, parametrise

# Neighbours are the nearest tenth of the front; how far on their plane a trial lies, standard deviation in their distance.
_NEAREST, _SPREAD = 0.1, 0.7


class Front(NamedTuple):
    """Gains (every leaf (points,)) that no other found gains beat in all three figures (points, 3), by settling time."""

    gains: Any
    figures: np.ndarray
    tried: int
    rollouts: int  # with gradient
    plain_rollouts: int  # all, each tangent, trial and scoring counted as one


def pareto_front(
    objective: RestToRest | FollowLine,
    initial_gains: Any,
    *,
    points: int = 96,
    iterations: int = 8,
    rounds: int = 25,
    swing: tuple[float, float] = (0.01, 0.7),
    effort: tuple[float, float] = (1e-4, 0.3),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
) -> Front:
    """Tune many weightings at once by Levenberg-Marquardt, fill in between them, and keep what nothing else dominates.

    The best compromises between three figures are a surface in the space of the gains. Each round tries more gains on the
    planes through neighbours of the front so far, beyond its edge too, by their figures alone: the objective's `figures`,
    scored with the hard sign, a 1 kHz hold and the motor's limit.

    Args:
        objective: what is weighted, by its `compromise`.
        initial_gains: the first start.
        points: weightings, each with its own limit of the swing and its own weight of the effort.
        iterations: of Levenberg-Marquardt on each.
        rounds: of filling in, with 5 `points` gains each.
        swing: lowest and highest limit of the swing (of the lean along lines), rad; even in the logarithm.
        effort: lowest and highest weight of the effort, likewise.
        bounds: of the gains; the objective's own by default.
        seed: of all draws.

    Returns:
        The gains and their figures.

    Raises:
        ValueError: a range is not admissible, or no gains settle.
    """
    require_count("points", points)
    require_count("iterations", iterations)
    for name, (low, high) in (("swing", swing), ("effort", effort)):
        if not 0.0 < low < high:
            raise ValueError(f"{name} = ({low}, {high}) is no range; type two increasing positive numbers")
    limits = objective.BOUNDS if bounds is None else bounds
    chosen = parametrise(initial_gains, transforms={name: bounded(*ends) for name, ends in limits.items()})
    cube = drawn.latin_hypercube(jax.random.key(seed), points, 2)
    swings = swing[0] * (swing[1] / swing[0]) ** cube[:, 0]
    efforts = effort[0] * (effort[1] / effort[0]) ** cube[:, 1]
    rule, cap = levenberg_marquardt(), members_of(objective).largest_residual_gradient

    def search(vector: Array, limit: Array, weight: Array) -> Array:
        task = objective.compromise(limit, weight)

        def iterate(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
            trial, state = carry
            seen = linearise(lambda free: task.residuals(chosen.to_gains(free)), trial, cap)
            moved = rule.update(seen, state, trial)
            return moved, moved[0]

        return jax.lax.scan(iterate, (vector, rule.init(vector)), None, length=iterations)[1]

    score = js.batch(lambda vector: objective.figures(jax.tree.map(jnp.asarray, chosen.to_gains(vector))))
    vectors = drawn.across(jax.random.key(seed + 1), chosen.to_vector(initial_gains), points)
    # What a weighting passes on its way may be as good a compromise as where it ends.
    passed = jnp.reshape(js.batch(search)(vectors, swings, efforts), (points * iterations, len(chosen.names)))
    nothing = _Scored(np.zeros((0, len(chosen.names))), np.zeros((0, 3)))
    front = nothing.joined(_Scored(np.asarray(passed), np.asarray(score(passed))))
    if not len(front.vectors):
        raise ValueError("none of the tuned gains settles within duration; type a longer duration or other bounds")
    for key in jax.random.split(jax.random.key(seed + 2), rounds):
        trials = _among_neighbours(key, front, 5 * points)
        front = front.joined(_Scored(trials, np.asarray(score(jnp.asarray(trials)))))
    order = np.argsort(front.figures[:, 0])
    tried = points * (iterations + 5 * rounds)
    return Front(
        gains=jax.tree.map(np.asarray, jax.vmap(chosen.to_gains)(jnp.asarray(front.vectors[order]))),
        figures=front.figures[order],
        tried=tried,
        rollouts=points * iterations,
        plain_rollouts=points * iterations * rule.plain_rollouts(len(chosen.names)) + tried,
    )


class _Scored(NamedTuple):
    vectors: np.ndarray
    figures: np.ndarray

    def joined(self, other: _Scored) -> _Scored:
        """The front of both; this one is a front already."""
        new = non_dominated(other.figures)
        vectors, figures = other.vectors[new], other.figures[new]
        here, there = ~_dominated(self.figures, figures), ~_dominated(figures, self.figures)
        return _Scored(
            np.concatenate([self.vectors[here], vectors[there]]), np.concatenate([self.figures[here], figures[there]])
        )


def _among_neighbours(key: Array, front: _Scored, count: int) -> np.ndarray:
    """Draw vectors (count, n) on planes through a point of the front and two others, which its nearest tenth holds."""
    keys = jax.random.split(key, 3)
    size = len(front.vectors)
    near = min(size, max(8, round(_NEAREST * size)))
    at = np.asarray(jax.random.randint(keys[0], (count,), 0, size))
    scaled = front.figures / np.maximum(np.ptp(front.figures, axis=0), 1e-300)
    distance = np.sum((scaled[at][:, None] - scaled[None]) ** 2, axis=-1)
    nearest = np.argpartition(distance, near - 1, axis=1)[:, :near]
    picked = np.asarray(jax.random.randint(keys[1], (2, count), 0, near))
    share = _SPREAD * np.asarray(jax.random.normal(keys[2], (2, count, 1)))
    neighbours = front.vectors[nearest[np.arange(count), picked]]
    return front.vectors[at] + np.sum(share * (neighbours - front.vectors[at]), axis=0)


def non_dominated(points: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the finite points (n, d) that no other point beats or equals everywhere and beats somewhere."""
    return ~_dominated(points, points) & np.all(np.isfinite(points), axis=1)


def _dominated(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Mask (n,) of the points (n, d) that one of the others (m, d) beats or equals everywhere and beats somewhere."""
    no_worse = np.all(others[:, None] <= points[None], axis=-1)
    better = np.any(others[:, None] < points[None], axis=-1)
    return np.any(no_worse & better, axis=0)


def hypervolume(points: np.ndarray, reference: np.ndarray) -> float:
    """Return the volume that the points (n, d) dominate below `reference` (d,): everything is to be small. By slices, exact."""
    inside = points[np.all(points < reference, axis=1)]
    if len(inside) == 0:
        return 0.0
    if points.shape[1] == 1:
        return float(reference[0] - inside.min())
    order = inside[np.argsort(inside[:, -1])]
    heights = np.diff(np.append(order[:, -1], reference[-1]))
    return float(sum(h * hypervolume(order[: i + 1, :-1], reference[:-1]) for i, h in enumerate(heights) if h > 0.0))
