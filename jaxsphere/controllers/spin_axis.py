"""Where the spin axis of the shell points, and where it should point for the sphere to roll along a path.

    n      spin axis of the shell, unit             t, s   unit tangent and left normal of the path
    d      direction of the pendulum, unit          L      angular momentum about the contact point, N m s
    w      angular velocity of the shell, rad/s     u, k   unit vectors up the vertical and normal to the slope
    d*     d that the path asks for                 v_d    velocity that the path asks for, m/s

Gravity and the force at the contact give L no moment about the vertical, so u.(L + m_p l v_d x d) stays constant to first order
along a straight path, and u.w on any path that is followed exactly. The motors cannot change it: a transient leaves a constant
yaw rate. The shell that follows the path then turns at

    w = k x v_d / r + (c + tan(slope) v_dy / r) k,     c = u.w / cos(slope)

The spin axis is fixed in the shell, n' = w x n. With w constant every n but the one along w cones about w. With w changing
slowly the axis that does not cone is n* = unit(w + w' x w / w2).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.controllers.references import Pair, Reference
from jaxsphere.models.spatial import Lumped, State, attitude, dynamics
from jaxsphere.numerics import Real, evaluate_once
from jaxsphere.numerics.linear_algebra import Vector3, combine, cross, dot

# Below this speed (m/s) the path has no direction and the robot's own counts; below this rate (rad/s) a turn of w is ignored.
_CRAWL, _SLOW_TURNING = 1e-3, 0.7

# Of the rate of rolling: the largest yaw rate that n* follows.
_LARGEST_YAW = 0.5

NORMAL: Vector3 = (0.0, 0.0, 1.0)
ZERO: Vector3 = (0.0, 0.0, 0.0)


class Posture(NamedTuple):
    """What the law needs of a state, as vectors in O."""

    axis: Vector3  # n
    direction: Vector3  # d
    velocity: Vector3  # of the centre, m/s
    momentum: Vector3  # L, N m s


class PathFrame(NamedTuple):
    """Directions of the path now, and how fast a sphere rolls along it."""

    tangent: Vector3  # t
    left: Vector3  # s
    rolling: Array  # Omega, rad/s
    axis: Vector3  # n or -n, whichever points to the left


class AxisTarget(NamedTuple):
    """Axis n* without coning, and how far the spin axis is from it."""

    axis: Vector3  # n*
    heading_error: Real  # p, rad
    lean_error: Real  # q, rad


def posture_of(lumped: Lumped, state: State) -> Posture:
    """Extract axis, pendulum, velocity and angular momentum about the contact point from a state."""
    now = attitude.of_state(state)
    axes = attitude.axes_of(now)
    turning, gimbal = attitude.shell_turning_of(now), attitude.turning_of(now)
    dx, dz = dynamics.direction_of(now)
    zero = jnp.zeros_like(dx)
    direction = attitude.to_slope(axes, (dx, zero, dz))
    swing = attitude.to_slope(axes, cross((gimbal[0], gimbal[1] + now.pendulum_rate, gimbal[2]), (dx, zero, dz)))
    x, y, _ = attitude.to_slope(axes, dynamics.rolled(lumped, axes, now[8:]))
    velocity: Vector3 = (x, y, zero)
    transverse, axial = lumped.shell_transverse, lumped.shell_axial
    about_x, about_y, about_z = lumped.gimbal_inertia
    bob_x, bob_y, bob_z = dynamics.bob_spin(lumped, now)
    spins: Vector3 = (
        transverse * turning[0] + about_x * gimbal[0] + bob_x,
        transverse * turning[1] + about_y * gimbal[1] + bob_y,
        axial * turning[2] + about_z * gimbal[2] + bob_z,
    )
    bob = combine((lumped.radius, NORMAL), (lumped.length, direction))
    momentum = combine(
        (1.0, attitude.to_slope(axes, spins)),
        (lumped.central_mass * lumped.radius, cross(NORMAL, velocity)),
        (lumped.pendulum_mass, cross(bob, combine((1.0, velocity), (lumped.length, swing)))),
    )
    axis: Vector3 = (axes.upslope[2], axes.across[2], axes.normal[2])
    return Posture(axis, once(direction), once(velocity), once(momentum))


def path_frame(lumped: Lumped, reference: Reference, followed: Pair, axis: Vector3) -> PathFrame:
    """Frame of the path, rolling at the velocity `followed` (m/s); of the spin axis where the reference stands still."""
    x, y = reference.velocity
    square = x * x + y * y
    own = _CRAWL**3 / (square + _CRAWL**2)
    tangent = unit((x + own * axis[1], y - own * axis[0], 0.0))
    left = cross(NORMAL, tangent)
    facing = jnp.where(dot(axis, left) < 0.0, -1.0, 1.0)
    rolling = jnp.maximum(dot((*followed, 0.0), tangent), 1e-9) / lumped.radius
    return PathFrame(once(tangent), once(left), rolling, combine((facing, axis)))


def axis_target(lumped: Lumped, reference: Reference, posture: Posture, frame: PathFrame) -> AxisTarget:
    """Find n* and how far the spin axis is from it."""
    (x, y), (x_rate, y_rate) = reference.velocity, reference.acceleration
    steepness = lumped.along_slope / (lumped.into_slope * lumped.radius)
    yaw_rate = vertical_spin(lumped, reference, posture) + steepness * y
    largest = _LARGEST_YAW * frame.rolling + 1e-3
    yaw_rate = yaw_rate * (1.0 + (yaw_rate / largest) ** 16) ** -0.0625
    turning: Vector3 = (-y / lumped.radius, x / lumped.radius, yaw_rate)
    change: Vector3 = (-y_rate / lumped.radius, x_rate / lumped.radius, steepness * y_rate)
    still = 1e-6 * (1.0 + frame.rolling)  # keeps the axis defined where nothing turns
    followed = dot(turning, turning) + _SLOW_TURNING**2
    wanted = unit(combine((1.0, turning), (1.0 / followed, cross(change, turning)), (still, frame.left)))
    level = combine((1.0, frame.tangent), (-dot(frame.tangent, wanted), wanted))
    return AxisTarget(wanted, -dot(frame.axis, level), -dot(frame.axis, cross(frame.tangent, wanted)))


def vertical_spin(lumped: Lumped, reference: Reference, posture: Posture) -> Real:
    """Vertical spin c that the shell will have once it follows the path, rad/s."""
    velocity: Vector3 = (*reference.velocity, 0.0)
    turn = cross(velocity, (*reference.acceleration, 0.0))[2] / (dot(velocity, velocity) + _CRAWL**2)
    mass = lumped.central_mass + lumped.pendulum_mass
    shell = combine(
        (1.0, posture.momentum),
        (lumped.pendulum_mass * lumped.length, cross(velocity, posture.direction)),
        (-mass * lumped.radius, cross(NORMAL, velocity)),
        (-lumped.gimbal_inertia[0] * turn, NORMAL),
    )
    return upward(lumped, shell) / lumped.shell_axial


def yaw_of(lumped: Lumped, balance: Vector3, error: Vector3, swing: Vector3) -> Real:
    """Yaw (rad) of the shell that goes with an error (m) of the centre and a swing of the pendulum away from `balance`.

    Its rate is what the yaw rate differs by from that which c tells, to first order.
    """
    moment = lumped.pendulum_mass * lumped.length
    rolling = lumped.shell_axial / lumped.radius + (lumped.central_mass + lumped.pendulum_mass) * lumped.radius
    bob = combine((lumped.radius, NORMAL), (lumped.length, balance))
    gain = combine((rolling, cross(NORMAL, error)), (moment, cross(balance, error)), (moment, cross(bob, swing)))
    return -upward(lumped, gain) / lumped.shell_axial


def upward(lumped: Lumped, vector: Vector3) -> Real:
    """Component of a vector up the vertical, over the cosine of the slope."""
    return vector[0] * lumped.along_slope / lumped.into_slope + vector[2]


def once(vector: Vector3) -> Vector3:
    """Vector as something that XLA computes once and then reads."""
    x, y, z = (evaluate_once(jnp.asarray(component)) for component in vector)
    return x, y, z


def unit(vector: Vector3) -> Vector3:
    """Vector of length one along `vector`."""
    return combine((1.0 / jnp.sqrt(dot(vector, vector) + 1e-24), vector))
