"""Options from a TOML file whose tables and keys are those of the command's dataclass; the command line overrides them."""

from __future__ import annotations

import tomllib
import types
import typing
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

Options = TypeVar("Options")

_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}


def take_spec(words: list[str]) -> tuple[str | None, list[str]]:
    """Split `--spec FILE` off the words of a command line. Raises ValueError when the file is not named."""
    for i, word in enumerate(words):
        if word.startswith("--spec="):
            return word.removeprefix("--spec="), words[:i] + words[i + 1 :]
        if word == "--spec":
            if i + 1 == len(words):
                raise ValueError("--spec needs a file; type e.g. --spec tuning.toml")
            return words[i + 1], words[:i] + words[i + 2 :]
    return None, words


def read_toml(path: str) -> dict[str, Any]:
    """Return the content of a TOML file. Raises ValueError when it cannot be read or is no TOML."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"spec = {path!r} cannot be read ({error.strerror}); type a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"spec = {path!r} is no TOML: {error}; mend that line") from None


def load_spec(default: Options, path: str) -> Options:
    """Return a copy of the dataclass `default` with what the TOML file says. Raises ValueError for what does not belong."""
    return fill(default, read_toml(path), f"spec = {path!r}")


def fill(default: Any, content: dict[str, Any], where: str) -> Any:
    """Copy of the dataclass `default` with `content`; `where` opens the sentence of the ValueError for what does not belong."""
    kinds = typing.get_type_hints(type(default))
    known = [leaf.name for leaf in fields(default) if leaf.name != "spec"]
    changes = {}
    for name, value in content.items():
        if name not in known:
            raise ValueError(f"{where}: {name!r} is no option here; type one of {', '.join(known)}")
        old = getattr(default, name)
        if is_dataclass(old):
            if not isinstance(value, dict):
                raise ValueError(f"{where}: {name} = {value!r} is no table; type [{name}] and its options below")
            changes[name] = fill(old, value, f"{where}, [{name}]")
        else:
            changes[name] = _value(kinds[name], value, f"{where}: {name} = {value!r}")
    return replace(default, **changes)


def _value(kind: Any, value: Any, where: str) -> Any:
    """`value` as `kind` (float, int, bool, str, a tuple of them, or one of several). Raises ValueError if it is none."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        kind = next(one for one in inner if one is not type(None))
        return _value(kind, value, where)
    if origin is tuple:
        if not isinstance(value, list):
            raise ValueError(f"{where} is no list; type e.g. [1.0, 2.0]")
        if inner[-1] is Ellipsis:
            return tuple(_value(inner[0], entry, where) for entry in value)
        if len(value) != len(inner):
            raise ValueError(f"{where} has {len(value)} entries; type {len(inner)}")
        return tuple(_value(one, entry, where) for one, entry in zip(inner, value, strict=True))
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        raise ValueError(f"{where} is not {_WORDS[kind]}; type {_WORDS[kind]}")
    return value
