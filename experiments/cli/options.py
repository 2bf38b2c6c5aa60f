"""Options of the command line, made from the library's own dataclasses and functions.

Every field of a dataclass, or parameter of a function, becomes an option of the same name, kind and default. Its help is
that of its metadata, or else that of the library's field of that name. Angles of `ANGLES` are typed in degrees,
under their name with _deg.
"""

from __future__ import annotations

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import field, fields, is_dataclass, make_dataclass, replace
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import tyro

import jaxsphere as js
from jaxsphere.checks import require_scalar
from jaxsphere.units import described

ANGLES = ("slope", "slopes", "swing", "swing_limit", "lean_limit", "heading")
# Of parameters that the library asks for.
DEFAULTS = {"slope": math.radians(10.0)}
# Groups whose options are typed without the group's name in front.
FLAT = ("gains", "motion", "tuning", "map")

# Entries of arrays that are None by default.
LENGTHS = {"initial_state": 4, "sensor_bias": 4, "disturbance": 4}


class Command(NamedTuple):
    """A command: what it runs, and the dataclass of its options."""

    run: Callable[[Any], None]
    options: type[Any]
    specified: bool  # whether a TOML file can hold its options


def options(
    title: str, /, *sources: Callable[..., Any], without: tuple[str, ...] = (), unset: bool = False, **more: Any
) -> type:
    """Return a dataclass of options, made from the fields or parameters of `sources`.

    Args:
        title: name of the dataclass.
        sources: dataclasses and functions of the library; the first that has a name decides on its default.
        without: names that are no options.
        unset: make every default None, for changes of an object that is chosen elsewhere.
        more: further options of a text or None as (default, help).
    """
    entries: dict[str, Any] = {
        key: _entry(key, str | None if default is None else str, default, "", words) for key, (default, words) in more.items()
    }
    for source in sources:
        hints = typing.get_type_hints(source)
        metadata = {leaf.name: leaf.metadata for leaf in fields(source)} if is_dataclass(source) else {}
        defaults: Any = cast(Any, source)() if is_dataclass(source) else None
        for key, parameter in inspect.signature(cast(Any, source)).parameters.items():
            if key in without or key in entries or f"{key}_deg" in entries:
                continue
            default = DEFAULTS.get(key, parameter.default) if defaults is None else getattr(defaults, key)
            unit, words = described(key)
            unit, words = metadata.get(key, {}).get("unit", unit), metadata.get(key, {}).get("help", words)
            kind = _kind(key, hints[key], default)
            if isinstance(default, np.ndarray):
                default = tuple(default.tolist())
            if unset:
                kind, default = kind | None, None
            if key in ANGLES:
                key, default, unit = f"{key}_deg", _turned(default, math.degrees), "degrees"
            entries[key] = _entry(key, kind, default, unit, words)
    return make_dataclass(title, list(entries.values()), namespace={"__doc__": ""})


def command(run: Callable[[Any], None], specified: bool = True, **groups: Any) -> Command:
    """Return a command whose options are `groups`: dataclasses of `options`, or (kind, default, help) of one option."""
    entries: list[Any] = []
    groups.setdefault("out", (str, "out", "Folder for pictures, numbers (metrics.json) and manifest.json"))
    if specified:
        words = "TOML file with any of these options, e.g. a table [robot]; the command line overrides it"
        groups["spec"] = (str | None, None, words)
    for key, group in groups.items():
        if isinstance(group, tuple):
            kind, default, words = group
            entries.append(_entry(key, kind, default, "", words))
        else:
            kind = Annotated[group, tyro.conf.arg(name="")] if key in FLAT else group
            entries.append((key, kind, field(default_factory=group)))
    name = "".join(part.title() for part in run.__name__.split("_"))
    return Command(run, make_dataclass(name, entries, namespace={"__doc__": run.__doc__}), specified)


def arguments(chosen: Any, *names: str) -> dict[str, Any]:
    """Return the library's arguments by name: angles in radians, entries of a state as an array; all, or those of `names`.

    Raises:
        ValueError: an angle is not finite, or a slope not below 90 degrees.
    """
    found: dict[str, Any] = {}
    for leaf in fields(chosen):
        value, name = getattr(chosen, leaf.name), leaf.name.removesuffix("_deg")
        if leaf.name != name and value is not None:
            limit = 90.0 if name.startswith("slope") else math.inf
            for one in value if isinstance(value, tuple) else (value,):
                require_scalar(leaf.name, one, above=-limit, below=limit, unit="deg")
            value = _turned(value, math.radians)
        elif isinstance(value, tuple) and (name in LENGTHS or name.endswith("inertia")):
            value = np.array(value, np.float64)
        found[name] = value
    return {name: found[name] for name in names} if names else found


def robot(chosen: Any, default: js.Robot | None = None, label: str = "robot") -> js.Robot:
    """Return the named robot, or `default`, with the changes of `chosen`. Raises ValueError as `js.check_robot` does."""
    changes = {name: value for name, value in arguments(chosen).items() if value is not None}
    name = changes.pop("name", None)
    base = js.robot_named(name) if name else default or js.Robot()
    rubbing = {leaf.name: changes.pop(leaf.name) for leaf in fields(js.Friction) if leaf.name in changes}
    if rubbing:
        changes["friction"] = replace(base.friction or js.Friction(), **rubbing)
    return js.check_robot(replace(base, **changes), label)


def as_typed(sentence: str, kind: type, words: list[str], spec: Mapping[str, Any]) -> str:
    """Return a sentence of the library with its names as the user typed them: --slope-deg, or [motion] slope_deg in a spec."""
    for group, name, flag in _flags(kind):
        in_spec = name in (spec.get(group, {}) if group else spec) and not any(w.split("=")[0] == flag for w in words)
        typed = (f"[{group}] {name}" if group else name) if in_spec else flag
        inside = rf"(?:{group}|task|numerics)\."
        friction = r"(?:friction\.)?"
        prefix = inside + friction if group in ("robot", "plant", "gains") else rf"(?:{inside})?"
        sentence = re.sub(rf"(?<![\w.\-\]] )(?<![\w.\-]){prefix}{name}(?= = )", typed, sentence)
        if flag not in sentence:
            sentence = re.sub(
                rf"(?<![\w.\-]){prefix}{name}=(True\b)?(?=\S)", lambda m, flag=flag: flag + " " * (not m[1]), sentence
            )
    return sentence


def _flags(kind: type) -> typing.Iterator[tuple[str, str, str]]:
    """Yield group, name and flag of every option."""
    hints = typing.get_type_hints(kind)
    for leaf in fields(kind):  # type: ignore[arg-type]
        if is_dataclass(hints[leaf.name]):
            before = "" if leaf.name in FLAT else f"{leaf.name}."
            for inner in fields(hints[leaf.name]):
                yield leaf.name, inner.name, "--" + f"{before}{inner.name}".replace("_", "-")
        elif leaf.name not in ("spec", "experiments"):  # typed without a flag
            yield "", leaf.name, "--" + leaf.name.replace("_", "-")


def _entry(name: str, kind: Any, default: Any, unit: str, words: str) -> tuple[str, Any, Any]:
    text = ", ".join(part for part in (words, unit) if part)
    return name, Annotated[kind, tyro.conf.arg(help=text)], field(default=default)


def _kind(name: str, annotation: Any, default: Any) -> Any:
    """Return the kind of an option: a number, a text, a truth value or a tuple of numbers; or None, where that is allowed."""
    inner = typing.get_args(annotation) if typing.get_origin(annotation) in (typing.Union, types.UnionType) else (annotation,)
    if isinstance(default, np.ndarray):
        kind: Any = tuple[(float,) * len(default)]
    elif isinstance(default, tuple) and not set(typing.get_args(annotation)) <= {float, int, str, ...}:
        kind = tuple[(float,) * len(default)]
    elif name in LENGTHS:
        kind = tuple[(float,) * LENGTHS[name]]
    else:
        known = [one for one in inner if one in (bool, int, float, str) or typing.get_origin(one) is tuple]
        if not known:
            raise TypeError(f"{name}: {annotation} is no kind of option; leave it out by without=({name!r},)")
        kind = known[0]
    return kind | None if default is None or type(None) in inner else kind


def _turned(value: Any, turn: Callable[[float], float]) -> Any:
    if isinstance(value, tuple):
        return tuple(_turned(one, turn) for one in value)
    # Rounded, so that 10 degrees read as 10 in --help.
    return None if value is None else round(turn(value), 12) if turn is math.degrees else turn(value)


RobotOptions = options(
    "RobotOptions", js.Robot, js.Friction, without=("friction",), unset=True, name=(None, f"One of {', '.join(js.robots())}")
)
