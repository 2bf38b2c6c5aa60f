"""Named terms of the objective of a move from rest to rest, their weights, and terms of the user's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.checks import is_concrete
from jaxsphere.numerics import Real


class Weights(NamedTuple):
    """Weights of the terms of `RestToRest`; zero switches a term off."""

    tracking: Real = 1.0
    swing: Real = 1.0
    torque: Real = 1e-3
    chatter: Real = 0.5
    settling: Real = 0.0
    overshoot: Real = 1.0
    singularity: Real = 100.0
    stability: Real = 100.0
    prior: Real = 0.03


class Terms(NamedTuple):
    """The unweighted terms of one rollout; every entry a scalar (as residuals: vectors whose squares sum to it)."""

    tracking: Array  # s^2: integral of t |e| / travel, |e| rounded off below 1e-3 of the travel
    swing: Array  # s: integral of the excess of |phi - phi_0| over swing_limit in degrees, squared up to 1, linear beyond
    torque: Array  # (N m)^2 s: integral of tau^2
    chatter: Array  # (N m)^2: mean square of the torque step eta / decoupling that the hard sign switches by
    settling: Array  # s: integral of a smooth step that is 1 outside the 2 % band and 0 inside
    overshoot: Array  # s: integral of the excess of e over overshoot_limit in % of the travel, likewise
    singularity: Array  # squared shortfall of the nonsingularity margin below 0.2, of 0.2
    stability: Array  # sum of the squared shortfalls of the Hurwitz margins below 0.1, of 0.1
    prior: Array  # sum of the squared logarithms of c1 ... k over those of `typical`: it decides what nothing else does


class Term(NamedTuple):
    """A term of the user's own: the objective gains weight x function(trajectory)^2."""

    name: str
    function: Callable[[js.Trajectory], Array]  # of a saved trajectory, one scalar
    weight: float = 1.0


def linear_far_out(x: Array) -> Array:
    """Root of 2 (sqrt(1 + x^2) - 1): its square is x^2 up to about one and grows like 2 |x| beyond."""
    return x * jnp.sqrt(2.0 / (1.0 + jnp.sqrt(1.0 + x * x)))


def is_off(weight: Real) -> bool:
    """Tell whether a term is known to have no weight; a traced weight always counts."""
    return is_concrete(weight) and float(weight) == 0.0


def scalar_of(term: Term, trajectory: js.Trajectory) -> Array:
    """Value of a term of the user's own. Raises ValueError unless it is one scalar."""
    value = jnp.asarray(term.function(trajectory))
    if value.shape != ():
        raise ValueError(f"term {term.name!r} returns shape {value.shape}; return one scalar, e.g. the jnp.mean of it")
    return value
