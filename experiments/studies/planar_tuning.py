"""A tuning study of the planar controller: tune, score with the hard sign, examine the gradient, certify on fresh robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jaxsphere as js
import tuning
from experiments.plots.report import Study
from experiments.studies.fig4 import SCORING, figures
from experiments.studies.settings import PlanarTuning, Unlike
from jaxsphere.checks import require_count, require_scalar


def check(settings: PlanarTuning, unlike: Unlike, robot: js.Robot, initial: js.SlidingModeGains) -> None:
    """Raise ValueError for a setting that is not admissible."""
    js.sliding_mode.check_gains(initial)
    for name in ("itae_weight", "swing_weight", "torque_weight", "chatter_weight"):
        require_scalar(name, getattr(settings, name), above=0.0, or_equal=True)
    require_scalar("swing_limit", settings.swing_limit, above=0.0, unit="rad")
    require_scalar("scenarios", unlike.scenarios, above=0.0, or_equal=True)
    require_count("samples", unlike.samples)
    js.require_holdable(robot, settings.slope)


def study(
    settings: PlanarTuning, unlike: Unlike, robot: js.Robot, initial: js.SlidingModeGains, checkpoint: str | None = None
) -> Study:
    """Run a study and return what it found. Raises ValueError as `check` and `tuning.tune` do."""
    check(settings, unlike, robot, initial)
    weights = (settings.itae_weight, settings.swing_weight, settings.torque_weight, settings.chatter_weight)
    nominal = tuning.RestToRest(
        robot,
        settings.slope,
        travel=settings.travel,
        duration=settings.duration,
        dt=settings.dt,
        smoothing=settings.smoothing[0] if settings.smoothing else 0.0,
        torque_limit=settings.torque_limit,
        swing_limit=settings.swing_limit,
        weights=tuning.Weights(*weights),
    )
    objective: Any = nominal
    if unlike.scenarios:
        scenarios, _ = tuning.sample(unlike.uncertainty(settings.slope), robot, unlike.scenarios, seed=settings.seed)
        objective = tuning.Robust(nominal, scenarios, unlike.aggregate, unlike.alpha)
    bounds = tuning.BOUNDS | (tuning.SEEKING_BOUNDS if initial.k_i else {})
    result = tuning.tune(
        tuning.Annealed(objective, settings.smoothing, settings.stiffness),
        initial,
        bounds={name: ends for name, ends in bounds.items() if name not in settings.frozen},
        checkpoint=checkpoint,
        **settings.arguments(),
    )
    gains = {"before": initial, "after": result.gains} if unlike.scenarios else {}
    certificates = {name: certify(settings, unlike, robot, each) for name, each in gains.items()}
    last = nominal.stiffened(settings.smoothing[-1], settings.stiffness[-1])
    return examined(last, result, certificates, settings.smoothing if settings.examine else ())


def examined(
    objective: tuning.RestToRest,
    result: tuning.TuningResult,
    certificates: dict[str, tuning.Certificate] | None = None,
    smoothing: Sequence[float] = (0.2, 0.05),
) -> Study:
    """Score the gains before and after with the hard sign; examine those after, unless `smoothing` has no widths (rad/s)."""
    task = objective.task
    scoring = SCORING | {"torque_limit": task.torque_limit, "throw": False}
    pairs = {"before": result.initial_gains, "after": result.gains}
    return Study(
        robot=task.robot,
        slope=float(task.slope),
        travel=float(task.travel),
        objective=objective,
        result=result,
        scored={name: js.rest_to_rest(task.robot, task.slope, each, task.travel, **scoring) for name, each in pairs.items()},
        certificates=certificates or {},
        health=tuning.check_gradient(objective, result.gains) if smoothing else None,
        audit=tuning.audit_sign(objective, result.gains, smoothing) if smoothing else None,
        directions=tuning.stiff_and_sloppy(objective, result.gains) if smoothing else None,
    )


def certify(settings: PlanarTuning, unlike: Unlike, robot: js.Robot, gains: js.SlidingModeGains) -> tuning.Certificate:
    """Return the certificate of any gains on robots that a study with these settings has not seen."""
    return tuning.certify(
        gains,
        unlike.uncertainty(settings.slope),
        robot,
        count=unlike.samples,
        seed=settings.seed + 1_000_000,
        duration=unlike.within,
        travel=settings.travel,
        torque_limit=settings.torque_limit,
    )


def numbers(found: Study) -> dict[str, Any]:
    """Numbers of a study for metrics.json."""
    content: dict[str, Any] = {"gains": found.result.gains, **{name: figures(run) for name, run in found.scored.items()}}
    content["starts_within_2_percent"] = found.result.near_best()
    content |= {key: value._asdict() for key in ("health", "audit", "directions") if (value := getattr(found, key)) is not None}
    if found.certificates:
        content["certificate"] = {
            name: {key: value for key, value in one._asdict().items() if key != "settling_times"}
            for name, one in found.certificates.items()
        }
    return content


def sentences(found: Study) -> list[str]:
    """What a study says beyond its table, a sentence each."""
    said = []
    if found.health is not None:
        said.append(f"gradient: {found.health.verdict}")
    if found.audit is not None:
        said.append(
            f"hard sign: the ITAE changes by {100 * found.audit.gap:.1f} % from the widest smoothing, the torque "
            f"travels {found.audit.chatter[-1]:.0f} N m in {found.objective.duration:g} s of chattering (smoothed: "
            f"{found.audit.chatter[0]:.0f})"
        )
    if found.directions is not None:
        said.append(f"gains: {found.directions.sentence()}")
    said += [f"certificate, {name}: {one.sentence()}" for name, one in found.certificates.items()]
    return said
