"""Objective of a move from rest to rest: a sum of squares of named, smooth residuals, one number to make small.

    objective(gains) = sum over the terms of weight x term,    term = sum of the squares of its residuals

Every residual is smooth in the gains (a hinge only where its square is), so that second-order optimisers can use it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from jaxsphere.checks import is_concrete
from jaxsphere.controllers import sliding_mode
from jaxsphere.models import planar
from jaxsphere.numerics import Real
from jaxsphere.tasks.metrics import SETTLING_BAND
from tuning.objectives import terms
from tuning.objectives.limits import Limits
from tuning.objectives.stability import hurwitz_margins
from tuning.objectives.task_objective import SCORING, TaskObjective, with_settings
from tuning.objectives.terms import Series, Term, linear_far_out

Sums = tuple[Array, ...]

# Ranges for Latin-hypercube starts of a robot like set A; within them 4 ms and 8 ms of hold keep the smoothed switching stable.
BOUNDS = {"c1": (0.2, 1.5), "c2": (1.0, 8.0), "z_u": (0.2, 0.98), "phi_z": (2.0, 20.0), "eta": (0.5, 10.0), "k": (0.2, 10.0)}

# The equilibrium-seeking gain, where it is used at all.
SEEKING_BOUNDS = {"k_i": (0.005, 0.3)}

# Widths of the smooth |e| and of the smooth step into the settling band, of the travel.
_ERROR_WIDTH = 1e-3
_SETTLING_WIDTH = 4e-3
# Margins below these are penalised: of the divisor of (12) and of Routh's column.
_LEAST_NONSINGULARITY = 0.2
_LEAST_HURWITZ = 0.1


class Weights(NamedTuple):
    """Weights of the terms of `RestToRest`; zero switches a term off."""

    itae: Real = 1.0
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

    itae: Array  # s^2: integral of t |e| / travel, |e| rounded off below 1e-3 of the travel
    swing: Array  # s: integral of the excess of |phi - phi_0| over swing_limit in degrees, squared up to 1, linear beyond
    torque: Array  # (N m)^2 s: integral of tau^2
    chatter: Array  # (N m)^2: mean square of the torque step eta / decoupling that the hard sign switches by
    settling: Array  # s: integral of a smooth step that is 1 outside the 2 % band and 0 inside
    overshoot: Array  # s: integral of the excess of e over overshoot_limit in % of the travel, likewise
    singularity: Array  # squared shortfall of the nonsingularity margin below 0.2, of 0.2
    stability: Array  # sum of the squared shortfalls of the Hurwitz margins below 0.1, of 0.1
    prior: Array  # sum of the squared logarithms of c1 ... k over those of `typical`; regularises


_MOVING = 6  # terms that are integrals over time


@dataclass(frozen=True, eq=False, init=False)
class RestToRest(TaskObjective):
    """Objective of a move from rest to rest, as a function of `SlidingModeGains`.

    Every field of `task` and `numerics` may be typed as a keyword. By default the motor has 5 N m, the sign is smoothed over
    0.2 rad/s and the controller sampled every `dt`; `control_period=None` makes it continuous.

    Attributes:
        task: the move.
        numerics: of its rollouts.
        swing_limit: rad, |phi - phi_0| above it is penalised.
        overshoot_limit: of the travel, likewise.
        weights: of the terms.
        extra: terms of the user's own.
        typical: gains that the term `prior` draws towards.
    """

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = BOUNDS

    task: js.PlanarTask = js.PlanarTask(torque_limit=5.0, smoothing=0.2, control_period=8e-3)
    numerics: js.Numerics = js.Numerics(dt=8e-3, duration=8.0)
    swing_limit: Real = math.radians(20.0)
    overshoot_limit: Real = 0.01
    weights: Weights = Weights()
    extra: tuple[Term, ...] = ()
    typical: js.SlidingModeGains = js.SlidingModeGains(z_u=0.35)

    def rollout(self, gains: js.SlidingModeGains) -> js.Trajectory:
        """Return the rollout of the task with these gains, saved at every step."""
        return js.simulate(self.task, gains, self.numerics, diagnostics=True, throw=False)

    def residuals(self, gains: js.SlidingModeGains) -> Float[Array, " m"]:
        """Return the weighted residuals of one rollout; the objective is the sum of their squares.

        Raises:
            ValueError: there is no term with a weight, or a term of the user's own returns no scalar.
        """
        self.require_sound()
        trajectory = self.rollout(gains)
        return terms.weighted_residuals(self.weights, self._unweighted(gains, trajectory), self.extra, trajectory)

    def terms(self, gains: js.SlidingModeGains) -> Terms:
        """Return every term of one rollout, unweighted."""
        return Terms(*(jnp.sum(part * part) for part in self._unweighted(gains, self.rollout(gains))))

    def cost_so_far(self, gains: js.SlidingModeGains) -> Float[Array, " T"]:
        """Return the objective counted up to each time of the rollout, without terms of the user's own."""
        parts = [part * part for part in self._unweighted(gains, self.rollout(gains))]
        still = terms.weighted_sum(self.weights[_MOVING:], map(jnp.sum, parts[_MOVING:]))
        return jnp.cumsum(terms.weighted_sum(self.weights[:_MOVING], parts[:_MOVING])) + still

    def limits(self, gains: js.SlidingModeGains) -> Limits:
        """Return by how much one rollout exceeds the limits."""
        trajectory, task = self.rollout(gains), self.task
        hard = {
            "ended_early": 1.0 - trajectory.end_time / self.duration,  # of the duration
            "singularity": -jnp.asarray(js.nonsingularity_margin(task.robot, gains)),
            "stability": -jnp.min(hurwitz_margins(task.robot, task.slope, gains)),
        }
        swing = trajectory.metrics.peak_swing / self.swing_limit - 1.0
        return Limits(hard, {"swing": swing, "overshoot": trajectory.metrics.overshoot - self.overshoot_limit})

    def figures(self, gains: js.SlidingModeGains) -> Float[Array, 3]:
        """Return settling time (s), peak swing about equilibrium (rad) and effort ((N m)^2 s), infinite unless the lane is ok.

        They are scored with the hard sign and a 1 kHz hold.
        """
        task, numerics = with_settings(self.task, self.numerics, SCORING | {"smoothing": 0.0})
        found = js.simulate(task, gains, numerics, throw=False)
        three = jnp.stack([found.metrics.settling_time, found.metrics.peak_swing, found.metrics.effort])
        return jnp.where(found.status == js.Status.OK, three, jnp.inf)

    def stiffened(self, smoothing: Real, stiffness: Real) -> RestToRest:
        """Return the same with another smoothing (rad/s) and the penalties of the limits multiplied by `stiffness`."""
        hard = ("swing", "overshoot", "singularity", "stability")
        weights = self.weights._replace(**{name: getattr(self.weights, name) * stiffness for name in hard})
        return replace(self, task=replace(self.task, smoothing=smoothing), weights=weights)

    def compromise(self, limit: Real, effort: Real) -> RestToRest:
        """Return the same with another limit of the swing (rad) and weight of the effort."""
        return replace(self, swing_limit=limit, weights=self.weights._replace(torque=effort))

    def each(self, function: Callable[[js.PlanarTask], Any]) -> Any:
        """Return function(task) of every rollout, with a leading axis of one."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], function(self.task))

    def check(self) -> None:
        """Raise ValueError when there is no term, or the slope is past the bound of the robot."""
        self.require_sound()
        if is_concrete((self.task.robot, self.task.slope)):
            js.require_holdable(self.task.robot, self.task.slope)

    def series(self, gains: js.SlidingModeGains) -> Series:
        """Return all that the objective adds up."""
        trajectory = self.rollout(gains)
        parts = self._unweighted(gains, trajectory)._asdict()
        still = {f"term {name}": parts.pop(name) for name in Terms._fields[_MOVING:]}
        state = dict(zip(("sphere angle", "rate of the sphere", "swing", "rate of the swing"), trajectory.state.T, strict=True))
        end = trajectory.time == trajectory.time[-1]
        own = {term.name: jnp.where(end, term.scalar(trajectory), 0.0) for term in self.extra}
        return Series(trajectory.time, state | {f"term {name}": part for name, part in (parts | own).items()}, still)

    def _unweighted(self, gains: js.SlidingModeGains, trajectory: js.Trajectory) -> Terms:
        time = trajectory.time
        # The state at the end is reached, not driven from: it closes the last step and weighs nothing.
        step = jnp.full_like(time, self.numerics.dt).at[-1].set(0.0)
        rates = self._rates(gains, tuple(trajectory.state.T), trajectory.torque[:, 0])
        weight = (jnp.sqrt(step * time), *(jnp.sqrt(step),) * 5)
        return Terms(*(w * rate for w, rate in zip(weight, rates, strict=True)), *self._still(gains))

    def streamed(self, gains: js.SlidingModeGains) -> Terms:
        """Terms summed up inside the rollout, which saves nothing."""

        def add(total: Sums, time: Array, state: planar.State, torque: Sums, dt: Array) -> Sums:
            rates = self._rates(gains, state, torque[0])
            return tuple(t + w * rate * rate for t, w, rate in zip(total, (dt * time, *(dt,) * 5), rates, strict=True))

        zero = jnp.zeros_like(js.equilibrium_swing(self.task.robot, self.task.slope))
        measure = js.Measure((zero,) * _MOVING, add, lambda total: total)
        numerics = replace(self.numerics, save_every=None)
        trajectory = js.simulate(self.task, gains, numerics, measure=measure)
        # A lane that ended early pays for the rest of the time where it stands.
        last = self._rates(gains, tuple(trajectory.state[-1]), zero)
        dt = self.numerics.dt
        steps, done = round(self.duration / dt), jnp.round(trajectory.end_time / dt)
        left = dt * (steps - done)
        left_time = 0.5 * dt**2 * (steps * (steps - 1) - done * (done - 1.0))
        rest = (left_time, *(left,) * 5)
        moving = (t + w * rate * rate for t, w, rate in zip(trajectory.metrics, rest, last, strict=True))
        return Terms(*moving, *(jnp.sum(part * part) for part in self._still(gains)))

    def _rates(self, gains: js.SlidingModeGains, state: planar.State, torque: Array) -> Sums:
        """Roots of what the terms itae ... overshoot integrate, at states of any shape."""
        alpha, _, swing, _ = state
        task = self.task
        start = 0.0 if task.initial_state is None else task.initial_state[0]
        equilibrium = js.equilibrium_swing(task.robot, task.slope)
        error = (alpha - start) / task.travel - 1.0
        size = jnp.sqrt(error * error + _ERROR_WIDTH**2)
        excess = jnp.rad2deg(jnp.maximum(jnp.abs(swing - equilibrium) - self.swing_limit, 0.0))
        lumped, unseeking = planar.lump(task.robot, task.slope), jnp.zeros_like(alpha)
        now = sliding_mode.signals(lumped, equilibrium, gains, state, unseeking, start + task.travel, task.smoothing)
        return (
            error / jnp.sqrt(size + _ERROR_WIDTH),
            linear_far_out(excess),
            torque,
            gains.eta / (now.decoupling * jnp.sqrt(self.duration)),
            jnp.exp(0.5 * jax.nn.log_sigmoid((size - SETTLING_BAND) / _SETTLING_WIDTH)),
            linear_far_out(100.0 * jnp.maximum(error - self.overshoot_limit, 0.0)),
        )

    def _still(self, gains: js.SlidingModeGains) -> Sums:
        """Residuals of the terms singularity, stability and prior, which no trajectory enters."""
        margin = js.nonsingularity_margin(self.task.robot, gains)
        hurwitz = hurwitz_margins(self.task.robot, self.task.slope, gains)
        return (
            jnp.atleast_1d(jnp.maximum(1.0 - margin / _LEAST_NONSINGULARITY, 0.0)),
            jnp.maximum(1.0 - hurwitz / _LEAST_HURWITZ, 0.0),
            terms.prior(gains, self.typical, ("c1", "c2", "z_u", "phi_z", "eta", "k")),
        )
