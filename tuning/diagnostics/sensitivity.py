"""Which gains matter: stiff and sloppy directions of an objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from tuning.optimisers.levenberg_marquardt import quadratic
from tuning.transforms import parametrise


class Directions(NamedTuple):
    """Eigenvalues (n,) of the Gauss-Newton Hessian in the logarithms of the gains, stiffest first, and their directions."""

    names: tuple[str, ...]
    eigenvalues: np.ndarray
    vectors: np.ndarray  # (n, n), one direction a row

    def sentence(self) -> str:
        """Return one sentence for people."""
        stiff, sloppy = (self._words(row) for row in (0, -1))
        ratio = self.eigenvalues[0] / max(self.eigenvalues[-1], 1e-300)
        # A change d of the logarithms raises the objective by d' H d / 2.
        harmless = float(np.sqrt(0.02 / max(self.eigenvalues[-1], 1e-300)))
        return (
            f"what matters most is {stiff}, what matters least is {sloppy}: the first is {ratio:.1e} times as stiff, and along "
            f"the last the gains may change by a factor of {np.exp(min(harmless, 20.0)):.3g} before the objective rises by 0.01"
        )

    def _words(self, row: int) -> str:
        vector = self.vectors[row]
        named = [(abs(share), share, name) for name, share in zip(self.names, vector, strict=True) if abs(share) > 0.3]
        first = max(named)[1]
        return " ".join(f"{'x' if share * first > 0 else '/'} {name}" for _, share, name in sorted(named, reverse=True))[2:]


def stiff_and_sloppy(objective: Any, gains: Any, names: Sequence[str] = ()) -> Directions:
    """Return the directions of the logarithms of the gains by how much they matter to the objective.

    Args:
        objective: with `residuals`.
        gains: where.
        names: of the gains; all free ones by default.
    """
    names = tuple(names) or parametrise(gains).names

    def residuals(logarithms: Array) -> Array:
        changed = {name: jnp.exp(logarithms[i]) for i, name in enumerate(names)}
        return objective.residuals(replace(gains, **changed))

    point = jnp.log(jnp.stack([jnp.asarray(getattr(gains, name), float) for name in names]))
    hessian = jax.jit(lambda free: quadratic(residuals, free).hessian)(point)
    values, vectors = np.linalg.eigh(np.asarray(hessian))
    return Directions(names, values[::-1], vectors.T[::-1])
