"""Files that are either whole or not there: written beside their place, then renamed.

A temporary file is called `.NAME~HOST~PID~RANDOM` and the suffix of its file, so that another process can tell whether its
writer is still alive.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

_DAY = 86400.0  # s


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], None]) -> Path:
    """Let `write` fill a temporary file in the folder of `path`, then rename it to `path`; on any error nothing is left.

    The temporary file keeps the suffix of `path`. Raises OSError when the folder cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{path.stem}~{_host()}~{os.getpid()}~"
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=path.suffix)
    os.close(handle)
    try:
        write(Path(name))
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)
    return path


def remove_abandoned(folder: str | os.PathLike[str]) -> None:
    """Remove the temporary files in a folder whose writers were killed, and those of other hosts that are a day old."""
    for path in Path(folder).glob(".*~*"):
        parts = path.name.split("~")
        if len(parts) == 4 and parts[2].isdigit() and _is_abandoned(path, parts[1], int(parts[2])):
            path.unlink(missing_ok=True)


def _is_abandoned(path: Path, host: str, process: int) -> bool:
    if host != _host():
        try:
            return time.time() - path.stat().st_mtime > _DAY
        except FileNotFoundError:
            return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except (PermissionError, OverflowError):
        pass
    return False


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9-]", "-", platform.node())[:40]


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
