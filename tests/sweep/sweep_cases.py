"""A small sweep of real closed loops that the tests of the sweep engine share, also across processes."""

import hashlib
import sys

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js

BASE = {
    "robot": js.Robot(),
    "gains": js.SlidingModeGains(),
    "initial_state": np.array([0.0, 0.0, 0.3, 0.0]),
    "duration": 0.4,
    "dt": 1e-2,
    "method": "semi_implicit_euler",
    "save_every": None,
}


def axes(slopes=11):
    """Every kind of axis; 120 lanes a slope, the steepest of which no swing holds."""
    return [
        js.axes.linear("slope", -5.0, 22.0, slopes, unit="deg"),
        js.axes.zipped(js.axes.listed("gains.c1", [0.4, 0.8]), js.axes.logarithmic("travel", 1.0, 10.0, 2), name="move"),
        js.axes.latin_hypercube({"robot.pendulum_mass": (1.8, 2.3), "robot.shell_inertia.2": (0.015, 0.02)}, 12, seed=1),
        js.axes.zipped(
            js.axes.uniform({"initial_state.2": (0.0, 0.5)}, 5, seed=2), js.axes.normal({"initial_state.3": (0.0, 0.5)}, 5)
        ),
    ]


def climbs(**options):
    """The sweep of these axes."""
    return js.sweep(js.rest_to_rest, BASE, axes(), **options)


def digest(results):
    """Checksum of every bit of every output."""
    total = hashlib.sha256()
    for name, values in results.values.items():
        total.update(name.encode() + str(values.dtype).encode() + str(values.shape).encode() + values.tobytes())
    return total.hexdigest()


def swing(stiffness, angle, damping=0.5):
    """A pendulum held by a spring and a damper, 60 steps: the cheapest closed loop there is."""
    plant = js.Plant(lambda x, u: (x[1], u[0] - 9.81 * js.numerics.sincos(x[0])[0]), _fate, (False, True))
    start = (angle, 0.0 * angle)
    return js.rollout(plant, _hold(stiffness, damping), start, dt=0.01 + 0.0 * angle, steps=60, save_every=None)


def _fate(x):
    return jnp.where(abs(x[0]) > 2.0, js.Status.WHIRLING, js.Status.OK)


def _hold(stiffness, damping):
    return lambda time, x, memory: js.ControllerOutput((-stiffness * x[0] - damping * x[1],), (), jnp.int32(0))


def swings(count=40, damping=0.4, **options):
    """Sweep of `swing` over 50 lanes a stiffness; some swing too far. 2000 lanes in four chunks of 500 by default."""
    axes = [js.axes.linear("stiffness", -30.0, 10.0, count), js.axes.uniform({"angle": (0.0, 1.0)}, 50, seed=3)]
    return js.sweep(swing, {"damping": damping}, axes, **{"chunk": 512} | options)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        rank, port = sys.argv[1:3]
        jax.distributed.initialize(f"127.0.0.1:{port}", num_processes=2, process_id=int(rank))
        assert jax.process_count() == 2
    found = climbs(chunk=512, store=sys.argv[3] if len(sys.argv) > 3 else None)
    print(digest(found), sum(found.counts().values()), jax.device_count())
