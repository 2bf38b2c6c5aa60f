"""Files that are either whole or not there: written beside their place, then renamed."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], None]) -> Path:
    """Let `write` fill a temporary file in the folder of `path`, then rename it to `path`; on any error nothing is left.

    The temporary file keeps the suffix of `path`. Raises OSError when the folder cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    try:
        write(Path(name))
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)
    return path


def write_json(path: str | os.PathLike[str], content: Any) -> Path:
    """Write any pytree of numbers and strings as JSON, atomically; a number that is not finite becomes null."""
    text = json.dumps(to_plain(content), indent=2, allow_nan=False) + "\n"
    return write_atomically(path, partial(_fill, text))


def _fill(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")


def to_plain(content: Any) -> Any:
    """Turn dataclasses, named tuples and arrays into dicts, lists and numbers that JSON knows."""
    if isinstance(content, dict):
        return {str(key): to_plain(value) for key, value in content.items()}
    if hasattr(content, "_asdict"):
        return to_plain(content._asdict())
    if hasattr(content, "__dataclass_fields__"):
        return {name: to_plain(getattr(content, name)) for name in content.__dataclass_fields__}
    if isinstance(content, np.ndarray | np.generic | jax.Array):
        return to_plain(np.asarray(content).tolist())
    if isinstance(content, list | tuple):
        return [to_plain(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    if content is None or isinstance(content, str | int | float | bool):
        return content
    return str(content)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
