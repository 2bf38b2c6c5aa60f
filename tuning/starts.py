"""Starts of the search: Latin hypercubes, one row per start."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array


def latin_hypercube(key: Array, count: int, size: int) -> Array:
    """Return points (count, size) in the open unit cube: along every axis each of `count` equal cells holds exactly one."""
    order_key, place_key = jax.random.split(key)
    orders = jax.vmap(lambda one: jax.random.permutation(one, count))(jax.random.split(order_key, size)).T
    place = jax.random.uniform(place_key, (count, size), minval=1e-3, maxval=1.0 - 1e-3)
    return (orders + place) / count


def around(key: Array, centre: Array, count: int, spread: float) -> Array:
    """Return starts (count, n): `centre` (n,), and a Latin hypercube of normal draws, `spread` their standard deviation."""
    noise = jax.scipy.special.ndtri(latin_hypercube(key, count, centre.shape[0]))
    return centre[None, :] + spread * noise.at[0].set(0.0)


def across(key: Array, centre: Array, count: int) -> Array:
    """Return starts (count, n): `centre`, and a Latin hypercube over the bounds, even in the logarithms of the gains."""
    place = 0.02 + 0.96 * latin_hypercube(key, count, centre.shape[0])
    return jnp.arcsin(2.0 * place - 1.0).at[0].set(centre)
