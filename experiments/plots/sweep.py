"""Pictures of sweeps: a curve, a map or strips, by the number of axes. Statuses differ in grey, hatch and marker."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import jaxsphere as js
from experiments.plots.style import figure, name_axes

PANELS = 4  # outputs shown at most
POINTS = 4000  # lanes shown at most in a strip
CELLS = 1000  # along an axis of a map at most


class Look(NamedTuple):
    """How lanes of one status look."""

    grey: str
    hatch: str
    marker: str


LOOKS = {
    js.Status.OK: Look("1.0", "", "o"),
    js.Status.NOT_SETTLED: Look("0.85", "..", "s"),
    js.Status.WHIRLING: Look("0.7", "//", "^"),
    js.Status.DIVERGED: Look("0.55", "xx", "v"),
    js.Status.SINGULAR_DECOUPLING: Look("0.45", "++", "D"),
    js.Status.SINGULAR_JOINTS: Look("0.4", "--", "P"),
    js.Status.INFEASIBLE_LEAN: Look("0.3", "\\\\", "X"),
    js.Status.NONFINITE: Look("0.15", "oo", "*"),
}
SHOWN = (js.Status.OK, js.Status.NOT_SETTLED)  # lanes that ran to the end


def sweep_figure(results: js.SweepResults) -> Figure:
    """Draw the first outputs: a curve over one axis, maps over two, strips over each leaf otherwise."""
    outputs = [name for name in results.values if name not in ("status", "end_time") and _is_scalar(results, name)][:PANELS]
    single = [len(axis.columns) == 1 for axis in results.axes]
    by_position = [len(found.dimensions) == 1 for found in results.coordinates.values()] if all(single) else [False]
    ordered = all(by_position) and all(axis.columns[0].kind in ("linear", "logarithmic", "listed") for axis in results.axes)
    if ordered and len(results.axes) == 2:
        return _maps(results, outputs[: PANELS - 1])
    if ordered and len(results.axes) == 1:
        return _curves(results, outputs)
    return _strips(results, outputs)


def _curves(results: js.SweepResults, outputs: list[str]) -> Figure:
    fig, panels = figure(1, max(len(outputs), 1), (4.2 * max(len(outputs), 1), 3.6))
    (column,) = results.columns
    at, status = results.coordinates[column.leaf].values, results.status
    for panel, name in zip(panels[0], outputs, strict=False):
        values = results.values[name]
        panel.plot(at, np.where(np.isin(status, SHOWN), values, np.nan), color="0.4", linewidth=0.8)
        for one in np.unique(status):
            _points(panel, at[status == one], values[status == one], js.Status(one))
        if column.kind == "logarithmic":
            panel.set_xscale("log")
        name_axes(panel, _label(column), _with_unit(name, results.units[name]))
    fig.suptitle(_title(results))
    return fig


def _maps(results: js.SweepResults, outputs: list[str]) -> Figure:
    rows = -(-(len(outputs) + 1) // 2)
    fig, grid = figure(rows, 2, (9.0, 3.8 * rows))
    *panels, ending = grid.flat[: len(outputs) + 1]
    for unused in grid.flat[len(outputs) + 1 :]:
        unused.remove()
    down, along = results.columns
    thin = tuple(slice(None, None, -(-length // CELLS)) for length in results.shape)
    y, x = (results.coordinates[column.leaf].values[part] for column, part in zip((down, along), thin, strict=True))
    status = results.status[thin]
    for panel, name in zip(panels, outputs, strict=True):
        values = results.values[name][thin]
        shown = np.where(np.isin(status, SHOWN) & np.isfinite(values), values, np.nan)
        mesh = panel.pcolormesh(x, y, shown, cmap="cividis", shading="nearest")
        fig.colorbar(mesh, ax=panel)
        name_axes(panel, _label(along), _label(down), title=_with_unit(name, results.units[name]), legend=False)
    _status_map(ending, x, y, status)
    name_axes(ending, _label(along), _label(down), title="how the lanes ended", legend=False)
    for panel in (*panels, ending):
        panel.grid(visible=False)
        panel.set_xscale("log" if along.kind == "logarithmic" else "linear")
        panel.set_yscale("log" if down.kind == "logarithmic" else "linear")
    fig.suptitle(_title(results))
    return fig


def _status_map(panel: Axes, x: np.ndarray, y: np.ndarray, status: np.ndarray) -> None:
    greys = ListedColormap([look.grey for look in LOOKS.values()])
    edges = np.arange(len(LOOKS) + 1) - 0.5
    panel.pcolormesh(x, y, status, cmap=greys, norm=BoundaryNorm(edges, len(LOOKS)), shading="nearest")
    present = [js.Status(one) for one in np.unique(status)]
    if min(status.shape) > 1:
        for one in present:
            panel.contourf(x, y, status == one, levels=[0.5, 1.5], colors="none", hatches=[LOOKS[one].hatch])
    patches = [
        Patch(facecolor=LOOKS[one].grey, hatch=LOOKS[one].hatch, edgecolor="0.2", label=_words(one.name)) for one in present
    ]
    panel.legend(handles=patches, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, frameon=False)


def _strips(results: js.SweepResults, outputs: list[str]) -> Figure:
    columns = results.columns[:PANELS]
    fig, panels = figure(max(len(outputs), 1), len(columns), (3.2 * len(columns), 2.6 * max(len(outputs), 1)))
    leaves, values = _thinned(results, -(-results.lanes // POINTS))
    for row, name in zip(panels, outputs, strict=False):
        for panel, column in zip(row, columns, strict=True):
            for one in np.unique(values["status"]):
                chosen = values["status"] == one
                _points(panel, leaves[column.leaf][chosen], values[name][chosen], js.Status(one))
            if column.kind.endswith("logarithmic"):
                panel.set_xscale("log")
            name_axes(panel, _label(column), _with_unit(name, results.units[name]), legend=panel is panels[0, 0])
    fig.suptitle(_title(results))
    return fig


def _thinned(results: js.SweepResults, step: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Leaves and outputs of every so many lanes, gathered a chunk at a time."""
    chosen = [(part, part.lanes % step == 0) for part in results.chunks()]
    leaves = {name: np.concatenate([part.leaves[name][one] for part, one in chosen]) for name in chosen[0][0].leaves}
    values = {name: np.concatenate([part.outputs[name][one] for part, one in chosen]) for name in chosen[0][0].outputs}
    return leaves, values


def _points(panel: Axes, x: np.ndarray, y: np.ndarray, status: js.Status) -> None:
    look = LOOKS[status]
    style: dict[str, Any] = {"markersize": 3.5, "markeredgecolor": "0.2", "markeredgewidth": 0.4, "linestyle": "none"}
    panel.plot(x, y, marker=look.marker, markerfacecolor=look.grey, label=_words(status.name), **style)


def _is_scalar(results: js.SweepResults, name: str) -> bool:
    kind = results.shards.layout[name]
    return kind.shape == () and np.issubdtype(kind, np.floating)


def _label(column: Any) -> str:
    return _with_unit(column.leaf, column.unit)


def _with_unit(name: str, unit: str) -> str:
    return f"{_words(name)} ({unit})" if unit else _words(name)


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _title(results: js.SweepResults) -> str:
    ok = results.counts().get(js.Status.OK, 0)
    return f"Sweep of {results.lanes} lanes, {ok} of them ok"
