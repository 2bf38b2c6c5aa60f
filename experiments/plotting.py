"""Pictures. Lines differ in dash and lightness as well as colour, so that they can be told apart in grey."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg", force=False)

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxsphere as js
from tuning import TuningResult

STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#08306b", "linestyle": "-"},
    {"color": "#e6701e", "linestyle": "--"},
    {"color": "#7a9a3a", "linestyle": "-."},
    {"color": "#8c8c8c", "linestyle": ":"},
)
RC: Any = {
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "figure.constrained_layout.use": True,
}


class Run(NamedTuple):
    """One trajectory of a regulation task and what to call it."""

    label: str
    trajectory: js.Trajectory
    gains: js.SlidingModeGains


def figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    """Empty figure of `size` inches with a grid of axes (rows, columns)."""
    with plt.rc_context(RC):
        return plt.subplots(rows, columns, figsize=size, squeeze=False)


def regulation_figure(title: str, runs: Sequence[Run], robot: js.Robot, slope: float, travel: float, until: float) -> Figure:
    """Sphere angle, swing, torque and surfaces over time and both phase planes, in the manner of the paper's Fig. 4."""
    fig, axes = figure(3, 2, (9.0, 9.5))
    angle, swing, torque, surfaces, sphere_plane, pendulum_plane = axes.flat
    equilibrium = float(js.equilibrium_swing(robot, slope))
    angle.axhline(travel, color="0.4", linewidth=0.8)
    angle.text(until, travel, "target ", ha="right", va="bottom", fontsize=8, color="0.3")
    swing.axhline(np.rad2deg(equilibrium), color="0.4", linewidth=0.8)
    swing.text(until, np.rad2deg(equilibrium), "equilibrium (3) ", ha="right", va="bottom", fontsize=8, color="0.3")
    for run, style in zip(runs, STYLES, strict=False):
        time, state = np.asarray(run.trajectory.time), np.asarray(run.trajectory.state)
        shown, signals = time <= until, run.trajectory.diagnostics
        assert signals is not None
        s1, s2, z = (np.asarray(signal)[shown] for signal in (signals.s1, signals.s2, signals.z))
        time, (alpha, alpha_rate, phi, phi_rate) = time[shown], state[shown].T
        angle.plot(time, alpha, label=run.label, **style)
        swing.plot(time, np.rad2deg(phi), label=run.label, **style)
        torque.plot(time, np.asarray(run.trajectory.torque)[shown, 0], label=run.label, **style)
        surfaces.plot(time, s1, label=f"s1, {run.label}", **style)
        surfaces.plot(time, s2, label=f"s2, {run.label}", **{**style, "linewidth": 0.8})
        phase_plane(sphere_plane, alpha - travel, alpha_rate, float(run.gains.c1), run.label, style)
        phase_plane(pendulum_plane, phi - equilibrium - z, phi_rate, float(run.gains.c2), run.label, style)
    name_axes(angle, "time (s)", "sphere angle α (rad)")
    name_axes(swing, "time (s)", "swing φ (deg)")
    name_axes(torque, "time (s)", "motor torque τ (N m)")
    name_axes(surfaces, "time (s)", "surfaces s1, s2 (rad/s)")
    name_axes(sphere_plane, "error α − α_d (rad)", "rate α' (rad/s)", title="phase plane of the sphere, thin: s1 = 0")
    name_axes(pendulum_plane, "φ − φ0 − z (rad)", "rate φ' (rad/s)", title="phase plane of the pendulum, thin: s2 = 0")
    fig.suptitle(title)
    return fig


def phase_plane(axes: Axes, position: np.ndarray, rate: np.ndarray, slope: float, label: str, style: dict) -> None:
    """Rate against position with its start, and the line rate = -slope position, thin."""
    axes.plot(position, rate, label=label, **style)
    axes.plot(position[0], rate[0], "o", color=style["color"], markersize=4)
    low, high = position.min(), position.max()
    ends = np.array([low - 0.05 * (high - low), high + 0.05 * (high - low)])
    surface = -slope * ends
    inside = np.clip(surface, rate.min() - 0.1 * np.ptp(rate), rate.max() + 0.1 * np.ptp(rate))
    axes.plot(-inside / slope, inside, linewidth=0.7, color=style["color"], linestyle=style["linestyle"])


def sign_figure(corrected: js.Trajectory, printed: js.Trajectory, until: float) -> Figure:
    """What the sign of z in (8) decides: the corrected law climbs, the printed one rolls away downhill."""
    fig, axes = figure(1, 2, (9.0, 3.4))
    for name, trajectory, style in (("z = −z_U tanh", corrected, STYLES[0]), ("z = +z_U tanh, as printed", printed, STYLES[1])):
        time, state = np.asarray(trajectory.time), np.asarray(trajectory.state)
        shown = time <= min(until, float(trajectory.end_time))
        axes[0, 0].plot(time[shown], state[shown, 0], label=name, **style)
        axes[0, 1].plot(time[shown], np.rad2deg(state[shown, 2]), label=name, **style)
    name_axes(axes[0, 0], "time (s)", "sphere angle α (rad)")
    name_axes(axes[0, 1], "time (s)", "swing φ (deg)")
    fig.suptitle("Sign of the asked swing in (8), Table 3, slope 10°")
    return fig


def error_figure(title: str, labels: Sequence[str], time: np.ndarray, errors: Sequence[np.ndarray], band: float) -> Figure:
    """Errors (rad) over time of several runs, with the settling band."""
    fig, axes = figure(1, 1, (7.0, 3.6))
    panel = axes[0, 0]
    panel.axhspan(-band, band, color="0.9", label="2 % band")
    for label, error, style in zip(labels, errors, STYLES, strict=False):
        panel.plot(time, error, label=label, **style)
    panel.set_ylim(-1.5, 1.0)
    name_axes(panel, "time (s)", "error α − α_d (rad)", title=title)
    return fig


def convergence_figure(result: TuningResult) -> Figure:
    """Objective of every start over the iterations, and the gains before and after."""
    fig, axes = figure(1, 2, (9.0, 3.6))
    curves, gains = axes.flat
    objective = result.history["objective"]
    best = np.minimum.accumulate(np.where(np.isfinite(objective), objective, np.inf), axis=0)
    winner = int(np.argmin(best[-1]))
    for index in range(objective.shape[1]):
        curves.plot(objective[:, index], color="0.75", linewidth=0.8, label="other starts" if index == (winner == 0) else None)
    curves.plot(objective[:, winner], label="best start", **STYLES[0])
    curves.set_yscale("log")
    name_axes(curves, "iteration", "objective")
    ratios = [float(getattr(result.gains, name)) / float(getattr(result.initial_gains, name)) for name in result.names]
    gains.barh(range(len(ratios)), np.log2(ratios), color=STYLES[0]["color"])
    gains.set_yticks(range(len(ratios)), result.names)
    gains.axvline(0.0, color="0.4", linewidth=0.8)
    name_axes(gains, "change of the gain (factors of two)", "", legend=False)
    fig.suptitle(f"Tuning: objective {result.initial_objective:.3f} → {result.objective:.3f}")
    return fig


def bars_figure(title: str, labels: Sequence[str], values: Sequence[float], unit: str) -> Figure:
    """Horizontal bars on a logarithmic axis, each with its number."""
    fig, axes = figure(1, 1, (7.0, 0.5 * len(labels) + 1.4))
    panel = axes[0, 0]
    panel.barh(range(len(values)), values, color=STYLES[0]["color"], height=0.55)
    for row, value in enumerate(values):
        panel.text(value * 1.05, row, f"{value:.3g}", va="center")
    panel.set_xscale("log")
    panel.set_xlim(min(values) / 10, max(values) * 4)
    panel.set_yticks(range(len(labels)), labels)
    panel.invert_yaxis()
    name_axes(panel, unit, "", title=title, legend=False)
    return fig


def descent_figure(title: str, curves: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Best objective so far against rollouts, both on logarithmic axes; label -> (rollouts, objective)."""
    fig, axes = figure(1, 1, (7.0, 4.2))
    panel = axes[0, 0]
    for i, (label, (rollouts, objective)) in enumerate(curves.items()):
        best = np.minimum.accumulate(np.where(np.isfinite(objective), objective, np.inf))
        panel.step(rollouts, best, where="post", label=label, **STYLES[i % 4] | {"linewidth": 1.8 if i < 3 else 0.9})
    panel.set_xscale("log")
    panel.set_yscale("log")
    name_axes(panel, "rollouts", "best objective so far", title=title)
    return fig


def fronts_figure(title: str, fronts: Mapping[str, np.ndarray]) -> Figure:
    """Fronts (points, 3) of settling (s), swing (rad) and effort ((N m)^2 s), one panel each, the lighter the more effort."""
    fig, axes = figure(1, len(fronts), (3.3 * len(fronts) + 0.9, 3.6))
    bottom, top = (float(end(np.concatenate([points[:, 2] for points in fronts.values()]))) for end in (np.min, np.max))
    for panel, (label, points) in zip(axes[0], fronts.items(), strict=True):
        settling, swing, effort = points.T
        shade: dict[str, Any] = {"c": effort, "s": 8, "cmap": "viridis", "vmin": bottom, "vmax": top}
        dots = panel.scatter(settling, np.rad2deg(swing), **shade)
        name_axes(panel, "2 % settling (s)", "peak swing about equilibrium (deg)", f"{label}, {len(points)} points", False)
        panel.sharex(axes[0, 0])
        panel.sharey(axes[0, 0])
    fig.colorbar(dots, ax=axes[0, -1], label="effort ((N m)² s)")
    fig.suptitle(title)
    return fig


def name_axes(axes: Axes, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Label both axes of a panel, with a small title and a legend where asked."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, fontsize=9)
    if legend:
        axes.legend(fontsize=8, frameon=False)
