"""Speed: batched closed loops in steps per second, as ratios to peers measured in the same run, alternating."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
from experiments.plots.style import bars_figure
from experiments.records import Record
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import equilibrium_swing

DT = 5e-3
SLOPE = float(np.deg2rad(10.0))
ROUNDS = 5


def planar_case(record: Record, lanes: int, steps: int) -> dict[str, Any]:
    """Time the planar closed loop (lanes that differ in slope, RK4) in both precisions, and diffrax where it is installed."""
    runs = {f"jaxsphere {dtype.__name__}": _rollouts(lanes, steps, dtype) for dtype in (jnp.float64, jnp.float32)}
    if find_spec("diffrax"):
        runs["diffrax float64 (Tsit5)"] = _diffrax(lanes, steps)
    print(f"planar closed loop, {lanes} lanes x {steps} steps, {len(jax.local_devices())} devices; {ROUNDS} rounds, median")
    speed, compile_seconds = _race(runs, dict.fromkeys(runs, lanes * steps))
    numbers: dict[str, Any] = {
        kind: {"steps_per_second": speed[f"jaxsphere {kind}"], "first_call_seconds": compile_seconds[f"jaxsphere {kind}"]}
        for kind in ("float64", "float32")
    }
    if "diffrax float64 (Tsit5)" in speed:
        # RK4 evaluates the field 4 times a step, Tsit5 6 times (the seventh stage is the next step's first).
        ratio = (4 * speed["jaxsphere float64"]) / (6 * speed["diffrax float64 (Tsit5)"])
        numbers["diffrax"] = {"steps_per_second": speed["diffrax float64 (Tsit5)"], "evaluations_ratio": ratio}
        print(f"  vector-field evaluations per second, jaxsphere / diffrax: {ratio:.2f}")
    else:
        print("  diffrax is not installed; pip install 'jaxsphere[bench]' for the ratio")
    title = f"Planar closed loop, {lanes} lanes × {steps} steps"
    record.picture("bench_planar", bars_figure(title, list(speed), list(speed.values()), "steps per second"))
    return numbers


def _rollouts(lanes: int, steps: int, dtype: Any) -> Callable[[], Any]:
    def lane(slope: jax.Array) -> tuple[jax.Array, jax.Array]:
        trajectory = js.rest_to_rest(js.Robot(), slope, duration=steps * DT, dt=DT, save_every=None, dtype=dtype, throw=False)
        return trajectory.state[-1], trajectory.status

    batch, slopes = js.batch(lane), jnp.linspace(0.01, 0.31, lanes, dtype=dtype)
    return lambda: batch(slopes)


def _diffrax(lanes: int, steps: int) -> Callable[[], Any]:
    import diffrax  # pyright: ignore[reportMissingImports]

    gains = js.SlidingModeGains()

    def lane(slope: jax.Array) -> jax.Array:
        lumped, equilibrium = planar.lump(js.Robot(), slope), equilibrium_swing(js.Robot(), slope)
        law = js.sliding_mode.law(js.Robot(), slope, gains, 10.0, 0.02)

        def field(time: Any, state: Any, _: Any) -> tuple[jax.Array, ...]:
            return planar.derivative(lumped, state, law(time, state, (jnp.zeros_like(slope),)).torque)

        zero = jnp.zeros_like(slope)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),  # type: ignore[arg-type]
            diffrax.Tsit5(),
            0.0,
            steps * DT,
            DT,
            (zero, zero, equilibrium, zero),
            saveat=diffrax.SaveAt(t1=True),
            max_steps=steps + 1,
        )
        assert solution.ys is not None
        return solution.ys[0]

    batch, slopes = js.batch(lane), jnp.linspace(0.01, 0.31, lanes)
    return lambda: batch(slopes)


def spatial_case(record: Record, lanes: int, steps: int) -> dict[str, Any]:
    """Time the spatial closed loop (lines at different speeds, RK4, 1 ms, 1 kHz hold), and MuJoCo's rollout of the robot."""
    runs = {"jaxsphere float64": _tracking(lanes, steps, None), "jaxsphere float64, 1 kHz hold": _tracking(lanes, steps, 1e-3)}
    work = dict.fromkeys(runs, lanes * steps)
    if find_spec("mujoco"):
        from experiments.benchmarks import mujoco_peer

        engine = "MuJoCo rollout, no control, Euler"
        # A fifth of the lanes is enough work to time it.
        runs[engine] = mujoco_peer.rollouts(js.Robot(), SLOPE, max(lanes // 5, 2), steps, len(jax.local_devices()))
        work[engine] = max(lanes // 5, 2) * steps
    print(f"spatial closed loop, {lanes} lanes x {steps} steps, {len(jax.local_devices())} devices; {ROUNDS} rounds, median")
    speed, compile_seconds = _race(runs, work)
    numbers: dict[str, Any] = {
        "float64": {
            "steps_per_second": speed["jaxsphere float64"],
            "steps_per_second_1kHz_hold": speed["jaxsphere float64, 1 kHz hold"],
            "first_call_seconds": compile_seconds["jaxsphere float64"],
        }
    }
    if len(runs) == 3:
        ratio = speed["jaxsphere float64"] / speed[engine]
        numbers["mujoco"] = {"steps_per_second": speed[engine], "ratio": ratio}
        print(f"  steps per second, jaxsphere closed loop / MuJoCo: {ratio:.2f}")
    else:
        print("  MuJoCo is not installed; pip install 'jaxsphere[bench]' for the ratio")
    title = f"Spatial closed loop, {lanes} lanes × {steps} steps"
    record.picture("bench_spatial", bars_figure(title, list(speed), list(speed.values()), "steps per second"))
    return numbers


def _tracking(lanes: int, steps: int, control_period: float | None) -> Callable[[], Any]:
    def lane(speed: jax.Array) -> tuple[jax.Array, jax.Array]:
        options: dict[str, Any] = {"control_period": control_period, "save_every": None, "throw": False}
        trajectory = js.track_line(js.Robot(), SLOPE, None, speed, duration=steps * 1e-3, dt=1e-3, **options)
        return trajectory.state[-1], trajectory.status

    batch, speeds = js.batch(lane), jnp.linspace(0.2, 1.0, lanes)
    return lambda: batch(speeds)


def _race(runs: dict[str, Callable[[], Any]], work: dict[str, int]) -> tuple[dict[str, float], dict[str, float]]:
    """Run all in turn, print and return steps per second (median) and the seconds of the first call."""
    first = {name: _seconds(run) for name, run in runs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            seconds[name].append(_seconds(run))
    speed = {name: work[name] / float(np.median(times)) for name, times in seconds.items()}
    for name, value in speed.items():
        print(f"  {name:<36}{value:10.3e} steps/s   first call {first[name]:.2f} s")
    return speed, first


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start
