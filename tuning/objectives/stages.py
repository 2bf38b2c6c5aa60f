"""Stages of a search: the smoothing shrinks towards the hard sign and the limits stiffen while the gains are tuned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxsphere.checks import require_scalar
from tuning.objectives.objective import members_of


@dataclass(frozen=True, eq=False)
class Annealed:
    """An objective in stages; the last one is what is tuned for, and what it is called with.

    Attributes:
        objective: a `RestToRest`, a `FollowLine` or a `Robust` of one.
        smoothing: epsilon of each stage, rad/s. With a controller held for dt it must exceed eta dt / 2, or the smoothed sign
            chatters like the hard one. A `FollowLine` has no sign to smooth.
        stiffness: factor of the penalties of every stage.
    """

    objective: Any
    smoothing: tuple[float, ...] = (0.2, 0.1, 0.05)
    stiffness: tuple[float, ...] = (1.0, 4.0, 16.0)

    @property
    def stages(self) -> int:
        """How many there are."""
        return len(self.smoothing)

    @property
    def largest_residual_gradient(self) -> float:
        """See `linearise`."""
        return members_of(self.objective).largest_residual_gradient

    def stage(self, index: Array | int) -> Any:
        """Return the objective of one stage; `index` may be traced."""
        return self.objective.stiffened(jnp.asarray(self.smoothing)[index], jnp.asarray(self.stiffness)[index])

    def __call__(self, gains: Any) -> Float[Array, ""]:
        """Return the objective of the last stage."""
        return self.stage(-1)(gains)

    def residuals(self, gains: Any) -> Float[Array, " m"]:
        """Return the residuals of the last stage."""
        return self.stage(-1).residuals(gains)

    def limits(self, gains: Any) -> Any:
        """Return the limits of the last stage."""
        return self.stage(-1).limits(gains)

    def check(self) -> None:
        """Raise ValueError unless the stages pair up with positive numbers and the objective itself is sound."""
        if not self.smoothing or len(self.smoothing) != len(self.stiffness):
            raise ValueError(
                f"smoothing has {len(self.smoothing)} stages and stiffness {len(self.stiffness)}; type as many of one as of "
                "the other, at least one"
            )
        for name in ("smoothing", "stiffness"):
            for value in getattr(self, name):
                require_scalar(name, value, above=0.0)
        self.objective.check()

    def explain(self, gains: Any) -> str:
        """Return a phrase that says when and where the first stage ceases to be finite."""
        return self.stage(0).explain(gains)
