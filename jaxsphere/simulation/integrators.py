"""Fixed-step integrators: one step is (field, time, state, dt) -> (state, info at the start of the step).

`field(time, state)` returns (rate, info); state and rate are tuples of equally shaped arrays, info is any pytree. The stages
run under `lax.scan`, so that the physics is compiled once however many stages there are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import require_choice
from jaxsphere.numerics import Real

State = tuple[Array, ...]
Field = Callable[[Array, State], tuple[tuple[Real, ...], Any]]
Step = Callable[[Field, Array, State, Array], tuple[State, Any]]

# Each stage of the classical method needs only the stage before it: (step to the next stage, weight, time), in units of dt.
_RK4 = np.array([[0.5, 1 / 6, 0.0], [0.5, 1 / 3, 0.5], [1.0, 1 / 3, 0.5], [0.0, 1 / 6, 1.0]])

# Dormand & Prince (1980), fifth-order weights; the seventh stage serves only the error estimate and is left out.
_DOPRI5_STAGES = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
    ]
)
_DOPRI5_WEIGHTS = np.array([35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84])


def rk4(field: Field, time: Array, state: State, dt: Array) -> tuple[State, Any]:
    """Advance one step by the classical Runge-Kutta method, order 4."""

    def stage(carry: tuple[State, State], coefficients: Array) -> tuple[tuple[State, State], Any]:
        point, total = carry
        to_next, weight, fraction = coefficients
        rate, info = field(time + fraction * dt, point)
        point = tuple(x + (to_next * dt) * k for x, k in zip(state, rate, strict=True))
        total = tuple(x + (weight * dt) * k for x, k in zip(total, rate, strict=True))
        return (point, total), info

    (_, end), infos = jax.lax.scan(stage, (state, state), jnp.asarray(_RK4, state[0].dtype))
    return end, _first(infos)


def dopri5(field: Field, time: Array, state: State, dt: Array) -> tuple[State, Any]:
    """Advance one step by the fifth-order method of Dormand and Prince (no step-size control), order 5."""
    count, dtype = len(_DOPRI5_WEIGHTS), state[0].dtype

    def combine(weights: Array, rates: State) -> State:
        return tuple(x + dt * jnp.tensordot(weights, k, axes=1) for x, k in zip(state, rates, strict=True))

    def stage(rates: State, row: tuple[Array, Array]) -> tuple[State, Any]:
        index, weights = row
        rate, info = field(time + weights.sum() * dt, combine(weights, rates))
        return tuple(k.at[index].set(new) for k, new in zip(rates, rate, strict=True)), info

    empty = tuple(jnp.zeros((count, *jnp.shape(x)), dtype) for x in state)
    rates, infos = jax.lax.scan(stage, empty, (jnp.arange(count), jnp.asarray(_DOPRI5_STAGES, dtype)))
    return combine(jnp.asarray(_DOPRI5_WEIGHTS, dtype), rates), _first(infos)


def semi_implicit_euler(is_velocity: tuple[bool, ...]) -> Step:
    """Build the step that advances the velocities first and the positions with the new velocities, order 1.

    Args:
        is_velocity: which components are velocities; the others are positions.
    """

    def step(field: Field, time: Array, state: State, dt: Array) -> tuple[State, Any]:
        rate, info = field(time, state)
        half = tuple(x + dt * k if fast else x for x, k, fast in zip(state, rate, is_velocity, strict=True))
        rate, _ = field(time, half)
        return tuple(x if fast else x + dt * k for x, k, fast in zip(half, rate, is_velocity, strict=True)), info

    return step


METHODS = ("rk4", "dopri5", "semi_implicit_euler")


def stepper(method: str, is_velocity: tuple[bool, ...]) -> Step:
    """Return the step called `method`. Raises ValueError with the known names otherwise."""
    require_choice("method", method, METHODS)
    if method == "semi_implicit_euler":
        return semi_implicit_euler(is_velocity)
    return {"rk4": rk4, "dopri5": dopri5}[method]


def _first(infos: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[0], infos)
