"""Second-order optimisers as pairs (init, update): one evaluation with derivatives per update, so that they scan and vmap.

L-BFGS has its trial points evaluated outside and accepts or rejects them; Levenberg-Marquardt is handed the residuals and
tries points of its own. A trial whose value or derivatives are not finite is rejected like one that is too high.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_count
from tuning.optimisers import Optimiser

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
    """Levenberg-Marquardt of a sum of squares with Marquardt's scaling, on one Jacobian for several steps.

    An update takes `rounds` steps. In each it tries the damping times every one of `factors` side by side, keeps the best
    point if it is lower, and corrects the Jacobian by Broyden's rank-one formula with what the trial has shown: a step
    costs len(factors) evaluations of the residuals instead of a Jacobian.

    Args:
        damping: at the start, relative to the diagonal of the Hessian. longest: largest change of any entry in one step.
        floor: least diagonal entry that scales the damping, of the largest: a gain that hardly matters moves slowly.
        rounds: steps on one Jacobian. factors: increasing. `update` needs a `LeastSquares` at the vector.

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


class BfgsState(NamedTuple):
    """The last accepted point with its value and gradient, the pairs (memory, n), and the line search on the way."""

    point: Array
    value: Array
    gradient: Array
    moves: Array
    changes: Array
    direction: Array
    length: Array


def lbfgs(memory: int = 8, longest: float = 1.0, decrease: float = 1e-4) -> Optimiser:
    """Limited-memory BFGS of Nocedal (1980) with a line search by quadratic interpolation, one evaluation per update.

    Args:
        memory: pairs kept. longest: largest change of any entry in one step. decrease: of Armijo's condition.
        `update` needs the value and the gradient of the trial point. Pairs without positive curvature are left out.
    """

    def init(vector: Array) -> BfgsState:
        zero, pairs = jnp.zeros_like(vector), jnp.zeros((memory, vector.shape[0]))
        return BfgsState(vector, jnp.full((), jnp.inf), zero, pairs, pairs, zero, jnp.ones(()))

    def update(seen: tuple[Array, Array], state: BfgsState, vector: Array) -> tuple[Array, BfgsState]:
        value, gradient = seen
        first = jnp.isinf(state.value)
        usable = jnp.isfinite(value) & jnp.all(jnp.isfinite(gradient))
        slope = jnp.sum(state.gradient * state.direction)
        enough = value <= state.value + decrease * state.length * slope
        better = usable & (first | enough)

        move, change = vector - state.point, gradient - state.gradient
        curved = better & ~first & (jnp.sum(move * change) > 1e-12 * jnp.sum(move * move))
        moves = jnp.where(curved, _push(state.moves, move), state.moves)
        changes = jnp.where(curved, _push(state.changes, change), state.changes)
        direction = _two_loops(gradient, moves, changes)
        norm = jnp.max(jnp.abs(direction))
        # Before any curvature is known the first step has unit length at most.
        reach = jnp.where(jnp.any(moves != 0.0), longest, jnp.minimum(longest, 0.1))
        direction = direction * jnp.minimum(1.0, reach / jnp.maximum(norm, reach))

        safe = jnp.where(usable, value, state.value - slope * state.length)
        bend = safe - state.value - slope * state.length
        minimum = -0.5 * slope * state.length**2 / jnp.maximum(bend, 1e-300)
        shorter = jnp.clip(jnp.where(usable, minimum, 0.0), 0.1 * state.length, 0.5 * state.length)

        after = BfgsState(
            point=jnp.where(better, vector, state.point),
            value=jnp.where(better, value, state.value),
            gradient=jnp.where(better, gradient, state.gradient),
            moves=moves,
            changes=changes,
            direction=jnp.where(better, direction, state.direction),
            length=jnp.where(better, 1.0, shorter),
        )
        return after.point + after.length * after.direction, after

    return Optimiser(init, update, needs="value")


def _push(rows: Array, row: Array) -> Array:
    return jnp.concatenate([rows[1:], row[None]])


def _two_loops(gradient: Array, moves: Array, changes: Array) -> Array:
    """Minus the inverse Hessian of the pairs (newest last) times the gradient; rows of zeros count for nothing."""
    products = jnp.sum(moves * changes, axis=1)
    kept = products > 0.0
    inverse = jnp.where(kept, 1.0 / jnp.where(kept, products, 1.0), 0.0)

    def back(q: Array, pair: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        s, y, rho = pair
        share = rho * jnp.sum(s * q)
        return q - share * y, share

    q, shares = jax.lax.scan(back, gradient, (moves, changes, inverse), reverse=True)
    newest = jnp.sum(changes[-1] * changes[-1])
    q = q * jnp.where(kept[-1], products[-1] / jnp.where(newest > 0.0, newest, 1.0), 1.0)

    def forth(r: Array, pair: tuple[Array, Array, Array, Array]) -> tuple[Array, None]:
        s, y, rho, share = pair
        return r + s * (share - rho * jnp.sum(y * r)), None

    r, _ = jax.lax.scan(forth, q, (moves, changes, inverse, shares))
    return -r


def linearise(residuals: Callable[[Array], Array], vector: Array) -> LeastSquares:
    """Sum of the squares of `residuals(vector) -> (m,)` with its Jacobian by forward mode."""

    def push(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(residuals, (vector,), (direction,))

    r, jacobian = jax.vmap(push, out_axes=(None, 0))(jnp.eye(vector.shape[0], dtype=vector.dtype))
    return LeastSquares(jnp.sum(r * r), 2.0 * jacobian @ r, r, jacobian, residuals)


def quadratic(residuals: Callable[[Array], Array], vector: Array) -> Quadratic:
    """Value, gradient and Gauss-Newton Hessian of the sum of squares of `residuals(vector) -> (m,)`."""
    seen = linearise(residuals, vector)
    return Quadratic(seen.value, seen.gradient, 2.0 * seen.jacobian @ seen.jacobian.T)
