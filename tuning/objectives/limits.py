"""Limits of a task: how far gains keep from them, and which they break."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool

TOLERANCE = 0.02  # of a limit: the penalties that keep it are stiff, not infinite


class Limits(NamedTuple):
    """By how much limits are exceeded, by name, relative to them; positive where one is broken."""

    hard: dict[str, Array]
    soft: dict[str, Array]  # in a batch of scenarios these are penalised only

    @property
    def feasible(self) -> Bool[Array, ...]:
        """Whether every limit is kept to within 2 %."""
        return jnp.all(jnp.stack([by <= TOLERANCE for by in (self.hard | self.soft).values()]), axis=0)

    def sentence(self) -> str:
        """Name the limits that are broken, or say that none is; for numbers on the host."""
        every = self.hard | self.soft
        broken = [f"{name.replace('_', ' ')} by {float(by):.3g}" for name, by in every.items() if by > TOLERANCE]
        return f"breaks {', '.join(broken)}" if broken else "keeps every limit"
