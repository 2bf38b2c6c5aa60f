"""Style of the pictures. Lines differ in dash and lightness as well as colour, so that they can be told apart in grey."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib

matplotlib.use("Agg", force=False)

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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


def figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    """Empty figure of `size` inches with a grid of axes (rows, columns)."""
    with plt.rc_context(RC):
        return plt.subplots(rows, columns, figsize=size, squeeze=False)


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


def name_axes(axes: Axes, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Label both axes of a panel, with a small title and a legend where asked."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, fontsize=9)
    if legend:
        axes.legend(fontsize=8, frameon=False)
