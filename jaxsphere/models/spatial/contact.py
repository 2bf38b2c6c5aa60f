"""Is rolling credible? The forces at the contact point that rolling without slipping needs: the lambda of (40) and the normal.

Symbols, frames and the layout of a state are those of `frames`. All of it is the balance of momentum of the whole
robot: central mass m + m_i at the centre, m_p at the bob.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial import dynamics
from jaxsphere.models.spatial import frames as kinematics
from jaxsphere.models.spatial.frames import State
from jaxsphere.numerics import Real
from jaxsphere.numerics.linear_algebra import Vector3, dot
from jaxsphere.robot import Robot


class Contact(NamedTuple):
    """Forces of the slope on the sphere, N, in O, and the friction coefficient that rolling needs."""

    normal: Array  # negative where the sphere would leave the slope
    friction: tuple[Array, Array]
    friction_coefficient: Array  # infinite where the normal force is not positive


def contact(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> Contact:
    """Forces that keep the sphere rolling on the slope without slip, for the corrected model.

    Args:
        robot: the robot. slope: rad. state: 12 components. torque: drive and tilt, N m.
    """
    x, y, normal = _contact_force(robot, slope, state, torque)
    pressed = normal > 0.0
    slip_free = jnp.sqrt(dot((x, y), (x, y)))
    coefficient = jnp.where(pressed, slip_free / jnp.where(pressed, normal, 1.0), jnp.inf)
    return Contact(normal, (x, y), coefficient)


def constraint_force(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> tuple[Array, Array]:
    """Multipliers lambda of M q'' + N = A^T lambda + B tau, N, Eq. (40).

    They are the friction on the sphere, because A1 is the identity.
    """
    x, y, _ = _contact_force(robot, slope, state, torque)
    return x, y


def _contact_force(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> tuple[Array, Array, Array]:
    rates = dynamics.derivative_components(dynamics.lump(robot, slope), state, torque)

    def momentum(now: State) -> Vector3:
        x_rate, y_rate = kinematics.rolling_velocity(robot, now)
        bob = kinematics.pendulum_velocity(robot, now)
        central, mass = robot.shell_mass + robot.gimbal_mass, robot.pendulum_mass
        return central * x_rate + mass * bob[0], central * y_rate + mass * bob[1], mass * bob[2]

    x, y, z = jax.jvp(lambda *now: momentum(now), tuple(state), tuple(rates))[1]
    weight = robot.gravity * (robot.shell_mass + robot.gimbal_mass + robot.pendulum_mass)
    return x + weight * jnp.sin(slope), y, z + weight * jnp.cos(slope)
