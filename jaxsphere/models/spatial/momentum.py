"""Momentum of the spatial robot, body by body, in frames that do not see the precession.

Symbols and frames are those of `frames`; P is the frame turned by psi only. Every speed that carries momentum is a
row J(q) v of `momentum_rows`, in this order: the centre in P (2), the shell's turning in B (3), the gimbal's in C (3), the bob
in D (3). Rows depend on theta, beta1 and beta2 alone and list nonzero columns only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial.frames import State
from jaxsphere.numerics import Real, sincos
from jaxsphere.numerics.linear_algebra import Vector3, cross, dot, sum_of_products
from jaxsphere.robot import Robot

PSI, THETA, PHI, BETA1, BETA2 = range(5)
Row = dict[int, Real]
Pair = tuple[Real, Real]


class Lumped(NamedTuple):
    """Constants of the spatial equations for one robot on one slope; every entry a scalar."""

    central_mass: Real  # m + m_i, kg
    pendulum_mass: Real  # m_p, kg
    shell_transverse: Real  # I_xxs = I_yys, kg m2
    shell_axial: Real  # I_zzs, kg m2
    gimbal_inertia: Vector3  # I_xxi, I_yyi, I_zzi, kg m2
    radius: Real  # r, m
    length: Real  # l, m
    along_slope: Real  # g sin(gamma), m/s2
    into_slope: Real  # g cos(gamma), m/s2


class Angles(NamedTuple):
    """Sines and cosines of the four angles that matter; the spin does not."""

    s_theta: Array
    c_theta: Array
    s_gimbal: Array
    c_gimbal: Array
    s_pendulum: Array
    c_pendulum: Array
    s_psi: Array
    c_psi: Array


class Motion(NamedTuple):
    """Angular velocities of the frames and what their time derivatives are while v stays constant; rad/s and rad/s2."""

    body: Vector3  # of B, in B
    body_drift: Vector3
    gimbal: Vector3  # of C, in C
    gimbal_drift: Vector3
    pendulum: Vector3  # of D, in D
    pendulum_drift: tuple[Real, Real]  # its y and z entries


def lump(robot: Robot, slope: Real) -> Lumped:
    """Gather the constants of the spatial equations for `robot` on a `slope` (rad); unequal I_xxs, I_yys are averaged."""
    shell, gimbal = robot.shell_inertia, robot.gimbal_inertia
    return Lumped(
        central_mass=robot.shell_mass + robot.gimbal_mass,
        pendulum_mass=robot.pendulum_mass,
        shell_transverse=0.5 * (shell[0] + shell[1]),
        shell_axial=shell[2],
        gimbal_inertia=(gimbal[0], gimbal[1], gimbal[2]),
        radius=robot.shell_radius,
        length=robot.pendulum_length,
        along_slope=robot.gravity * jnp.sin(slope),
        into_slope=robot.gravity * jnp.cos(slope),
    )


def angles_of(state: State) -> Angles:
    """Evaluate the sines and cosines of a state."""
    return Angles(*sincos(state[3]), *sincos(state[5]), *sincos(state[6]), *sincos(state[2]))


def _add(*terms: tuple[Real, Row]) -> Row:
    columns = sorted({column for _, row in terms for column in row})
    return {column: sum_of_products(*((factor, row.get(column, 0.0)) for factor, row in terms)) for column in columns}


def slope_in_pendulum(angles: Angles) -> tuple[Vector3, Vector3, Vector3]:
    """Rotation that takes components in P to components in D, by rows."""
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    forward, side = c_gimbal * c_theta, c_gimbal * s_theta
    return (
        (c_pendulum * forward - s_pendulum * s_theta, c_pendulum * s_gimbal, -c_pendulum * side - s_pendulum * c_theta),
        (-s_gimbal * c_theta, c_gimbal, s_gimbal * s_theta),
        (s_pendulum * forward + c_pendulum * s_theta, s_pendulum * s_gimbal, c_pendulum * c_theta - s_pendulum * side),
    )


def motion_of(angles: Angles, velocity: Sequence[Real]) -> Motion:
    """Hand the turning on from B to the gimbal's C to the pendulum's D."""
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    psi_rate, theta_rate, _, beta1_rate, beta2_rate = velocity
    bx, by, bz = -psi_rate * s_theta, theta_rate, psi_rate * c_theta
    bx_drift, bz_drift = -bz * theta_rate, bx * theta_rate
    cx, cy, cz = c_gimbal * bx + s_gimbal * by, c_gimbal * by - s_gimbal * bx, bz + beta1_rate
    cx_drift, cy_drift = c_gimbal * bx_drift + beta1_rate * cy, -s_gimbal * bx_drift - beta1_rate * cx
    dx, dy, dz = c_pendulum * cx - s_pendulum * cz, cy + beta2_rate, s_pendulum * cx + c_pendulum * cz
    dz_drift = s_pendulum * cx_drift + c_pendulum * bz_drift + beta2_rate * dx
    return Motion(
        body=(bx, by, bz),
        body_drift=(bx_drift, 0.0, bz_drift),
        gimbal=(cx, cy, cz),
        gimbal_drift=(cx_drift, cy_drift, bz_drift),
        pendulum=(dx, dy, dz),
        pendulum_drift=(cy_drift, dz_drift),
    )


def center_of(lumped: Lumped, angles: Angles, velocity: Sequence[Real]) -> tuple[tuple[Row, Row], Pair]:
    """Rows of the centre's velocity in P, and its acceleration in P while v stays constant, m/s2."""
    psi_rate, theta_rate, spin_rate, _, _ = velocity
    radius, s_theta = lumped.radius, angles.s_theta
    rows: tuple[Row, Row] = {THETA: radius}, {PHI: -radius * s_theta}
    drift = (
        psi_rate * radius * s_theta * spin_rate,
        psi_rate * radius * theta_rate - radius * angles.c_theta * theta_rate * spin_rate,
    )
    return rows, drift


def center_velocity(lumped: Lumped, state: State) -> Pair:
    """Velocity (x', y') of the rolling centre in O, m/s."""
    angles = angles_of(state)
    along_x, along_y = lumped.radius * state[8], -lumped.radius * angles.s_theta * state[9]
    return angles.c_psi * along_x - angles.s_psi * along_y, angles.s_psi * along_x + angles.c_psi * along_y


def momentum_rows(lumped: Lumped, angles: Angles, turn: tuple[Vector3, ...], center: tuple[Row, Row]) -> tuple[Row, ...]:
    """Speeds that carry momentum, J by rows: centre in P (2), shell in B (3), gimbal in C (3), bob in D (3)."""
    s_theta, c_theta, s_gimbal, c_gimbal, _, c_pendulum, _, _ = angles
    (x, y), length = center, lumped.length
    about_y: Row = {PSI: turn[1][2], THETA: turn[1][1], BETA2: 1.0}
    about_z: Row = {PSI: turn[2][2], THETA: turn[2][1], BETA1: c_pendulum}
    return (
        *center,
        {PSI: -s_theta},
        {THETA: 1.0},
        {PSI: c_theta, PHI: 1.0},
        {PSI: -c_gimbal * s_theta, THETA: s_gimbal},
        {PSI: s_gimbal * s_theta, THETA: c_gimbal},
        {PSI: c_theta, BETA1: 1.0},
        _add((turn[0][0], x), (turn[0][1], y)),
        _add((turn[1][0], x), (turn[1][1], y), (length, about_z)),
        _add((turn[2][0], x), (turn[2][1], y), (-length, about_y)),
    )


def weights(lumped: Lumped) -> tuple[Real, ...]:
    """Mass (kg) or moment (kg m2) that belongs to each row."""
    return (
        *(lumped.central_mass,) * 2,
        *(lumped.shell_transverse, lumped.shell_transverse, lumped.shell_axial),
        *lumped.gimbal_inertia,
        *(lumped.pendulum_mass,) * 3,
    )


def momentum_rates(
    lumped: Lumped, motion: Motion, turn: tuple[Vector3, ...], spin_rate: Real, lift: Vector3
) -> tuple[Real, ...]:
    """Rates of momentum while v stays constant, without gravity, in the order of the rows; N and N m.

    Args:
        lift: acceleration of the centre minus gravity, in P, m/s2. The other arguments as above.
    """
    bx, by, bz = motion.body
    transverse, axial = lumped.shell_transverse, lumped.shell_axial
    tumbling, spinning = transverse * bz, axial * (bz + spin_rate)
    shell = (
        transverse * motion.body_drift[0] + by * (spinning - tumbling),
        transverse * motion.body_drift[1] - bx * (spinning - tumbling),
        axial * motion.body_drift[2],
    )
    momentum = tuple(moment * rate for moment, rate in zip(lumped.gimbal_inertia, motion.gimbal, strict=True))
    turning = cross(motion.gimbal, (momentum[0], momentum[1], momentum[2]))
    gimbal = (
        moment * rate + torque for moment, rate, torque in zip(lumped.gimbal_inertia, motion.gimbal_drift, turning, strict=True)
    )
    dx, dy, dz = motion.pendulum
    dy_drift, dz_drift = motion.pendulum_drift
    swing = (-dy * dy - dz * dz, dz_drift + dx * dy, dx * dz - dy_drift)
    bob = (lumped.pendulum_mass * (dot(axis, lift) + lumped.length * a) for axis, a in zip(turn, swing, strict=True))
    return (lumped.central_mass * lift[0], lumped.central_mass * lift[1], *shell, *gimbal, *bob)
