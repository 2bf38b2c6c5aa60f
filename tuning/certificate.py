"""Held-out certificate of gains: how often they fail on fresh samples, with an exact interval of the failure rate."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_scalar
from tuning.robust import Scenarios, Uncertainty, sample


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
    settling_times: np.ndarray  # s, (count,), infinite where not settled

    def sentence(self) -> str:
        """One sentence for people."""
        return (
            f"{self.failures} of {self.count} samples failed ({100 * self.rate:.2f} %, 95 % interval {100 * self.low:.2f} to "
            f"{100 * self.high:.2f} %): {self.not_settled} not settled, {self.ended_early} ended early, {self.over_limits} "
            f"over the limits; {self.excluded} drawn robots could not hold their slope and were left out"
        )


def certify(
    gains: js.SlidingModeGains,
    uncertainty: Uncertainty,
    nominal: js.Robot | None = None,
    *,
    count: int = 2000,
    seed: int = 2000,
    confidence: float = 0.95,
    swing_limit: float = 0.5 * math.pi,
    **task: Any,
) -> Certificate:
    """Count failures of the gains on fresh samples with the hard sign, a 1 kHz hold and the motor's limit.

    A sample fails when it has not settled to 2 % within the duration, ended early, or swung beyond `swing_limit`. The torque
    cannot break its limit: it is clipped.

    Args:
        gains: to certify. uncertainty, nominal: what is drawn. count, seed: of the samples; use a seed that tuning did not.
        confidence: of the two-sided interval. swing_limit: rad, of |phi|; the horizontal by default.
        task: as in `rest_to_rest`; 15 s and 5 N m by default.
    """
    require_scalar("swing_limit", swing_limit, above=0.0, unit="rad")
    nominal = js.Robot() if nominal is None else nominal
    scenarios, excluded = sample(uncertainty, nominal, count, seed)
    settings: dict[str, Any] = {"duration": 15.0, "dt": 1e-3, "smoothing": 0.0, "control_period": 1e-3, "torque_limit": 5.0}
    settings |= task
    numbers = jax.tree.map(lambda leaf: jnp.full((count,), leaf, float), gains)

    def lane(scenario: Scenarios, gains: js.SlidingModeGains) -> tuple[Array, Any]:
        robot, plant, slope, initial_state, late, bias = scenario
        options = settings | {"plant": plant, "initial_state": initial_state, "delayed": late, "sensor_bias": bias}
        found = js.rest_to_rest(robot, slope, gains, save_every=None, throw=False, **options)
        return found.status, found.metrics

    status, metrics = jax.tree.map(np.asarray, js.batch(lane)(scenarios, numbers))
    steepest = np.maximum(np.abs(metrics.lowest_swing), np.abs(metrics.highest_swing))
    not_settled = status == js.Status.NOT_SETTLED
    early = ~np.isin(status, (int(js.Status.OK), int(js.Status.NOT_SETTLED)))
    over = ~early & (steepest > swing_limit)
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
        settling_times=metrics.settling_time,
    )


def clopper_pearson(failures: int, count: int, confidence: float = 0.95) -> tuple[Array, Array]:
    """Exact two-sided interval (lowest, highest) of a failure rate of which `failures` of `count` samples were seen."""
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
