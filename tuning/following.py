"""Objective of following a line with the spatial robot."""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.numerics import Real


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
    lean_weight: float = 0.2
    lean_limit: float = 1.0

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
