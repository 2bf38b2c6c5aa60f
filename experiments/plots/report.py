"""One page on a tuning study: what the gains do before and after, how the search went, how sure the answer is."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxsphere as js
import tuning
from experiments.plots.regulation import phase_plane
from experiments.plots.style import RC, STYLES, name_axes
from tuning import TuningResult
from tuning.diagnostics.health import Audit, Health
from tuning.diagnostics.sensitivity import Directions

_LAYOUT = "aaapppttt;ssssqqqqq;vvvvggggg;hhhhxxxxx"
UNTIL = 10.0  # s
WINDOW = 20  # samples of 1 ms


class Study(NamedTuple):
    """What a study found; `scored` and `certificates` are by the name of the gains, "before" and "after"."""

    robot: js.Robot
    slope: float
    travel: float
    objective: tuning.RestToRest  # of the modelled robot, last stage
    result: tuning.TuningResult
    scored: dict[str, js.Trajectory]
    certificates: dict[str, tuning.Certificate]
    health: Health | None
    audit: Audit | None
    directions: Directions | None

    @property
    def gains(self) -> dict[str, js.SlidingModeGains]:
        """Gains before and after."""
        return {"before": self.result.initial_gains, "after": self.result.gains}


def planar_page(found: Study, title: str) -> Figure:
    """Traces and phase planes, convergence of all starts, change of the gains, robustness or audit, gains to copy."""
    with plt.rc_context(RC):
        fig, axes = plt.subplot_mosaic(_LAYOUT, figsize=(10.0, 12.5))
    _traces(found, axes["a"], axes["p"], axes["t"])
    _planes(found, axes["s"], axes["q"])
    convergence(found.result, axes["v"])
    changes(found.result, axes["g"])
    if found.certificates:
        _histogram(found, axes["h"])
    elif found.audit is not None:
        _audit(found, axes["h"])
    else:
        axes["h"].set_axis_off()
    _words(found, axes["x"])
    fig.suptitle(title)
    return fig


def _traces(found: Study, angle: Axes, swing: Axes, torque: Axes) -> None:
    equilibrium = np.rad2deg(float(js.equilibrium_swing(found.robot, found.slope)))
    angle.axhline(found.travel, color="0.4", linewidth=0.8)
    swing.axhline(equilibrium, color="0.4", linewidth=0.8)
    for (name, run), style in zip(found.scored.items(), STYLES, strict=False):
        time, state = np.asarray(run.time), np.asarray(run.state)
        shown = time <= min(UNTIL, float(run.end_time))
        angle.plot(time[shown], state[shown, 0], label=name, **style)
        swing.plot(time[shown], np.rad2deg(state[shown, 2]), label=name, **style)
        _envelope(torque, time[shown], np.asarray(run.torque)[shown, 0], name, style)
    name_axes(angle, "time (s)", "sphere angle α (rad)")
    name_axes(swing, "time (s)", "swing φ (deg)")
    name_axes(torque, "time (s)", "motor torque τ (N m)", title="envelope; hard sign, 1 kHz hold")


def _envelope(axes: Axes, time: np.ndarray, values: np.ndarray, label: str, style: dict[str, Any]) -> None:
    """Lowest and highest value of every window: a chattering torque as a band that others can be seen through."""
    rows = values[: len(values) // WINDOW * WINDOW].reshape(-1, WINDOW)
    low, high, middle = rows.min(axis=1), rows.max(axis=1), time[: rows.size : WINDOW]
    axes.fill_between(middle, low, high, color=style["color"], alpha=0.25, linewidth=0.0)
    axes.plot(middle, low, **{**style, "linewidth": 0.8})
    axes.plot(middle, high, label=label, **{**style, "linewidth": 0.8})


def _planes(found: Study, sphere: Axes, pendulum: Axes) -> None:
    equilibrium = float(js.equilibrium_swing(found.robot, found.slope))
    for (name, run), style in zip(found.scored.items(), STYLES, strict=False):
        shown = np.asarray(run.time) <= min(UNTIL, float(run.end_time))
        alpha, alpha_rate, phi, phi_rate = np.asarray(run.state)[shown].T
        assert run.diagnostics is not None
        asked, gains = np.asarray(run.diagnostics.z)[shown], found.gains[name]
        phase_plane(sphere, alpha - found.travel, alpha_rate, float(gains.c1), name, style)
        phase_plane(pendulum, phi - equilibrium - asked, phi_rate, float(gains.c2), name, style)
    name_axes(sphere, "error α − α_d (rad)", "rate α' (rad/s)", title="phase plane of the sphere, thin: s1 = 0")
    name_axes(pendulum, "φ − φ0 − z (rad)", "rate φ' (rad/s)", title="phase plane of the pendulum, thin: s2 = 0")


def convergence(result: TuningResult, axes: Axes) -> None:
    """Lowest objective so far of every start over the iterations."""
    objective = np.fmin.accumulate(np.where(np.isfinite(result.history["objective"]), result.history["objective"], np.nan))
    winner = int(np.nanargmin(np.where(result.feasible | ~result.feasible.any(), result.bests, np.nan)))
    others = [index for index in range(objective.shape[1]) if index != winner]
    for index in others:
        axes.plot(objective[:, index], color="0.75", linewidth=0.8, label="other starts" if index == others[0] else None)
    axes.plot(objective[:, winner], label="best start", **STYLES[0])
    axes.set_yscale("log")
    name_axes(
        axes, "iteration", "lowest objective so far", title=f"search: {result.initial_objective:.3g} → {result.objective:.3g}"
    )


def changes(result: TuningResult, axes: Axes) -> None:
    """Change of every free gain, and where the other starts that came within 2 % of the best ended."""
    rows = np.arange(len(result.names))
    before = np.array([float(getattr(result.initial_gains, name)) for name in result.names])
    after = np.array([float(getattr(result.gains, name)) for name in result.names])
    near = result.bests <= 1.02 * result.objective
    axes.barh(rows, np.log2(after / before), color=STYLES[0]["color"], height=0.5, label="best start")
    for row, name in enumerate(result.names):
        ends = np.log2(result.answers[name][near] / before[row])
        axes.plot(ends, np.full(ends.shape, row - 0.38), "|", color=STYLES[1]["color"], label=None if row else "within 2 %")
    axes.set_yticks(rows, result.names)
    axes.axvline(0.0, color="0.4", linewidth=0.8)
    name_axes(axes, "change of the gain (factors of two)", "")


def _histogram(found: Study, axes: Axes) -> None:
    settled = {name: one.settling_times[np.isfinite(one.settling_times)] for name, one in found.certificates.items()}
    longest = max([1.0, *(float(times.max()) for times in settled.values() if times.size)])
    edges = np.linspace(0.0, longest, 50).tolist()
    for (name, times), style, filled in zip(settled.items(), STYLES, (False, True), strict=False):
        one = found.certificates[name]
        label = f"{name}: {100 * one.rate:.2g} % of {one.count} failed"
        axes.hist(times, edges, label=label, histtype="stepfilled" if filled else "step", color=style["color"], alpha=0.8)
    name_axes(axes, "2 % settling time (s)", "fresh robots", title="held-out certificate; failures are not drawn")


def _audit(found: Study, axes: Axes) -> None:
    assert found.audit is not None
    places = np.arange(len(found.audit.smoothing))
    axes.plot(places, found.audit.settling_time, marker="o", label="2 % settling time (s)", **STYLES[0])
    swing = np.rad2deg(found.audit.peak_swing) / 10.0
    axes.plot(places, swing, marker="s", label="peak swing (10 deg)", **STYLES[1])
    axes.set_xticks(places, [f"{width:g}" if width else "hard" for width in found.audit.smoothing])
    known = np.concatenate([found.audit.settling_time, swing])
    axes.set_ylim(0.0, 1.4 * float(known[np.isfinite(known)].max()))
    name_axes(axes, "smoothing ε (rad/s)", "", title="from the smoothed to the hard sign, 1 kHz hold")


def _words(found: Study, axes: Axes) -> None:
    axes.set_axis_off()
    rows = []
    for name, run in found.scored.items():
        numbers = run.metrics
        rows.append(
            f"{name:<7}{js.Status(int(run.status)).name.lower():<12} settles {float(numbers.settling_time):5.2f} s, peak "
            f"{float(np.rad2deg(numbers.peak_swing)):5.1f} deg, {float(numbers.peak_torque):.1f} N m"
        )
    gains = found.result.gains
    copied = ", ".join(f"{leaf.name}={float(getattr(gains, leaf.name)):.5g}" for leaf in fields(gains))
    rows += ["", *textwrap.wrap(f"js.{type(gains).__name__}({copied})", 58, subsequent_indent="    ")]
    if found.health is not None:
        rows += ["", *textwrap.wrap(f"gradient: {found.health.verdict}", 58)]
    if found.certificates:
        rows += ["", *textwrap.wrap(f"certificate: {found.certificates['after'].sentence()}", 58)]
    axes.text(0.0, 1.0, "\n".join(rows), va="top", family="monospace", fontsize=7.5, transform=axes.transAxes)
