"""Objectives: weighted sums of named terms of a rollout, one number to make small."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.numerics import Real


class Weights(NamedTuple):
    """Weights of the terms of `RestToRest`; zero switches a term off."""

    tracking: float = 1.0
    swing: float = 1.0
    torque: float = 1e-3
    chatter: float = 0.5


class Terms(NamedTuple):
    """The unweighted terms of one rollout; every entry a scalar."""

    tracking: Array  # s^2: integral of t |e| / travel
    swing: Array  # s: integral of the squared excess of |phi - phi_0| over swing_limit, in units of (1 degree)^2
    torque: Array  # (N m)^2 s: integral of tau^2
    chatter: Array  # (N m)^2: mean square of the torque step eta / decoupling that the hard sign switches by


@dataclass(frozen=True, eq=False)
class RestToRest:
    """Objective of a move from rest to rest, as a function of `SlidingModeGains`.

    slope: rad. travel: rad. duration, dt: s. smoothing: epsilon of the switching term, rad/s, positive for a useful gradient
    with respect to eta. torque_limit: N m. swing_limit: rad, |phi - phi_0| above it is penalised.
    """

    robot: js.Robot = field(default_factory=js.Robot)
    slope: Real = 0.17453292519943295  # 10 degrees
    travel: Real = 10.0
    duration: float = 8.0
    dt: float = 4e-3
    smoothing: float = 0.05
    torque_limit: float | None = 5.0
    swing_limit: float = 0.3490658503988659  # 20 degrees
    weights: Weights = Weights()
    method: str = "rk4"

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
            method=self.method,
            throw=False,
        )

    def terms(self, gains: js.SlidingModeGains) -> Terms:
        """Evaluate every term of one rollout."""
        trajectory = self.rollout(gains)
        alpha, _, swing, _ = trajectory.state.T
        error = (alpha - alpha[0]) / self.travel - 1.0
        deviation = jnp.abs(swing - js.equilibrium_swing(self.robot, self.slope))
        excess = jnp.rad2deg(jnp.maximum(deviation - self.swing_limit, 0.0))
        torque = trajectory.torque[:, 0]
        return Terms(
            tracking=self.dt * jnp.sum(trajectory.time * jnp.abs(error)),
            swing=self.dt * jnp.sum(excess**2),
            torque=self.dt * jnp.sum(torque**2),
            chatter=jnp.mean((gains.eta / trajectory.diagnostics.decoupling) ** 2),
        )

    def __call__(self, gains: js.SlidingModeGains) -> Array:
        """Weighted sum of the terms."""
        return sum((w * t for w, t in zip(self.weights, self.terms(gains), strict=True)), jnp.zeros(()))


@dataclass(frozen=True, eq=False)
class FollowLine:
    """Objective of following a line from Table 4's start, as a function of `TrackingGains`: mean over the speeds, in cm.

    slope: rad. speeds: v_f, m/s, one rollout each. duration, dt: s; the controller is sampled every dt.
    torque_limit: N m. effort_weight: cm per (N m)^2 s. lean_weight: cm per degree by which the spin axis leans more than
    lean_limit (rad) from the slope, towards the singular attitude.
    """

    robot: js.Robot = field(default_factory=js.Robot)
    slope: Real = 0.17453292519943295  # 10 degrees
    speeds: tuple[float, ...] = (0.5,)
    duration: float = 20.0
    dt: float = 4e-3
    torque_limit: float | None = 5.0
    effort_weight: float = 0.0
    lean_weight: float = 0.1
    lean_limit: float = 1.3089969389957472  # 75 degrees

    def __call__(self, gains: js.TrackingGains) -> Array:
        """Root-mean-square distance from the line (cm) plus penalties; a lane that ends early pays for the rest."""
        return jnp.mean(jax.vmap(lambda speed: self._one(gains, speed))(jnp.asarray(self.speeds)))

    def _one(self, gains: js.TrackingGains, speed: Array) -> Array:
        trajectory = js.track_line(
            self.robot,
            self.slope,
            gains,
            speed,
            duration=self.duration,
            dt=self.dt,
            torque_limit=self.torque_limit,
            control_period=self.dt,
            save_every=None,
            throw=False,
        )
        lost = 100.0 * (1.0 - trajectory.end_time / self.duration)
        excess = jnp.rad2deg(jnp.maximum(trajectory.metrics.peak_lean - self.lean_limit, 0.0))
        penalties = self.effort_weight * trajectory.metrics.effort + self.lean_weight * excess
        return 100.0 * trajectory.metrics.rms_error + penalties + lost
