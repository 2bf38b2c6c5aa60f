"""Stages of a search: the smoothing shrinks towards the hard sign and the limits stiffen while the gains are tuned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_scalar


@dataclass(frozen=True, eq=False)
class Annealed:
    """An objective in stages; the last one is what is tuned for, and what it is called with.

    objective: a `RestToRest` or a `Robust`. smoothing: epsilon of each stage, rad/s. With a controller held for dt it must
    exceed eta dt / 2, or the smoothed sign chatters like the hard one. stiffness: factor of the penalties of every stage.
    """

    objective: Any
    smoothing: tuple[float, ...] = (0.2, 0.1, 0.05)
    stiffness: tuple[float, ...] = (1.0, 4.0, 16.0)

    @property
    def stages(self) -> int:
        """How many there are."""
        return len(self.smoothing)

    def stage(self, index: Array | int) -> Any:
        """Objective of one stage; `index` may be traced."""
        return self.objective.stiffened(jnp.asarray(self.smoothing)[index], jnp.asarray(self.stiffness)[index])

    def __call__(self, gains: js.SlidingModeGains) -> Array:
        """Objective of the last stage."""
        return self.stage(-1)(gains)

    def residuals(self, gains: js.SlidingModeGains) -> Array:
        """Residuals of the last stage."""
        return self.stage(-1).residuals(gains)

    def limits(self, gains: js.SlidingModeGains) -> Any:
        """Limits of the last stage."""
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

    def explain(self, gains: js.SlidingModeGains) -> str:
        """See `RestToRest.explain`."""
        return self.stage(0).explain(gains)
