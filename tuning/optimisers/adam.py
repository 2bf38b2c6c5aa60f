"""Adam, and a learning rate that decays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from tuning.optimisers.optimiser import Optimiser


class AdamState(NamedTuple):
    """Step count and the two decaying averages."""

    count: Array
    mean: Array
    square: Array


def adam(
    learning_rate: float | Callable[[Array], Array] = 0.05,
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-8,
    clip: float = 10.0,
) -> Optimiser:
    """Return Adam of Kingma and Ba (2015), with bias correction.

    A gradient that is not finite is rejected: vector and state stay as they are.

    Args:
        learning_rate: a number, or a function of the step count.
        beta1, beta2: decay of the averages of the gradient and of its square.
        epsilon: added to the root of the latter.
        clip: longest gradient; longer ones are shortened to it.
    """
    rate = learning_rate if callable(learning_rate) else (lambda count: jnp.asarray(learning_rate))

    def init(vector: Array) -> AdamState:
        return AdamState(jnp.zeros((), jnp.int32), jnp.zeros_like(vector), jnp.zeros_like(vector))

    def update(gradient: Array, state: AdamState, vector: Array) -> tuple[Array, AdamState]:
        usable = jnp.all(jnp.isfinite(gradient))
        safe = jnp.where(usable, gradient, 0.0)
        norm = jnp.sqrt(jnp.sum(safe * safe))
        safe = safe * jnp.minimum(1.0, clip / jnp.maximum(norm, clip))
        count = state.count + 1
        mean = beta1 * state.mean + (1.0 - beta1) * safe
        square = beta2 * state.square + (1.0 - beta2) * safe * safe
        step = rate(state.count) * (mean / (1.0 - beta1**count)) / (jnp.sqrt(square / (1.0 - beta2**count)) + epsilon)
        moved = AdamState(count, mean, square)
        kept = AdamState(*(jnp.where(usable, new, old) for new, old in zip(moved, state, strict=True)))
        return jnp.where(usable, vector - step, vector), kept

    return Optimiser(init, update)


def cosine_decay(start: float, steps: int, floor: float = 0.05) -> Callable[[Array], Array]:
    """Return a learning rate that falls from `start` to `floor * start` along half a cosine over `steps` steps."""

    def rate(count: Array) -> Array:
        progress = jnp.minimum(count / steps, 1.0)
        return start * (floor + (1.0 - floor) * 0.5 * (1.0 + jnp.cos(jnp.pi * progress)))

    return rate
