"""What the terms of every objective share: their weights, a user's own, shapes that keep residuals smooth, faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from jaxsphere.checks import is_concrete
from jaxsphere.numerics import Real


class Term(NamedTuple):
    """A term of the user's own: the objective gains weight x function(trajectory)^2."""

    name: str
    function: Callable[[js.Trajectory], Array]  # of a saved trajectory, one scalar
    weight: float = 1.0

    def scalar(self, trajectory: js.Trajectory) -> Array:
        """Return the function's value on a trajectory. Raises ValueError unless it is one scalar."""
        value = jnp.asarray(self.function(trajectory))
        if value.shape != ():
            raise ValueError(f"term {self.name!r} returns shape {value.shape}; return one scalar, e.g. the jnp.mean of it")
        return value


def linear_far_out(x: Array) -> Array:
    """Return the root of 2 (sqrt(1 + x^2) - 1): its square is x^2 up to about one and grows like 2 |x| beyond."""
    return x * jnp.sqrt(2.0 / (1.0 + jnp.sqrt(1.0 + x * x)))


def is_off(weight: Real) -> bool:
    """Tell whether a weight is zero; a traced one never is."""
    return is_concrete(weight) and float(weight) == 0.0


def require_terms(weights: Any, extra: tuple[Term, ...]) -> None:
    """Raise ValueError when every weight of the NamedTuple is zero and there is no term of the user's own."""
    if not extra and all(is_off(weight) for weight in weights):
        raise ValueError(
            "weights leaves the objective without terms; type a positive one, e.g. "
            f"tuning.{type(weights).__name__}({type(weights)._fields[0]}=1.0)"
        )


def weighted_residuals(
    weights: Iterable[Real], parts: Iterable[Array], extra: tuple[Term, ...] = (), trajectory: Any = None
) -> Float[Array, " m"]:
    """Return the residuals of terms, times the roots of their weights, without those whose weight is zero."""
    weighted = [jnp.sqrt(w) * part.reshape(-1) for w, part in zip(weights, parts, strict=True) if not is_off(w)]
    return jnp.concatenate([*weighted, *(jnp.sqrt(term.weight) * term.scalar(trajectory)[None] for term in extra)])


def weighted_sum(weights: Iterable[Real], terms: Iterable[Array]) -> Float[Array, ...]:
    """Return the sum of the terms times their weights."""
    return sum((w * term for w, term in zip(weights, terms, strict=True)), jnp.zeros(()))


def prior(gains: Any, typical: Any, names: Iterable[str]) -> Float[Array, " n"]:
    """Return the logarithms of the named gains over typical ones: regularises directions that the data do not determine."""
    return jnp.stack([jnp.log(getattr(gains, name) / getattr(typical, name)) for name in names])


class Series(NamedTuple):
    """All that an objective adds up, at some gains."""

    time: Float[Array, " T"]  # s
    moving: dict[str, Array]  # what changes with time, (T, ...)
    still: dict[str, Array]  # what belongs to no time


def first_not_finite(series: Series, lane: int = 0) -> str:
    """Return a phrase that names the quantity that is not finite first, and when; `lane` says of which scenario it is."""
    for name, value in series.still.items():
        if not np.all(np.isfinite(np.asarray(value))):
            return f"lane {lane}, t = 0 s, {name}"
    found = []
    for order, (name, values) in enumerate(series.moving.items()):
        bad = ~np.all(np.isfinite(np.asarray(values).reshape(len(series.time), -1)), axis=1)
        if bad.any():
            found.append((int(np.argmax(bad)), order, name))
    if not found:
        return f"lane {lane}, all of its terms are finite; their sum is too large"
    row, _, name = min(found)
    return f"lane {lane}, t = {float(series.time[row]):g} s, {name}"
