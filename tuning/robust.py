"""Gains for robots that are not exactly the modelled one: sampled scenarios and aggregates over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_choice, require_scalar
from jaxsphere.numerics import Real
from tuning.diagnosis import first_not_finite
from tuning.limits import Limits
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
    "worst".
    """

    objective: RestToRest
    scenarios: Scenarios
    aggregate: str = "mean"
    alpha: float = 0.9

    def values(self, gains: js.SlidingModeGains) -> Array:
        """Objective of every scenario, (count,)."""
        return self._each(lambda one: one(gains))

    def __call__(self, gains: js.SlidingModeGains) -> Array:
        """Aggregate of the objective over the scenarios."""
        return aggregate(self.values(gains), self.aggregate, self.alpha)

    def residuals(self, gains: js.SlidingModeGains) -> Array:
        """Residuals (count * m,) whose squares sum to the aggregate: those of every scenario times the root of its share.

        The shares of "cvar" and "worst" depend on the order of the values only, so their derivative is that of the aggregate.
        """
        every = self._each(lambda one: one.residuals(gains))
        values = jax.lax.stop_gradient(jnp.sum(every * every, axis=1))
        share = _shares(values, self.aggregate, self.alpha)
        return (jnp.sqrt(share)[:, None] * every).reshape(-1)

    def limits(self, gains: js.SlidingModeGains) -> Limits:
        """Worst of every hard limit over the scenarios; that of the swing and of the overshoot are soft here."""
        worst = jax.tree.map(jnp.max, self._each(lambda one: one.limits(gains)))
        return worst._replace(swing=jnp.zeros(()), overshoot=jnp.zeros(()))

    def stiffened(self, smoothing: Real, stiffness: Real) -> Robust:
        """Same scenarios, see `RestToRest.stiffened`."""
        return replace(self, objective=self.objective.stiffened(smoothing, stiffness))

    def check(self) -> None:
        """Raise ValueError unless every robot of the scenarios can hold its slope and the objective has terms."""
        require_choice("aggregate", self.aggregate, AGGREGATES)
        self.objective.check()
        holds = np.asarray(jax.vmap(js.equilibrium.can_hold)(self.scenarios.plant, self.scenarios.slope))
        if not holds.all():
            raise ValueError(
                f"scenarios: {int(np.sum(~holds))} of {holds.size} robots cannot hold their slope, the first is lane "
                f"{int(np.argmin(holds))}; type gentler slopes, or draw them with tuning.sample"
            )

    def explain(self, gains: js.SlidingModeGains) -> str:
        """Say which scenario is the first whose objective is not finite, and when and where it ceases to be."""
        values, series = jax.jit(lambda: self._each(lambda one: (one(gains), one.series(gains))))()
        lane = int(np.argmin(np.isfinite(values)))
        return first_not_finite(*jax.tree.map(lambda leaf: leaf[lane], series), lane=lane)

    def _each(self, function: Callable[[RestToRest], Any]) -> Any:
        return jax.vmap(lambda one: function(self._of(one)))(self.scenarios)

    def _of(self, scenario: Scenarios) -> RestToRest:
        return replace(self.objective, **scenario._asdict())


def aggregate(values: Array, how: str, alpha: float = 0.9) -> Array:
    """Mean, mean of the worst share 1 - alpha (CVaR; of at least one value), or largest of `values` (count,)."""
    return jnp.sum(_shares(values, how, alpha) * values)


def _shares(values: Array, how: str, alpha: float) -> Array:
    """Weight of each value in the aggregate, (count,); they sum to one."""
    require_choice("aggregate", how, AGGREGATES)
    count = values.shape[0]
    if how == "mean":
        return jnp.full((count,), 1.0 / count)
    require_scalar("alpha", alpha, above=0.0, below=1.0, or_equal=True)
    worst = 1 if how == "worst" else max(1, round((1.0 - alpha) * count))
    return jnp.zeros(count).at[jnp.argsort(values)[count - worst :]].set(1.0 / worst)
