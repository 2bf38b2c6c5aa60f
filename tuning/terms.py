"""What the terms of every objective share: a user's own term, and the shapes that keep residuals smooth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.checks import is_concrete
from jaxsphere.numerics import Real


class Term(NamedTuple):
    """A term of the user's own: the objective gains weight x function(trajectory)^2."""

    name: str
    function: Callable[[js.Trajectory], Array]  # of a saved trajectory, one scalar
    weight: float = 1.0


def linear_far_out(x: Array) -> Array:
    """Root of 2 (sqrt(1 + x^2) - 1): its square is x^2 up to about one and grows like 2 |x| beyond."""
    return x * jnp.sqrt(2.0 / (1.0 + jnp.sqrt(1.0 + x * x)))


def is_off(weight: Real) -> bool:
    """Tell whether a weight is zero; a traced one never is."""
    return is_concrete(weight) and float(weight) == 0.0


def scalar_of(term: Term, trajectory: js.Trajectory) -> Array:
    """Value of a user's term on a trajectory. Raises ValueError unless it is one scalar."""
    value = jnp.asarray(term.function(trajectory))
    if value.shape != ():
        raise ValueError(f"term {term.name!r} returns shape {value.shape}; return one scalar, e.g. the jnp.mean of it")
    return value


def require_terms(weights: Any, extra: tuple[Term, ...]) -> None:
    """Raise ValueError when every weight of the NamedTuple is zero and there is no term of the user's own."""
    if not extra and all(is_off(weight) for weight in weights):
        raise ValueError(
            "weights leaves the objective without terms; type a positive one, e.g. "
            f"tuning.{type(weights).__name__}({type(weights)._fields[0]}=1.0)"
        )
