"""Pictures of searches for gains: convergence, descent against rollouts, fronts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.plots.style import STYLES, figure, name_axes
from tuning import TuningResult


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
