"""Checks of user input on the host. A traced value has no number yet and is passed over; every fault is one sentence."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.core
import numpy as np


def is_concrete(value: Any) -> bool:
    """Tell whether every leaf of `value` is a number on the host, not a tracer."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def require_scalar(
    name: str,
    value: Any,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    or_equal: bool = False,
    unit: str = "",
    hint: str = "",
) -> None:
    """Require one finite number strictly between `above` and `below` (`or_equal` admits `above` itself).

    Raises ValueError naming the argument, its value and the admissible range.
    """
    if not is_concrete(value):
        return
    try:
        number = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value!r} is no number; type one finite number{_unit(unit)}") from None
    if number.ndim:
        raise ValueError(f"{name} has shape {number.shape}; type one number, or batch the call with jax.vmap")
    inside = number > above or (or_equal and number == above)
    if not (np.isfinite(number) and inside and number < below):
        raise ValueError(f"{name} = {float(number):g}{_unit(unit)} is not admissible; {hint or _range(above, below, or_equal)}")


def require_count(name: str, value: Any) -> None:
    """Require a whole number of at least one. Raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"{name} = {value!r} is not admissible; type a whole number of at least 1")


def require_finite_vector(name: str, value: Any, length: int, entries: str) -> None:
    """Require `length` finite numbers; `entries` says what they are. Raises ValueError otherwise."""
    if jax.numpy.shape(value) != (length,):
        raise ValueError(f"{name} has shape {jax.numpy.shape(value)}; type {length} numbers: {entries}")
    if is_concrete(value) and not np.all(np.isfinite(np.asarray(value, dtype=np.float64))):
        raise ValueError(f"{name} = {np.asarray(value).tolist()} is not finite; type {length} finite numbers: {entries}")


def require_choice(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Require one of `choices`. Raises ValueError that lists them."""
    if value not in choices:
        raise ValueError(f"{name} = {value!r} is not known; type one of {', '.join(choices)}")


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _range(above: float, below: float, or_equal: bool) -> str:
    if math.isinf(above) and math.isinf(below):
        return "type a finite number"
    at_least = "at least" if or_equal else "above"
    if math.isinf(below):
        return f"type a finite number {at_least} {above:g}"
    if math.isinf(above):
        return f"type a finite number below {below:g}"
    return f"type a number {at_least} {above:g} and below {below:g}"
