"""Two computations are the same when they trace to the same program on the same constants, in every process."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.identity import fingerprint_of

ROOT = Path(__file__).parent.parent
FACTOR = 3.0
TABLE = np.arange(100.0)


def by_constant(x):
    """Uses a constant of the module."""
    return FACTOR * x


class Scale:
    """An object with a method and a callable."""

    def __init__(self, factor):
        self.factor = factor

    def times(self, x):
        """x by the factor of the object."""
        return self.factor * x

    __call__ = times


def by_default(factor):
    """A function with a positional default."""

    def scaled(x, factor=factor):
        return factor * x

    return scaled


def by_callback(factor):
    """A function of the host."""
    return lambda x: jax.pure_callback(lambda value: np.asarray(value * factor), jax.ShapeDtypeStruct((), jnp.float64), x)


MAKERS = {
    "captured": lambda factor: lambda x: factor * x,
    "default": by_default,
    "default under jit": lambda factor: jax.jit(by_default(factor)),
    "jit inside": lambda factor: lambda x: jax.jit(lambda y: y * factor)(x) + 1.0,
    "bound method": lambda factor: Scale(factor).times,
    "callable object": lambda factor: Scale(factor),
    "partial": lambda factor: functools.partial(lambda a, x: a * x, factor),
    "array": lambda factor: lambda x: x + (factor * TABLE)[7] * jnp.sum(factor * TABLE),
    "array in a scan": lambda factor: lambda x: jax.lax.scan(lambda c, row: (c * row, None), x, jnp.asarray(factor * TABLE))[0],
    "custom derivative": lambda factor: lambda x: jax.nn.relu(factor * x),
    "key": lambda factor: lambda x: x + jax.random.normal(jax.random.key(int(10 * factor)), ()),
    "callback": by_callback,
    "branch": lambda factor: lambda x: jax.lax.cond(x > 0.0, lambda y: y, lambda y: factor * y, x),
}


@pytest.mark.parametrize("kind", MAKERS)
def test_another_number_is_another_program_and_the_same_number_the_same(kind):
    make = MAKERS[kind]
    assert fingerprint_of(make(2.0), 1.0) == fingerprint_of(make(2.0), 1.0)
    assert fingerprint_of(make(2.0), 1.0) != fingerprint_of(make(2.5), 1.0)


def test_a_changed_module_constant_is_noticed_and_a_name_is_not(monkeypatch):
    before = fingerprint_of(by_constant, 1.0)
    assert before == fingerprint_of(lambda other: 3.0 * other, 1.0)
    monkeypatch.setitem(globals(), "FACTOR", 4.0)
    assert before != fingerprint_of(by_constant, 1.0)


def test_shapes_and_types_of_the_arguments_count():
    prints = {fingerprint_of(lambda x: 2.0 * x, x) for x in (1.0, np.float32(1.0), np.ones(2), np.ones(3))}
    assert len(prints) == 4


CLIMB = """
import jaxsphere as js
from jaxsphere.identity import fingerprint_of
lane = lambda slope: js.rest_to_rest(js.Robot(), slope, throw=False, duration=0.1, save_every=None).metrics
print(fingerprint_of(lane, 0.1))
"""


def test_two_processes_agree_on_a_closed_loop():
    environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    found = subprocess.run([sys.executable, "-c", CLIMB], env=environment, capture_output=True, text=True, check=True).stdout

    def lane(slope):
        return js.rest_to_rest(js.Robot(), slope, throw=False, duration=0.1, save_every=None).metrics

    assert found.split() == [fingerprint_of(lane, 0.1)]


def test_a_sweep_does_not_go_on_with_another_program_and_does_under_another_name(tmp_path):
    axis = js.axes.listed("x", [1.0, 2.0])
    for number, make in enumerate((MAKERS["captured"], by_default, MAKERS["default under jit"], MAKERS["bound method"])):
        folder = tmp_path / str(number)
        js.sweep(make(2.0), {}, axis, store=folder)
        js.sweep(make(2.0), {}, axis, store=folder, resume=True)
        with pytest.raises(ValueError, match=r"another sweep \(it differs in lane\)"):
            js.sweep(make(3.0), {}, axis, store=folder, resume=True)
    js.sweep(by_constant, {}, axis, store=tmp_path / "named")
    js.sweep(lambda x: 3.0 * x, {}, axis, store=tmp_path / "named", resume=True)
