"""Identity of a computation: the traced program with its constants by value, never a name, a bytecode or an address.

Two functions have the same fingerprint when JAX traces them to the same operations on the same constants. A default, a captured
number, a module constant and the object of a bound method are all part of the traced program; the name of a function is not.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from types import CodeType, FunctionType, MethodType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from jaxsphere.files import to_plain

LONG = 64  # entries from which an array is described by its checksum
# Rules for derivatives, which tracing has applied already, and labels: no part of what is computed.
_LABELS = ("name", "jvp_jaxpr_fun", "jvp_jaxpr_thunk", "fwd_jaxpr_thunk", "fwd", "bwd", "ctx_mesh", "compiler_options_kvs")
_ADDRESS = re.compile(r" at 0x[0-9a-f]+|\bid=\d+")


def fingerprint_of(function: Callable[..., Any], *example_arguments: Any) -> str:
    """Return a checksum that two functions share when they trace to the same program on arguments like these.

    Args:
        function: any function that JAX can trace.
        example_arguments: arrays, or `jax.ShapeDtypeStruct`s, of the shapes and dtypes that it is called with.

    Returns:
        64 hexadecimal digits, the same in every process with the same versions of JAX and of the libraries that are traced.
    """
    # A function made anew, because JAX does not trace one again that it has met.
    return fingerprint_of_jaxpr(jax.make_jaxpr(lambda *arguments: function(*arguments))(*example_arguments))


def fingerprint_of_jaxpr(program: Any) -> str:
    """Return the checksum of a traced program (what `jax.make_jaxpr` returns), see `fingerprint_of`."""
    return _Canon().closed(program)


def fingerprint(content: Any) -> str:
    """Return the checksum of plain content (what JSON knows), whatever the order of its names."""
    return _sha(json.dumps(content, sort_keys=True).encode())


def described(value: Any) -> Any:
    """Return plain content that says what a value is: numbers, names, long arrays by their checksum, functions by name."""
    if isinstance(value, Mapping):
        return {str(key): described(one) for key, one in value.items()}
    if hasattr(value, "_asdict"):
        return described(value._asdict())
    if hasattr(value, "__dataclass_fields__") and not isinstance(value, type):
        fields = {name: described(getattr(value, name)) for name in value.__dataclass_fields__}
        return {"type": type(value).__name__} | fields
    if isinstance(value, list | tuple):
        return [described(one) for one in value]
    if isinstance(value, np.ndarray | jax.Array) and value.size >= LONG:
        return {"shape": list(value.shape), "dtype": str(value.dtype), "sha256": _sha(np.asarray(value).tobytes())}
    if isinstance(value, float | np.floating) and not math.isfinite(value):
        return repr(float(value))
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__name__)}"
    plain = to_plain(value)
    return _ADDRESS.sub("", plain) if isinstance(plain, str) else plain


def versions() -> dict[str, str]:
    """Return the versions that the last bit of a result depends on, and the platform that computes it."""
    return {name: _version(name) for name in ("jaxsphere", "jax", "jaxlib", "numpy")} | {"platform": jax.default_backend()}


class _Canon:
    """Checksums of jaxprs with variables by number and constants by value; a program met twice is read once."""

    def __init__(self) -> None:
        self.known: dict[int, tuple[Any, str]] = {}

    def closed(self, program: Any) -> str:
        constants = [self.value(constant) for constant in program.consts]
        return _sha(json.dumps([self.open(program.jaxpr), constants]).encode())

    def open(self, jaxpr: Any) -> str:
        if id(jaxpr) not in self.known:
            self.known[id(jaxpr)] = jaxpr, self._read(jaxpr)
        return self.known[id(jaxpr)][1]

    def _read(self, jaxpr: Any) -> str:
        numbers: dict[Any, int] = {}

        def define(variable: Any) -> str:
            numbers[variable] = len(numbers)
            return f"{numbers[variable]}:{variable.aval.str_short()}"

        def use(atom: Any) -> str:
            return self.value(atom.val) + str(atom.aval) if isinstance(atom, core.Literal) else str(numbers[atom])

        lines = [" ".join(map(define, [*jaxpr.constvars, *jaxpr.invars]))]
        for equation in jaxpr.eqns:
            inputs = " ".join(map(use, equation.invars))
            parameters = [f"{key}={self.value(equation.params[key])}" for key in sorted(equation.params) if key not in _LABELS]
            outputs = " ".join(map(define, equation.outvars))
            lines.append(f"{outputs} = {equation.primitive.name}[{'; '.join(parameters)}] {inputs}")
        lines.append(" ".join(map(use, jaxpr.outvars)))
        return _sha("\n".join(lines).encode())

    def value(self, value: Any) -> str:
        """Text of a parameter or a constant."""
        if isinstance(value, core.ClosedJaxpr):
            return self.closed(value)
        if isinstance(value, core.Jaxpr):
            return self.open(value)
        if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            return f"key {self.value(jax.random.key_data(value))}"
        if isinstance(value, np.ndarray | np.generic | jax.Array) or hasattr(value, "__array__"):
            array = np.asarray(value)
            return f"{array.dtype}{array.shape} {_sha(array.tobytes())}"
        if isinstance(value, Mapping):
            return "{" + ", ".join(sorted(f"{key}: {self.value(one)}" for key, one in value.items())) + "}"
        if isinstance(value, tuple | list):
            return f"{type(value).__name__}({', '.join(map(self.value, value))})"
        if isinstance(value, frozenset | set):
            return "{" + ", ".join(sorted(map(self.value, value))) + "}"
        if isinstance(value, float):
            return value.hex()
        if isinstance(value, functools.partial):
            return f"partial {self.value((value.func, value.args, value.keywords))}"
        if isinstance(value, MethodType):
            return f"{self.value(value.__func__)} of {self.value(value.__self__)}"
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return f"{type(value).__name__} {self.value({f.name: getattr(value, f.name) for f in dataclasses.fields(value)})}"
        if isinstance(value, FunctionType):
            cells = [self.value(cell.cell_contents) for cell in value.__closure__ or ()]
            return f"{self.code(value.__code__)} {cells} {self.value(value.__defaults__)}"
        return _ADDRESS.sub("", str(value))

    def code(self, code: CodeType) -> str:
        """Text of a host function that the program calls, e.g. of a callback."""
        constants = [self.code(one) if isinstance(one, CodeType) else self.value(one) for one in code.co_consts]
        return _sha(repr((code.co_code.hex(), code.co_names, constants)).encode())


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
