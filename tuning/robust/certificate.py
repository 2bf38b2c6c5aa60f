"""Held-out certificate of gains: how often they fail on fresh samples, with an exact interval of the failure rate."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_scalar
from tuning.objectives.task_objective import SCORING, with_settings
from tuning.robust.scenarios import Uncertainty, drawn_fields, sample


class Certificate(NamedTuple):
    """How often gains failed on fresh samples, and the two-sided interval of the failure rate."""

    failures: int
    count: int
    excluded: int
    not_settled: int
    ended_early: int
    over_limits: int
    rate: float
    low: float
    high: float
    settling_times: np.ndarray  # s, (count,), infinite where not settled; where a line is followed, the time allowed for it

    def sentence(self) -> str:
        """Return one sentence for people."""
        return (
            f"{self.failures} of {self.count} samples failed ({100 * self.rate:.2f} %, 95 % interval {100 * self.low:.2f} to "
            f"{100 * self.high:.2f} %): {self.not_settled} not settled, {self.ended_early} ended early, {self.over_limits} "
            f"over the limits; {self.excluded} drawn robots could not hold their slope and were left out"
        )


def certify(
    gains: Any,
    uncertainty: Uncertainty,
    nominal: js.Robot | js.PlanarTask | js.SpatialTask | None = None,
    *,
    count: int = 2000,
    seed: int = 2000,
    confidence: float = 0.95,
    swing_limit: float = 0.5 * math.pi,
    lean_limit: float = 0.5 * math.pi,
    **settings: Any,
) -> Certificate:
    """Return how often the gains fail on fresh samples with the hard sign, a 1 kHz hold and the motor's limit.

    A sample fails when it has not settled (or not followed) within the duration, ended early, or swung (or leant) beyond its
    limit. The torque cannot break its limit: it is clipped.

    Args:
        gains: to certify.
        uncertainty: what is drawn.
        nominal: the modelled robot of a `PlanarTask`, or a task; `Robot()` by default.
        count: of the samples.
        seed: of the samples; use one that tuning did not.
        confidence: of the two-sided interval.
        swing_limit: rad, of |phi| in a `PlanarTask`; the horizontal by default.
        lean_limit: rad, of |theta - pi/2| in a `SpatialTask`.
        settings: fields of the task and of `Numerics`; 15 s by default, and 5 N m where no task is given.
    """
    require_scalar("swing_limit", swing_limit, above=0.0, unit="rad")
    require_scalar("lean_limit", lean_limit, above=0.0, unit="rad")
    task: Any = nominal
    if task is None or isinstance(task, js.Robot):
        task = js.PlanarTask(js.Robot() if task is None else task, torque_limit=5.0)
    planar = isinstance(task, js.PlanarTask)
    hard = SCORING | {"duration": 15.0} | ({"smoothing": 0.0} if planar else {}) | settings
    task, numerics = with_settings(task, js.Numerics(), hard)
    scenarios, excluded = sample(uncertainty, task, count, seed)
    drawn = {name: getattr(scenarios, name) for name in drawn_fields(scenarios)}
    numbers = jax.tree.map(lambda leaf: jnp.full((count,), leaf, float), gains)

    def lane(fields: dict[str, Any], gains: Any) -> tuple[Array, Any]:
        found = js.simulate(replace(task, **fields), gains, numerics, throw=False)
        return found.status, found.metrics

    status, metrics = jax.tree.map(np.asarray, js.batch(lane)(drawn, numbers))
    not_settled = status == js.Status.NOT_SETTLED
    early = ~np.isin(status, (int(js.Status.OK), int(js.Status.NOT_SETTLED)))
    if planar:
        beyond = np.maximum(np.abs(metrics.lowest_swing), np.abs(metrics.highest_swing)) > swing_limit
    else:
        beyond = metrics.peak_lean > lean_limit
    over = ~early & beyond
    failures = int(np.sum(not_settled | early | over))
    low, high = (float(bound) for bound in clopper_pearson(failures, count, confidence))
    return Certificate(
        failures=failures,
        count=count,
        excluded=excluded,
        not_settled=int(not_settled.sum()),
        ended_early=int(early.sum()),
        over_limits=int(over.sum()),
        rate=failures / count,
        low=low,
        high=high,
        settling_times=metrics.settling_time if planar else np.where(not_settled | early, np.inf, float(task.settled_after)),
    )


def clopper_pearson(failures: int, count: int, confidence: float = 0.95) -> tuple[Array, Array]:
    """Return the exact two-sided interval (lowest, highest) of a failure rate when `failures` of `count` samples failed."""
    require_scalar("confidence", confidence, above=0.0, below=1.0)
    require_scalar("count", count, above=0)
    if not 0 <= failures <= count:
        raise ValueError(f"failures = {failures} is not between 0 and count = {count}; type a whole number that is")
    tail = 0.5 * (1.0 - confidence)
    low = _beta_quantile(float(max(failures, 1)), count - failures + 1.0, tail)
    high = _beta_quantile(failures + 1.0, float(max(count - failures, 1)), 1.0 - tail)
    return jnp.where(failures == 0, 0.0, low), jnp.where(failures == count, 1.0, high)


def _beta_quantile(a: float, b: float, probability: float) -> Array:
    def halve(_: Any, interval: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = interval
        middle = 0.5 * (low + high)
        below = jax.scipy.special.betainc(a, b, middle) < probability
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, 60, halve, (jnp.zeros(()), jnp.ones(())))
    return 0.5 * (low + high)
