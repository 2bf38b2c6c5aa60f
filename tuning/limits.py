"""Hard limits of a task: how far gains keep from them, and which they break."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

# Of a limit: the penalties that keep it are stiff, not infinite.
TOLERANCE = 0.02


class Limits(NamedTuple):
    """By how much each hard limit is exceeded, relative to it; positive where it is broken."""

    ended_early: Array  # share of the duration after the end of the rollout
    singularity: Array  # minus the nonsingularity margin
    stability: Array  # minus the Hurwitz margin of the sliding motion
    swing: Array  # peak |phi - phi_0| over swing_limit, less one
    overshoot: Array  # in excess of overshoot_limit, of the travel

    @property
    def feasible(self) -> Array:
        """Whether every limit is kept to within 2 %."""
        return jnp.max(jnp.stack(list(self)), axis=0) <= TOLERANCE

    def sentence(self) -> str:
        """Name the limits that are broken, or say that none is; for numbers on the host."""
        broken = [f"{name.replace('_', ' ')} by {float(by):.3g}" for name, by in self._asdict().items() if by > TOLERANCE]
        return f"breaks {', '.join(broken)}" if broken else "keeps every limit"
