"""An optimiser is a pair of pure functions (init, update) for vectors of R^n; it scans and vmaps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array


class Optimiser(NamedTuple):
    """Two functions, and what the second must be shown."""

    init: Callable[[Array], Any]  # vector (n,) -> state
    update: Callable[[Any, Any, Array], tuple[Array, Any]]  # (seen, state, vector) -> (vector, state)
    needs: str = "gradient"  # what `seen` is: "gradient" (n,), "value" (value, gradient) or "residuals", a `LeastSquares`
    trials: int = 0  # how often `update` itself evaluates the residuals, without derivatives

    def plain_rollouts(self, size: int) -> int:
        """Return the rollouts of one update of `size` unknowns when each of the forward mode's tangents counts as one."""
        return 1 + size + self.trials
