"""A tuning study of the tracking controller: tune on lines, choose among the answers, score at speeds that were not seen."""

from __future__ import annotations

import math
from typing import Any

import jaxsphere as js
import tuning
from experiments.plots import search, tracking
from experiments.records import Record
from experiments.studies import fig5, lines
from experiments.studies.settings import LineTuning

Scored = dict[str, tuple[tuple[float, ...], lines.Scores]]


def objective(settings: LineTuning, robot: js.Robot) -> tuning.FollowLine:
    """Return the objective of a study. Raises ValueError for a setting that is not admissible."""
    js.require_holdable(robot, settings.slope)
    made = tuning.FollowLine(
        robot,
        settings.slope,
        speeds=settings.speeds,
        duration=settings.duration,
        dt=settings.dt,
        torque_limit=settings.torque_limit,
        lean_limit=settings.lean_limit,
        friction_limit=settings.friction_limit,
        starts=lines.TRAINING_STARTS,
        settled_after=0.5 * settings.duration,
    )
    made.check()
    for name in ("validation_speeds", "held_out_speeds"):
        if not getattr(settings, name):
            raise ValueError(f"{name} = () leaves nothing to score; type at least one speed in m/s, e.g. 0.35")
    return made


def study(
    settings: LineTuning, robot: js.Robot, initial: js.TrackingGains, record: Record
) -> tuple[tuning.TuningResult, Scored, dict[str, Any]]:
    """Run a study and save its pictures into `record`.

    Returns:
        The result, the scores before and after by set of speeds, and the numbers for metrics.json.
    """
    asked = objective(settings, robot)
    options: dict[str, Any] = settings.arguments() | {"checkpoint": settings.checkpoint}
    result = lines.search(asked, initial, settings.validation_speeds, **options)
    runs = {"before": initial, "after": result.gains}
    sets = {"tuned on": (settings.speeds, lines.TRAINING_STARTS), "held out": (settings.held_out_speeds, lines.HELD_OUT_STARTS)}
    scored = {
        name: (speeds, lines.score(robot, settings.slope, list(runs.values()), speeds, settings.torque_limit, starts))
        for name, (speeds, starts) in sets.items()
    }
    _draw(settings, robot, runs, scored, record)
    record.picture("tuning_convergence", search.convergence_figure(result))
    terms = {name: asked.terms(gains)._asdict() for name, gains in runs.items()}
    figures = {name: lines.numbers(speeds, found) for name, (speeds, found) in scored.items()}
    return result, scored, {"gains": result.gains, "terms": terms, **figures}


def _draw(settings: LineTuning, robot: js.Robot, runs: dict[str, js.TrackingGains], scored: Scored, record: Record) -> None:
    middle, limit = settings.speeds[len(settings.speeds) // 2], settings.torque_limit
    tracks = [fig5.named(name, fig5.score(robot, settings.slope, gains, middle, limit), middle) for name, gains in runs.items()]
    degrees = f"{round(math.degrees(settings.slope), 9):g}° slope"
    title = f"Before and after tuning, {middle:g} m/s on a {degrees}, 1 kHz hold"
    record.picture("tuning", tracking.tracking_figure(title, tracks, limit))
    curves = [(name, speeds, *lines.means(found)[:2]) for name, (speeds, found) in scored.items()]
    title = f"Speeds tuned on and held out, {degrees}, |τ| ≤ {limit:g} N m, 1 kHz hold"
    record.picture("tuning_speeds", tracking.speeds_figure(title, curves))
