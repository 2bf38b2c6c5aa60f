"""Units of named numbers, read from where the numbers are declared.

A dataclass declares the unit of a field in its metadata, `quantity(1.2, "kg", "mass of the shell")`; a NamedTuple in a class
attribute, `UNITS = {"settling_time": "s"}`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any

# Name of a field -> (unit, help), of the classes that `declare` has seen.
_KNOWN: dict[str, tuple[str, str]] = {}


def quantity(default: Any, unit: str, words: str) -> Any:
    """Return a dataclass field with a default (or a function that makes one), a unit and a help text."""
    metadata = {"unit": unit, "help": words}
    return field(default_factory=default, metadata=metadata) if callable(default) else field(default=default, metadata=metadata)


def declare(*classes: type, **more: tuple[str, str]) -> None:
    """Make the units and help texts of the fields of `classes` known by name; the first class that has a name counts.

    Args:
        classes: dataclasses and NamedTuples.
        more: name -> (unit, help) of what is a field of none.
    """
    for one in classes:
        found = {name: (unit, "") for name, unit in getattr(one, "UNITS", {}).items()}
        if dataclasses.is_dataclass(one):
            found = {leaf.name: (leaf.metadata.get("unit", ""), leaf.metadata.get("help", "")) for leaf in fields(one)}
        for name, told in (found | more).items():
            if any(told):
                _KNOWN.setdefault(name, told)


def described(name: str) -> tuple[str, str]:
    """Return unit and help text of a field of the library's classes, ("", "") where none has that name."""
    return _KNOWN.get(name, ("", ""))


def declared_units(tree: Any, prefix: str = "") -> dict[str, str]:
    """Return dotted name -> unit for every field below `tree` whose class declares one."""
    found: dict[str, str] = {}
    for name, child, unit in _fields(tree):
        path = f"{prefix}{name}"
        if unit:
            found[path] = unit
        found |= declared_units(child, f"{path}.")
    return found


def unit_of(name: str, declared: Mapping[str, str] | None = None) -> str:
    """Return the unit of a dotted name, "" where it is unknown.

    Args:
        name: e.g. "robot.shell_inertia.2"; numbers at its end are places in an array.
        declared: dotted name -> unit, see `declared_units`.
    """
    parts = name.split(".")
    while len(parts) > 1 and parts[-1].isdigit():
        parts.pop()
    return (declared or {}).get(".".join(parts)) or described(parts[-1])[0]


def _fields(tree: Any) -> list[tuple[str, Any, str]]:
    """(name, value, unit) of the parts of a container."""
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return [(leaf.name, getattr(tree, leaf.name), leaf.metadata.get("unit", "")) for leaf in fields(tree)]
    if isinstance(tree, tuple) and hasattr(tree, "_asdict"):
        units = getattr(tree, "UNITS", {})
        return [(name, value, units.get(name, "")) for name, value in tree._asdict().items()]  # type: ignore[attr-defined]
    if isinstance(tree, Mapping):
        return [(str(name), value, "") for name, value in tree.items()]
    if isinstance(tree, list | tuple):
        return [(str(index), value, "") for index, value in enumerate(tree)]
    return []
