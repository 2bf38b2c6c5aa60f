"""Where a rollout or an objective ceases to be finite."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jax import Array


def first_not_finite(time: Array, series: Mapping[str, Array], still: Mapping[str, Array], lane: int = 0) -> str:
    """Name the quantity that is not finite first, and when.

    time: (T,), s. series: name -> (T, ...), what changes with time. still: name -> numbers that no time belongs to.
    lane: which one it is.
    """
    for name, value in still.items():
        if not np.all(np.isfinite(np.asarray(value))):
            return f"lane {lane}, t = 0 s, {name}"
    found = []
    for order, (name, values) in enumerate(series.items()):
        rows = np.asarray(values).reshape(len(time), -1)
        bad = ~np.all(np.isfinite(rows), axis=1)
        if bad.any():
            found.append((int(np.argmax(bad)), order, name))
    if not found:
        return f"lane {lane}, all of its terms are finite; their sum is too large"
    row, _, name = min(found)
    return f"lane {lane}, t = {float(time[row]):g} s, {name}"
