"""Pareto front of settling, swing and effort: many weightings of one objective, tuned in one batched run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_scalar
from jaxsphere.simulation.lanes import over_lanes
from tuning import starts as drawn
from tuning.objectives import BOUNDS, RestToRest
from tuning.second_order import levenberg_marquardt, linearise
from tuning.transforms import bounded, parametrise

NAMES = ("settling time, s", "peak swing about equilibrium, rad", "effort, (N m)^2 s")


class Front(NamedTuple):
    """Gains (every leaf (points,)) that no other found gains beat in all three figures (points, 3), by settling time."""

    gains: js.SlidingModeGains
    figures: np.ndarray
    tried: int
    rollouts: int  # with gradient
    plain_rollouts: int  # all, each tangent, trial and scoring counted as one


def pareto_front(
    objective: RestToRest,
    initial_gains: js.SlidingModeGains,
    *,
    points: int = 96,
    iterations: int = 16,
    swing: tuple[float, float] = (0.01, 0.7),
    effort: tuple[float, float] = (1e-4, 0.3),
    bounds: dict[str, tuple[float, float]] | None = None,
    seed: int = 0,
) -> Front:
    """Tune `points` weightings at once by Levenberg-Marquardt and keep what none of the gains on the way dominates.

    A weighting has its own swing limit (rad, between the two of `swing`) and its own weight of the torque (between the two
    of `effort`), both even in the logarithm. The figures are scored with the hard sign, a 1 kHz hold and the motor's limit.

    Raises:
        ValueError: a range is not admissible, or no gains settle.
    """
    require_scalar("points", points, above=0)
    require_scalar("iterations", iterations, above=0)
    for name, (low, high) in (("swing", swing), ("effort", effort)):
        if not 0.0 < low < high:
            raise ValueError(f"{name} = ({low}, {high}) is no range; type two increasing positive numbers")
    limits = BOUNDS if bounds is None else bounds
    chosen = parametrise(initial_gains, transforms={name: bounded(*ends) for name, ends in limits.items()})
    cube = drawn.latin_hypercube(jax.random.key(seed), points, 2)
    swings = swing[0] * (swing[1] / swing[0]) ** cube[:, 0]
    efforts = effort[0] * (effort[1] / effort[0]) ** cube[:, 1]
    rule = levenberg_marquardt()

    def search(vector: Array, limit: Array, weight: Array) -> Array:
        task = replace(objective, swing_limit=limit, weights=objective.weights._replace(torque=weight))

        def iterate(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
            trial, state = carry
            seen = linearise(lambda free: task.residuals(chosen.to_gains(free)), trial)
            moved = rule.update(seen, state, trial)
            return moved, moved[0]

        return jax.lax.scan(iterate, (vector, rule.init(vector)), None, length=iterations)[1]

    def score(vector: Array) -> tuple[js.SlidingModeGains, Array]:
        gains = jax.tree.map(jnp.asarray, chosen.to_gains(vector))
        return gains, figures(objective, gains)

    vectors = drawn.across(jax.random.key(seed + 1), chosen.to_vector(initial_gains), points)
    found = over_lanes(search)(vectors, swings, efforts)
    # What a weighting passes on its way may be as good a compromise as where it ends.
    passed = jnp.reshape(found, (points * iterations, len(chosen.names)))
    gains, scores = jax.tree.map(np.asarray, over_lanes(score)(passed))
    keep = non_dominated(scores)
    if not keep.any():
        raise ValueError("none of the tuned gains settles within duration; type a longer duration or other bounds")
    order = np.flatnonzero(keep)[np.argsort(scores[keep, 0])]
    plain = points * iterations * (rule.plain_rollouts(len(chosen.names)) + 1)
    return Front(jax.tree.map(lambda leaf: leaf[order], gains), scores[order], len(scores), points * iterations, plain)


def figures(objective: RestToRest, gains: js.SlidingModeGains) -> Array:
    """Settling time, peak swing and effort (3,) with the hard sign and a 1 kHz hold; infinite unless the lane is ok."""
    task = (objective.robot, objective.slope, gains, objective.travel, objective.duration, 1e-3, 0.0, objective.torque_limit)
    found = js.rest_to_rest(*task, control_period=1e-3, save_every=None, throw=False)
    metrics = found.metrics
    three = jnp.stack([metrics.settling_time, metrics.peak_swing, metrics.effort])
    return jnp.where(found.status == js.Status.OK, three, jnp.inf)


def non_dominated(points: np.ndarray) -> np.ndarray:
    """Mask (n,) of the finite points (n, d) that no other point beats or equals everywhere and beats somewhere."""
    no_worse = np.all(points[:, None] <= points[None], axis=-1)
    better = np.any(points[:, None] < points[None], axis=-1)
    return ~np.any(no_worse & better, axis=0) & np.all(np.isfinite(points), axis=1)


def hypervolume(points: np.ndarray, reference: np.ndarray) -> float:
    """Volume that the points (n, d) dominate below `reference` (d,): everything is to be small. By slices, exact."""
    inside = points[np.all(points < reference, axis=1)]
    if len(inside) == 0:
        return 0.0
    if points.shape[1] == 1:
        return float(reference[0] - inside.min())
    order = inside[np.argsort(inside[:, -1])]
    heights = np.diff(np.append(order[:, -1], reference[-1]))
    return float(sum(h * hypervolume(order[: i + 1, :-1], reference[:-1]) for i, h in enumerate(heights) if h > 0.0))
