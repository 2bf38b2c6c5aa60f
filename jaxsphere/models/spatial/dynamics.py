"""Dynamics of the spatial robot on a slope: equations (45) and (46).

Symbols, frames and the layout of a state are those of `frames`. The two torques (N m) are

    tau1    drive: between gimbal and shell, about the spin axis; tau1 > 0 rolls the shell forward
    tau2    tilt: between gimbal and pendulum, about y of C

Everything is written in frames that do not see the precession (`momentum`), where velocities and inertia depend on
theta, beta1 and beta2 alone; psi enters through gravity. Every speed that carries momentum is a row J(q) v:

    M(q) = sum J^T m J        h(q, v) = sum J^T m (J' v + Omega x J v - gravity)        M v' + h = C^T B tau

with Omega the angular velocity of the frame that the row is written in. As in `planar`, `lump` gathers constants, and the
functions on a `Lumped` are what a rollout evaluates.

Differs from the paper:
    B in (40)   has +1 on spin and +1 on beta1. Both turn about z of B in the same sense, so a motor between shell and gimbal
                acts with opposite signs, (+1, -1); the printed pair is a torque from outside the robot.
    (27)        takes I_xxs and I_yys in B, which does not spin. That holds for I_xxs = I_yys only: `check_spatial_robot`.
    tau1, tau2  are named tilt and drive in the text; by B it is the other way round.
`printed` has the model with the printed constraints and B.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_choice
from jaxsphere.models.spatial import momentum, printed
from jaxsphere.models.spatial.frames import STATE_NAMES, State
from jaxsphere.models.spatial.momentum import Lumped, lump
from jaxsphere.numerics import Real, evaluate_once, sincos
from jaxsphere.numerics.linear_algebra import solve_positive_definite, sum_of_products
from jaxsphere.robot import Robot
from jaxsphere.status import Status, code

CONVENTIONS = ("corrected", "printed")

# What drive and tilt torque do on (psi, theta, phi, beta1, beta2): the columns of C^T B.
INPUT_COLUMNS = (0.0, 0.0, 1.0, -1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0)

# Nearer than this to 0 or pi (rad) the lean counts as singular: precession and spin are then about nearly the same axis.
SINGULAR_LEAN = 0.05


class Reduced(NamedTuple):
    """Reduced dynamics M v' + h = B tau at one state, by components."""

    inertia: tuple[tuple[Real, ...], ...]  # lower triangle of M, kg m2
    bias: tuple[Real, ...]  # h, N m
    center: tuple[Real, Real]  # x', y', m/s


class Affine(NamedTuple):
    """v' = drift + drive tau1 + tilt tau2; each entry is (5), rad/s2 and 1/(kg m2)."""

    drift: tuple[Array, ...]
    drive: tuple[Array, ...]
    tilt: tuple[Array, ...]


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


def reduced(lumped: Lumped, state: State) -> Reduced:
    """Assemble M and h of C^T (M C v' + M C' v + N) = C^T B tau by components, Eq. (45)."""
    angles, velocity = momentum.angles_of(state), tuple(state)[7:]
    turn = momentum.slope_in_pendulum(angles)
    center, drift = momentum.center_of(lumped, angles, velocity)
    rows = momentum.momentum_rows(lumped, angles, turn, center)
    lift = (
        drift[0] + lumped.along_slope * angles.c_psi,
        drift[1] - lumped.along_slope * angles.s_psi,
        lumped.into_slope,
    )
    motion = momentum.motion_of(angles, velocity)
    rates = momentum.momentum_rates(lumped, motion, turn, velocity[momentum.PHI], lift)
    forces = [evaluate_once(jnp.asarray(rate)) for rate in rates]
    weighted = [{j: weight * row[j] for j in row} for weight, row in zip(momentum.weights(lumped), rows, strict=True)]

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


def accelerations(terms: Reduced, torque: Sequence[Array]) -> tuple[Array, ...]:
    """Solve M v' = B tau - h for v' (5), rad/s2."""
    drive, tilt = INPUT_COLUMNS
    applied = (sum_of_products((a, torque[0]), (b, torque[1])) for a, b in zip(drive, tilt, strict=True))
    right = [force - bias for force, bias in zip(applied, terms.bias, strict=True)]
    (solution,) = solve_positive_definite(terms.inertia, right)
    return solution


def affine(lumped: Lumped, state: State) -> Affine:
    """Solve the reduced dynamics for v', affine in the torques: f2 and the columns of G of (46)."""
    terms = reduced(lumped, state)
    right = [-bias for bias in terms.bias]
    return Affine(*solve_positive_definite(terms.inertia, right, *INPUT_COLUMNS))


def derivative_components(lumped: Lumped, state: State, torque: Sequence[Array]) -> tuple[Real, ...]:
    """Time derivative (q', v') of the state under drive and tilt torque, by components, Eq. (46)."""
    terms = reduced(lumped, state)
    return (*terms.center, *state[7:], *accelerations(terms, torque))


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
    if convention == "printed":
        return printed.derivative(robot, slope, state, torque)
    return jnp.stack(derivative_components(lump(robot, slope), tuple(state), tuple(torque)))


def mass_matrix(robot: Robot, state: State) -> Array:
    """Inertia matrix C^T M C of the reduced dynamics, (5, 5), kg m2."""
    lower = reduced(lump(robot, 0.0), tuple(jnp.asarray(state))).inertia
    return jnp.array([[lower[max(i, j)][min(i, j)] for j in range(5)] for i in range(5)])


def is_singular(state: State) -> Array:
    """Tell (bool) whether the lean is within SINGULAR_LEAN of 0 or pi, where precession and spin become one."""
    return jnp.abs(sincos(state[3])[0]) < np.sin(SINGULAR_LEAN)


def status(state: State) -> Array:
    """Status code of a state: SINGULAR_COORDINATES near a lean of 0 or pi, OK elsewhere."""
    return jnp.where(is_singular(state), code(Status.SINGULAR_COORDINATES), code(Status.OK))
