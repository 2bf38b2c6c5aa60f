"""Is rolling credible? The forces at the contact point that rolling without slipping needs: the lambda of (40) and the normal.

Symbols, frames and the layout of a state are those of `frames`. All of it is the balance of momentum of the whole
robot: central mass m + m_i at the centre, m_p at the bob.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial import attitude, dynamics
from jaxsphere.models.spatial.frames import State
from jaxsphere.models.spatial.lumped import lump
from jaxsphere.numerics import Real, safe_sqrt
from jaxsphere.numerics.linear_algebra import combine
from jaxsphere.robot import Robot


class Contact(NamedTuple):
    """Forces of the slope on the sphere, N, in O, and the friction coefficient that rolling needs."""

    normal: Array  # negative where the sphere would leave the slope
    friction: tuple[Array, Array]
    friction_coefficient: Array  # infinite where the normal force is not positive


def contact(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> Contact:
    """Forces that keep the sphere rolling on the slope without slip, for the corrected model.

    Args:
        robot: the robot.
        slope: rad.
        state: components in the gimbal's frame, or in paper coordinates.
        torque: drive and tilt, N m.
    """
    x, y, normal = _contact_force(robot, slope, state, torque)
    pressed = normal > 0.0
    coefficient = jnp.where(pressed, safe_sqrt(x * x + y * y) / jnp.where(pressed, normal, 1.0), jnp.inf)
    return Contact(normal, (x, y), coefficient)


def constraint_force(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> tuple[Array, Array]:
    """Multipliers lambda of M q'' + N = A^T lambda + B tau, N, Eq. (40).

    They are the friction on the sphere, because A1 is the identity.
    """
    x, y, _ = _contact_force(robot, slope, state, torque)
    return x, y


def _contact_force(robot: Robot, slope: Real, state: State, torque: Sequence[Array]) -> tuple[Array, Array, Array]:
    now, lumped = attitude.of_state(state), lump(robot, slope)
    axes, accelerations = attitude.axes_of(now), dynamics.derivative_components(lumped, now, torque)[8:]
    centre = (1.0, dynamics.rolled(lumped, axes, accelerations)), (1.0, dynamics.centre_drift(lumped, now, axes.normal))
    bob = dynamics.bob_acceleration(lumped, now, accelerations)
    mass = lumped.central_mass + lumped.pendulum_mass
    force = attitude.to_slope(axes, combine((mass, combine(*centre)), (lumped.pendulum_mass, bob)))
    x, y, z = (jnp.asarray(part) for part in force)
    return x + mass * lumped.along_slope, y, z + mass * lumped.into_slope
