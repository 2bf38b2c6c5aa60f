"""Checkpoints of a long search: one file with everything that the next iteration needs, whole or not there."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxsphere.files import write_atomically

_AGREEMENT = 1e-3  # relative, of a stored best and the same computed by another program


def save(path: str | os.PathLike[str], problem: dict[str, Any], batch: Any, history: dict[str, np.ndarray]) -> Path:
    """Write a checkpoint atomically and return its path.

    Args:
        path: of the file.
        problem: plain content that two searches share exactly when they solve the same problem in the same way.
        batch: state of all starts, a pytree of arrays.
        history: name -> (iterations, starts).
    """
    leaves = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(batch))}
    return write_atomically(path, partial(_write, {"problem": np.array(json.dumps(problem)), **leaves, **history}))


def load(
    path: str | os.PathLike[str], problem: dict[str, Any], batch: Any, bests: Callable[[Any], Array]
) -> tuple[Any, dict[str, np.ndarray]]:
    """Return batch and history as `save` wrote them.

    Args:
        path, problem: as in `save`.
        batch: any with the structure of the saved one.
        bests: batch -> objective of each start (starts,) at the best vector that it has, evaluated anew.

    Raises:
        ValueError: the file is missing, no checkpoint, of another problem, or its best values are not those of its vectors.
    """
    name = os.fspath(path)
    if not Path(path).exists():
        raise ValueError(f"checkpoint = {name!r} does not exist; type resume=False to start anew")
    try:
        with np.load(path, allow_pickle=False) as file:
            content = dict(file)
        saved = json.loads(str(content.pop("problem")))
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"checkpoint = {name!r} is no checkpoint; type a file that tune(checkpoint=...) wrote") from error
    if difference := _difference(saved, json.loads(json.dumps(problem))):
        raise ValueError(
            f"checkpoint = {name!r} is of another problem (it differs in {difference}); type another file, or "
            "resume=False to overwrite it"
        )
    leaves = [content.pop(f"leaf_{i}") for i in range(len(jax.tree.leaves(batch)))]
    batch = jax.tree.unflatten(jax.tree.structure(batch), leaves)
    now, then = np.asarray(bests(batch)), batch.best
    known = np.isfinite(then)
    if not np.allclose(now[known], then[known], rtol=_AGREEMENT, atol=1e-9):
        raise ValueError(
            f"checkpoint = {name!r} says that its best objectives are {then[known].tolist()}, but there they are "
            f"{now[known].tolist()}; type resume=False to start anew"
        )
    return batch, content


def _write(content: dict[str, np.ndarray], path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, **content)  # type: ignore[arg-type]


def _difference(one: dict[str, Any], other: dict[str, Any]) -> str:
    return ", ".join(sorted(key for key in one.keys() | other.keys() if one.get(key) != other.get(key)))
