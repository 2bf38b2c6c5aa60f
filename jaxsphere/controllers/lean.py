"""The lean of the pendulum that accelerates the robot as demanded, and where that puts the two joints.

    d       unit vector from the centre to the bob, in O; d_z < 0 below the centre
    a       acceleration of the centre asked for, (x, y), m/s2
    M       total mass, kg
    I_s     moment of the shell about its spin axis, kg m2

With d held fixed in space, the angular momentum about the contact point gives

    m_p l g cos(gamma) d_xy = (I_s/r + M r + m_p l d_z) a + (M r + m_p l d_z) g sin(gamma) (1, 0)        |d| = 1

a quadratic in d_z. At a = 0 it is (2). This is not in the paper: its own controllers do not move the robot (see `tracking`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial import Lumped, State, attitude
from jaxsphere.numerics import Real, evaluate_once, sincos
from jaxsphere.numerics.linear_algebra import Vector3, dot

Pair = tuple[Real, Real]

# Square of the smallest sine between lean and spin axis that still defines a gimbal angle.
_AXIS_MARGIN = 1e-12


class Lean(NamedTuple):
    """Direction of the pendulum in O, and how far the demand is from what no lean can give."""

    direction: Vector3
    margin: Array  # discriminant over m_p l g cos(gamma) squared; negative where the demand is infeasible


class Joints(NamedTuple):
    """How far the joints are from a lean, wrapped to (-pi, pi], and how that changes; rad and rad/s."""

    error: tuple[Array, Array]  # beta* - beta
    rate: tuple[Array, Array]  # beta*' - beta'


def balancing_lean(lumped: Lumped, demand: Pair) -> Lean:
    """Solve the balance for the pendulum's direction.

    Where no lean gives the demand, the direction is the nearest to a solution, and the margin is negative.

    Args:
        lumped: robot and slope.
        demand: a, m/s2.
    """
    radius, moment = lumped.radius, lumped.pendulum_mass * lumped.length
    rolling = (lumped.central_mass + lumped.pendulum_mass) * radius
    weight = moment * lumped.into_slope
    still = ((lumped.shell_axial / radius + rolling) * demand[0] + rolling * lumped.along_slope) / weight
    still_y = (lumped.shell_axial / radius + rolling) * demand[1] / weight
    lowered, lowered_y = moment * (demand[0] + lumped.along_slope) / weight, moment * demand[1] / weight
    square = 1.0 + lowered * lowered + lowered_y * lowered_y
    half = still * lowered + still_y * lowered_y
    margin = half * half - square * (still * still + still_y * still_y - 1.0)
    feasible = margin > 0.0
    root = jnp.where(feasible, jnp.sqrt(jnp.where(feasible, margin, 1.0)), 0.0)
    down = -(half + root) / square
    across, across_y = still + down * lowered, still_y + down * lowered_y
    norm = jnp.sqrt(across * across + across_y * across_y + down * down)
    return Lean((across / norm, across_y / norm, down / norm), jnp.asarray(margin))


def joints_to(state: State, direction: Vector3) -> Joints:
    """Find how far the gimbal and pendulum angles are from those that point the pendulum along `direction` (fixed in O)."""
    now = attitude.of_state(state)
    x, y, z = (evaluate_once(jnp.asarray(part)) for part in attitude.to_gimbal(attitude.axes_of(now), direction))
    turning_x, turning_y, turning_z = attitude.turning_of(now)
    s_pendulum, c_pendulum = sincos(now.pendulum_angle)
    square = jnp.maximum(x * x + y * y, _AXIS_MARGIN)
    across = jnp.sqrt(square)
    gimbal_rate = z * (x * turning_x + y * turning_y) / square - turning_z
    pendulum_rate = (y * turning_x - x * turning_y) / across - now.pendulum_rate
    return Joints(
        error=(jnp.arctan2(y, x), jnp.arctan2(-z * c_pendulum - across * s_pendulum, across * c_pendulum - z * s_pendulum)),
        rate=(gimbal_rate, pendulum_rate),
    )


def limit(demand: Pair, largest: Real) -> Pair:
    """Shrink a demand smoothly to less than `largest` (m/s2), a_max tanh(|v| / a_max) v / |v|, keeping its direction."""
    square = dot(demand, demand)
    moving = square > 1e-24 * largest * largest
    size = jnp.sqrt(jnp.where(moving, square, 1.0))
    factor = jnp.where(moving, largest * jnp.tanh(size / largest) / size, 1.0)
    return demand[0] * factor, demand[1] * factor
