"""Dynamics of the spatial robot on a slope: equations (45) and (46).

Symbols, frames and the layout of a state are those of `spatial_kinematics`. The two torques (N m) are

    tau1    drive: between gimbal and shell, about the spin axis; tau1 > 0 rolls the shell forward
    tau2    tilt: between gimbal and pendulum, about y of C

Everything is written in frames that do not see the precession (P, turned by psi only, and B, C, D), where velocities and
inertia depend on theta, beta1 and beta2 alone; psi enters through gravity. Every speed that carries momentum is a row J(q) v:

    M(q) = sum J^T m J        h(q, v) = sum J^T m (J' v + Omega x J v - gravity)        M v' + h = C^T B tau

with Omega the angular velocity of the frame that the row is written in. As in `planar`, `lump` gathers constants, and the
functions on a `Lumped` are what a rollout evaluates.

Differs from the paper:
    B in (40)   has +1 on spin and +1 on beta1. Both turn about z of B in the same sense, so a motor between shell and gimbal
                acts with opposite signs, (+1, -1); the printed pair is a torque from outside the robot.
    (27)        takes I_xxs and I_yys in B, which does not spin. That holds for I_xxs = I_yys only: `check_spatial_robot`.
    tau1, tau2  are named tilt and drive in the text; by B it is the other way round.
`convention="printed"` switches the rolling constraints (22)-(23), hence A(q) and C(q), and B to what is printed, and nothing
else: moments, (26) and the corrected (31) stay, and gravity acts as it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_choice
from jaxsphere.command import Status, code
from jaxsphere.linear_algebra import Vector3, cross, dot, solve_positive_definite, sum_of_products
from jaxsphere.models.spatial_kinematics import CONVENTIONS, IS_VELOCITY, STATE_NAMES, STATE_UNITS, State
from jaxsphere.numerics import Real, evaluate_once, sincos
from jaxsphere.robot import Robot

__all__ = [
    "CONVENTIONS",
    "IS_VELOCITY",
    "STATE_NAMES",
    "STATE_UNITS",
    "Lumped",
    "Reduced",
    "State",
    "accelerations",
    "check_spatial_robot",
    "derivative",
    "derivative_components",
    "input_columns",
    "is_singular",
    "lump",
    "mass_matrix",
    "reduced",
    "status",
]

# Nearer than this to 0 or pi (rad) the lean counts as singular: precession and spin are then about nearly the same axis.
SINGULAR_LEAN = 0.05

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


class Reduced(NamedTuple):
    """Reduced dynamics M v' + h = B tau at one state, by components."""

    inertia: tuple[tuple[Real, ...], ...]  # lower triangle of M, kg m2
    bias: tuple[Real, ...]  # h, N m
    center: tuple[Real, Real]  # x', y', m/s


class _Angles(NamedTuple):
    s_theta: Array
    c_theta: Array
    s_gimbal: Array
    c_gimbal: Array
    s_pendulum: Array
    c_pendulum: Array
    s_psi: Array
    c_psi: Array


def check_spatial_robot(robot: Robot, name: str = "robot") -> Robot:
    """Require I_xxs = I_yys on the host and return the robot; raises ValueError otherwise, traced moments are passed over."""
    if is_concrete(robot.shell_inertia):
        x, y = (float(moment) for moment in np.asarray(robot.shell_inertia)[:2])
        if abs(x - y) > 1e-9 * max(abs(x), abs(y)):
            raise ValueError(
                f"{name}.shell_inertia has I_xx = {x:g} and I_yy = {y:g} kg m2, but the spatial model follows the shell in a "
                "frame that does not spin and needs a shell that is symmetric about its spin axis; type equal x and y moments"
            )
    return robot


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


def input_columns(convention: str = "corrected") -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Columns of C^T B: what drive and tilt torque do on (psi, theta, phi, beta1, beta2).

    Differs from the paper: the drive acts with (+1, -1) on spin and beta1, unless `convention` is "printed" (+1, +1).
    """
    reaction = 1.0 if convention == "printed" else -1.0
    return (0.0, 0.0, 1.0, reaction, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0)


class _Motion(NamedTuple):
    """Angular velocities of the frames and what their time derivatives are while v stays constant; rad/s and rad/s2."""

    body: Vector3  # of B, in B
    body_drift: Vector3
    gimbal: Vector3  # of C, in C
    gimbal_drift: Vector3
    pendulum: Vector3  # of D, in D
    pendulum_drift: tuple[Real, Real]  # its y and z entries


def _add(*terms: tuple[Real, Row]) -> Row:
    columns = sorted({column for _, row in terms for column in row})
    return {column: sum_of_products(*((factor, row.get(column, 0.0)) for factor, row in terms)) for column in columns}


def _slope_in_pendulum(angles: _Angles) -> tuple[Vector3, Vector3, Vector3]:
    """Rotation that takes components in P to components in D, by rows."""
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    forward, side = c_gimbal * c_theta, c_gimbal * s_theta
    return (
        (c_pendulum * forward - s_pendulum * s_theta, c_pendulum * s_gimbal, -c_pendulum * side - s_pendulum * c_theta),
        (-s_gimbal * c_theta, c_gimbal, s_gimbal * s_theta),
        (s_pendulum * forward + c_pendulum * s_theta, s_pendulum * s_gimbal, c_pendulum * c_theta - s_pendulum * side),
    )


def _motion(angles: _Angles, velocity: Sequence[Real]) -> _Motion:
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    psi_rate, theta_rate, _, beta1_rate, beta2_rate = velocity
    bx, by, bz = -psi_rate * s_theta, theta_rate, psi_rate * c_theta
    bx_drift, bz_drift = -bz * theta_rate, bx * theta_rate
    cx, cy, cz = c_gimbal * bx + s_gimbal * by, c_gimbal * by - s_gimbal * bx, bz + beta1_rate
    cx_drift, cy_drift = c_gimbal * bx_drift + beta1_rate * cy, -s_gimbal * bx_drift - beta1_rate * cx
    dx, dy, dz = c_pendulum * cx - s_pendulum * cz, cy + beta2_rate, s_pendulum * cx + c_pendulum * cz
    dz_drift = s_pendulum * cx_drift + c_pendulum * bz_drift + beta2_rate * dx
    return _Motion(
        body=(bx, by, bz),
        body_drift=(bx_drift, 0.0, bz_drift),
        gimbal=(cx, cy, cz),
        gimbal_drift=(cx_drift, cy_drift, bz_drift),
        pendulum=(dx, dy, dz),
        pendulum_drift=(cy_drift, dz_drift),
    )


def _mirror(angles: _Angles) -> tuple[tuple[Real, Real], tuple[Real, Real]]:
    """The printed constraints as a reflection of the true centre's motion, in P."""
    s_double = 2.0 * angles.s_psi * angles.c_psi
    c_double = angles.c_psi * angles.c_psi - angles.s_psi * angles.s_psi
    return (-s_double, -c_double), (-c_double, s_double)


def _center(lumped: Lumped, angles: _Angles, velocity: Sequence[Real], convention: str) -> tuple[tuple[Row, Row], Pair]:
    """Rows of the centre's velocity in P, and its acceleration in P while v stays constant, m/s2."""
    psi_rate, theta_rate, spin_rate, _, _ = velocity
    radius, s_theta = lumped.radius, angles.s_theta
    rows: tuple[Row, Row] = {THETA: radius}, {PHI: -radius * s_theta}
    drift = (
        psi_rate * radius * s_theta * spin_rate,
        psi_rate * radius * theta_rate - radius * angles.c_theta * theta_rate * spin_rate,
    )
    if convention == "printed":
        (a, b), (c, d) = _mirror(angles)
        x, y = drift
        return (_add((a, rows[0]), (b, rows[1])), _add((c, rows[0]), (d, rows[1]))), (a * x + b * y, c * x + d * y)
    return rows, drift


def _rows(lumped: Lumped, angles: _Angles, turn: tuple[Vector3, ...], center: tuple[Row, Row]) -> tuple[Row, ...]:
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


def _weights(lumped: Lumped) -> tuple[Real, ...]:
    return (
        *(lumped.central_mass,) * 2,
        *(lumped.shell_transverse, lumped.shell_transverse, lumped.shell_axial),
        *lumped.gimbal_inertia,
        *(lumped.pendulum_mass,) * 3,
    )


def _forces(
    lumped: Lumped, motion: _Motion, turn: tuple[Vector3, ...], spin_rate: Real, lift: Vector3
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
        moment * rate + torque
        for moment, rate, torque in zip(lumped.gimbal_inertia, motion.gimbal_drift, turning, strict=True)
    )
    dx, dy, dz = motion.pendulum
    dy_drift, dz_drift = motion.pendulum_drift
    swing = (-dy * dy - dz * dz, dz_drift + dx * dy, dx * dz - dy_drift)
    bob = (lumped.pendulum_mass * (dot(axis, lift) + lumped.length * a) for axis, a in zip(turn, swing, strict=True))
    return (lumped.central_mass * lift[0], lumped.central_mass * lift[1], *shell, *gimbal, *bob)


def reduced(lumped: Lumped, state: State, convention: str = "corrected") -> Reduced:
    """Assemble M and h of C^T (M C v' + M C' v + N) = C^T B tau by components, Eq. (45)."""
    _, _, psi, theta, _, beta1, beta2, *velocity = state
    angles = _Angles(*sincos(theta), *sincos(beta1), *sincos(beta2), *sincos(psi))
    turn = _slope_in_pendulum(angles)
    center, drift = _center(lumped, angles, velocity, convention)
    rows = _rows(lumped, angles, turn, center)
    lift = (
        drift[0] + lumped.along_slope * angles.c_psi,
        drift[1] - lumped.along_slope * angles.s_psi,
        lumped.into_slope,
    )
    forces = [evaluate_once(f) for f in _forces(lumped, _motion(angles, velocity), turn, velocity[PHI], lift)]
    weighted = [{j: weight * row[j] for j in row} for weight, row in zip(_weights(lumped), rows, strict=True)]

    def entry(i: int, j: int) -> Real:
        return sum_of_products(*((heavy.get(i, 0.0), row.get(j, 0.0)) for heavy, row in zip(weighted, rows, strict=True)))

    center_x, center_y = (sum_of_products(*((row[j], velocity[j]) for j in row)) for row in center)
    return Reduced(
        inertia=tuple(tuple(entry(i, j) for j in range(i + 1)) for i in range(5)),
        bias=tuple(sum_of_products(*((row.get(i, 0.0), f) for row, f in zip(rows, forces, strict=True))) for i in range(5)),
        center=(
            angles.c_psi * center_x - angles.s_psi * center_y,
            angles.s_psi * center_x + angles.c_psi * center_y,
        ),
    )


def accelerations(terms: Reduced, torque: Sequence[Array], convention: str = "corrected") -> tuple[Array, ...]:
    """Solve M v' = B tau - h for v' (5), rad/s2."""
    drive, tilt = input_columns(convention)
    applied = (sum_of_products((a, torque[0]), (b, torque[1])) for a, b in zip(drive, tilt, strict=True))
    right = [evaluate_once(force - bias) for force, bias in zip(applied, terms.bias, strict=True)]
    (solution,) = solve_positive_definite(terms.inertia, right)
    return solution


def derivative_components(
    lumped: Lumped, state: State, torque: Sequence[Array], convention: str = "corrected"
) -> tuple[Array, ...]:
    """Time derivative (q', v') of the state under drive and tilt torque, by components, Eq. (46)."""
    terms = reduced(lumped, state, convention)
    return (*terms.center, *state[7:], *accelerations(terms, torque, convention))


def derivative(robot: Robot, slope: Real, state: State, torque: Real, convention: str = "corrected") -> Array:
    """Time derivative of one state.

    Args:
        robot: the robot. slope: rad. state: (12,) = q, v in m, rad, m/s and rad/s. torque: (2,) drive and tilt, N m.
        convention: "corrected" or "printed".

    Returns:
        (12,).
    """
    state, torque = jnp.asarray(state), jnp.asarray(torque)
    if state.shape != (12,):
        raise ValueError(f"state has shape {state.shape}; type 12 numbers: {', '.join(STATE_NAMES)} (or use jax.vmap)")
    if torque.shape != (2,):
        raise ValueError(f"torque has shape {torque.shape}; type 2 numbers in N m: drive and tilt (or use jax.vmap)")
    require_choice("convention", convention, CONVENTIONS)
    return jnp.stack(derivative_components(lump(robot, slope), tuple(state), tuple(torque), convention))


def mass_matrix(robot: Robot, state: State, convention: str = "corrected") -> Array:
    """Inertia matrix C^T M C of the reduced dynamics, (5, 5), kg m2."""
    lower = reduced(lump(robot, 0.0), tuple(jnp.asarray(state)), convention).inertia
    return jnp.array([[lower[max(i, j)][min(i, j)] for j in range(5)] for i in range(5)])


def is_singular(state: State) -> Array:
    """Tell (bool) whether the lean is within SINGULAR_LEAN of 0 or pi, where precession and spin become one."""
    return jnp.abs(sincos(state[3])[0]) < np.sin(SINGULAR_LEAN)


def status(state: State) -> Array:
    """Status code of a state: SINGULAR_COORDINATES near a lean of 0 or pi, OK elsewhere."""
    return jnp.where(is_singular(state), code(Status.SINGULAR_COORDINATES), code(Status.OK))
