"""Tracking gains along lines of many speeds: scored over 20 s with a 1 kHz hold, chosen on some speeds, judged on others.

The figures are means over speeds and starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxsphere as js
import tuning
from experiments.studies.settings import VALIDATION_SPEEDS

DURATION = 20.0
CONTROL_PERIOD = 1e-3

# m: Table 4's start with its mirror image, and a third one that tuning never sees.
TRAINING_STARTS = ((0.3, 0.1), (0.1, 0.3))
HELD_OUT_STARTS = (*TRAINING_STARTS, (0.32, 0.08))

# How many of the answers are looked at on the validation speeds, and what an early end counts as there, cm.
_FINALISTS = 8
_ENDED_EARLY = 30.0


class Scores(NamedTuple):
    """Figures of gains at speeds from starts, each (gains, speeds, starts)."""

    rms: np.ndarray  # root mean square distance over 20 s, cm
    worst: np.ndarray  # largest distance after 5 s, cm
    ended: np.ndarray  # whether the lane ended early, its other figures say little


def search(
    objective: tuning.FollowLine,
    initial: js.TrackingGains,
    validation_speeds: Sequence[float] = VALIDATION_SPEEDS,
    *,
    iterations: int = 12,
    frozen: Sequence[str] = (),
    optimiser: str = "lm",
    **settings: Any,
) -> tuning.TuningResult:
    """Tune within SPATIAL_BOUNDS and choose among the answers of the starts at the validation speeds, if any.

    settings: as in `tuning.tune`.
    """
    bounds = {name: ends for name, ends in tuning.SPATIAL_BOUNDS.items() if name not in frozen}
    options = {"iterations": iterations, "frozen": frozen, "optimiser": optimiser, "bounds": bounds, "chunk": 5}
    found = tuning.tune(objective, initial, **options, **settings)
    if not validation_speeds:
        return found
    task = objective.task
    return choose(found, task.robot, float(task.slope), validation_speeds, task.torque_limit)


def score(
    robot: js.Robot,
    slope: float,
    gains: Sequence[js.TrackingGains],
    speeds: Sequence[float],
    torque_limit: float | None = 5.0,
    starts: Sequence[tuple[float, float]] = TRAINING_STARTS,
) -> Scores:
    """Follow every speed from every start with all gains for 20 s with a 1 kHz hold, all in one batch."""

    def lane(gains: js.TrackingGains, speed: jax.Array, start: jax.Array) -> tuple[jax.Array, ...]:
        options: dict[str, Any] = {"control_period": CONTROL_PERIOD, "save_every": None, "throw": False}
        task = {"duration": DURATION, "torque_limit": torque_limit, "start": (start[0], start[1])}
        found = js.track_line(robot, slope, gains, speed, **task, **options)
        early = (found.status != js.Status.OK) & (found.status != js.Status.NOT_SETTLED)
        return 100.0 * found.metrics.rms_error, 100.0 * found.metrics.late_error, early

    shape = len(gains), len(speeds), len(starts)
    i, j, k = (index.reshape(-1) for index in np.indices(shape))
    stacked = jax.tree.map(lambda *leaves: np.asarray(leaves, np.float64)[i], *gains)
    figures = js.batch(lane)(stacked, np.asarray(speeds, np.float64)[j], np.asarray(starts, np.float64)[k])
    return Scores(*(np.asarray(figure).reshape(shape) for figure in figures))


def choose(
    result: tuning.TuningResult, robot: js.Robot, slope: float, speeds: Sequence[float], torque_limit: Any
) -> tuning.TuningResult:
    """Result with that of its starts' answers that does best at `speeds`, which the search has not seen.

    That is the least mean over the lanes of rms plus worst error after 5 s, where a lane that ends early counts as 30 cm each.
    Only the answers of least objective are looked at.
    """
    finalists = np.argsort(result.bests)[:_FINALISTS]
    finalists = finalists[np.isfinite(result.bests[finalists])]
    gains = [js.TrackingGains(**{name: float(row[i]) for name, row in result.answers.items()}) for i in finalists]
    found = score(robot, slope, gains, speeds, torque_limit, TRAINING_STARTS)
    merit = np.where(found.ended, 2.0 * _ENDED_EARLY, found.rms + found.worst).mean(axis=(1, 2))
    best = int(np.argmin(merit))
    return replace(result, gains=gains[best], objective=float(result.bests[finalists[best]]))


def means(found: Scores) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means over starts of rms and worst error, (gains, speeds), and how many lanes ended early, (gains, speeds).

    The means are over the lanes that no gains let end early, so that they compare like with like; NaN where there is none.
    """
    alive = np.broadcast_to(~found.ended.any(axis=0), found.ended.shape)
    count = alive.sum(axis=2)
    rms, worst = (np.where(alive, x, 0.0).sum(axis=2) / np.where(count > 0, count, np.nan) for x in found[:2])
    return rms, worst, found.ended.sum(axis=2)


def pooled(found: Scores) -> Scores:
    """The same lanes as if all were of one speed, to take the means over everything."""
    return Scores(*(x.reshape(len(x), 1, -1) for x in found))


def table(name: str, speeds: Sequence[float], found: Scores) -> list[str]:
    """Rows that set the second gains of `found` against the first, the means, and at which speeds they are worse."""
    rms, worst, ended = means(found)
    rows = [f"{name:<12}   ended early    rms distance (cm)   worst after 5 s (cm)", f"{'':<12}" + "  before   after" * 3]
    every = [(f"{speed:g} m/s", ended[:, i], rms[:, i], worst[:, i]) for i, speed in enumerate(speeds)]
    all_rms, all_worst, all_ended = (x[:, 0] for x in means(pooled(found)))
    for label, early, one, other in [*every, ("all", all_ended, all_rms, all_worst)]:
        rows.append(f"{label:<12}{early[0]:>8d}{early[1]:>8d}" + "".join(f"{x:>8.2f}" for x in (*one, *other)))
    for figure, values in (("rms distance", rms), ("worst distance after 5 s", worst), ("number of early ends", ended)):
        worse = [f"{speed:g}" for speed, before, after in zip(speeds, *values, strict=True) if after > before]
        rows.append(f"larger {figure} than before at {', '.join(worse)} m/s" if worse else f"no larger {figure} at any speed")
    return rows


def numbers(speeds: Sequence[float], found: Scores) -> dict[str, Any]:
    """Figures before and after per speed and over all, as in `table`."""
    named: dict[str, Any] = {}
    columns = [f"{speed:g} m/s" for speed in speeds]
    for labels, (rms, worst, ended) in ((columns, means(found)), (["all"], means(pooled(found)))):
        for row, when in enumerate(("before", "after")):
            for i, label in enumerate(labels):
                figures = {
                    "rms_error_cm": rms[row, i],
                    "largest_error_after_5_s_cm": worst[row, i],
                    "ended_early": ended[row, i],
                }
                named.setdefault(when, {})[label] = figures
    return named
