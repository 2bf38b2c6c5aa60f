"""Levenberg-Marquardt for sums of squares: it is handed the residuals and tries points of its own.

A trial whose value or derivatives are not finite is rejected like one that is too high.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxsphere.checks import require_count
from tuning.optimisers.optimiser import Optimiser

# Dampings tried side by side, as multiples of the last one that was best; what it grows by when all of them fail.
FACTORS = (0.25, 1.0, 4.0)
_GROWTH = 4.0
_DAMPING_RANGE = (1e-12, 1e8)


class Quadratic(NamedTuple):
    """Value, gradient (n,) and Gauss-Newton Hessian (n, n) of a sum of squares at one point."""

    value: Array
    gradient: Array
    hessian: Array


class LeastSquares(NamedTuple):
    """A sum of squares at one point, its linearisation there, and its residuals elsewhere."""

    value: Array
    gradient: Array  # (n,)
    residuals: Array  # (m,)
    jacobian: Array  # (n, m), transposed
    elsewhere: Callable[[Array], Array]  # (n,) -> (m,)


class MarquardtState(NamedTuple):
    """The last point with finite derivatives, the damping it was left with, and the one to start with where it led."""

    point: Array
    left_with: Array
    damping: Array


class _Secant(NamedTuple):
    point: Array
    residuals: Array
    jacobian: Array
    value: Array
    damping: Array


def levenberg_marquardt(
    damping: float = 0.1, longest: float = 0.5, floor: float = 1e-2, rounds: int = 3, factors: tuple[float, ...] = FACTORS
) -> Optimiser:
    """Return Levenberg-Marquardt of a sum of squares with Marquardt's scaling, on one Jacobian for several steps.

    An update takes `rounds` steps. In each it tries the damping times every one of `factors` side by side, keeps the best
    point if it is lower, and corrects the Jacobian by Broyden's rank-one formula with what the trial has shown: a step
    costs len(factors) evaluations of the residuals instead of a Jacobian.

    Args:
        damping: at the start, relative to the diagonal of the Hessian.
        longest: largest change of any entry in one step.
        floor: least diagonal entry that scales the damping, of the largest: a gain that hardly matters moves slowly.
        rounds: steps on one Jacobian.
        factors: of the damping, increasing.

    Returns:
        An Optimiser whose `update` needs a `LeastSquares` at the vector.

    Raises:
        ValueError: rounds is below one, or factors are not positive and increasing.
    """
    require_count("rounds", rounds)
    if not factors or min(factors) <= 0.0 or any(b <= a for a, b in pairwise(factors)):
        raise ValueError(f"factors = {factors} are no multiples of the damping; type positive increasing ones")

    def init(vector: Array) -> MarquardtState:
        return MarquardtState(vector, jnp.full((), damping), jnp.full((), damping))

    def update(seen: LeastSquares, state: MarquardtState, vector: Array) -> tuple[Array, MarquardtState]:
        usable = jnp.isfinite(seen.value) & jnp.all(jnp.isfinite(seen.jacobian))

        def improve(now: _Secant, _: None) -> tuple[_Secant, None]:
            return _secant_step(now, seen.elsewhere, jnp.asarray(factors), longest, floor), None

        start = _Secant(vector, seen.residuals, seen.jacobian, seen.value, state.damping)
        end, _ = jax.lax.scan(improve, start, None, length=rounds)
        # A point without derivatives is left again, for a shorter way from the one before.
        again = jnp.clip(10.0 * state.left_with, *_DAMPING_RANGE)
        back, ahead = MarquardtState(state.point, again, again), MarquardtState(vector, state.damping, end.damping)
        kept = MarquardtState(*(jnp.where(usable, new, old) for new, old in zip(ahead, back, strict=True)))
        return jnp.where(usable, end.point, state.point), kept

    return Optimiser(init, update, needs="residuals", trials=rounds * len(factors))


def _secant_step(now: _Secant, elsewhere: Callable[[Array], Array], factors: Array, longest: float, floor: float) -> _Secant:
    dampings = jnp.clip(now.damping * factors, *_DAMPING_RANGE)
    steps = jax.vmap(lambda damping: _damped_step(now, damping, longest, floor))(dampings)
    trials = jax.vmap(lambda step: elsewhere(now.point + step))(steps)
    values = jnp.sum(trials * trials, axis=1)
    values = jnp.where(jnp.isfinite(values), values, jnp.inf)
    best = jnp.argmin(values)
    better = values[best] < now.value
    # When nothing is lower, the shortest step tells most about the slope here.
    shown = jnp.where(better, best, len(factors) - 1)
    step, residuals = steps[shown], trials[shown]
    surprise = residuals - now.residuals - step @ now.jacobian
    corrected = now.jacobian + step[:, None] * surprise[None, :] / jnp.maximum(jnp.sum(step * step), 1e-300)
    return _Secant(
        point=jnp.where(better, now.point + step, now.point),
        residuals=jnp.where(better, residuals, now.residuals),
        jacobian=jnp.where(jnp.isfinite(values[shown]), corrected, now.jacobian),
        value=jnp.where(better, values[best], now.value),
        damping=jnp.clip(jnp.where(better, dampings[best], _GROWTH * dampings[-1]), *_DAMPING_RANGE),
    )


def _damped_step(now: _Secant, damping: Array, longest: float, floor: float) -> Array:
    hessian = now.jacobian @ now.jacobian.T
    diagonal = jnp.diagonal(hessian)
    scale = jnp.maximum(diagonal, floor * jnp.max(diagonal) + 1e-30)
    # In units in which the diagonal is one: a gain that hardly matters leaves the system well conditioned.
    unit = jnp.sqrt(scale)
    matrix = hessian / (unit[:, None] * unit[None, :]) + damping * jnp.eye(scale.shape[0])
    step = -jnp.linalg.solve(matrix, (now.jacobian @ now.residuals) / unit) / unit
    return step * jnp.minimum(1.0, longest / jnp.maximum(jnp.max(jnp.abs(step)), longest))


def with_jacobian(function: Callable[[Array], Array], vector: Float[Array, " n"]) -> tuple[Array, Float[Array, "n ..."]]:
    """Return function(vector) and its derivatives by forward mode: no memory in the horizon of a rollout."""

    def push(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(function, (vector,), (direction,))

    return jax.vmap(push, out_axes=(None, 0))(jnp.eye(vector.size, dtype=vector.dtype))


def linearise(
    residuals: Callable[[Array], Array], vector: Float[Array, " n"], largest_residual_gradient: float = math.inf
) -> LeastSquares:
    """Return the sum of the squares of residuals with its Jacobian by forward mode.

    Args:
        residuals: vector (n,) -> (m,).
        vector: where.
        largest_residual_gradient: relative to the residual or to the root mean square of all, whichever is larger. Larger
            ones are clipped, the value is not: in chaotic regimes they are unreliable.
    """

    r, jacobian = with_jacobian(residuals, vector)
    if largest_residual_gradient < math.inf:
        most = largest_residual_gradient * jnp.maximum(jnp.abs(r), jnp.sqrt(jnp.mean(r * r)))
        slope = jnp.sqrt(jnp.sum(jacobian * jacobian, axis=0))
        jacobian = jacobian * jnp.where(slope > most, most / jnp.where(slope > most, slope, 1.0), 1.0)[None, :]
    return LeastSquares(jnp.sum(r * r), 2.0 * jacobian @ r, r, jacobian, residuals)


def quadratic(
    residuals: Callable[[Array], Array], vector: Float[Array, " n"], largest_residual_gradient: float = math.inf
) -> Quadratic:
    """Return value, gradient and Gauss-Newton Hessian of a sum of squares; arguments as in `linearise`."""
    seen = linearise(residuals, vector, largest_residual_gradient)
    return Quadratic(seen.value, seen.gradient, 2.0 * seen.jacobian @ seen.jacobian.T)
