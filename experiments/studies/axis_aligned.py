"""What `axis_aligned` does: poles round the compass, Table 4's start, lines, a fleet of random starts, and curves.

python -m experiments.studies.axis_aligned LANES SEED LAW... prints the table, e.g. 1024 1 axis_aligned pendulum_attitude
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from experiments.studies.lines import HELD_OUT_STARTS
from experiments.studies.settings import HELD_OUT_SPEEDS
from jaxsphere import linear, references

CONTROL_PERIOD = 1e-3
AFTER = (5.0, 10.0, 15.0)  # s, from when on the worst error is taken
CURVES = {"circle of 1 m at 0.5 m/s": (0.0, 0.5), "eight in 15 s": (1.0, 15.0), "eight in 10 s": (1.0, 10.0)}


class Cases(NamedTuple):
    """Paths and starts, (lanes,) each; a curve starts on itself."""

    kind: Any  # 0 circle, 1 eight, 2 line
    size: Any  # speed of a circle or line, m/s, or period of an eight, s
    heading: Any  # of a line, rad
    slope: Any  # rad
    x: Any  # of the start less that of the path, m
    y: Any


class Followed(NamedTuple):
    """How the cases went, (lanes,) each."""

    worst: tuple[Any, ...]  # largest error after AFTER, m
    lean: Any  # largest |theta - pi/2|, rad
    saturated: Any  # time at the torque limit after 0.2 s, s
    deviation: Any  # larger standard deviation of the torques over the last 5 s, N m
    status: Any
    end_time: Any  # s


def lines(speeds: Any, heading: Any, slope: Any, x: Any, y: Any) -> Cases:
    """Cases of straight lines."""
    return Cases(*np.broadcast_arrays(2.0, speeds, heading, slope, x, y))


def fleet(lanes: int, seed: int) -> Cases:
    """Random lines: 0.1...1.2 m/s, any heading, 0...14 degrees, starts at rest within 0.4 m of the path's."""
    random = np.random.default_rng(seed)
    distance, angle = 0.4 * np.sqrt(random.uniform(size=lanes)), random.uniform(0.0, 2.0 * np.pi, lanes)
    speed, heading = random.uniform(0.1, 1.2, lanes), random.uniform(0.0, 2.0 * np.pi, lanes)
    slope = np.deg2rad(random.uniform(0.0, 14.0, lanes))
    return lines(speed, heading, slope, distance * np.cos(angle), distance * np.sin(angle))


def follow(cases: Cases, gains: js.TrackingGains | None = None, realisation: str = "axis_aligned") -> Followed:
    """Follow all cases for 20 s with a 1 kHz hold and 5 N m."""
    gains = js.SpatialTask(realisation=realisation).default_gains() if gains is None else gains
    return jax.tree.map(np.asarray, _program(realisation)(cases, _repeat(gains, len(cases.kind))))


def _repeat(gains: js.TrackingGains, lanes: int) -> Any:
    return jax.tree.map(lambda gain: np.full(lanes, float(gain)), gains)


def _reference(case: Any, time: Array) -> references.Reference:
    """One reference for all kinds, so that all lanes share one program."""
    circle = references.circle(1.0, case.size)(time)
    eight = references.figure_eight(1.0, case.size)(time)
    line = references.line(case.size, case.heading)(time)
    return jax.tree.map(lambda a, b, c: jnp.where(case.kind < 0.5, a, jnp.where(case.kind < 1.5, b, c)), circle, eight, line)


_PROGRAMS: dict[str, Any] = {}


def _program(realisation: str) -> Any:
    def lane(case: Cases, gains: js.TrackingGains) -> Followed:
        reference = jax.tree_util.Partial(_reference, case)
        first = reference(jnp.zeros(())).position
        start = first[0] + case.x, first[1] + case.y
        options: dict[str, Any] = {"control_period": CONTROL_PERIOD, "realisation": realisation}
        task = js.SpatialTask(slope=case.slope, reference=reference, start_position=start, **options)
        run = js.simulate(task, gains, js.Numerics(CONTROL_PERIOD, save_every=None), measure=_measure(reference), throw=False)
        return run.metrics._replace(status=run.status, end_time=run.end_time)

    if realisation not in _PROGRAMS:
        _PROGRAMS[realisation] = js.batch(lane)
    return _PROGRAMS[realisation]


def _measure(reference: Any) -> js.Measure:
    zero = jnp.zeros(())

    def update(so_far: Any, time: Array, state: Any, torque: Any, dt: Array) -> Any:
        worst, lean, saturated, sums, squares = so_far
        x, y = reference(time).position
        error = jnp.hypot(state[0] - x, state[1] - y)
        at_limit = jnp.maximum(jnp.abs(torque[0]), jnp.abs(torque[1])) > 4.999
        share = jnp.where(time >= AFTER[-1], dt / 5.0, 0.0)
        return (
            tuple(jnp.maximum(w, jnp.where(time >= after, error, 0.0)) for w, after in zip(worst, AFTER, strict=True)),
            jnp.maximum(lean, js.spatial.lean_from_upright(state)),
            saturated + jnp.where(at_limit & (time > 0.2), dt, 0.0),
            tuple(total + share * u for total, u in zip(sums, torque, strict=True)),
            tuple(total + share * u * u for total, u in zip(squares, torque, strict=True)),
        )

    def finish(so_far: Any) -> Followed:
        worst, lean, saturated, sums, squares = so_far
        variances = [jnp.maximum(square - total**2, 0.0) for square, total in zip(squares, sums, strict=True)]
        return Followed(worst, lean, saturated, jnp.sqrt(jnp.maximum(*variances)), zero, zero)

    return js.Measure(((zero,) * 3, zero, zero, (zero,) * 2, (zero,) * 2), update, finish)


def rolling(gains: js.TrackingGains, speeds: Any, slopes: Any, headings: Any) -> linear.Linearisation:
    """Closed loops of rolling straight, one for each entry of three arrays (lanes,) in m/s, rad and rad."""

    def one(speed: Array, slope: Array, heading: Array) -> linear.Linearisation:
        return js.linearise(js.SpatialTask(slope=slope, reference=references.line(speed, heading)), gains)

    return jax.vmap(one)(speeds, slopes, headings)


def sorted_poles(closed_loops: Any) -> np.ndarray:
    """Poles (lanes, 11), 1/s, that of the vertical spin first."""
    found = np.linalg.eigvals(closed_loops)
    return np.take_along_axis(found, np.argsort(np.abs(found), axis=-1), axis=-1)


def quantiles(values: Any, status: Any) -> str:
    """Quantiles at 50, 90 and 99 % of lengths in m, as cm; an early end counts as infinite."""
    counted = np.where(status == js.Status.OK, 100.0 * values, np.inf)
    return " / ".join(f"{np.quantile(counted, q, method='higher'):.4f}" for q in (0.5, 0.9, 0.99))


def report(lanes: int, seed: int, laws: Sequence[str]) -> list[str]:
    """Rows of the table, law by law."""
    grid = np.meshgrid(HELD_OUT_SPEEDS, range(3))
    x, y = np.array(HELD_OUT_STARTS)[grid[1].ravel()].T
    parts = {
        "fleet": fleet(lanes, seed),
        "14 speeds x 3 starts": lines(grid[0].ravel(), 0.25 * np.pi, np.deg2rad(10.0), x, y),
        "Table 4's start at 0.2, 0.5, 1 m/s": lines(np.array([0.2, 0.5, 1.0]), 0.25 * np.pi, np.deg2rad(10.0), 0.3, 0.1),
        "curves": Cases(*np.array([(*case, 0.0, np.deg2rad(10.0), 0.0, 0.0) for case in CURVES.values()]).T),
    }
    cases = Cases(*(np.concatenate(columns) for columns in zip(*parts.values(), strict=True)))
    rows = []
    for name in laws:
        found, first = follow(cases, realisation=name), 0
        for label, part in parts.items():
            slot = slice(first, first := first + len(part.kind))
            rows += [f"{name}, {label}", *_rows(jax.tree.map(lambda leaf, slot=slot: leaf[slot], found), len(part.kind) <= 3)]
    return rows


def _rows(found: Followed, each: bool) -> list[str]:
    names = {js.Status(code).name: int(count) for code, count in zip(*np.unique(found.status, return_counts=True), strict=True)}
    lean = np.rad2deg(found.lean)
    rows = [f"    ends {names}, lean 50/90/100 % {np.median(lean):.1f} {np.quantile(lean, 0.9):.1f} {lean.max():.1f} deg"]
    rows += [f"    worst after {t:g} s, cm: {quantiles(w, found.status)}" for t, w in zip(AFTER, found.worst, strict=True)]
    rows[-1] += f"; means {' '.join(f'{100.0 * w.mean():.4f}' for w in found.worst)}"
    rows += [f"    at the limit after 0.2 s: {found.saturated.max():.3f} s; torque's deviation {found.deviation.max():.5f} N m"]
    if each:
        rows += [f"    {[f'{100.0 * w[i]:.5f}' for w in found.worst]} cm, {lean[i]:.1f} deg" for i in range(len(lean))]
    return rows


if __name__ == "__main__":
    js.use_all_cores()
    print("\n".join(report(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])))
