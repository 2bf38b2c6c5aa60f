"""The demand of `axis_aligned`: track a path and at the same time turn the spin axis upright and across the path.

This is beyond the paper. Rolling straight, the spin axis cones about the axis of rotation and nothing in (57)-(58) damps it.

    t, s      unit tangent and left normal of the path                 n      spin axis of the shell, unit
    e_t, e_s  errors along and across the path, m                      n*     the axis about which the shell should turn, unit
    Omega     v_d / r, rate of rolling, rad/s                          zeta   `axis_damping`, of the coning pair
    L         angular momentum about the contact point, N m s          u      unit vector up the vertical
    d, d0     direction of the pendulum, and the one that balances the slope

Across the path, with heading error p = -n.t and lean error q = -n.(t x n*), rolling gives e_s'' = a and

    p' = Omega q + w        q' = e_s'/r - Omega p        w = yaw rate beyond that of n*

u.(L + m_p l v_d x d) is constant to first order. Hence a transient leaves a constant yaw rate, which n* takes in, and
w = (c_e e + c_d (d - d0))' is a rate itself: p - c_e e - c_d (d - d0) replaces p, and the rest is

    p' = Omega q        q' = e_s'/r - Omega (p + c_e e_s + c_d a)        c_e = t_x tan(slope) / r

with c_d for the lean that gives a. On the flat c_e = c_d = 0. The four gains that place the poles of this at
(s2 + k4 s + k3) (s2 + 2 zeta Omega s + Omega2), which is (59) times a damped coning pair, solve two pairs of equations:

    f_q / r + K f_p = 2 zeta Omega k4            f_e  = k3 + c_e f_p                           K = c_e - Omega2 c_d
    f_p / r - K f_q = 2 zeta (k3 - Omega2)       f_e' = k4 + 2 zeta Omega + Omega c_d f_q      a = -(f . states)

An error y corrected within one turn tilts the axis by y/r, so sqrt(k3) is kept below SLOWNESS Omega.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.controllers.lean import Pair, balancing_lean
from jaxsphere.controllers.references import Reference
from jaxsphere.models.spatial import frames
from jaxsphere.models.spatial.frames import State
from jaxsphere.models.spatial.momentum import Lumped
from jaxsphere.numerics import Real, sincos
from jaxsphere.numerics.linear_algebra import Vector3, cross, dot

if TYPE_CHECKING:
    from jaxsphere.controllers.tracking import TrackingGains

# Across the path no faster than this many radians per radian of rolling, and no slower than so many 1/s.
SLOWNESS, SLOWEST = 0.7, 0.3

# Of the discriminant of the lean's equation: what a demand leaves of it, and at most this part of what there is without one.
LEAN_MARGIN, LEAN_SHARE = 0.12, 0.5

# Below this speed (m/s) the path has no direction, and the robot's own counts; below this rate (1/s) the axis is not damped.
_CRAWL, _SLOW_ROLL = 1e-3, 0.7

_NORMAL: Vector3 = (0.0, 0.0, 1.0)


class Posture(NamedTuple):
    """What the law needs of a state, as vectors in O."""

    axis: Vector3  # n
    direction: Vector3  # d
    velocity: Vector3  # of the centre, m/s
    momentum: Vector3  # L, N m s


class AxisTarget(NamedTuple):
    """Where the spin axis should be, and how far it is from there."""

    axis: Vector3  # n*
    yaw_rate: Array  # that the transient has left, rad/s
    heading_error: Array  # p, rad
    lean_error: Array  # q, rad


def posture_of(lumped: Lumped, state: State) -> Posture:
    """Extract axis, pendulum, velocity and angular momentum about the contact point from a state."""
    (s_psi, c_psi), (s_theta, c_theta) = sincos(state[2]), sincos(state[3])
    s_gimbal, c_gimbal = sincos(state[5])
    frame_x: Vector3 = (c_psi * c_theta, s_psi * c_theta, -s_theta)
    frame_y: Vector3 = (-s_psi, c_psi, jnp.zeros_like(s_psi))
    axis: Vector3 = (c_psi * s_theta, s_psi * s_theta, c_theta)
    gimbal_x = _sum((c_gimbal, frame_x), (s_gimbal, frame_y))
    gimbal_y = _sum((-s_gimbal, frame_x), (c_gimbal, frame_y))
    turning = frames.angular_velocity(state)
    frame_turning: Vector3 = (-state[8] * s_psi, state[8] * c_psi, state[7])
    gimbal_turning = _sum((1.0, frame_turning), (state[10], axis))
    direction = frames.pendulum_direction(state)
    swing = cross(_sum((1.0, gimbal_turning), (state[11], gimbal_y)), direction)
    velocity: Vector3 = (lumped.radius * turning[1], -lumped.radius * turning[0], jnp.zeros_like(s_psi))
    transverse, axial = lumped.shell_transverse, lumped.shell_axial
    about_x, about_y, about_z = lumped.gimbal_inertia
    bob = _sum((lumped.radius, _NORMAL), (lumped.length, direction))
    momentum = _sum(
        (transverse, turning),
        ((axial - transverse) * dot(turning, axis), axis),
        (about_x * dot(gimbal_turning, gimbal_x), gimbal_x),
        (about_y * dot(gimbal_turning, gimbal_y), gimbal_y),
        (about_z * dot(gimbal_turning, axis), axis),
        (lumped.central_mass * lumped.radius, cross(_NORMAL, velocity)),
        (lumped.pendulum_mass, cross(bob, _sum((1.0, velocity), (lumped.length, swing)))),
    )
    return Posture(axis, direction, velocity, momentum)


def demanded_acceleration(lumped: Lumped, gains: TrackingGains, reference: Reference, posture: Posture, error: Pair) -> Pair:
    """Acceleration asked of the centre, m/s2: (58) along the path, and across it with the spin axis damped.

    Args:
        lumped: robot and slope. gains: k1, k2 along and k3, k4 across the path, and `axis_damping`.
        reference: desired motion now. posture: of the robot. error: of the centre, m.
    """
    tangent, speed, facing = _tangent(reference, posture.axis)
    axis = _scale(facing, posture.axis)
    left = cross(_NORMAL, tangent)
    rolling = speed / lumped.radius
    target = _target(lumped, reference, posture, tangent, rolling, axis)
    apart: Vector3 = (error[0], error[1], 0.0)
    moving: Vector3 = (
        posture.velocity[0] - reference.velocity[0],
        posture.velocity[1] - reference.velocity[1],
        0.0,
    )
    balance = balancing_lean(lumped, (0.0, 0.0)).direction
    heading = target.heading_error - _yaw(lumped, balance, apart, _sum((1.0, posture.direction), (-1.0, balance)))
    per_error = _yaw(lumped, balance, left, (0.0, 0.0, 0.0))
    per_demand = _yaw(lumped, balance, (0.0, 0.0, 0.0), _lean_per_demand(lumped, balance, left))

    root = jnp.sqrt(jnp.asarray(gains.k3))
    fastest = jnp.sqrt((SLOWNESS * rolling) ** 2 + SLOWEST**2)
    slower = 1.0 / jnp.sqrt(jnp.sqrt(1.0 + (root / fastest) ** 4))
    k3, k4 = gains.k3 * slower**2, gains.k4 * slower
    zeta = gains.axis_damping * rolling**2 / (rolling**2 + _SLOW_ROLL**2)
    coupling = lumped.radius * (per_error - rolling**2 * per_demand)
    lean_side = 2.0 * zeta * rolling * k4
    heading_side = 2.0 * zeta * (k3 - rolling**2)
    share = lumped.radius / (1.0 + coupling**2)
    of_lean = share * (lean_side - coupling * heading_side)
    of_heading = share * (heading_side + coupling * lean_side)
    across = (
        (k3 + per_error * of_heading) * dot(apart, left)
        + (k4 + 2.0 * zeta * rolling + rolling * per_demand * of_lean) * dot(moving, left)
        + of_heading * heading
        + of_lean * target.lean_error
    )
    along = gains.k1 * dot(apart, tangent) + gains.k2 * dot(moving, tangent)
    x, y, _ = _sum((-along, tangent), (-across, left))
    return reference.acceleration[0] + x, reference.acceleration[1] + y


def limit(lumped: Lumped, demand: Pair, largest: Real) -> Pair:
    """Shrink a demand to what `largest` (m/s2) and the lean allow, keeping its direction; hardly anything below 3/4 of it.

    The discriminant of the lean's equation is quadratic in the size of the demand; a part of it is kept.
    """
    square = dot(demand, demand)
    moving = square > 1e-24
    size = jnp.sqrt(jnp.where(moving, square, 1.0))
    along = jnp.where(moving, demand[0] / size, 1.0), jnp.where(moving, demand[1] / size, 0.0)
    still, ahead, back = (balancing_lean(lumped, (factor * along[0], factor * along[1])).margin for factor in (0.0, 1.0, -1.0))
    spare = jnp.maximum(still - jnp.minimum(LEAN_MARGIN, LEAN_SHARE * still), 1e-6)
    slope, bend = 0.5 * (ahead - back), still - 0.5 * (ahead + back)  # spare + slope a - bend a2 = 0, bend > 0
    feasible = 2.0 * spare / (jnp.sqrt(slope * slope + 4.0 * bend * spare) - slope)
    excess = square**4 * (feasible**-8 + (1.0 / largest) ** 8)
    factor = (1.0 + excess) ** -0.125
    return demand[0] * factor, demand[1] * factor


def _target(
    lumped: Lumped, reference: Reference, posture: Posture, tangent: Vector3, rolling: Array, axis: Vector3
) -> AxisTarget:
    """Axis n* and the errors of the spin axis from it."""
    velocity: Vector3 = (reference.velocity[0], reference.velocity[1], 0.0)
    square = dot(velocity, velocity)
    turn = cross(velocity, (reference.acceleration[0], reference.acceleration[1], 0.0))[2] / (square + _CRAWL**2)
    mass = lumped.central_mass + lumped.pendulum_mass
    steady = lumped.shell_axial / lumped.radius + mass * lumped.radius
    rest = _sum(
        (1.0, posture.momentum),
        (lumped.pendulum_mass * lumped.length, cross(velocity, posture.direction)),
        (-steady, cross(_NORMAL, velocity)),
    )
    yaw = (lumped.along_slope * rest[0] + lumped.into_slope * rest[2]) / (lumped.shell_axial * lumped.into_slope)
    largest = 0.5 * rolling + 1e-3
    yaw = yaw * (1.0 + (yaw / largest) ** 8) ** -0.125
    wanted = _sum((rolling, cross(_NORMAL, tangent)), (yaw - turn, _NORMAL))
    wanted = _scale(1.0 / jnp.sqrt(dot(wanted, wanted) + 1e-12), wanted)
    return AxisTarget(wanted, yaw, -dot(axis, tangent), -dot(axis, cross(tangent, wanted)))


def _tangent(reference: Reference, axis: Vector3) -> tuple[Vector3, Array, Array]:
    """Direction of the path, its speed (m/s), and which of the two senses of the spin axis is its left, +-1."""
    x, y = reference.velocity
    square = x * x + y * y
    own = _CRAWL**3 / (square + _CRAWL**2)
    ahead: Vector3 = (x + own * axis[1], y - own * axis[0], 0.0)
    size = jnp.sqrt(dot(ahead, ahead) + 1e-24)
    tangent = _scale(1.0 / size, ahead)
    facing = jnp.where(dot(axis, cross(_NORMAL, tangent)) < 0.0, -1.0, 1.0)
    return tangent, jnp.sqrt(square + 1e-24), facing


def _yaw(lumped: Lumped, balance: Vector3, error: Vector3, swing: Vector3) -> Array:
    """Yaw (rad) of the shell that goes with an error (m) of the centre and a swing of the pendulum away from balance."""
    moment = lumped.pendulum_mass * lumped.length
    steady = lumped.shell_axial / lumped.radius + (lumped.central_mass + lumped.pendulum_mass) * lumped.radius
    bob = _sum((lumped.radius, _NORMAL), (lumped.length, balance))
    gain = _sum((steady, cross(_NORMAL, error)), (moment, cross(balance, error)), (moment, cross(bob, swing)))
    return -(lumped.along_slope * gain[0] + lumped.into_slope * gain[2]) / (lumped.shell_axial * lumped.into_slope)


def _lean_per_demand(lumped: Lumped, balance: Vector3, along: Vector3) -> Vector3:
    """Change of the balancing direction per unit of a demand `along`, s2/m."""
    moment = lumped.pendulum_mass * lumped.length
    mass = lumped.central_mass + lumped.pendulum_mass
    heavy = lumped.shell_axial / lumped.radius + mass * lumped.radius + moment * balance[2]
    x = heavy * along[0] / (moment * (lumped.into_slope + lumped.along_slope * balance[0] / balance[2]))
    return x, heavy * along[1] / (moment * lumped.into_slope), -x * balance[0] / balance[2]


def _sum(*terms: tuple[Real, Vector3]) -> Vector3:
    x, y, z = (sum(factor * vector[i] for factor, vector in terms) for i in range(3))
    return x, y, z


def _scale(factor: Real, vector: Vector3) -> Vector3:
    return factor * vector[0], factor * vector[1], factor * vector[2]
