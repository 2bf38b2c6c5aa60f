"""What a sweep is, as plain text: two sweeps that say the same of themselves may share a store."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import json
import math
import re
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from types import CodeType
from typing import Any

import jax
import numpy as np

from jaxsphere.files import to_plain

LONG = 64  # entries from which an array is known by its checksum


def described(value: Any, captured: bool = True) -> Any:
    """Plain content that two values share when they mean the same; of a function its name, its code and what it captured."""
    if isinstance(value, functools.partial):
        return {"partial": described(value.func), "args": described(value.args), "keywords": described(value.keywords)}
    if isinstance(value, Mapping):
        return {str(key): described(one, captured) for key, one in value.items()}
    if hasattr(value, "_asdict"):
        return described(value._asdict(), captured)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        leaves = {field.name: described(getattr(value, field.name), captured) for field in dataclasses.fields(value)}
        return {"type": type(value).__name__} | leaves
    if isinstance(value, list | tuple):
        return [described(one, captured) for one in value]
    if isinstance(value, np.ndarray | jax.Array) and value.size >= LONG:
        array = np.asarray(value)
        return {"shape": list(array.shape), "dtype": str(array.dtype), "sha256": _sha(array.tobytes())}
    if isinstance(value, float | np.floating) and not math.isfinite(value):
        return repr(float(value))
    if callable(value):
        return _described_function(value, captured)
    plain = to_plain(value)
    return re.sub(r" at 0x[0-9a-f]+", "", plain) if isinstance(plain, str) else plain


def fingerprint(spec: Any) -> str:
    """Checksum of plain content, whatever the order of its names."""
    return _sha(json.dumps(spec, sort_keys=True).encode())


def versions() -> dict[str, str]:
    """Versions of what the last bit of a result depends on, and the platform that computes it."""
    return {name: _version(name) for name in ("jaxsphere", "jax", "jaxlib", "numpy")} | {"platform": jax.default_backend()}


def _described_function(function: Any, captured: bool) -> Any:
    name = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__name__)}"
    plain = inspect.unwrap(function)
    if not hasattr(plain, "__code__"):
        return name
    content: dict[str, Any] = {"function": name, "code": _digest(plain.__code__)}
    if captured and plain.__closure__:
        cells = [cell.cell_contents for cell in plain.__closure__]
        content["captured"] = [described(cell, captured=False) for cell in cells]
    return content


def _digest(code: CodeType) -> str:
    inner = [_digest(one) for one in code.co_consts if isinstance(one, CodeType)]
    # The entries of a set have no order that outlives the process.
    constants = [
        sorted(map(repr, one)) if isinstance(one, frozenset) else repr(one)
        for one in code.co_consts
        if not isinstance(one, CodeType)
    ]
    return _sha(repr((code.co_code.hex(), code.co_names, code.co_varnames, constants, inner)).encode())[:16]


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
