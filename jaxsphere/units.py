"""Units of named numbers, read from where the numbers are declared.

A dataclass declares the unit of a field in its metadata, `field(metadata={"unit": "kg"})`; a NamedTuple in a class attribute,
`UNITS = {"settling_time": "s"}`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

# Until every class declares its own.
FALLBACK = {
    **dict.fromkeys(("slope", "travel", "z_u", "heading"), "rad"),
    **dict.fromkeys(("shell_mass", "gimbal_mass", "pendulum_mass"), "kg"),
    **dict.fromkeys(("shell_inertia", "gimbal_inertia", "pendulum_inertia"), "kg m2"),
    **dict.fromkeys(("pendulum_length", "shell_radius", "tolerance"), "m"),
    **dict.fromkeys(("c1", "c2", "k", "k2", "k4", "k_d"), "1/s"),
    **dict.fromkeys(("k1", "k3", "k_p"), "1/s2"),
    **dict.fromkeys(("phi_z", "k_i", "smoothing"), "rad/s"),
    **dict.fromkeys(("settling_time", "end_time"), "s"),
    **dict.fromkeys(("peak_swing", "lowest_swing", "highest_swing", "peak_lean"), "rad"),
    **{"peak_torque": "N m", "chatter": "N m", "effort": "(N m)2 s", "rms_error": "m", "late_error": "m"},
    **{"eta": "rad/s2", "gravity": "m/s2", "a_max": "m/s2", "speed": "m/s", "torque_limit": "N m", "settled_after": "s"},
    "itae": "s2",
}


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
    return (declared or {}).get(".".join(parts)) or FALLBACK.get(parts[-1], "")


def _fields(tree: Any) -> list[tuple[str, Any, str]]:
    """(name, value, unit) of the parts of a container."""
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return [(field.name, getattr(tree, field.name), field.metadata.get("unit", "")) for field in dataclasses.fields(tree)]
    if isinstance(tree, tuple) and hasattr(tree, "_asdict"):
        units = getattr(tree, "UNITS", {})
        return [(name, value, units.get(name, "")) for name, value in tree._asdict().items()]  # type: ignore[attr-defined]
    if isinstance(tree, Mapping):
        return [(str(name), value, "") for name, value in tree.items()]
    if isinstance(tree, list | tuple):
        return [(str(index), value, "") for index, value in enumerate(tree)]
    return []
