"""Pictures of the planar robot from rest to rest, in the manner of the paper's Fig. 4."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxsphere as js
from experiments.plots.style import STYLES, figure, name_axes


class Run(NamedTuple):
    """One trajectory of a regulation task and what to call it."""

    label: str
    trajectory: js.Trajectory
    gains: js.SlidingModeGains


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
