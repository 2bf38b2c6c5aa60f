"""Numbers as people read them."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp


def print_numbers(numbers: dict[str, Any]) -> None:
    """Print named numbers, one a line; an array as its entries, and None as a dash."""
    for name, value in numbers.items():
        print(f"  {name:<36}{_shown(value)}")


def _shown(value: Any) -> str:
    if value is None or isinstance(value, str):
        return value or "-"
    array = jnp.asarray(value)
    return f"{float(array):.4g}" if array.ndim == 0 else " ... ".join(f"{float(entry):.4g}" for entry in array)
