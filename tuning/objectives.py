"""Objective of a move from rest to rest: a sum of squares of named, smooth residuals, one number to make small.

    objective(gains) = sum over the terms of weight x term,    term = sum of the squares of its residuals

Every residual is smooth in the gains (a hinge only where its square is), so that second-order optimisers can use it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.checks import is_concrete
from jaxsphere.controllers import sliding_mode
from jaxsphere.models import planar
from jaxsphere.numerics import Real
from jaxsphere.tasks.metrics import SETTLING_BAND
from jaxsphere.tasks.planar import PlanarTask, planar_plant
from tuning.diagnosis import first_not_finite
from tuning.limits import Limits
from tuning.stability import hurwitz_margins
from tuning.terms import Term, is_off, linear_far_out, require_terms, scalar_of

Sums = tuple[Array, ...]

# Ranges for Latin-hypercube starts of a robot like set A; within them 4 ms and 8 ms of hold keep the smoothed switching stable.
BOUNDS = {"c1": (0.2, 1.5), "c2": (1.0, 8.0), "z_u": (0.2, 0.98), "phi_z": (2.0, 20.0), "eta": (0.5, 10.0), "k": (0.2, 10.0)}

# The equilibrium-seeking gain, where it is used at all.
SEEKING_BOUNDS = {"k_i": (0.005, 0.3)}

# Widths of the smooth |e| and of the smooth step into the settling band, of the travel.
_TRACKING_WIDTH = 1e-3
_SETTLING_WIDTH = 4e-3
# Margins below these are penalised: of the divisor of (12) and of Routh's column.
_LEAST_NONSINGULARITY = 0.2
_LEAST_HURWITZ = 0.1


class Weights(NamedTuple):
    """Weights of the terms of `RestToRest`; zero switches a term off."""

    tracking: Real = 1.0
    swing: Real = 1.0
    torque: Real = 1e-3
    chatter: Real = 0.5
    settling: Real = 0.0
    overshoot: Real = 1.0
    singularity: Real = 100.0
    stability: Real = 100.0
    prior: Real = 0.03


class Terms(NamedTuple):
    """The unweighted terms of one rollout; every entry a scalar (as residuals: vectors whose squares sum to it)."""

    tracking: Array  # s^2: integral of t |e| / travel, |e| rounded off below 1e-3 of the travel
    swing: Array  # s: integral of the excess of |phi - phi_0| over swing_limit in degrees, squared up to 1, linear beyond
    torque: Array  # (N m)^2 s: integral of tau^2
    chatter: Array  # (N m)^2: mean square of the torque step eta / decoupling that the hard sign switches by
    settling: Array  # s: integral of a smooth step that is 1 outside the 2 % band and 0 inside
    overshoot: Array  # s: integral of the excess of e over overshoot_limit in % of the travel, likewise
    singularity: Array  # squared shortfall of the nonsingularity margin below 0.2, of 0.2
    stability: Array  # sum of the squared shortfalls of the Hurwitz margins below 0.1, of 0.1
    prior: Array  # sum of the squared logarithms of c1 ... k over those of `typical`: it decides what nothing else does


@dataclass(frozen=True, eq=False)
class RestToRest:
    """Objective of a move from rest to rest, as a function of `SlidingModeGains`.

    robot: the one the controller believes in. slope: rad. travel: rad. duration, dt: s; the controller is sampled every dt
    unless `continuous`. smoothing: epsilon of the switching term, rad/s, positive for a useful gradient with respect to eta.
    torque_limit: N m. swing_limit: rad, |phi - phi_0| above it is penalised. overshoot_limit: of the travel. extra: terms of
    the user's own. plant, initial_state, late, sensor_bias: as in `rest_to_rest`. typical: the gains that the term `prior`
    draws towards.
    """

    robot: js.Robot = field(default_factory=js.Robot)
    slope: Real = 0.17453292519943295  # 10 degrees
    travel: Real = 10.0
    duration: float = 8.0
    dt: float = 8e-3
    smoothing: Real = 0.2
    torque_limit: float | None = 5.0
    swing_limit: Real = 0.3490658503988659  # 20 degrees
    weights: Weights = Weights()
    method: str = "rk4"
    overshoot_limit: float = 0.01
    extra: tuple[Term, ...] = ()
    continuous: bool = False
    plant: js.Robot | None = None
    initial_state: Array | None = None
    late: Array | None = None
    sensor_bias: Array | None = None
    typical: js.SlidingModeGains = field(default_factory=lambda: js.SlidingModeGains(z_u=0.35))

    def rollout(self, gains: js.SlidingModeGains) -> js.Trajectory:
        """Roll out the task with these gains."""
        return js.rest_to_rest(
            self.robot,
            self.slope,
            gains,
            self.travel,
            self.duration,
            self.dt,
            self.smoothing,
            self.torque_limit,
            plant=self.plant,
            initial_state=self.initial_state,
            control_period=None if self.continuous else self.dt,
            delayed=self.late,
            sensor_bias=self.sensor_bias,
            method=self.method,
            throw=False,
        )

    def residuals(self, gains: js.SlidingModeGains) -> Array:
        """Weighted residuals (m,) of one rollout; the objective is the sum of their squares.

        Raises:
            ValueError: there is no term with a weight, or a term of the user's own returns no scalar.
        """
        require_terms(self.weights, self.extra)
        trajectory = self.rollout(gains)
        parts = self._unweighted(gains, trajectory)
        weighted = [jnp.sqrt(w) * part for w, part in zip(self.weights, parts, strict=True) if not is_off(w)]
        own = [jnp.sqrt(term.weight) * scalar_of(term, trajectory)[None] for term in self.extra]
        return jnp.concatenate([*weighted, *own])

    def terms(self, gains: js.SlidingModeGains) -> Terms:
        """Evaluate every term of one rollout, unweighted."""
        return Terms(*(jnp.sum(part * part) for part in self._unweighted(gains, self.rollout(gains))))

    def cost_so_far(self, gains: js.SlidingModeGains) -> Array:
        """Objective counted up to each time of the rollout, (T,), without terms of the user's own."""
        parts = self._unweighted(gains, self.rollout(gains))
        moving = sum((w * part * part for w, part in zip(self.weights[:6], parts[:6], strict=True)), jnp.zeros(()))
        still = sum((w * jnp.sum(part * part) for w, part in zip(self.weights[6:], parts[6:], strict=True)), jnp.zeros(()))
        return jnp.cumsum(moving) + still

    def __call__(self, gains: js.SlidingModeGains) -> Array:
        """Weighted sum of the terms. Its forward gradient needs no memory in the horizon, but for terms of the user's own."""
        if self.extra:
            residuals = self.residuals(gains)
            return jnp.sum(residuals * residuals)
        require_terms(self.weights, self.extra)
        return sum((w * t for w, t in zip(self.weights, self._streamed(gains), strict=True)), jnp.zeros(()))

    def limits(self, gains: js.SlidingModeGains) -> Limits:
        """How far one rollout keeps from the hard limits."""
        trajectory = self.rollout(gains)
        measured = trajectory.metrics
        return Limits(
            ended_early=1.0 - trajectory.end_time / self.duration,
            singularity=-jnp.asarray(js.nonsingularity_margin(self.robot, gains)),
            stability=-jnp.min(hurwitz_margins(self.robot, self.slope, gains)),
            swing=measured.peak_swing / self.swing_limit - 1.0,
            overshoot=measured.overshoot - self.overshoot_limit,
        )

    def stiffened(self, smoothing: Real, stiffness: Real) -> RestToRest:
        """Same task with another smoothing (rad/s), and the penalties of its limits multiplied by `stiffness`."""
        hard = ("swing", "overshoot", "singularity", "stability")
        weights = self.weights._replace(**{name: getattr(self.weights, name) * stiffness for name in hard})
        return replace(self, smoothing=smoothing, weights=weights)

    def check(self) -> None:
        """Raise ValueError when there is no term, or the slope is past the bound of the robot."""
        require_terms(self.weights, self.extra)
        if is_concrete((self.robot, self.slope)):
            js.require_holdable(self.robot, self.slope)

    def explain(self, gains: js.SlidingModeGains) -> str:
        """Say when and where the objective ceases to be finite: lane, time and quantity."""
        return first_not_finite(*self.series(gains))

    def series(self, gains: js.SlidingModeGains) -> tuple[Array, dict[str, Array], dict[str, Array]]:
        """Time (T,), all that changes with it by name (T,), and the terms that no time belongs to."""
        trajectory = self.rollout(gains)
        parts = self._unweighted(gains, trajectory)._asdict()
        still = {f"term {name}": parts.pop(name) for name in Terms._fields[6:]}
        state = dict(zip(("sphere angle", "rate of the sphere", "swing", "rate of the swing"), trajectory.state.T, strict=True))
        end = trajectory.time == trajectory.time[-1]
        own = {term.name: jnp.where(end, scalar_of(term, trajectory), 0.0) for term in self.extra}
        return trajectory.time, state | {f"term {name}": part for name, part in (parts | own).items()}, still

    def _unweighted(self, gains: js.SlidingModeGains, trajectory: js.Trajectory) -> Terms:
        time = trajectory.time
        # The state at the end is reached, not driven from: it closes the last step and weighs nothing.
        step = jnp.full_like(time, self.dt).at[-1].set(0.0)
        rates = self._rates(gains, tuple(trajectory.state.T), trajectory.torque[:, 0])
        weight = (jnp.sqrt(step * time), *(jnp.sqrt(step),) * 5)
        return Terms(*(w * rate for w, rate in zip(weight, rates, strict=True)), *self._still(gains))

    def _streamed(self, gains: js.SlidingModeGains) -> Terms:
        """Terms summed up inside the rollout, which saves nothing."""
        equilibrium = js.equilibrium_swing(self.robot, self.slope)
        zero = jnp.zeros_like(equilibrium)
        state = (zero, zero, equilibrium, zero) if self.initial_state is None else tuple(self.initial_state)

        def add(total: Sums, time: Array, state: planar.State, torque: tuple[Array, ...], dt: Array) -> Sums:
            rates = self._rates(gains, state, torque[0])
            weight = (dt * time, *(dt,) * 5)
            return tuple(t + w * rate * rate for t, w, rate in zip(total, weight, rates, strict=False))

        law = PlanarTask(
            self.robot,
            self.slope,
            self.travel,
            initial_state=self.initial_state,
            smoothing=self.smoothing,
            sensor_bias=self.sensor_bias,
        ).law(gains)
        steps = round(self.duration / self.dt)
        trajectory = js.rollout(
            planar_plant(
                self.robot if self.plant is None else self.plant, jnp.asarray(self.slope), state[0], jnp.asarray(self.travel)
            ),
            law,
            state,
            (zero,),
            dt=jnp.asarray(self.dt),
            steps=steps,
            save_every=None,
            hold=None if self.continuous else jnp.int32(1),
            delayed=self.late,
            torque_limit=None if self.torque_limit is None else jnp.asarray(self.torque_limit),
            measure=js.Measure((zero,) * 6, add, lambda total: total),
            method=self.method,
        )
        # A lane that ended early pays for the rest of the time where it stands.
        last = self._rates(gains, tuple(trajectory.state[-1]), zero)
        still = self._still(gains)
        done = jnp.round(trajectory.end_time / self.dt)
        left = self.dt * (steps - done)
        left_time = 0.5 * self.dt**2 * (steps * (steps - 1) - done * (done - 1.0))
        rest = (left_time, *(left,) * 5)
        moving = (t + w * rate * rate for t, w, rate in zip(trajectory.metrics, rest, last, strict=True))
        return Terms(*moving, *(jnp.sum(part * part) for part in still))

    def _rates(self, gains: js.SlidingModeGains, state: planar.State, torque: Array) -> Sums:
        """Roots of what the terms tracking ... overshoot integrate, at states of any shape."""
        alpha, _, swing, _ = state
        start = 0.0 if self.initial_state is None else self.initial_state[0]
        equilibrium = js.equilibrium_swing(self.robot, self.slope)
        error = (alpha - start) / self.travel - 1.0
        size = jnp.sqrt(error * error + _TRACKING_WIDTH**2)
        excess = jnp.rad2deg(jnp.maximum(jnp.abs(swing - equilibrium) - self.swing_limit, 0.0))
        now = sliding_mode.signals(
            planar.lump(self.robot, self.slope),
            equilibrium,
            gains,
            state,
            jnp.zeros_like(alpha),
            start + self.travel,
            self.smoothing,
        )
        return (
            error / jnp.sqrt(size + _TRACKING_WIDTH),
            linear_far_out(excess),
            torque,
            gains.eta / (now.decoupling * jnp.sqrt(self.duration)),
            jnp.exp(0.5 * jax.nn.log_sigmoid((size - SETTLING_BAND) / _SETTLING_WIDTH)),
            linear_far_out(100.0 * jnp.maximum(error - self.overshoot_limit, 0.0)),
        )

    def _still(self, gains: js.SlidingModeGains) -> Sums:
        """Residuals of the terms singularity, stability and prior, which no trajectory enters."""
        margin = js.nonsingularity_margin(self.robot, gains)
        hurwitz = hurwitz_margins(self.robot, self.slope, gains)
        names = ("c1", "c2", "z_u", "phi_z", "eta", "k")
        return (
            jnp.atleast_1d(jnp.maximum(1.0 - margin / _LEAST_NONSINGULARITY, 0.0)),
            jnp.maximum(1.0 - hurwitz / _LEAST_HURWITZ, 0.0),
            jnp.stack([jnp.log(getattr(gains, name) / getattr(self.typical, name)) for name in names]),
        )
