"""Objective of following lines with the spatial robot: a sum of squares of named residuals, one number to make small.

    objective(gains) = sum over the terms of weight x term,    term = mean over the lanes of the sum of its squared residuals

A term looks at every `sample_every`-th step of a rollout; it is the mean over those instants, so that it does not depend on how
many there are. Every residual is smooth in the gains (a hinge only where its square is).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_count, require_scalar
from jaxsphere.controllers import references, tracking
from jaxsphere.models.spatial import contact
from jaxsphere.numerics import Real
from jaxsphere.simulation.host import check_time_grid
from jaxsphere.tasks.spatial import spatial_plant
from tuning.terms import Term, is_off, linear_far_out, require_terms, scalar_of

Components = tuple[Array, ...]

# Ranges for Latin-hypercube starts of a robot like set A with a motor of 5 N m.
SPATIAL_BOUNDS = {
    "k1": (4.0, 100.0),
    "k2": (4.0, 30.0),
    "k3": (1.0, 12.0),
    "k4": (1.5, 10.0),
    "axis_damping": (0.1, 0.8),
    "k_p": (300.0, 2000.0),
    "k_d": (25.0, 120.0),
    "a_max": (0.5, 2.0),
}

TABLE_4_START = (0.3, 0.1)  # m

# Whether a lane that ended early goes on paying for the terms distance ... effort.
_KEPT = (True, True, True, False, False)


class LineWeights(NamedTuple):
    """Weights of the terms of `FollowLine`; zero switches a term off."""

    distance: Real = 1.0
    late: Real = 10.0
    lean: Real = 6.0
    friction: Real = 0.1
    effort: Real = 0.0
    lost: Real = 1e4
    prior: Real = 0.1


class LineTerms(NamedTuple):
    """The unweighted terms, means over the lanes; every entry a scalar (as residuals: vectors whose squares sum to it)."""

    distance: Array  # cm^2: mean square of the distance from the reference
    late: Array  # cm^2: the same from settled_after on
    lean: Array  # mean of the lean's excess over lean_limit in degrees, squared up to 1, linear beyond
    friction: Array  # mean of the excess of the friction angle needed over friction_limit's in degrees, likewise
    effort: Array  # (N m)^2: mean of the sum of the squared torques
    lost: Array  # share of the duration after an early end
    prior: Array  # sum of the squared logarithms of the gains over those of `typical`: it decides what nothing else does


@dataclass(frozen=True, eq=False)
class FollowLine:
    """Objective of following lines, from Table 4's start by default, as a function of `TrackingGains`.

    slope: rad. speeds: v_f, m/s. starts: of the centre, m; every speed is followed from every start. duration, dt: s; the
    controller is sampled every dt. torque_limit: N m. lean_limit: rad by which the spin axis may lean from the slope, towards
    the singular attitude. friction_limit: coefficient of friction that rolling may need. settled_after: s, from when on errors
    are late. sample_every: steps between two looks at a rollout. steepest: see `quadratic`; where the spin axis leans far,
    errors depend chaotically on the gains. extra: terms of the user's own, of one rollout's trajectory, averaged over the
    lanes. typical: the gains that the term `prior` draws towards. plant: the true robot, where it differs.
    """

    robot: js.Robot = field(default_factory=js.Robot)
    slope: Real = 0.17453292519943295  # 10 degrees
    speeds: tuple[float, ...] = (0.5,)
    duration: float = 4.0
    dt: float = 4e-3
    torque_limit: float | None = 5.0
    weights: LineWeights = LineWeights()
    lean_limit: Real = 0.75
    friction_limit: Real = 0.5
    starts: tuple[tuple[float, float], ...] = (TABLE_4_START,)
    settled_after: float = 2.0
    sample_every: int = 5
    steepest: float = 3.0
    extra: tuple[Term, ...] = ()
    typical: js.TrackingGains = field(default_factory=js.TrackingGains)
    plant: js.Robot | None = None

    def check(self) -> None:
        """Raise ValueError with one sentence when a setting is not admissible."""
        require_terms(self.weights, self.extra)
        if len(self.speeds) == 0:
            raise ValueError("speeds = () leaves nothing to follow; type at least one speed in m/s, e.g. (0.5,)")
        for speed in self.speeds:
            require_scalar("speeds", speed, unit="m/s")
        if np.ndim(self.starts) != 2 or np.shape(self.starts)[1] != 2 or not np.all(np.isfinite(self.starts)):
            raise ValueError(f"starts = {self.starts} are no positions; type pairs (x, y) in m, e.g. ((0.3, 0.1),)")
        require_count("sample_every", self.sample_every)
        check_time_grid(self.duration, self.dt, self.sample_every)
        require_scalar("settled_after", self.settled_after, above=0.0, below=self.duration, or_equal=True, unit="s")
        require_scalar("lean_limit", self.lean_limit, above=0.0, below=0.5 * math.pi, unit="rad")
        require_scalar("friction_limit", self.friction_limit, above=0.0)
        if not self.steepest > 0.0:
            raise ValueError(f"steepest = {self.steepest} is not admissible; type a positive number, or math.inf for no cap")
        for name, weight in zip(self.weights._fields, self.weights, strict=True):
            require_scalar(f"weights.{name}", weight, above=0.0, or_equal=True)

    def rollout(self, gains: js.TrackingGains, speed: Real, start: tuple[Real, Real] = TABLE_4_START) -> js.Trajectory:
        """Roll out one speed with these gains, saved at every look."""
        task = (self.robot, self.slope, gains, speed)
        options = {"plant": self.plant, "control_period": self.dt, "save_every": self.sample_every, "throw": False}
        return js.track_line(*task, duration=self.duration, dt=self.dt, torque_limit=self.torque_limit, start=start, **options)

    def residuals(self, gains: js.TrackingGains) -> Array:
        """Weighted residuals (m,) of all rollouts; the objective is the sum of their squares.

        Raises:
            ValueError: a setting is not admissible, or a term of the user's own returns no scalar.
        """
        self.check()

        def of_one(speed: Array, x: Array, y: Array) -> Array:
            trajectory = self.rollout(gains, speed, (x, y))
            parts = zip(self.weights, self._moving(trajectory, speed), strict=False)
            own = [jnp.sqrt(term.weight) * scalar_of(term, trajectory)[None] for term in self.extra]
            return jnp.concatenate([*(jnp.sqrt(w) * part.reshape(-1) for w, part in parts if not is_off(w)), *own])

        moving = jax.vmap(of_one)(*self._lanes)
        moving = moving.reshape(-1) / math.sqrt(moving.shape[0])
        if is_off(self.weights.prior):
            return moving
        return jnp.concatenate([moving, jnp.sqrt(self.weights.prior) * self._prior(gains)])

    def terms(self, gains: js.TrackingGains) -> LineTerms:
        """Evaluate every term, unweighted."""
        self.check()

        def of_one(speed: Array, x: Array, y: Array) -> tuple[Array, ...]:
            return tuple(jnp.sum(part * part) for part in self._moving(self.rollout(gains, speed, (x, y)), speed))

        moving = jax.vmap(of_one)(*self._lanes)
        prior = self._prior(gains)
        distance, late, lean, friction, effort, lost = (jnp.mean(term) for term in moving)
        return LineTerms(distance, late, lean, friction, effort, lost, jnp.sum(prior * prior))

    def __call__(self, gains: js.TrackingGains) -> Array:
        """Weighted sum of the terms. Its forward gradient needs no memory in the horizon, but for terms of the user's own."""
        if self.extra:
            residuals = self.residuals(gains)
            return jnp.sum(residuals * residuals)
        self.check()
        moving = jax.vmap(partial(self._streamed, gains))(*self._lanes)
        prior = self._prior(gains)
        terms = (*(jnp.mean(term) for term in moving), jnp.sum(prior * prior))
        return sum((w * term for w, term in zip(self.weights, terms, strict=True)), jnp.zeros(()))

    def explain(self, gains: js.TrackingGains) -> str:
        """Say which lane, when and what is not finite at these gains, or how the lanes ended."""
        told = []
        for speed, start in product(self.speeds, self.starts):
            found = self.rollout(gains, speed, start)
            for name, values in zip(LineTerms._fields, self._moving(found, jnp.asarray(speed)), strict=False):
                bad = ~np.isfinite(np.asarray(values).reshape(len(np.asarray(values)), -1)).all(axis=-1)
                if bad.any():
                    told.append(
                        f"{speed:g} m/s from {start} m: {name} is not finite at {float(found.time[int(np.argmax(bad))]):g} s"
                    )
        return "; ".join(told) or "every rollout is finite, its derivatives are not"

    def _moving(self, trajectory: js.Trajectory, speed: Array) -> tuple[Array, ...]:
        """Residuals of the terms distance ... lost of a saved rollout; the first axis of each is time."""
        time = trajectory.time
        alive = time < trajectory.end_time - 0.5 * self.dt
        groups = self._rates(
            tuple(trajectory.state.T), tuple(trajectory.torque.T), jnp.minimum(time, trajectory.end_time), speed
        )
        # The state at the end is reached, not driven from: it weighs nothing.
        weights = [jnp.sqrt(weight).at[-1].set(0.0) for weight in self._time_weights(time)]
        # A lane that ended early keeps its error and its lean to the end; no forces act on it any more.
        weights = [weight * (alive | keeps) for weight, keeps in zip(weights, _KEPT, strict=True)]
        parts = [jnp.stack(group, axis=-1) * weight[:, None] for group, weight in zip(groups, weights, strict=True)]
        return (*parts, weights[0] * ~alive)

    def _streamed(self, gains: js.TrackingGains, speed: Array, x: Array, y: Array) -> tuple[Array, ...]:
        """Terms distance ... lost of one lane, summed up inside the rollout, which saves nothing."""
        reference = references.line(speed)
        state = tuple(jnp.asarray(x, float) for x in tracking.resting_state(self.robot, self.slope, (x, y)))
        zero = jnp.zeros_like(state[0])

        def add(total: tuple[Array, ...], time: Array, state: Components, torque: Components, dt: Array) -> tuple[Array, ...]:
            looked = (jnp.round(time / self.dt) % self.sample_every == 0) & (dt > 0.0)
            groups, weights = self._rates(state, torque, time, speed), self._time_weights(time)
            return tuple(
                t + jnp.where(looked, w, 0.0) * _square(group) for t, w, group in zip(total, weights, groups, strict=True)
            )

        trajectory = js.rollout(
            spatial_plant(self._true_robot, jnp.asarray(self.slope)),
            tracking.law(self.robot, self.slope, gains, reference),
            state,
            dt=jnp.asarray(self.dt),
            steps=round(self.duration / self.dt),
            save_every=None,
            hold=jnp.int32(1),
            torque_limit=None if self.torque_limit is None else jnp.asarray(self.torque_limit),
            measure=js.Measure((zero,) * len(_KEPT), add, lambda total: total),
        )
        looks, first_late = self._looks
        passed = jnp.ceil(jnp.round(trajectory.end_time / self.dt) / self.sample_every)
        left, left_late = (looks - passed) / looks, (looks - jnp.maximum(passed, first_late)) / (looks - first_late)
        last = self._rates(tuple(trajectory.state[-1]), (zero, zero), trajectory.end_time, speed)
        rest = [left, left_late, left, zero, zero]
        moving = (t + w * _square(group) for t, w, group in zip(trajectory.metrics, rest, last, strict=True))
        return (*moving, left)

    @property
    def _lanes(self) -> tuple[Array, Array, Array]:
        """Speed, x and y of the start of every rollout, (lanes,) each."""
        every = [(speed, *start) for speed, start in product(self.speeds, self.starts)]
        speed, x, y = jnp.asarray(every, float).T
        return speed, x, y

    @property
    def _true_robot(self) -> js.Robot:
        return self.robot if self.plant is None else self.plant

    @property
    def _looks(self) -> tuple[int, int]:
        """Number of looks at a rollout, and of the first late one."""
        period = self.dt * self.sample_every
        return round(self.duration / period), math.ceil(self.settled_after / period - 1e-6)

    def _time_weights(self, time: Array) -> list[Array]:
        """Weights of the instants `time` in the terms distance ... effort, so that each is a mean over the looks."""
        looks, first_late = self._looks
        every = jnp.full_like(time, 1.0 / looks)
        late = jnp.where(time > (first_late * self.sample_every - 0.5) * self.dt, 1.0 / (looks - first_late), 0.0)
        return [every, late, every, every, every]

    def _rates(self, state: Components, torque: Components, time: Array, speed: Array) -> tuple[Components, ...]:
        """What the terms distance ... effort take the mean square of, at states of any shape."""
        x, y = references.line(speed)(time).position
        error = 100.0 * (state[0] - x), 100.0 * (state[1] - y)
        lean = jnp.rad2deg(jnp.maximum(jnp.abs(state[3] - 0.5 * jnp.pi) - self.lean_limit, 0.0))
        forces = contact.contact(self._true_robot, self.slope, state, torque)
        steeper = jnp.rad2deg(jnp.maximum(friction_angle(forces) - jnp.arctan(self.friction_limit), 0.0))
        return error, error, (linear_far_out(lean),), (linear_far_out(steeper),), torque

    def _prior(self, gains: js.TrackingGains) -> Array:
        names = [leaf.name for leaf in fields(gains)]
        return jnp.stack([jnp.log(getattr(gains, name) / getattr(self.typical, name)) for name in names])


def friction_angle(forces: contact.Contact) -> Array:
    """Angle (rad) between the force of the slope on the sphere and the normal: the arctangent of the friction coefficient.

    Past a quarter turn the sphere would leave the slope; there the coefficient is infinite, the angle stays smooth.
    """
    along, across = forces.friction
    square = along * along + across * across
    slipping = square > 0.0
    return jnp.where(slipping, jnp.arctan2(jnp.sqrt(jnp.where(slipping, square, 1.0)), forces.normal), 0.0)


def _square(group: Components) -> Array:
    return sum((x * x for x in group[1:]), group[0] * group[0])
