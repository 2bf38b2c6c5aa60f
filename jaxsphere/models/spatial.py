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

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_choice
from jaxsphere.command import Status, code
from jaxsphere.linear_algebra import Vector3, cross, solve_positive_definite, sum_of_products
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


def _add(*terms: tuple[Real, Row]) -> Row:
    columns = sorted({column for _, row in terms for column in row})
    return {column: sum_of_products(*((factor, row.get(column, 0.0)) for factor, row in terms)) for column in columns}


def _pendulum_from_slope(angles: _Angles) -> tuple[Vector3, Vector3, Vector3]:
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    return (
        (
            c_pendulum * c_gimbal * c_theta - s_pendulum * s_theta,
            c_pendulum * s_gimbal,
            -c_pendulum * c_gimbal * s_theta - s_pendulum * c_theta,
        ),
        (-s_gimbal * c_theta, c_gimbal, s_gimbal * s_theta),
        (
            s_pendulum * c_gimbal * c_theta + c_pendulum * s_theta,
            s_pendulum * s_gimbal,
            c_pendulum * c_theta - s_pendulum * c_gimbal * s_theta,
        ),
    )


def _center_rows(lumped: Lumped, angles: _Angles, convention: str) -> tuple[Row, Row]:
    """Velocity of the centre in P, m/s."""
    radius, s_theta = lumped.radius, angles.s_theta
    if convention == "printed":
        s_double = 2.0 * angles.s_psi * angles.c_psi
        c_double = angles.c_psi * angles.c_psi - angles.s_psi * angles.s_psi
        return (
            {THETA: -radius * s_double, PHI: radius * c_double * s_theta},
            {THETA: -radius * c_double, PHI: -radius * s_double * s_theta},
        )
    return {THETA: radius}, {PHI: -radius * s_theta}


def _rows(lumped: Lumped, angles: _Angles, convention: str) -> tuple[Row, ...]:
    """Speeds that carry momentum: centre in P (2), shell in B (3), gimbal in C (3), bob in D (3)."""
    s_theta, c_theta, s_gimbal, c_gimbal, s_pendulum, c_pendulum, _, _ = angles
    turn_x, turn_y, turn_z = _pendulum_from_slope(angles)
    center_x, center_y = _center_rows(lumped, angles, convention)
    length = lumped.length
    about_y: Row = {PSI: turn_y[2], THETA: turn_y[1], BETA2: 1.0}
    about_z: Row = {PSI: turn_z[2], THETA: turn_z[1], BETA1: c_pendulum}
    return (
        center_x,
        center_y,
        {PSI: -s_theta},
        {THETA: 1.0},
        {PSI: c_theta, PHI: 1.0},
        {PSI: -c_gimbal * s_theta, THETA: s_gimbal},
        {PSI: s_gimbal * s_theta, THETA: c_gimbal},
        {PSI: c_theta, BETA1: 1.0},
        _add((turn_x[0], center_x), (turn_x[1], center_y)),
        _add((turn_y[0], center_x), (turn_y[1], center_y), (length, about_z)),
        _add((turn_z[0], center_x), (turn_z[1], center_y), (-length, about_y)),
    )


def _weights(lumped: Lumped) -> tuple[Real, ...]:
    return (
        *(lumped.central_mass,) * 2,
        *(lumped.shell_transverse, lumped.shell_transverse, lumped.shell_axial),
        *lumped.gimbal_inertia,
        *(lumped.pendulum_mass,) * 3,
    )


def _frame_terms(lumped: Lumped, angles: _Angles, velocity: Sequence[Real], speeds: Sequence[Real]) -> tuple[Real, ...]:
    """What the turning of the frames and gravity add to J' v, in the rows' order, times mass or moment."""
    psi_rate, theta_rate, _, beta1_rate, beta2_rate = velocity
    turn_x, turn_y, turn_z = _pendulum_from_slope(angles)
    gravity = (-lumped.along_slope * angles.c_psi, lumped.along_slope * angles.s_psi, -lumped.into_slope)
    center = cross((0.0, 0.0, psi_rate), (speeds[0], speeds[1], 0.0))

    s1, s2, s3 = speeds[2:5]
    shell_momentum = (lumped.shell_transverse * s1, lumped.shell_transverse * s2, lumped.shell_axial * s3)
    shell = cross((s1, s2, angles.c_theta * psi_rate), shell_momentum)

    g1, g2, g3 = speeds[5:8]
    moments = lumped.gimbal_inertia
    gimbal = cross((g1, g2, g3), (moments[0] * g1, moments[1] * g2, moments[2] * g3))

    turning = (
        turn_x[2] * psi_rate + turn_x[1] * theta_rate - angles.s_pendulum * beta1_rate,
        turn_y[2] * psi_rate + turn_y[1] * theta_rate + beta2_rate,
        turn_z[2] * psi_rate + turn_z[1] * theta_rate + angles.c_pendulum * beta1_rate,
    )
    bob = cross(turning, (speeds[8], speeds[9], speeds[10]))
    weight = tuple(sum_of_products(*zip(turn, gravity, strict=True)) for turn in (turn_x, turn_y, turn_z))
    return (
        *(lumped.central_mass * (a - g) for a, g in zip(center[:2], gravity[:2], strict=True)),
        *shell,
        *gimbal,
        *(lumped.pendulum_mass * (a - g) for a, g in zip(bob, weight, strict=True)),
    )


def reduced(lumped: Lumped, state: State, convention: str = "corrected") -> Reduced:
    """Assemble M and h of C^T (M C v' + M C' v + N) = C^T B tau by components, Eq. (45)."""
    _, _, psi, theta, _, beta1, beta2, *velocity = state
    angles = _Angles(*sincos(theta), *sincos(beta1), *sincos(beta2), *sincos(psi))
    psi_rate, theta_rate, _, beta1_rate, beta2_rate = velocity
    turning = _Angles(
        *(angles.c_theta * theta_rate, -angles.s_theta * theta_rate),
        *(angles.c_gimbal * beta1_rate, -angles.s_gimbal * beta1_rate),
        *(angles.c_pendulum * beta2_rate, -angles.s_pendulum * beta2_rate),
        *(angles.c_psi * psi_rate, -angles.s_psi * psi_rate),
    )

    def speeds_of(at: _Angles) -> tuple[list[Real], tuple[Row, ...]]:
        rows = _rows(lumped, at, convention)
        return [jnp.asarray(sum_of_products(*((row[j], velocity[j]) for j in row))) for row in rows], rows

    speeds, drifts, rows = jax.jvp(speeds_of, (angles,), (turning,), has_aux=True)
    weights = _weights(lumped)
    extra = _frame_terms(lumped, angles, velocity, speeds)
    forces = [weight * drift + term for weight, drift, term in zip(weights, drifts, extra, strict=True)]
    weighted = [{j: weight * row[j] for j in row} for weight, row in zip(weights, rows, strict=True)]

    def entry(i: int, j: int) -> Real:
        return sum_of_products(*((heavy.get(i, 0.0), row.get(j, 0.0)) for heavy, row in zip(weighted, rows, strict=True)))

    center_x, center_y = speeds[:2]
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
