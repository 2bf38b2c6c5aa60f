"""The demand of `axis_aligned`: follow a path and turn the spin axis to where it does not cone.

This is beyond the paper: rolling straight, the spin axis cones about the axis of rotation and nothing in (57)-(58) damps it.
Symbols as in `spin_axis`, and

    e_t, e_s  errors along and across the path, m              Omega  v_d / r, rate of rolling, rad/s
    p, q      heading and lean error of the spin axis, rad     zeta   `axis_damping`, damping ratio of the coning

Across the path the centre obeys e_s'' = a, and the spin axis

    p' = Omega q + (c_e e_s + c_d a)'        q' = e_s'/r - Omega p

where c_e e_s + c_d a is the yaw that goes with an error and with the lean that gives a (`spin_axis.yaw_of`); on the flat both
are 0. With p less that yaw for p, four gains a = -(f_e e_s + f_e' e_s' + f_p p + f_q q) place the poles at

    (s2 + k4 s + k3) (s2 + 2 zeta Omega s + Omega2),

which is (59) times a damped pair in place of the coning. Comparing coefficients, with K = c_e - Omega2 c_d,

    f_q / r + K f_p = 2 zeta Omega k4            f_e  = k3 + c_e f_p
    f_p / r - K f_q = 2 zeta (k3 - Omega2)       f_e' = k4 + 2 zeta Omega + Omega c_d f_q

An error y that is corrected within less than a turn tilts the axis by y/r, so sqrt(k3) is held below about FASTEST Omega.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.controllers.lean import Pair, balancing_lean
from jaxsphere.controllers.references import Reference
from jaxsphere.controllers.spin_axis import ZERO, PathFrame, Posture, axis_target, once, path_frame, yaw_of
from jaxsphere.controllers.tracking_gains import TrackingGains
from jaxsphere.models.spatial import Lumped
from jaxsphere.numerics import Real
from jaxsphere.numerics.linear_algebra import Vector3, combine, dot

# Across the path no faster than this many radians per radian of rolling, but as fast as so many 1/s in any case.
FASTEST, SLOWEST = 0.8, 0.35

# Difference of the velocities of robot and path (m/s) from which on the robot's own counts for the spin axis.
CREDIT = 0.25

# Below this rate of rolling (rad/s) the axis is not damped.
SLOW_ROLL = 0.43

# Of the discriminant of the lean's equation: what a demand leaves of it, and at most this part of what there is without one.
LEAN_MARGIN, LEAN_SHARE = 0.12, 0.5


class Sideways(NamedTuple):
    """Gains across the path at one rate of rolling."""

    error: Real  # f_e, 1/s2
    error_rate: Real  # f_e', 1/s
    heading: Real  # f_p, m/s2
    lean: Real  # f_q, m/s2


def sideways_gains(gains: TrackingGains, radius: Real, rolling: Array, per_error: Real, per_demand: Real) -> Sideways:
    """Place the four poles across the path.

    Args:
        gains: k3, k4 and `axis_damping`.
        radius: of the shell, m.
        rolling: Omega, rad/s.
        per_error: c_e, rad/m.
        per_demand: c_d, rad s2/m.
    """
    fastest = (FASTEST * rolling) ** 2 + SLOWEST**2
    slower = (1.0 + (gains.k3 / fastest) ** 2) ** -0.25
    k3, k4 = gains.k3 * slower**2, gains.k4 * slower
    zeta = gains.axis_damping * rolling**2 / (rolling**2 + SLOW_ROLL**2)
    coupling = radius * (per_error - rolling**2 * per_demand)
    of_lean, of_heading = 2.0 * zeta * rolling * k4, 2.0 * zeta * (k3 - rolling**2)
    share = radius / (1.0 + coupling**2)
    heading = share * (of_heading + coupling * of_lean)
    lean = share * (of_lean - coupling * of_heading)
    return Sideways(k3 + per_error * heading, k4 + 2.0 * zeta * rolling + rolling * per_demand * lean, heading, lean)


def followed_velocity(reference: Reference, posture: Posture) -> Pair:
    """Velocity of the path, or the robot's own as soon as the two differ by more than CREDIT, m/s.

    What is known about the spin axis holds for small differences; a robot that catches up still rolls at its own rate.
    """
    x, y = posture.velocity[0] - reference.velocity[0], posture.velocity[1] - reference.velocity[1]
    square = (x * x + y * y) / CREDIT**2
    share = square / (1.0 + square)
    return reference.velocity[0] + share * x, reference.velocity[1] + share * y


def demanded_acceleration(lumped: Lumped, gains: TrackingGains, reference: Reference, posture: Posture, error: Pair) -> Pair:
    """Acceleration asked of the centre, m/s2: (58) along the path, and across it with the spin axis damped.

    Args:
        lumped: robot and slope.
        gains: k1, k2 along and k3, k4 across the path, and `axis_damping`.
        reference: desired motion now.
        posture: of the robot.
        error: of the centre, m.
    """
    followed = followed_velocity(reference, posture)
    frame = path_frame(lumped, reference, followed, posture.axis)
    apart: Vector3 = (*error, 0.0)
    moving = combine((1.0, posture.velocity), (-1.0, (*reference.velocity, 0.0)))
    along = gains.k1 * dot(apart, frame.tangent) + gains.k2 * dot(moving, frame.tangent)
    across = _across(lumped, gains, reference._replace(velocity=followed), posture, frame, apart, moving)
    x, y, _ = once(combine((1.0, (*reference.acceleration, 0.0)), (-along, frame.tangent), (-across, frame.left)))
    return x, y


def _across(
    lumped: Lumped,
    gains: TrackingGains,
    reference: Reference,
    posture: Posture,
    frame: PathFrame,
    apart: Vector3,
    moving: Vector3,
) -> Real:
    """Deceleration across the path for errors of the centre (m, m/s) and of the spin axis, m/s2."""

    def direction(x: Real, y: Real) -> Vector3:
        return balancing_lean(lumped, (x, y)).direction

    balance, leaning = jax.jvp(direction, reference.acceleration, (frame.left[0], frame.left[1]))
    balance, leaning = once(balance), once(leaning)
    per_error, per_demand = yaw_of(lumped, balance, frame.left, ZERO), yaw_of(lumped, balance, ZERO, leaning)
    sideways = sideways_gains(gains, lumped.radius, frame.rolling, per_error, per_demand)
    target = axis_target(lumped, reference, posture, frame)
    heading = target.heading_error - yaw_of(lumped, balance, apart, combine((1.0, posture.direction), (-1.0, balance)))
    return (
        sideways.error * dot(apart, frame.left)
        + sideways.error_rate * dot(moving, frame.left)
        + sideways.heading * heading
        + sideways.lean * target.lean_error
    )


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
    factor = (1.0 + square**4 * (feasible**-8 + (1.0 / largest) ** 8)) ** -0.125
    return demand[0] * factor, demand[1] * factor
