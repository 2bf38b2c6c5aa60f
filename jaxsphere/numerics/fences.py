"""Fences that make XLA compute a value once.

XLA may recompute a cheap value inside every fused kernel that reads it. `evaluate_once` stops that: a division counts as
expensive and is never duplicated, and the compiler cannot prove that the divisor below is one.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

# A real number of the user's or of a traced program; NumPy scalars and arrays serve as well.
Real = float | Array


def evaluate_once(value: Array) -> Array:
    """Return `value` unchanged (non-finite values become NaN) as something that XLA computes once and then reads."""
    return value / (1.0 + 0.0 * jax.lax.stop_gradient(value))


def safe_sqrt(square: Array) -> Array:
    """Square root of a sum of squares, with derivative 0 at 0, where the root itself has none."""
    positive = square > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
