"""Energies of the spatial robot, body by body: equations (27)-(29), (32)-(34) and (36)-(39).

Symbols, frames and the layout of a state are those of `frames`. Heights count from the plane through the origin of
O, along the vertical. Where a velocity of the centre (m/s) is given, it counts in place of that of rolling: (39) before the
constraints.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial import frames
from jaxsphere.models.spatial.frames import SpatialState, State
from jaxsphere.numerics import Real
from jaxsphere.numerics.linear_algebra import Vector3, dot
from jaxsphere.robot import Robot

Velocity = tuple[Real, Real] | None


def shell_kinetic_energy(robot: Robot, state: State, center: Velocity = None) -> Real:
    """Kinetic energy of the shell, J, Eq. (27).

    The moments are taken in B, which does not spin; that is right for I_xxs = I_yys only.
    """
    turning = _rotational(robot.shell_inertia, frames.shell_angular_velocity(state))
    return _translational(robot.shell_mass, robot, state, center) + turning


def shell_potential_energy(robot: Robot, slope: Real, state: State) -> Real:
    """Potential energy of the shell, J, Eq. (28)."""
    return robot.shell_mass * robot.gravity * _height(slope, frames.center_position(robot, state))


def gimbal_kinetic_energy(robot: Robot, state: State, center: Velocity = None) -> Real:
    """Kinetic energy of the gimbal, J, Eq. (32)."""
    turning = _rotational(robot.gimbal_inertia, frames.gimbal_angular_velocity(state))
    return _translational(robot.gimbal_mass, robot, state, center) + turning


def gimbal_potential_energy(robot: Robot, slope: Real, state: State) -> Real:
    """Potential energy of the gimbal, J, Eq. (33)."""
    return robot.gimbal_mass * robot.gravity * _height(slope, frames.gimbal_position(robot, state))


def pendulum_kinetic_energy(robot: Robot, state: State, center: Velocity = None) -> Real:
    """Kinetic energy of the pendulum's bob, J, Eq. (36).

    Beyond the paper: a bob with moments of its own turns too.
    """
    velocity = frames.pendulum_velocity(robot, state, center)
    turning = _rotational(robot.pendulum_inertia, frames.pendulum_angular_velocity(state))
    return 0.5 * robot.pendulum_mass * dot(velocity, velocity) + turning


def pendulum_potential_energy(robot: Robot, slope: Real, state: State) -> Real:
    """Potential energy of the pendulum's bob, J, Eq. (37)."""
    return robot.pendulum_mass * robot.gravity * _height(slope, frames.pendulum_position(robot, state))


def kinetic_energy(robot: Robot, state: State, center: Velocity = None) -> Real:
    """Kinetic energy of shell, gimbal and pendulum, J."""
    shell, gimbal = shell_kinetic_energy(robot, state, center), gimbal_kinetic_energy(robot, state, center)
    return shell + gimbal + pendulum_kinetic_energy(robot, state, center)


def potential_energy(robot: Robot, slope: Real, state: State) -> Real:
    """Potential energy of shell, gimbal and pendulum, J."""
    shell, gimbal = shell_potential_energy(robot, slope, state), gimbal_potential_energy(robot, slope, state)
    return shell + gimbal + pendulum_potential_energy(robot, slope, state)


def body_lagrangians(robot: Robot, slope: Real, state: State, center: Velocity = None) -> Vector3:
    """Lagrangians of shell, gimbal and pendulum, J, Eq. (29), Eq. (34), Eq. (38)."""
    return (
        shell_kinetic_energy(robot, state, center) - shell_potential_energy(robot, slope, state),
        gimbal_kinetic_energy(robot, state, center) - gimbal_potential_energy(robot, slope, state),
        pendulum_kinetic_energy(robot, state, center) - pendulum_potential_energy(robot, slope, state),
    )


def lagrangian(robot: Robot, slope: Real, state: State, center: Velocity = None) -> Real:
    """Lagrangian of the robot, J, Eq. (39)."""
    shell, gimbal, pendulum = body_lagrangians(robot, slope, state, center)
    return shell + gimbal + pendulum


def power(state: State, torque: Sequence[Array]) -> Array:
    """Mechanical power of the two motors, tau1 (phi' - beta1') + tau2 beta2', W."""
    now = SpatialState(*state)
    drive, tilt = torque
    return drive * (now.spin_rate - now.gimbal_rate) + tilt * now.pendulum_rate


def _translational(mass: Real, robot: Robot, state: State, center: Velocity) -> Real:
    velocity = frames.rolling_velocity(robot, state) if center is None else center
    return 0.5 * mass * dot(velocity, velocity)


def _rotational(moments: Array, rates: Vector3) -> Real:
    return 0.5 * (moments[0] * rates[0] ** 2 + moments[1] * rates[1] ** 2 + moments[2] * rates[2] ** 2)


def _height(slope: Real, position: Vector3) -> Real:
    x, _, z = position
    return x * jnp.sin(slope) + z * jnp.cos(slope)
