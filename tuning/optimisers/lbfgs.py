"""L-BFGS: its trial points are evaluated outside, it accepts or rejects them.

A trial whose value or derivatives are not finite is rejected like one that is too high.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from tuning.optimisers.optimiser import Optimiser


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
    """Return limited-memory BFGS of Nocedal (1980) with a line search by quadratic interpolation, one evaluation per update.

    Args:
        memory: pairs kept; those without positive curvature are left out.
        longest: largest change of any entry in one step.
        decrease: of Armijo's condition.

    Returns:
        An Optimiser whose `update` needs the value and the gradient of the trial point.
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
