"""A tuning study of the planar controller: tune, score with the hard sign, examine the gradient, certify on fresh robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jaxsphere as js
import tuning
from experiments.fig4 import SCORING, figures
from jaxsphere.checks import require_count, require_scalar
from tuning.health import Audit, Directions, Health

if TYPE_CHECKING:
    from experiments.cli import TunePlanar


class Study(NamedTuple):
    """What a study found; `scored` and `certificates` are by the name of the gains, "before" and "after"."""

    robot: js.Robot
    slope: float
    travel: float
    objective: tuning.RestToRest  # of the modelled robot, last stage
    result: tuning.TuningResult
    scored: dict[str, js.Trajectory]
    certificates: dict[str, tuning.Certificate]
    health: Health | None
    audit: Audit | None
    directions: Directions | None

    @property
    def gains(self) -> dict[str, js.SlidingModeGains]:
        """Gains before and after."""
        return {"before": self.result.initial_gains, "after": self.result.gains}


def check(options: TunePlanar) -> tuple[js.Robot, js.SlidingModeGains]:
    """Robot and first gains of a study. Raises ValueError for an option that is not admissible."""
    settings, robot, initial = options.tuning, options.robot.make(), options.gains.make()
    for name in ("tracking_weight", "swing_weight", "torque_weight", "chatter_weight"):
        require_scalar(name, getattr(settings, name), above=0.0, or_equal=True)
    require_scalar("swing_limit_deg", settings.swing_limit_deg, above=0.0, unit="deg")
    require_scalar("slope_deg", settings.slope_deg, above=-90.0, below=90.0, unit="deg")
    require_scalar("scenarios", options.uncertainty.scenarios, above=0.0, or_equal=True)
    require_count("samples", options.uncertainty.samples)
    js.require_holdable(robot, math.radians(settings.slope_deg))
    return robot, initial


def study(options: TunePlanar) -> Study:
    """Run the study that the options describe. Raises ValueError as `check` and `tuning.tune` do."""
    robot, initial = check(options)
    settings, uncertain = options.tuning, options.uncertainty
    slope = math.radians(settings.slope_deg)
    nominal = tuning.RestToRest(
        robot,
        slope,
        settings.travel,
        settings.duration,
        settings.dt,
        settings.smoothing[0] if settings.smoothing else 0.0,
        settings.torque_limit,
        math.radians(settings.swing_limit_deg),
        weights=tuning.Weights(
            settings.tracking_weight, settings.swing_weight, settings.torque_weight, settings.chatter_weight
        ),
    )
    objective: Any = nominal
    uncertainty = uncertain.make(slope)
    if uncertain.scenarios:
        scenarios, _ = tuning.sample(uncertainty, robot, uncertain.scenarios, seed=settings.seed)
        objective = tuning.Robust(nominal, scenarios, uncertain.aggregate, uncertain.alpha)
    bounds = tuning.BOUNDS | (tuning.SEEKING_BOUNDS if initial.k_i else {})
    result = tuning.tune(
        tuning.Annealed(objective, settings.smoothing, settings.stiffness),
        initial,
        optimiser=settings.optimiser,
        iterations=settings.iterations,
        starts=settings.starts,
        bounds={name: ends for name, ends in bounds.items() if name not in settings.frozen},
        learning_rate=settings.learning_rate,
        seed=settings.seed,
        gradient=settings.gradient,
        frozen=settings.frozen,
        progress=settings.progress,
        checkpoint=options.checkpoint,
        resume=settings.resume,
    )
    gains = {"before": initial, "after": result.gains}
    certificates = {name: certify(options, each) for name, each in gains.items()} if uncertain.scenarios else {}
    last = nominal.stiffened(settings.smoothing[-1], settings.stiffness[-1])
    return examined(last, result, certificates, settings.smoothing if settings.examine else ())


def examined(
    objective: tuning.RestToRest,
    result: tuning.TuningResult,
    certificates: dict[str, tuning.Certificate] | None = None,
    smoothing: Sequence[float] = (0.2, 0.05),
) -> Study:
    """Score the gains before and after with the hard sign; examine those after, unless `smoothing` has no widths (rad/s)."""
    scoring = SCORING | {"torque_limit": objective.torque_limit, "throw": False}
    task = (objective.robot, objective.slope)
    pairs = {"before": result.initial_gains, "after": result.gains}
    return Study(
        robot=objective.robot,
        slope=float(objective.slope),
        travel=float(objective.travel),
        objective=objective,
        result=result,
        scored={name: js.rest_to_rest(*task, each, objective.travel, **scoring) for name, each in pairs.items()},
        certificates=certificates or {},
        health=tuning.check_gradient(objective, result.gains) if smoothing else None,
        audit=tuning.audit_sign(objective, result.gains, smoothing) if smoothing else None,
        directions=tuning.stiff_and_sloppy(objective, result.gains) if smoothing else None,
    )


def certify(options: TunePlanar, gains: js.SlidingModeGains) -> tuning.Certificate:
    """Certificate of any gains on robots that a study with these options has not seen."""
    settings, uncertain = options.tuning, options.uncertainty
    return tuning.certify(
        gains,
        uncertain.make(math.radians(settings.slope_deg)),
        options.robot.make(),
        count=uncertain.samples,
        seed=settings.seed + 1_000_000,
        duration=uncertain.within,
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
            f"hard sign: the tracking term changes by {100 * found.audit.gap:.1f} % from the widest smoothing, the torque "
            f"travels {found.audit.chatter[-1]:.0f} N m in {found.objective.duration:g} s of chattering (smoothed: "
            f"{found.audit.chatter[0]:.0f})"
        )
    if found.directions is not None:
        said.append(f"gains: {found.directions.sentence()}")
    said += [f"certificate, {name}: {one.sentence()}" for name, one in found.certificates.items()]
    return said
