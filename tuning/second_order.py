"""Second-order optimisers as pairs (init, update): one evaluation of the objective per update, so that they scan and vmap.

A trial point is evaluated outside; `update` accepts or rejects it and proposes the next one. A trial whose value or
derivatives are not finite is rejected like one that is too high.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from tuning.optimisers import Optimiser


class Quadratic(NamedTuple):
    """Value, gradient (n,) and Gauss-Newton Hessian (n, n) of a sum of squares at one point."""

    value: Array
    gradient: Array
    hessian: Array


class MarquardtState(NamedTuple):
    """The last accepted point, what is known there, and the damping."""

    point: Array
    known: Quadratic
    damping: Array
    growth: Array


def levenberg_marquardt(damping: float = 0.1, longest: float = 0.5, floor: float = 1e-2) -> Optimiser:
    """Levenberg-Marquardt of a sum of squares with Marquardt's scaling and the damping rule of Nielsen (1999).

    Args:
        damping: at the start, relative to the diagonal of the Hessian. longest: largest change of any entry in one step.
        floor: least diagonal entry that scales the damping, of the largest: a gain that hardly matters moves slowly.
        `update` needs a `Quadratic` of the trial point.
    """

    def init(vector: Array) -> MarquardtState:
        size = vector.shape[0]
        nothing = Quadratic(jnp.full((), jnp.inf), jnp.zeros(size), jnp.eye(size))
        return MarquardtState(vector, nothing, jnp.full((), damping), jnp.full((), 2.0))

    def update(seen: Quadratic, state: MarquardtState, vector: Array) -> tuple[Array, MarquardtState]:
        usable = jnp.isfinite(sum((jnp.sum(part) for part in seen), jnp.zeros(())))
        better = usable & (seen.value < state.known.value)
        move = vector - state.point
        curvature = jnp.sum(move * (state.known.hessian @ move))
        predicted = -jnp.sum(state.known.gradient * move) - 0.5 * curvature
        first = jnp.isinf(state.known.value)
        ratio = jnp.where(first, 0.5, (state.known.value - seen.value) / jnp.maximum(predicted, 1e-300))
        lower = state.damping * jnp.maximum(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3)
        lower = jnp.where(first, state.damping, lower)
        after = MarquardtState(
            point=jnp.where(better, vector, state.point),
            known=Quadratic(*(jnp.where(better, new, old) for new, old in zip(seen, state.known, strict=True))),
            damping=jnp.clip(jnp.where(better, lower, state.damping * state.growth), 1e-12, 1e8),
            growth=jnp.where(better, 2.0, jnp.minimum(2.0 * state.growth, 16.0)),
        )
        return after.point + _damped_step(after, longest, floor), after

    return Optimiser(init, update, needs="quadratic")


def _damped_step(state: MarquardtState, longest: float, floor: float) -> Array:
    diagonal = jnp.diagonal(state.known.hessian)
    scale = jnp.maximum(diagonal, floor * jnp.max(diagonal) + 1e-30)
    # In units in which the diagonal is one: a gain that hardly matters leaves the system well conditioned.
    unit = jnp.sqrt(scale)
    matrix = state.known.hessian / (unit[:, None] * unit[None, :]) + state.damping * jnp.eye(scale.shape[0])
    step = -jnp.linalg.solve(matrix, state.known.gradient / unit) / unit
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


def quadratic(residuals: Any, vector: Array, steepest: float = math.inf) -> Quadratic:
    """Value, gradient and Gauss-Newton Hessian of the sum of squares of `residuals(vector) -> (m,)`, by forward mode.

    steepest: cap on the slope of each residual, relative to its size or to the root mean square of all, whichever is larger.
    A residual that is steeper says nothing at the distance of a step: chaos would drown what the others say. The gradient
    and the Hessian are those of the capped slopes, the value is exact.
    """

    def push(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(residuals, (vector,), (direction,))

    r, jacobian = jax.vmap(push, out_axes=(None, 0))(jnp.eye(vector.shape[0], dtype=vector.dtype))
    if steepest < math.inf:
        most = steepest * jnp.maximum(jnp.abs(r), jnp.sqrt(jnp.mean(r * r)))
        slope = jnp.sqrt(jnp.sum(jacobian * jacobian, axis=0))
        jacobian = jacobian * jnp.where(slope > most, most / jnp.where(slope > most, slope, 1.0), 1.0)[None, :]
    return Quadratic(jnp.sum(r * r), 2.0 * jacobian @ r, 2.0 * jacobian @ jacobian.T)
