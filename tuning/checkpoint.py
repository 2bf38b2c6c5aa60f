"""Checkpoints of a long search: one file with everything that the next iteration needs, whole or not there."""

from __future__ import annotations

import json
import os
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxsphere.files import to_plain, write_atomically


def describe(problem: dict[str, Any]) -> str:
    """Text that two runs share exactly when they solve the same problem; a function is known by its name."""
    return json.dumps(to_plain(_named(problem)), sort_keys=True)


def save(path: str | os.PathLike[str], problem: str, batch: Any, history: dict[str, np.ndarray]) -> Path:
    """Write the state of all starts and the history (name -> (iterations, starts)) atomically."""
    leaves = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(batch))}
    return write_atomically(path, partial(_write, {"problem": np.array(problem), **leaves, **history}))


def load(path: str | os.PathLike[str], problem: str, batch: Any) -> tuple[Any, dict[str, np.ndarray]]:
    """Read what `save` wrote; `batch` gives the structure.

    Raises:
        ValueError: the file is missing, no checkpoint, or of another problem.
    """
    name = os.fspath(path)
    if not Path(path).exists():
        raise ValueError(f"checkpoint = {name!r} does not exist; type resume=False to start anew")
    try:
        with np.load(path, allow_pickle=False) as file:
            content = dict(file)
        saved = str(content.pop("problem"))
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"checkpoint = {name!r} is no checkpoint; type a file that tune(checkpoint=...) wrote") from error
    if saved != problem:
        raise ValueError(
            f"checkpoint = {name!r} is of another problem (it differs in {_difference(saved, problem)}); type another file, or "
            "resume=False to overwrite it"
        )
    leaves = [content.pop(f"leaf_{i}") for i in range(len(jax.tree.leaves(batch)))]
    return jax.tree.unflatten(jax.tree.structure(batch), leaves), content


def _write(content: dict[str, np.ndarray], path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, **content)  # type: ignore[arg-type]


def _named(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _named(value) for key, value in content.items()}
    if hasattr(content, "_asdict"):
        return _named(content._asdict())
    if hasattr(content, "__dataclass_fields__"):
        return {"type": type(content).__name__} | {n: _named(getattr(content, n)) for n in content.__dataclass_fields__}
    if isinstance(content, list | tuple):
        return [_named(value) for value in content]
    return getattr(content, "__qualname__", content)


def _difference(one: str, other: str) -> str:
    first, second = json.loads(one), json.loads(other)
    return ", ".join(sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key)))
