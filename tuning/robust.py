"""Gains for robots that are not exactly the modelled one: sampled scenarios, aggregates and a held-out certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_choice, require_scalar
from jaxsphere.simulation.lanes import over_lanes
from tuning.objectives import RestToRest

AGGREGATES = ("mean", "cvar", "worst")
MASSES = ("shell_mass", "gimbal_mass", "pendulum_mass")
INERTIAS = ("shell_inertia", "gimbal_inertia")


@dataclass(frozen=True)
class Uncertainty:
    """What varies, uniformly and independently.

    relative: half-width per field of the robot, relative (an inertia's three moments share one factor). slope: lowest and
    highest, rad. swing: half-width of the initial swing about phi_0 of the modelled robot, rad. known: whether the controller
    knows the drawn robot; otherwise it keeps the nominal one. late: probability of a delay by one control period.
    sensor_bias: half-widths on alpha, alpha', phi, phi'. margin: a drawn robot is excluded, and counted, unless its climbing
    bound is at least this far above its slope, rad.
    """

    relative: Mapping[str, float] = field(default_factory=dict)
    slope: tuple[float, float] = (0.17453292519943295, 0.17453292519943295)
    swing: float = 0.0
    known: bool = True
    late: float = 0.0
    sensor_bias: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    margin: float = 0.02617993877991494  # 1.5 degrees


class Scenarios(NamedTuple):
    """A batch of fields of `RestToRest`; every leaf has a leading axis."""

    robot: js.Robot
    plant: js.Robot
    slope: Array
    initial_state: Array
    late: Array
    sensor_bias: Array


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


def sample(uncertainty: Uncertainty, nominal: js.Robot, count: int, seed: int) -> tuple[Scenarios, int]:
    """Draw `count` admissible scenarios, and tell how many drawn ones were excluded on the way.

    Raises:
        ValueError: a field is no field of the robot, a width is not admissible, or hardly any draw is admissible.
    """
    _check(uncertainty)
    require_scalar("count", count, above=0)
    drawn = jax.vmap(lambda key: _draw(uncertainty, nominal, key))(jax.random.split(jax.random.key(seed), 4 * count))
    room = jax.vmap(js.climbing_bound)(drawn.plant) - jnp.abs(drawn.slope)
    admissible = np.flatnonzero(np.asarray(room >= uncertainty.margin))
    if admissible.size < count:
        raise ValueError(
            f"slope = {uncertainty.slope} rad leaves {admissible.size} of {4 * count} drawn robots that hold it; "
            "type gentler slopes"
        )
    chosen = admissible[:count]
    return jax.tree.map(lambda leaf: leaf[chosen], drawn), int(chosen[-1] + 1 - count)


def _check(uncertainty: Uncertainty) -> None:
    known = js.Robot.__dataclass_fields__
    for name, width in uncertainty.relative.items():
        require_choice("relative", name, tuple(known))
        require_scalar(f"relative[{name!r}]", width, above=0.0, below=1.0, or_equal=True)
    low, high = uncertainty.slope
    if not low <= high:
        raise ValueError(f"slope = {uncertainty.slope} rad is no range; type the lowest first")


def _draw(uncertainty: Uncertainty, nominal: js.Robot, key: Array) -> Scenarios:
    robot_key, slope_key, swing_key, late_key, bias_key = jax.random.split(key, 5)
    factors = jax.random.uniform(robot_key, (len(uncertainty.relative),), minval=-1.0)
    varied = {
        name: jnp.asarray(getattr(nominal, name)) * (1.0 + width * factor)
        for (name, width), factor in zip(uncertainty.relative.items(), factors, strict=True)
    }
    plant = jax.tree.map(jnp.asarray, replace(nominal, **varied))
    robot = plant if uncertainty.known else jax.tree.map(jnp.asarray, nominal)
    low, high = uncertainty.slope
    slope = low + (high - low) * jax.random.uniform(slope_key)
    swing = js.equilibrium_swing(robot, slope) + uncertainty.swing * jax.random.uniform(swing_key, minval=-1.0)
    return Scenarios(
        robot=robot,
        plant=plant,
        slope=slope,
        initial_state=jnp.zeros(4).at[2].set(swing),
        late=jax.random.uniform(late_key) < uncertainty.late,
        sensor_bias=jnp.array(uncertainty.sensor_bias) * jax.random.uniform(bias_key, (4,), minval=-1.0),
    )


@dataclass(frozen=True, eq=False)
class Robust:
    """Aggregate of an objective over scenarios, as a function of the gains.

    objective: gives everything that the scenarios do not. aggregate: "mean", "cvar" (mean of the worst share 1 - alpha) or
    "worst". Only the mean has residuals.
    """

    objective: RestToRest
    scenarios: Scenarios
    aggregate: str = "mean"
    alpha: float = 0.9

    def values(self, gains: js.SlidingModeGains) -> Array:
        """Objective of every scenario, (count,)."""
        return jax.vmap(lambda one: self._of(one)(gains))(self.scenarios)

    def __call__(self, gains: js.SlidingModeGains) -> Array:
        """Aggregate of the objective over the scenarios."""
        return aggregate(self.values(gains), self.aggregate, self.alpha)

    def residuals(self, gains: js.SlidingModeGains) -> Array:
        """Residuals of the mean: those of every scenario, divided by the root of their number."""
        if self.aggregate != "mean":
            raise ValueError(f"aggregate = {self.aggregate!r} is no sum of squares; type optimiser='lbfgs' or aggregate='mean'")
        every = jax.vmap(lambda one: self._of(one).residuals(gains))(self.scenarios)
        return every.reshape(-1) / jnp.sqrt(every.shape[0])

    def _of(self, scenario: Scenarios) -> RestToRest:
        return replace(self.objective, **scenario._asdict())


def aggregate(values: Array, how: str, alpha: float = 0.9) -> Array:
    """Mean, mean of the worst share 1 - alpha (CVaR; of at least one value), or largest of `values` (count,)."""
    require_choice("aggregate", how, AGGREGATES)
    if how == "mean":
        return jnp.mean(values)
    require_scalar("alpha", alpha, above=0.0, below=1.0, or_equal=True)
    worst = 1 if how == "worst" else max(1, round((1.0 - alpha) * values.shape[0]))
    return jnp.mean(jnp.sort(values)[-worst:])


def certify(
    gains: js.SlidingModeGains,
    uncertainty: Uncertainty,
    nominal: js.Robot | None = None,
    *,
    count: int = 2000,
    seed: int = 2000,
    confidence: float = 0.95,
    **task: Any,
) -> Certificate:
    """Count failures of the gains on fresh samples with the hard sign, a 1 kHz hold and the motor's limit.

    A sample fails when it has not settled to 2 % within the duration, ended early, or swung the pendulum above the horizontal.

    Args:
        gains: to certify. uncertainty, nominal: what is drawn. count, seed: of the samples; use a seed that tuning did not.
        confidence: of the two-sided interval. task: as in `rest_to_rest`; 15 s and 5 N m by default.
    """
    nominal = js.Robot() if nominal is None else nominal
    scenarios, excluded = sample(uncertainty, nominal, count, seed)
    settings: dict[str, Any] = {"duration": 15.0, "dt": 1e-3, "smoothing": 0.0, "control_period": 1e-3, "torque_limit": 5.0}
    settings |= task
    numbers = jax.tree.map(lambda leaf: jnp.full((count,), leaf, float), gains)

    def lane(scenario: Scenarios, gains: js.SlidingModeGains) -> tuple[Array, Any]:
        robot, plant, slope, initial_state, late, bias = scenario
        options = settings | {"plant": plant, "initial_state": initial_state, "late": late, "sensor_bias": bias}
        found = js.rest_to_rest(robot, slope, gains, save_every=None, throw=False, **options)
        return found.status, found.metrics

    status, metrics = jax.tree.map(np.asarray, over_lanes(lane)(scenarios, numbers))
    steepest = np.maximum(np.abs(metrics.lowest_swing), np.abs(metrics.highest_swing))
    not_settled = status == js.Status.NOT_SETTLED
    early = ~np.isin(status, (int(js.Status.OK), int(js.Status.NOT_SETTLED)))
    over = ~early & (steepest > 0.5 * np.pi)
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
