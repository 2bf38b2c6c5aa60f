"""Pictures of the spatial robot: paths, errors, torques, lean, friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxsphere as js
from experiments.plots.style import STYLES, figure, name_axes


class Track(NamedTuple):
    """One tracking trajectory, what to call it, and where the reference was at its saved times (T, 2), m."""

    label: str
    trajectory: js.Trajectory
    reference: np.ndarray


# Of the distances that are drawn, cm; the axis ends above it, so that what is smaller leaves the picture.
_SMALLEST = 1e-4


def lived(track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, state, torque and error vector of a track up to where its lane ended."""
    time = np.asarray(track.trajectory.time)
    alive = time <= float(track.trajectory.end_time) + 1e-9
    state = np.asarray(track.trajectory.state)[alive]
    return time[alive], state, np.asarray(track.trajectory.torque)[alive], state[:, :2] - track.reference[alive]


def tracking_figure(title: str, tracks: Sequence[Track], limit: float | None = None, zoom: float | None = None) -> Figure:
    """Path (its first `zoom` m), distance from the reference, drive torque and attitude of the spin axis."""
    fig, axes = figure(2, 2, (9.5, 7.4))
    path, distance, torque, lean = axes.flat
    longest = max(tracks, key=lambda track: float(np.abs(track.reference).max()))
    path.plot(*_thinned(longest.reference).T, color="0.7", linewidth=4.0, alpha=0.6, label="reference")
    for track, style in zip(tracks, STYLES, strict=False):
        time, state, torques, error = lived(track)
        path.plot(state[:, 0], state[:, 1], label=track.label, **style)
        distance.semilogy(time, np.maximum(100.0 * np.hypot(*error.T), _SMALLEST), label=track.label, **style)
        lean.plot(time, np.rad2deg(state[:, 3]), label=track.label, **style)
        # "ideal" has five accelerations where the robot has two torques.
        torque.plot(time, torques[:, 0 if torques.shape[1] == 2 else 2], label=track.label, **{**style, "linewidth": 0.9})
        _mark_end(track, distance, time[-1], 100.0 * float(np.hypot(*error[-1])), style["color"])
    robot = tracks[0].trajectory.torque.shape[-1] == 2
    if limit is not None and robot:
        torque.axhline(limit, color="0.4", linewidth=0.8)
        torque.axhline(-limit, color="0.4", linewidth=0.8)
    path.plot(*tracks[0].trajectory.state[0, :2], "o", color="0.2", markersize=5)
    path.set_aspect("equal", adjustable="datalim" if zoom is None else "box")
    name_axes(path, "x up-slope (m)", "y (m)", title="path of the centre, dot: start")
    distance.set_ylim(bottom=10.0 * _SMALLEST)
    name_axes(distance, "time (s)", "distance from the reference (cm)")
    name_axes(torque, "time (s)", "drive torque τ1 (N m)" if robot else "spin acceleration φ'' (rad/s²)", legend=False)
    name_axes(lean, "time (s)", "lean of the spin axis θ (deg)", legend=False)
    if zoom is not None:
        path.set_xlim(-0.15 * zoom, zoom)
        path.set_ylim(-0.15 * zoom, zoom)
    fig.suptitle(title)
    return fig


def realisations_figure(title: str, tracks: Sequence[Track], until: float) -> Figure:
    """How the readings of the controller fare on the robot: distance, both torques and lean until each of them ends."""
    fig, axes = figure(2, 2, (9.5, 7.0))
    distance, lean, drive, tilt = axes.flat
    for track, style in zip(tracks, STYLES, strict=False):
        time, state, torques, error = lived(track)
        shown = time <= until
        if int(track.trajectory.status) not in (js.Status.OK, js.Status.NOT_SETTLED):
            style = {**style, "marker": "x", "markevery": [int(shown.sum()) - 1], "markersize": 8}
        distance.plot(time[shown], np.hypot(*error.T)[shown], label=f"{track.label}: {_ending(track)}", **style)
        lean.plot(time[shown], np.rad2deg(state[shown, 3]), label=track.label, **style)
        drive.plot(time[shown], torques[shown, 0], label=track.label, **style)
        tilt.plot(time[shown], torques[shown, 1], label=track.label, **style)
    name_axes(distance, "time (s)", "distance from the reference (m)")
    name_axes(lean, "time (s)", "lean of the spin axis θ (deg)", legend=False)
    name_axes(drive, "time (s)", "drive torque τ1 (N m)", legend=False)
    name_axes(tilt, "time (s)", "tilt torque τ2 (N m)", legend=False)
    fig.suptitle(title)
    return fig


def friction_figure(title: str, tracks: Sequence[Track]) -> Figure:
    """Friction coefficient that rolling without slip needs, over time, for tracks with diagnostics."""
    fig, axes = figure(1, 1, (7.0, 3.4))
    panel = axes[0, 0]
    for track, style in zip(tracks, STYLES, strict=False):
        assert track.trajectory.diagnostics is not None
        needed = np.asarray(track.trajectory.diagnostics.contact.friction_coefficient)
        panel.plot(np.asarray(track.trajectory.time), needed, label=track.label, **{**style, "linewidth": 1.0})
    name_axes(panel, "time (s)", "friction coefficient needed (1)", title=title)
    return fig


def speeds_figure(title: str, sets: Sequence[tuple[str, Sequence[float], np.ndarray, np.ndarray]]) -> Figure:
    """Errors over speed before (hollow, dashed) and after (filled): a panel each for rms and worst error after 5 s.

    A set is its name, its speeds (n,) in m/s, and both errors in cm, (2, n) each: before and after.
    """
    fig, axes = figure(1, 2, (9.5, 4.0))
    for panel, index, label in (
        (axes[0, 0], 2, "rms distance over 20 s (cm)"),
        (axes[0, 1], 3, "largest distance after 5 s (cm)"),
    ):
        for (name, speeds, *_), errors, style, marker in zip(sets, (s[index] for s in sets), STYLES, "os^", strict=False):
            order = np.argsort(speeds)
            for row, when in enumerate(("before", "after")):
                look = {"linestyle": "--", "markerfacecolor": "white"} if when == "before" else {"linestyle": "-"}
                shown = np.maximum(errors[row], 1e-2)
                line = {"color": style["color"], "marker": marker, "markersize": 5, "linewidth": 1.1} | look
                panel.plot(np.asarray(speeds)[order], shown[order], label=f"{name}, {when}", **line)
        name_axes(panel, "speed (m/s)", label)
    axes[0, 1].set_yscale("log")
    fig.suptitle(title)
    return fig


def _ending(track: Track) -> str:
    status = js.Status(int(track.trajectory.status))
    words = status.name.lower().replace("_", " ")
    early = status not in (js.Status.OK, js.Status.NOT_SETTLED)
    return f"{words} at {float(track.trajectory.end_time):.2f} s" if early else words


def _mark_end(track: Track, axes: Axes, time: float, value: float, color: str) -> None:
    if int(track.trajectory.status) not in (js.Status.OK, js.Status.NOT_SETTLED):
        axes.plot(time, value, "x", color=color, markersize=8)


def _thinned(points: np.ndarray, most: int = 400) -> np.ndarray:
    return points[:: max(1, len(points) // most)]
