"""What `tune` needs to know of an objective: how to evaluate it, and what else it may offer."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from jax import Array
from jaxtyping import Float


class Objective(Protocol):
    """A differentiable function of gains that is to be made small.

    Only the call is required, so that any function will do. An objective may also have the members of `Members`.
    """

    def __call__(self, gains: Any, /) -> Float[Array, ""]:
        """Value at the gains."""
        ...


class Members(NamedTuple):
    """What an objective may offer beside its value, each under the same name; None where it does not."""

    residuals: Callable[[Any], Array] | None  # gains -> (m,), the objective is the sum of their squares; for "lm"
    largest_residual_gradient: float  # larger gradients of a residual are clipped, see `linearise`; infinite: none is
    limits: Callable[[Any], Any] | None  # gains -> `Limits`; they decide which starts ended feasible
    check: Callable[[], None] | None  # raises ValueError for a setting that is not admissible, before anything compiles
    explain: Callable[[Any], str] | None  # gains -> where and when the objective ceases to be finite
    stages: int  # in how many the search goes; the iterations are shared among them
    stage: Callable[[Any], Objective]  # index, which may be traced -> objective of that stage; the last one is tuned for


def members_of(objective: Objective) -> Members:
    """Return what an objective offers, with the default for what it does not have."""
    defaults = Members(None, math.inf, None, None, None, 1, lambda _: objective)
    return Members(*(getattr(objective, name, default) for name, default in defaults._asdict().items()))
