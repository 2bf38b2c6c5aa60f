"""What the compiler makes of a step, and what importing the package costs."""

import re
import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxsphere as js

LANES = 8


@pytest.fixture(scope="module")
def loop():
    """HLO text of everything that the loops of a batched rollout call."""

    def lane(slope, gains):
        found = js.rest_to_rest(js.Robot(), slope, gains, duration=1.0, dt=1e-2, torque_limit=5.0, save_every=None, throw=False)
        return found.state, found.metrics

    gains = jax.tree.map(lambda gain: np.full(LANES, gain), js.SlidingModeGains())
    text = jax.jit(jax.vmap(lane)).lower(np.linspace(0.0, 0.2, LANES), gains).compile().as_text()
    blocks = re.split(r"\n\n", text)
    named = {match.group(1): block for block in blocks if (match := re.match(r"(?:ENTRY )?%?([\w.\-]+) \(", block.strip()))}
    assert len(named) > 10
    pending = set(re.findall(r"(?:body|condition)=%?([\w.\-]+)", text))
    assert pending
    inside = set()
    while pending:
        name = pending.pop()
        inside.add(name)
        called = re.findall(r"(?:calls|to_apply|body|condition)=%?([\w.\-]+)", named[name])
        pending |= set(called) - inside
    return "\n".join(named[name] for name in sorted(inside))


def count(text, operation):
    """How often an operation stands in HLO text."""
    return len(re.findall(rf" {operation}\(", text))


def test_step_calls_no_library(loop):
    assert "custom_call_target" not in loop
    assert "lapack" not in loop.lower()


def test_step_evaluates_no_transcendental_twice(loop):
    # tanh: the asked swing, the smooth sign, the seeking rate. Sine and cosine of the swing: one polynomial each,
    # with a rounding in the range reduction of each; those of the slope are outside the loop.
    assert {name: count(loop, name) for name in ("tanh", "sine", "cosine", "round-nearest-even")} == {
        "tanh": 3,
        "sine": 0,
        "cosine": 0,
        "round-nearest-even": 2,
    }
    others = ("exponential", "log", "power", "sqrt", "rsqrt", "atan2", "tan")
    assert not any(count(loop, name) for name in others)


def test_step_divides_only_where_the_model_does(loop):
    # 1 / det M, 1 / decoupling, two of the fence around sine and cosine, s1 / phi_z, z_U / phi_z, s2 / epsilon, two of
    # the metrics (overshoot and tracking): nine.
    assert count(loop, "divide") <= 9


def test_import_loads_nothing_of_the_command_line():
    program = "import sys, jaxsphere; print(sorted({'matplotlib', 'tqdm', 'tyro', 'tuning', 'experiments'} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=120)
    assert shown.stdout.strip() == "[]"


def test_import_switches_to_double_precision_and_computes_nothing():
    program = """
import jax
from jax._src import xla_bridge
import jaxsphere
assert jax.config.jax_enable_x64
assert not xla_bridge.backends_are_initialized()
jax.config.update("jax_num_cpu_devices", 3)
assert jax.device_count() == 3
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
