"""Robots that are not exactly the modelled one: a batch of sampled tasks, and an objective's aggregate over them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.numerics import Real
from tuning.objectives.objective import members_of
from tuning.objectives.terms import first_not_finite

AGGREGATES = ("mean", "cvar", "worst")

Scenarios = js.PlanarTask | js.SpatialTask  # whose drawn fields have a leading axis


@dataclass(frozen=True)
class Uncertainty:
    """What varies, uniformly and independently.

    Attributes:
        relative: half-width per field of the robot, relative (an inertia's three moments share one factor).
        slope: lowest and highest, rad.
        swing: half-width of the initial swing about phi_0 of the modelled robot, rad; of a `PlanarTask` only, a `SpatialTask`
            starts at rest.
        known: whether the controller knows the drawn robot; otherwise it keeps the nominal one.
        delayed: probability that torques act one control period late.
        sensor_bias: half-widths on alpha, alpha', phi, phi'; of a `PlanarTask` only, a `SpatialTask` has exact sensors.
        margin: a drawn robot is excluded, and counted, unless its climbing bound is at least this far above its slope, rad.
    """

    relative: Mapping[str, float] = field(default_factory=dict)
    slope: tuple[float, float] = (math.radians(10.0), math.radians(10.0))
    swing: float = 0.0
    known: bool = True
    delayed: float = 0.0
    sensor_bias: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    margin: float = math.radians(1.5)


def sample(
    uncertainty: Uncertainty, nominal: js.Robot | js.PlanarTask | js.SpatialTask, count: int, seed: int
) -> tuple[Any, int]:
    """Return `count` admissible scenarios, and how many drawn ones were excluded on the way.

    Args:
        uncertainty: what varies.
        nominal: the modelled robot of a `PlanarTask`, or a task.
        count: how many.
        seed: of the draws.

    Returns:
        The task with a leading axis on its `drawn_fields`, and the number of excluded draws.

    Raises:
        ValueError: a field is no field of the robot, a width is not admissible, or hardly any draw is admissible.
    """
    task = js.PlanarTask(nominal) if isinstance(nominal, js.Robot) else nominal
    _check(uncertainty, task)
    require_count("count", count)
    keys = jax.random.split(jax.random.key(seed), 4 * count)
    drawn = jax.vmap(lambda key: _draw(uncertainty, task.robot, key))(keys)
    room = jax.vmap(js.climbing_bound)(drawn["plant"]) - jnp.abs(drawn["slope"])
    admissible = np.flatnonzero(np.asarray(room >= uncertainty.margin))
    if admissible.size < count:
        raise ValueError(
            f"slope = {uncertainty.slope} rad leaves {admissible.size} of {4 * count} drawn robots that hold it; "
            "type gentler slopes"
        )
    chosen = admissible[:count]
    fields = {name: jax.tree.map(lambda leaf: leaf[chosen], drawn[name]) for name in drawn_fields(task)}
    return replace(task, **fields), int(chosen[-1] + 1 - count)


def drawn_fields(task: Scenarios) -> tuple[str, ...]:
    """Return the names of the fields of a task that `sample` draws."""
    planar = ("initial_state", "sensor_bias") if isinstance(task, js.PlanarTask) else ()
    return ("robot", "plant", "slope", "delayed", *planar)


def _check(uncertainty: Uncertainty, task: Scenarios) -> None:
    for name, width in uncertainty.relative.items():
        require_choice("relative", name, tuple(name for name in js.Robot.__dataclass_fields__ if name != "friction"))
        require_scalar(f"relative[{name!r}]", width, above=0.0, below=1.0, or_equal=True)
    low, high = uncertainty.slope
    if not low <= high:
        raise ValueError(f"slope = {uncertainty.slope} rad is no range; type the lowest first")
    if isinstance(task, js.SpatialTask) and (uncertainty.swing or any(uncertainty.sensor_bias)):
        raise ValueError("swing and sensor_bias vary in a PlanarTask only; type zeros, or another task")


def _draw(uncertainty: Uncertainty, nominal: js.Robot, key: Array) -> dict[str, Any]:
    robot_key, slope_key, swing_key, delay_key, bias_key = jax.random.split(key, 5)
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
    return {
        "robot": robot,
        "plant": plant,
        "slope": slope,
        "initial_state": jnp.zeros(4).at[2].set(swing),
        "delayed": jax.random.uniform(delay_key) < uncertainty.delayed,
        "sensor_bias": jnp.array(uncertainty.sensor_bias) * jax.random.uniform(bias_key, (4,), minval=-1.0),
    }


@dataclass(frozen=True, eq=False)
class Robust:
    """Aggregate of an objective over scenarios, as a function of the gains.

    Attributes:
        objective: a `RestToRest` or a `FollowLine`; it gives everything that is not drawn.
        scenarios: of `sample`.
        aggregate: "mean", "cvar" (mean of the worst share 1 - alpha) or "worst".
        alpha: of "cvar".
    """

    objective: Any
    scenarios: Any
    aggregate: str = "mean"
    alpha: float = 0.9

    @property
    def largest_residual_gradient(self) -> float:
        """See `linearise`."""
        return members_of(self.objective).largest_residual_gradient

    def values(self, gains: Any) -> Float[Array, " count"]:
        """Return the objective of every scenario."""
        return self._each(lambda one: one(gains))

    def __call__(self, gains: Any) -> Float[Array, ""]:
        """Return the aggregate of the objective over the scenarios."""
        return aggregate(self.values(gains), self.aggregate, self.alpha)

    def residuals(self, gains: Any) -> Float[Array, " m"]:
        """Return residuals whose squares sum to the aggregate: those of every scenario times the root of its share.

        The shares of "cvar" and "worst" depend on the order of the values only, so their derivative is that of the aggregate.
        """
        every = self._each(lambda one: one.residuals(gains))
        values = jax.lax.stop_gradient(jnp.sum(every * every, axis=1))
        share = _shares(values, self.aggregate, self.alpha)
        return (jnp.sqrt(share)[:, None] * every).reshape(-1)

    def limits(self, gains: Any) -> Any:
        """Return the worst of every hard limit over the scenarios; the others are only penalised here."""
        return jax.tree.map(jnp.max, self._each(lambda one: one.limits(gains)))._replace(soft={})

    def stiffened(self, smoothing: Real, stiffness: Real) -> Robust:
        """Return the same scenarios, with the objective's penalties as in `RestToRest.stiffened`."""
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

    def explain(self, gains: Any) -> str:
        """Return a phrase that says in which scenario, when and where the objective ceases to be finite."""
        values, series = jax.jit(lambda: self._each(lambda one: (one(gains), one.series(gains))))()
        lane = int(np.argmin(np.isfinite(values)))
        return first_not_finite(jax.tree.map(lambda leaf: leaf[lane], series), lane=lane)

    def _each(self, function: Callable[[Any], Any]) -> Any:
        drawn = {name: getattr(self.scenarios, name) for name in drawn_fields(self.scenarios)}
        return jax.vmap(lambda fields: function(replace(self.objective, **fields)))(drawn)


def aggregate(values: Float[Array, " count"], how: str, alpha: float = 0.9) -> Float[Array, ""]:
    """Return the mean, the mean of the worst share 1 - alpha ("cvar", of at least one value), or the largest of `values`."""
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
