"""Objective of following lines with the spatial robot: a sum of squares of named residuals, one number to make small.

    objective(gains) = sum over the terms of weight x term,    term = mean over the lanes of the sum of its squared residuals

A term looks at every `save_every`-th step of a rollout; it is the mean over those instants, so that it does not depend on how
many there are. Every residual is smooth in the gains (a hinge only where its square is).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from jaxsphere.checks import require_count, require_scalar
from jaxsphere.controllers import references
from jaxsphere.models.spatial import contact
from jaxsphere.numerics import Real
from jaxsphere.simulation.host import check_time_grid
from tuning.objectives import terms
from tuning.objectives.limits import Limits
from tuning.objectives.line_terms import SPATIAL_BOUNDS, LineTerms, LineWeights, friction_angle
from tuning.objectives.task_objective import SCORING, TaskObjective, with_settings
from tuning.objectives.terms import Series, Term, linear_far_out

Components = tuple[Array, ...]

TABLE_4_START = (0.3, 0.1)  # m

# Whether a lane that ended early goes on paying for the terms distance ... effort.
_KEPT = (True, True, True, False, False)


@dataclass(frozen=True, eq=False, init=False)
class FollowLine(TaskObjective):
    """Objective of following lines through the origin, from Table 4's start by default, as a function of `TrackingGains`.

    Every field of `task` and `numerics` may be typed as a keyword. By default the controller is sampled every `dt`.

    Attributes:
        task: what the lanes share; its `settled_after` says from when on errors are late.
        numerics: of the rollouts; a term looks at what they save.
        speeds: v_f, m/s.
        starts: of the centre, m; every speed is followed from every start.
        lean_limit: rad, the spin axis may lean by this from upright, towards the singular attitude.
        friction_limit: coefficient of friction that rolling may need.
        weights: of the terms.
        hard_limits: whether a start of the search that ends early or breaks these limits is infeasible; penalised they are.
        largest_residual_gradient: see `linearise`; where the spin axis leans far, errors depend chaotically on the gains.
        extra: terms of the user's own, of one rollout's trajectory, averaged over the lanes.
        typical: gains that the term `prior` draws towards.
    """

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = SPATIAL_BOUNDS

    task: js.SpatialTask = js.SpatialTask(control_period=4e-3, settled_after=2.0)
    numerics: js.Numerics = js.Numerics(dt=4e-3, duration=4.0, save_every=5)
    speeds: tuple[float, ...] = (0.5,)
    starts: tuple[tuple[float, float], ...] = (TABLE_4_START,)
    lean_limit: Real = 0.75
    friction_limit: Real = 0.5
    weights: LineWeights = LineWeights()
    hard_limits: bool = False
    largest_residual_gradient: float = 3.0
    extra: tuple[Term, ...] = ()
    typical: js.TrackingGains = js.TrackingGains()

    def check(self) -> None:
        """Raise ValueError with one sentence when a setting is not admissible."""
        super().require_sound()
        if len(self.speeds) == 0:
            raise ValueError("speeds = () leaves nothing to follow; type at least one speed in m/s, e.g. (0.5,)")
        for speed in self.speeds:
            require_scalar("speeds", speed, unit="m/s")
        if np.ndim(self.starts) != 2 or np.shape(self.starts)[1] != 2 or not np.all(np.isfinite(self.starts)):
            raise ValueError(f"starts = {self.starts} are no positions; type pairs (x, y) in m, e.g. ((0.3, 0.1),)")
        require_count("save_every", self.numerics.save_every)
        check_time_grid(self.duration, self.numerics.dt, self.numerics.save_every)
        settled = self.task.settled_after
        require_scalar("settled_after", settled, above=0.0, below=self.duration, or_equal=True, unit="s")
        require_scalar("lean_limit", self.lean_limit, above=0.0, below=0.5 * math.pi, unit="rad")
        require_scalar("friction_limit", self.friction_limit, above=0.0)
        if not self.largest_residual_gradient > 0.0:
            raise ValueError(
                f"largest_residual_gradient = {self.largest_residual_gradient} is not admissible; type a positive number, or "
                "math.inf for no cap"
            )
        for name, weight in zip(self.weights._fields, self.weights, strict=True):
            require_scalar(f"weights.{name}", weight, above=0.0, or_equal=True)

    def require_sound(self) -> None:
        """See `check`."""
        self.check()

    def lane(self, speed: Real, start: tuple[Real, Real] = TABLE_4_START) -> js.SpatialTask:
        """Return the task of one lane: a line at `speed` (m/s) from a start at rest (x, y, m)."""
        reference = references.as_reference(references.line(speed))
        return replace(self.task, reference=reference, start_position=start, heading=0.25 * math.pi)

    def each(self, function: Callable[[js.SpatialTask], Any]) -> Any:
        """Return function(task) of every lane, speeds before starts, with a leading axis of lanes."""
        every = [(speed, *start) for speed, start in product(self.speeds, self.starts)]
        return jax.vmap(lambda speed, x, y: function(self.lane(speed, (x, y))))(*jnp.asarray(every, float).T)

    def rollout(self, gains: js.TrackingGains, speed: Real, start: tuple[Real, Real] = TABLE_4_START) -> js.Trajectory:
        """Return the rollout of one lane with these gains, saved at every look."""
        return self._run(self.lane(speed, start), gains)

    def residuals(self, gains: js.TrackingGains) -> Float[Array, " m"]:
        """Return the weighted residuals of all rollouts; the objective is the sum of their squares.

        Raises:
            ValueError: a setting is not admissible, or a term of the user's own returns no scalar.
        """
        self.check()

        def of_one(task: js.SpatialTask) -> Array:
            trajectory = self._run(task, gains)
            return terms.weighted_residuals(self.weights[:-1], self._moving(task, trajectory), self.extra, trajectory)

        moving = self.each(of_one)
        moving = moving.reshape(-1) / math.sqrt(moving.shape[0])
        if terms.is_off(self.weights.prior):
            return moving
        return jnp.concatenate([moving, jnp.sqrt(self.weights.prior) * self._prior(gains)])

    def terms(self, gains: js.TrackingGains) -> LineTerms:
        """Return every term, unweighted."""
        self.check()
        return self._averaged(gains, lambda task: [jnp.sum(x * x) for x in self._moving(task, self._run(task, gains))])

    def cost_so_far(self, gains: js.TrackingGains) -> Float[Array, " T"]:
        """Return the objective counted up to each look at the rollouts, without terms of the user's own."""
        self.check()

        def of_one(task: js.SpatialTask) -> Array:
            parts = self._moving(task, self._run(task, gains))
            return terms.weighted_sum(self.weights[:-1], [jnp.sum(x.reshape(len(x), -1) ** 2, axis=1) for x in parts])

        return jnp.cumsum(jnp.mean(self.each(of_one), axis=0)) + self.weights.prior * jnp.sum(self._prior(gains) ** 2)

    def streamed(self, gains: js.TrackingGains) -> LineTerms:
        """Return the terms, summed up inside rollouts that save nothing."""
        return self._averaged(gains, lambda task: self._streamed(task, gains))

    def limits(self, gains: js.TrackingGains) -> Limits:
        """Return by how much the worst lane exceeds the limits; zeros unless they are hard."""
        if not self.hard_limits:
            return Limits({"ended_early": jnp.zeros(())}, {})

        def of_one(task: js.SpatialTask) -> Limits:
            found = self._run(task, gains)
            acting = found.time < found.end_time - 0.5 * self.numerics.dt
            angle = friction_angle(self._contact(task, tuple(found.state.T), tuple(found.torque.T)))
            friction = jnp.max(jnp.where(acting, angle, 0.0)) / jnp.arctan(self.friction_limit) - 1.0
            soft = {"lean": found.metrics.peak_lean / self.lean_limit - 1.0, "friction": friction}
            return Limits({"ended_early": 1.0 - found.end_time / self.duration}, soft)

        return jax.tree.map(jnp.max, self.each(of_one))

    def figures(self, gains: js.TrackingGains) -> Float[Array, 3]:
        """Return late error (m), peak lean (rad) and effort ((N m)^2 s) of the worst lane, infinite unless every lane lasts.

        They are scored with a 1 kHz hold.
        """

        def of_one(task: js.SpatialTask) -> Array:
            task, numerics = with_settings(task, self.numerics, SCORING)
            found = js.simulate(task, gains, numerics, throw=False)
            three = jnp.stack([found.metrics.late_error, found.metrics.peak_lean, found.metrics.effort])
            lasts = (found.status == js.Status.OK) | (found.status == js.Status.NOT_SETTLED)
            return jnp.where(lasts, three, jnp.inf)

        return jnp.max(self.each(of_one), axis=0)

    def stiffened(self, smoothing: Real, stiffness: Real) -> FollowLine:
        """Return the same with the penalties of its limits times `stiffness`; the law has no sign for `smoothing` to smooth."""
        del smoothing
        hard = {name: getattr(self.weights, name) * stiffness for name in ("lean", "friction", "lost")}
        return replace(self, weights=self.weights._replace(**hard))

    def compromise(self, limit: Real, effort: Real) -> FollowLine:
        """Return the same with another limit of the lean (rad) and weight of the effort."""
        return replace(self, lean_limit=limit, weights=self.weights._replace(effort=effort))

    def series(self, gains: js.TrackingGains) -> Series:
        """Return all that the objective adds up."""
        lanes = [f"at {speed:g} m/s from {start} m" for speed, start in product(self.speeds, self.starts)]
        parts = self.each(lambda task: self._moving(task, self._run(task, gains)))
        moving = {
            f"{name} {lane}": part[row]
            for row, lane in enumerate(lanes)
            for name, part in zip(LineTerms._fields, parts, strict=False)
        }
        period = self.numerics.dt * (self.numerics.save_every or 1)
        return Series(period * jnp.arange(parts[0].shape[1]), moving, {"term prior": self._prior(gains)})

    def _run(self, task: js.SpatialTask, gains: js.TrackingGains) -> js.Trajectory:
        return js.simulate(task, gains, self.numerics, diagnostics=False, throw=False)

    def _averaged(self, gains: js.TrackingGains, moving: Callable[[js.SpatialTask], Any]) -> LineTerms:
        return LineTerms(*map(jnp.mean, self.each(moving)), prior=jnp.sum(self._prior(gains) ** 2))

    def _moving(self, task: js.SpatialTask, trajectory: js.Trajectory) -> Components:
        """Residuals of the terms distance ... lost of a saved rollout; the first axis of each is time."""
        time = trajectory.time
        alive = time < trajectory.end_time - 0.5 * self.numerics.dt
        states, torques = tuple(trajectory.state.T), tuple(trajectory.torque.T)
        groups = self._rates(task, states, torques, jnp.minimum(time, trajectory.end_time))
        # The state at the end is reached, not driven from: it weighs nothing.
        weights = [jnp.sqrt(weight).at[-1].set(0.0) for weight in self._time_weights(time)]
        # A lane that ended early keeps its error and its lean to the end; no forces act on it any more.
        weights = [weight * (alive | keeps) for weight, keeps in zip(weights, _KEPT, strict=True)]
        parts = [jnp.stack(group, axis=-1) * weight[:, None] for group, weight in zip(groups, weights, strict=True)]
        return (*parts, weights[0] * ~alive)

    def _streamed(self, task: js.SpatialTask, gains: js.TrackingGains) -> Components:
        """Terms distance ... lost of one lane, summed up inside the rollout, which saves nothing."""
        dt, every = self.numerics.dt, self.numerics.save_every or 1

        def add(total: Components, time: Array, state: Components, torque: Components, step: Array) -> Components:
            looked = (jnp.round(time / dt) % every == 0) & (step > 0.0)
            groups, weights = self._rates(task, state, torque, time), self._time_weights(time)
            return tuple(
                t + jnp.where(looked, w, 0.0) * _square(group) for t, w, group in zip(total, weights, groups, strict=True)
            )

        zero = jnp.zeros_like(jnp.asarray(task.slope, float))
        measure = js.Measure((zero,) * len(_KEPT), add, lambda total: total)
        trajectory = js.simulate(task, gains, replace(self.numerics, save_every=None), measure=measure)
        looks, first_late = self._looks
        passed = jnp.ceil(jnp.round(trajectory.end_time / dt) / every)
        left, left_late = (looks - passed) / looks, (looks - jnp.maximum(passed, first_late)) / (looks - first_late)
        last = self._rates(task, tuple(trajectory.state[-1]), (zero, zero), trajectory.end_time)
        rest = [left, left_late, left, zero, zero]
        moving = (t + w * _square(group) for t, w, group in zip(trajectory.metrics, rest, last, strict=True))
        return (*moving, left)

    @property
    def _looks(self) -> tuple[int, int]:
        """Number of looks at a rollout, and of the first late one."""
        period = self.numerics.dt * (self.numerics.save_every or 1)
        return round(self.duration / period), math.ceil(float(self.task.settled_after) / period - 1e-6)

    def _time_weights(self, time: Array) -> list[Array]:
        """Weights of the instants `time` in the terms distance ... effort, so that each is a mean over the looks."""
        looks, first_late = self._looks
        every = jnp.full_like(time, 1.0 / looks)
        start = (first_late * (self.numerics.save_every or 1) - 0.5) * self.numerics.dt
        return [every, jnp.where(time > start, 1.0 / (looks - first_late), 0.0), every, every, every]

    def _rates(self, task: js.SpatialTask, state: Components, torque: Components, time: Array) -> tuple[Components, ...]:
        """What the terms distance ... effort take the mean square of, at states of any shape."""
        x, y = task.reference(time).position
        error = 100.0 * (state[0] - x), 100.0 * (state[1] - y)
        lean = jnp.rad2deg(jnp.maximum(js.spatial.lean_from_upright(state) - self.lean_limit, 0.0))
        angle = friction_angle(self._contact(task, state, torque))
        steeper = jnp.rad2deg(jnp.maximum(angle - jnp.arctan(self.friction_limit), 0.0))
        return error, error, (linear_far_out(lean),), (linear_far_out(steeper),), torque

    def _contact(self, task: js.SpatialTask, state: Components, torque: Components) -> contact.Contact:
        return contact.contact(task.robot if task.plant is None else task.plant, task.slope, state, torque)

    def _prior(self, gains: js.TrackingGains) -> Array:
        return terms.prior(gains, self.typical, [leaf.name for leaf in fields(gains)])


def _square(group: Components) -> Array:
    return sum((x * x for x in group[1:]), group[0] * group[0])
