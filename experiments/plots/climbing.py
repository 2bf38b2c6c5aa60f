"""Pictures of how steep: the static surface, maps of gamma* and of outcomes, sensitivities, a steepest climb."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import jaxsphere as js
from experiments.plots.style import STYLES, figure, name_axes
from jaxsphere.robot import total_mass
from tuning.climbing import Sensitivity

# Beyond the codes of `Status`: fails, and settles with an unlimited motor.
TORQUE_LIMITED = 8

# Lightness falls with every class, so that they stay apart in grey.
CLASSES: dict[int, tuple[str, str]] = {
    js.Status.OK: ("settles", "#f4f1de"),
    js.Status.NOT_SETTLED: ("not settled", "#f2b134"),
    TORQUE_LIMITED: ("torque-limited", "#6fb3a8"),
    js.Status.DIVERGED: ("rolls away", "#b5446e"),
    js.Status.WHIRLING: ("whirls", "#4b3b8f"),
    js.Status.INFEASIBLE_LEAN: ("past the bound (4)", "#222222"),
    js.Status.SINGULAR_DECOUPLING: ("law singular", "#777777"),
    js.Status.NONFINITE: ("not finite", "#000000"),
}


class Axis(NamedTuple):
    """One axis of a map: the name of a quantity, its values, and its label with the unit."""

    name: str
    values: np.ndarray
    label: str


class BoundMap(NamedTuple):
    """gamma* (rad) over two axes, rows along y: NaN where the flat is not climbed."""

    x: Axis
    y: Axis
    value: np.ndarray
    lower: np.ndarray  # seen to succeed, at most the tolerance below `upper`
    upper: np.ndarray  # seen to fail, or the bound (4)
    status: np.ndarray  # Status at `upper`, OK where that is the bound (4)
    rollouts: int
    seconds: float  # simulated in all of them


class OutcomeMap(NamedTuple):
    """Status codes (or TORQUE_LIMITED) over two axes, rows along y, and which nodes were simulated."""

    x: Axis
    y: Axis
    outcome: np.ndarray
    simulated: np.ndarray


def static_figure(robots: dict[str, js.Robot]) -> Figure:
    """Draw the bound (4) over mass ratio and l/r, with the robots placed on it."""
    fig, axes = figure(1, 1, (6.4, 4.6))
    panel = axes[0, 0]
    length, mass = np.linspace(0.05, 1.0, 200), np.linspace(0.02, 0.8, 200)
    bound = np.rad2deg(np.arcsin(np.outer(mass, length)))
    shading = panel.contourf(length, mass, bound, np.arange(0, 56, 5), cmap="cividis")
    lines = panel.contour(length, mass, bound, [5, 10, 15, 20, 25, 30, 40], colors="white", linewidths=0.8)
    panel.clabel(lines, fmt="%g°", fontsize=8)
    for (name, robot), marker in zip(robots.items(), "osD^v", strict=False):
        at = robot.pendulum_length / robot.shell_radius, robot.pendulum_mass / total_mass(robot)
        words = f"{name.replace('_', ' ')}, {np.rad2deg(float(js.climbing_bound(robot))):.1f}°"
        panel.plot(*at, marker, color="white", markeredgecolor="black", markersize=8, label=words)
    fig.colorbar(shading, ax=panel, label="steepest slope held statically, (4) (deg)")
    name_axes(panel, "pendulum length / shell radius", "pendulum mass / total mass", "bound (4) and published robots")
    legend = panel.legend(fontsize=8, loc="lower left", framealpha=0.9, frameon=True)
    legend.set_zorder(5)
    panel.grid(False)
    return fig


def release_figure(bounds: np.ndarray, simulated: np.ndarray) -> Figure:
    """Draw the bound found by releasing robots against (4) (both rad), and the differences."""
    fig, axes = figure(1, 2, (9.0, 3.8))
    against, apart = axes.flat
    limit = np.rad2deg(bounds.max())
    against.plot([0, limit], [0, limit], label="equal", **STYLES[1])
    against.plot(np.rad2deg(bounds), np.rad2deg(simulated), ".", color=STYLES[0]["color"], markersize=3, label="one robot")
    name_axes(against, "bound (4) (deg)", "steepest slope held in simulation (deg)")
    apart.hist(1e6 * (simulated - bounds), bins=40, color=STYLES[0]["color"])
    name_axes(apart, "simulated − (4) (microradians)", "robots", legend=False)
    fig.suptitle(f"{len(bounds)} random robots, released under the torque that balances the slope")
    return fig


def bound_figure(found: BoundMap, title: str, mark: tuple[float, float, str] | None = None) -> Figure:
    """Draw gamma* over two parameters, hatched where the flat is not climbed, and what happens just above it."""
    fig, axes = figure(1, 2, (11.0, 4.4))
    surface, ends = axes.flat
    degrees = np.ma.masked_invalid(np.rad2deg(found.value))
    extent = _extent(found.x.values, found.y.values)
    for panel in (surface, ends):
        panel.set_facecolor("0.85")
        panel.grid(False)
    image = surface.imshow(degrees, origin="lower", extent=extent, aspect="auto", cmap="cividis", interpolation="nearest")
    if degrees.count() and min(found.value.shape) > 1:
        lines = surface.contour(found.x.values, found.y.values, degrees, 8, colors="white", linewidths=0.6)
        surface.clabel(lines, fmt="%.3g°", fontsize=7)
    fig.colorbar(image, ax=surface, label="closed-loop bound γ* (deg)")
    shown = np.where(np.isnan(found.value), -1, found.status)
    _draw_classes(ends, shown, extent, "how climbs end just above γ*", {-1: ("flat not climbed", "#d9d9d9")})
    for panel in (surface, ends):
        if mark is not None:
            panel.plot(*mark[:2], "*", color="white", markeredgecolor="black", markersize=12, label=mark[2])
        name_axes(panel, found.x.label, found.y.label, legend=False)
    if mark is not None:
        surface.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    fig.suptitle(title)
    return fig


def outcome_figure(found: OutcomeMap, title: str) -> Figure:
    """Draw how every climb ends, and which climbs were simulated to know."""
    fig, axes = figure(1, 2, (11.0, 4.4))
    ends, asked = axes.flat
    extent = _extent(found.x.values, found.y.values)
    _draw_classes(ends, found.outcome, extent, "outcome", {})
    asked.imshow(found.simulated, origin="lower", extent=extent, aspect="auto", cmap="Greys", interpolation="nearest")
    share = found.simulated.size / found.simulated.sum()
    asked.set_title(f"simulated: {found.simulated.sum()} of {found.simulated.size}, {share:.0f} times fewer", fontsize=9)
    for panel in (ends, asked):
        name_axes(panel, found.x.label, found.y.label, legend=False)
        panel.grid(False)
    fig.suptitle(title)
    return fig


def _extent(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float]:
    """Edges of the picture when every value is the middle of its pixel."""
    half = [0.5 * (values[-1] - values[0]) / max(len(values) - 1, 1) for values in (x, y)]
    return x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1]


def _draw_classes(
    panel: Axes, codes: np.ndarray, extent: tuple[float, float, float, float], title: str, more: dict[int, tuple[str, str]]
) -> None:
    known = {int(code): look for code, look in (more | CLASSES).items()}
    present = [code for code in known if np.any(codes == code)]
    rank = np.zeros(codes.shape)
    for place, code in enumerate(present):
        rank[codes == code] = place
    colours = ListedColormap([known[code][1] for code in present])
    norm = BoundaryNorm(np.arange(len(present) + 1) - 0.5, len(present))
    panel.imshow(rank, origin="lower", extent=extent, aspect="auto", cmap=colours, norm=norm, interpolation="nearest")
    patches = [Patch(facecolor=known[code][1], edgecolor="0.3", label=known[code][0]) for code in present]
    panel.legend(handles=patches, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    panel.set_title(title, fontsize=9)


WORDS = {
    "c1": "c1",
    "c2": "c2",
    "z_u": "z_U",
    "phi_z": "Φ_z",
    "eta": "η",
    "k": "k",
    "shell_mass": "shell mass",
    "gimbal_mass": "gimbal mass",
    "pendulum_mass": "pendulum mass",
    "pendulum_length": "pendulum length",
    "shell_radius": "shell radius",
    "shell_inertia": "shell inertia",
    "gimbal_inertia": "gimbal inertia",
}


def sensitivity_figure(found: Sensitivity, differences: np.ndarray, static: np.ndarray) -> Figure:
    """Draw what one per cent more of every quantity adds to gamma*: implicit, by differences of bisections, and to (4)."""
    order = np.argsort(np.abs(found.derivative))
    rows = np.arange(len(order))
    fig, axes = figure(1, 2, (10.0, 4.8))
    for panel, scale in zip(axes.flat, ("linear", "log"), strict=True):
        size = 0.01 * np.rad2deg(np.stack([found.derivative, differences, static])[:, order])
        shown = size if scale == "linear" else np.abs(size)
        panel.barh(rows + 0.2, shown[0], 0.38, color=STYLES[0]["color"], label="γ*, implicit differentiation")
        panel.barh(rows - 0.2, shown[2], 0.38, color="#c9c9c9", edgecolor="0.4", label="bound (4)")
        panel.plot(shown[1], rows + 0.2, "|", color=STYLES[1]["color"], markersize=11, label="γ*, differences of bisections")
        panel.set_yticks(rows, [WORDS[found.names[index]] for index in order])
        panel.set_xscale(scale)
    name_axes(axes[0, 0], "change of the bound for +1 % (deg)", "")
    name_axes(axes[0, 1], "its size, logarithmic (deg)", "", legend=False)
    axes[0, 0].legend(fontsize=8, loc="lower left")
    axes[0, 0].axvline(0.0, color="0.4", linewidth=0.8)
    axes[0, 1].set_xlim(1e-6, 1.0)
    fig.suptitle(f"What raises the closed-loop bound of Table 3, γ* = {np.rad2deg(found.slope):.4f}°")
    return fig


def climb_figure(title: str, runs: Sequence[tuple[str, js.Trajectory]], robot: js.Robot, slope: float, travel: float) -> Figure:
    """Draw sphere angle, swing and torque of climbs on one slope, with both equilibria."""
    fig, axes = figure(1, 3, (11.0, 3.6))
    angle, swing, torque = axes.flat
    both = js.equilibria(robot, slope)
    angle.axhspan(0.98 * travel, 1.02 * travel, color="0.85", label="2 % band")
    swing.axhline(np.rad2deg(float(both.lower)), color="0.4", linewidth=0.8, label="φ0")
    swing.axhline(np.rad2deg(float(both.upper)), color="0.4", linewidth=0.8, linestyle=":", label="π − φ0")
    for (name, run), style in zip(runs, STYLES, strict=False):
        keep = np.asarray(run.time) < float(run.end_time)
        time, state = np.asarray(run.time)[keep], np.asarray(run.state)[keep]
        angle.plot(time, state[:, 0], label=name, **style)
        swing.plot(time, np.rad2deg(state[:, 2]), label=name, **style)
        torque.plot(time, np.asarray(run.torque)[keep, 0], label=name, **{**style, "linewidth": 0.5})
    angle.set_ylim(-1.0 * travel, 1.3 * travel)
    name_axes(angle, "time (s)", "sphere angle α (rad)")
    name_axes(swing, "time (s)", "swing φ (deg)")
    name_axes(torque, "time (s)", "motor torque τ (N m)", "a band: the hard sign chatters")
    fig.suptitle(title)
    return fig


def tuning_figure(bounds: Sequence[float], static: float) -> Figure:
    """Draw gamma* after every round of tuning, as its distance from the bound (4)."""
    fig, axes = figure(1, 1, (6.0, 3.6))
    panel: Any = axes[0, 0]
    panel.plot(np.arange(len(bounds)), np.rad2deg(bounds), "o-", color=STYLES[0]["color"], label="γ*")
    panel.axhline(np.rad2deg(static), label="bound (4)", **STYLES[1])
    panel.axhline(0.99 * np.rad2deg(static), label="99 % of it", **STYLES[3])
    panel.set_xticks(range(len(bounds)), ["Table 3", *(f"round {i}" for i in range(1, len(bounds)))])
    name_axes(panel, "", "steepest slope (deg)")
    return fig
