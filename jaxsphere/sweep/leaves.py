"""Dotted names: of the numbers among a lane's arguments, which axes replace, and of the numbers that a lane returns."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsphere.units import declared_units, unit_of


def replaced(arguments: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `arguments` with the leaves named by `values` (dotted name -> number) put in their places.

    A name without dots may be new. Raises ValueError for a name that leads to no number.
    """
    result = dict(arguments)
    for name, value in values.items():
        root, *path = name.split(".")
        result[root] = _put(result.get(root), path, value, name, root) if path else _instead(result.get(root), value, name)
    return result


def require_arguments(lane: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Require that `lane` takes these arguments by name. Raises ValueError naming the first one that it does not know."""
    try:
        signature = inspect.signature(lane)
    except (TypeError, ValueError):
        return
    known = [p.name for p in signature.parameters.values() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    if not any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values()):
        for name in arguments:
            if name not in known:
                raise ValueError(f"axis or argument {name!r} is unknown to the lane function; type one of {', '.join(known)}")
    needed = [name for name in known if signature.parameters[name].default is inspect.Parameter.empty]
    missing = [name for name in needed if name not in arguments]
    if missing:
        raise ValueError(f"the lane function needs {missing[0]!r}; give it in base or type an axis for it")


def takes_dtype(lane: Callable[..., Any]) -> bool:
    """Tell whether `lane` has an argument called dtype."""
    try:
        return "dtype" in inspect.signature(lane).parameters
    except (TypeError, ValueError):
        return False


def named_outputs(result: Any) -> dict[str, Any]:
    """Dotted name -> number or array for everything that a lane returns; one bare number is called "value".

    A Trajectory gives its status, end_time, final_state and metrics. Raises ValueError for what is no number.
    """
    if all(hasattr(result, name) for name in ("status", "end_time", "state", "metrics")):
        ends = {"status": result.status, "end_time": result.end_time, "final_state": result.state[-1]}
        return ends | ({} if result.metrics is None else named_outputs(result.metrics))
    named = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(result)[0]:
        name = ".".join(_entry(key) for key in path) or "value"
        if not _is_number(leaf):
            raise ValueError(f"the lane function returns {name} = {leaf!r}, which is no number; let it return numbers only")
        named[name] = leaf
    if not named:
        raise ValueError(f"the lane function returns {result!r}, which holds no number; let it return a pytree of numbers")
    return named


def output_units(result: Any) -> dict[str, str]:
    """Return output -> unit for what `named_outputs` returns, "" where it is unknown."""
    declared = declared_units(getattr(result, "metrics", None) or result)
    return {name: unit_of(name, declared) for name in named_outputs(result)}


def with_dtype(arguments: Any, dtype: Any) -> Any:
    """Return `arguments` with arrays of real numbers as `dtype`; plain numbers adapt by themselves."""

    def leaf(value: Any) -> Any:
        is_real = isinstance(value, np.ndarray | np.generic | jax.Array) and jnp.issubdtype(value.dtype, jnp.floating)
        return value.astype(dtype) if is_real else value

    return jax.tree.map(leaf, arguments)


def _put(tree: Any, path: list[str], value: Any, name: str, so_far: str) -> Any:
    """`tree` with `value` at `path` below it; `name` and `so_far` are for the sentence when there is no such place."""
    if not path:
        return _instead(tree, value, name)
    key, rest = path[0], path[1:]
    below = f"{so_far}.{key}"
    children = _children(tree)
    if key not in children:
        options = ", ".join(f"{so_far}.{child}" for child in children)
        fix = f"type one of {options}" if options else f"{so_far} = {tree!r} has no parts, give it a value first"
        raise ValueError(f"axis {name!r} leads to no number; {fix}")
    child = _put(children[key], rest, value, name, below)
    if isinstance(tree, np.ndarray | jax.Array):
        return jnp.asarray(tree).at[int(key)].set(child)
    if isinstance(tree, dict):
        return tree | {key: child}
    if hasattr(tree, "_replace"):
        return tree._replace(**{key: child})
    if isinstance(tree, list | tuple):
        return type(tree)(child if str(index) == key else one for index, one in enumerate(tree))
    return dataclasses.replace(tree, **{key: child})


def _children(tree: Any) -> dict[str, Any]:
    if isinstance(tree, dict):
        return tree
    if hasattr(tree, "_asdict"):
        return tree._asdict()
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return {field.name: getattr(tree, field.name) for field in dataclasses.fields(tree)}
    if isinstance(tree, list | tuple) or (isinstance(tree, np.ndarray | jax.Array) and tree.ndim):
        return {str(index): one for index, one in enumerate(tree)}
    return {}


def _instead(old: Any, value: Any, name: str) -> Any:
    """`value`, once it is certain that `old` is one number or nothing."""
    parts = _children(old)
    if parts or not (old is None or _is_number(old)):
        fix = f"type one of {', '.join(f'{name}.{part}' for part in parts)}" if parts else "name a number"
        raise ValueError(f"axis {name!r} is not one number; {fix}")
    return value


def _is_number(value: Any) -> bool:
    dtype = getattr(value, "dtype", None)
    if dtype is None:
        return isinstance(value, bool | int | float | complex)
    return jnp.issubdtype(dtype, np.number) or jnp.issubdtype(dtype, np.bool_)


def _entry(key: Any) -> str:
    found = next((getattr(key, kind) for kind in ("key", "name", "idx") if hasattr(key, kind)), key)
    return str(found)
