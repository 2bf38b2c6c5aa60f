"""Planar robot on a slope: equations (1), (5) and (60).

    alpha   sphere angle, rad; the centre of the sphere has rolled up-slope by r alpha
    phi     swing of the pendulum, rad, from the vertical, positive up-slope
    gamma   slope, rad, positive when the up-slope direction is alpha > 0
    tau     motor torque, N m, between shell and pendulum; its power is tau (alpha' + phi') because both angles count
            positive in opposite senses of rotation

A state is (alpha, alpha', phi, phi'), as an array (4,) or any sequence of four equally shaped arrays: physics is written on
components, so that under `vmap` each component is one array of lanes. `lump` gathers the constants of one robot on one slope;
the functions that take a `Lumped` are what a rollout evaluates, the ones that take `(robot, slope, ...)` are for people.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.friction import Losses, joint_loss, losses, smooth_sign
from jaxsphere.numerics import Real, sincos
from jaxsphere.robot import Robot, total_mass

IS_VELOCITY = (False, True, False, True)

# Motor torque on (alpha, phi): the relative angle is alpha + phi.
INPUT = (1.0, 1.0)

State = Sequence[Array] | Array


class PlanarState(NamedTuple):
    """The components of a state by name, in their order: `PlanarState(*state)`."""

    alpha: Array  # rad
    alpha_rate: Array  # rad/s
    swing: Array  # phi, rad
    swing_rate: Array  # rad/s


class Lumped(NamedTuple):
    """Constants of (1) for one robot on one slope; every entry a scalar."""

    rolling_inertia: Real  # M11 = (m + m_i + m_p) r^2 + I_s, kg m2
    pendulum_inertia: Real  # M22 = m_p l^2 + I_p + I_i, kg m2
    coupling: Real  # m_p r l, kg m2
    slope_torque: Real  # (m + m_i + m_p) g r sin(gamma), N m
    pendulum_weight: Real  # m_p g l, N m
    sin_slope: Array
    cos_slope: Array
    losses: Losses | None  # of friction


class Canonical(NamedTuple):
    """Drift and input gain of the two accelerations: alpha'' = f1 + b1 tau, phi'' = f2 + b2 tau."""

    f1: Array
    b1: Array
    f2: Array
    b2: Array


def lump(robot: Robot, slope: Real) -> Lumped:
    """Gather the constants of the planar equations for `robot` on a `slope` (rad)."""
    total = total_mass(robot)
    sin_slope, cos_slope = jnp.sin(slope), jnp.cos(slope)
    radius, length, gravity = robot.shell_radius, robot.pendulum_length, robot.gravity
    return Lumped(
        rolling_inertia=total * radius**2 + robot.shell_inertia[2],
        pendulum_inertia=robot.pendulum_mass * length**2 + robot.pendulum_inertia[2] + robot.gimbal_inertia[2],
        coupling=robot.pendulum_mass * radius * length,
        slope_torque=total * gravity * radius * sin_slope,
        pendulum_weight=robot.pendulum_mass * gravity * length,
        sin_slope=sin_slope,
        cos_slope=cos_slope,
        losses=losses(robot, slope),
    )


def inertia(lumped: Lumped, state: State) -> tuple[Real, Array, Real]:
    """Entries (M11, M12, M22) of the symmetric inertia matrix, kg m2."""
    sin_swing, cos_swing = sincos(PlanarState(*state).swing)
    cos_relative = cos_swing * lumped.cos_slope + sin_swing * lumped.sin_slope
    return lumped.rolling_inertia, lumped.coupling * cos_relative, lumped.pendulum_inertia


def bias(lumped: Lumped, state: State) -> tuple[Array, Array]:
    """Entries (N1, N2) of the centrifugal, gravity and friction torques, N m."""
    now = PlanarState(*state)
    sin_swing, cos_swing = sincos(now.swing)
    sin_relative = sin_swing * lumped.cos_slope - cos_swing * lumped.sin_slope
    centrifugal = lumped.coupling * sin_relative * now.swing_rate**2
    rolling, joint = friction_torques(lumped, state)
    return lumped.slope_torque - centrifugal + rolling + joint, lumped.pendulum_weight * sin_swing + joint


def friction_torques(lumped: Lumped, state: State) -> tuple[Real, Real]:
    """Torques (N m) of rolling resistance, against alpha', and of the drive joint, against alpha' + phi'."""
    if lumped.losses is None:
        return 0.0, 0.0
    now = PlanarState(*state)
    rolling = lumped.losses.rolling * smooth_sign(now.alpha_rate)
    return rolling, joint_loss(lumped.losses.drive, now.alpha_rate + now.swing_rate)


def canonical_form(lumped: Lumped, state: State) -> Canonical:
    """Solve the dynamics for both accelerations, affine in the torque: [f1, f2] = -M^-1 N and [b1, b2] = M^-1 B, Eq. (60).

    This is the form (5) that the sliding-mode controller is designed on.
    """
    m11, m12, m22 = inertia(lumped, state)
    n1, n2 = bias(lumped, state)
    inverse_determinant = 1.0 / (m11 * m22 - m12 * m12)
    return Canonical(
        f1=(m12 * n2 - m22 * n1) * inverse_determinant,
        b1=(m22 * INPUT[0] - m12 * INPUT[1]) * inverse_determinant,
        f2=(m12 * n1 - m11 * n2) * inverse_determinant,
        b2=(m11 * INPUT[1] - m12 * INPUT[0]) * inverse_determinant,
    )


def derivative(lumped: Lumped, state: State, torque: Sequence[Array]) -> PlanarState:
    """Time derivative of the state under the motor torque, by components: the two subsystems A and B, Eq. (5)."""
    now, (tau,) = PlanarState(*state), torque
    f1, b1, f2, b2 = canonical_form(lumped, state)
    return PlanarState(now.alpha_rate, f1 + b1 * tau, now.swing_rate, f2 + b2 * tau)


def acceleration(robot: Robot, slope: Real, state: State, torque: Real) -> Array:
    """Accelerations (alpha'', phi'') from M(q) q'' + N(q, q') = B tau, Eq. (1).

    Args:
        robot: the robot.
        slope: rad.
        state: (4,) = alpha, alpha', phi, phi' in rad and rad/s.
        torque: (), N m.

    Returns:
        (2,), rad/s2.
    """
    state = jnp.asarray(state)
    if state.shape != (4,):
        raise ValueError(f"state has shape {state.shape}; type 4 numbers: alpha, alpha', phi, phi' (or use jax.vmap)")
    if jnp.ndim(torque):
        raise ValueError(f"torque has shape {jnp.shape(torque)}; type one number in N m (or use jax.vmap)")
    rates = derivative(lump(robot, slope), tuple(state), (jnp.asarray(torque),))
    return jnp.stack([rates.alpha_rate, rates.swing_rate])


def mass_matrix(robot: Robot, slope: Real, state: State) -> Array:
    """Inertia matrix M(q), (2, 2), kg m2."""
    m11, m12, m22 = inertia(lump(robot, slope), tuple(jnp.asarray(state)))
    return jnp.array([[m11, m12], [m12, m22]])


def kinetic_energy(robot: Robot, slope: Real, state: State) -> Array:
    """Kinetic energy q'^T M q' / 2, J."""
    now = PlanarState(*state)
    m11, m12, m22 = inertia(lump(robot, slope), state)
    return 0.5 * (m11 * now.alpha_rate**2 + 2.0 * m12 * now.alpha_rate * now.swing_rate + m22 * now.swing_rate**2)


def potential_energy(robot: Robot, slope: Real, state: State) -> Array:
    """Potential energy, J, zero at alpha = 0 with the pendulum at a right angle."""
    now, lumped = PlanarState(*state), lump(robot, slope)
    return lumped.slope_torque * now.alpha - lumped.pendulum_weight * sincos(now.swing)[1]


def power(state: State, torque: Sequence[Array]) -> Array:
    """Mechanical power of the motor, tau (alpha' + phi'), W."""
    now, (tau,) = PlanarState(*state), torque
    return tau * (INPUT[0] * now.alpha_rate + INPUT[1] * now.swing_rate)
