"""How the spatial robot moves: equations (19)-(26), (30), (31), (35) and (41)-(44).

    x, y    centre of the sphere along the slope, m; x points up-slope        frame O: x, y, and z normal to the slope
    psi     precession, rad, about the normal                                 frame B: R_B^O = Rz(psi) Ry(theta); follows the
    theta   lean, rad; pi/2 upright, 0 and pi singular                                 spin axis, but does not spin
    phi     spin of the shell about z of B, rad                               frame C: turned with the gimbal, about z of B
    beta1   gimbal angle about z of B, rad                                    frame D: turned with the pendulum, about y of C
    beta2   pendulum angle about y of C, rad

    q = (x, y, psi, theta, phi, beta1, beta2) and v = (psi', theta', phi', beta1', beta2'); a state is the 12 components (q, v),
    as an array (12,) or any sequence of equally shaped arrays. Vectors are tuples of components.

Differs from the paper (`printed` keeps what is printed, where it can be evaluated):
    (20)  is the angular velocity turned by 90 degrees about the normal; it contradicts (19) and (26), which are right.
    (21)  the centre is at +r k from the contact point, not at -r k.
    (22), (23), and with them A(q) in (40) and A2 in (42), mirror rolling: (x', y') for (-y', -x'). They follow from the printed
          (20) and (21) with neither sign of r.
    (31)  needs the rate of beta1 where the angle is printed, and the angular velocity of B. Always corrected: the printed sum
          of a rate and an angle has no meaning.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.numerics import Real, sincos
from jaxsphere.numerics.linear_algebra import Vector3, cross
from jaxsphere.robot import Robot

State = Sequence[Array] | Array


class SpatialState(NamedTuple):
    """The components of a state by name, in their order: `SpatialState(*state)`."""

    x: Array  # m
    y: Array  # m
    precession: Array  # psi, rad
    lean: Array  # theta, rad
    spin: Array  # phi, rad
    gimbal_angle: Array  # beta1, rad
    pendulum_angle: Array  # beta2, rad
    precession_rate: Array  # rad/s
    lean_rate: Array  # rad/s
    spin_rate: Array  # rad/s
    gimbal_rate: Array  # rad/s
    pendulum_rate: Array  # rad/s


def body_rotation(state: State) -> Array:
    """Rotation R_B^O that takes components in B to components in O, (3, 3), Eq. (19)."""
    now = SpatialState(*state)
    (s_psi, c_psi), (s_theta, c_theta) = sincos(now.precession), sincos(now.lean)
    return jnp.array(
        [
            [c_psi * c_theta, -s_psi, c_psi * s_theta],
            [s_psi * c_theta, c_psi, s_psi * s_theta],
            [-s_theta, jnp.zeros_like(s_theta), c_theta],
        ]
    )


def angular_velocity(state: State) -> Vector3:
    """Angular velocity of the shell, components in O, rad/s, Eq. (20).

    Differs from the paper: the printed vector is this one turned by +90 degrees about the normal.
    """
    now = SpatialState(*state)
    (s_psi, c_psi), (s_theta, c_theta) = sincos(now.precession), sincos(now.lean)
    psi_rate, theta_rate, spin_rate = now.precession_rate, now.lean_rate, now.spin_rate
    along_x = -theta_rate * s_psi + spin_rate * c_psi * s_theta
    along_y = theta_rate * c_psi + spin_rate * s_psi * s_theta
    along_z = psi_rate + spin_rate * c_theta
    return along_x, along_y, along_z


def center_velocity(robot: Robot, state: State) -> Vector3:
    """Velocity of the centre of the sphere from its rotation about the contact point, components in O, m/s, Eq. (21).

    Differs from the paper: the arm is +r k, from the contact point to the centre.
    """
    normal = (0.0, 0.0, robot.shell_radius)
    return cross(angular_velocity(state), normal)


def rolling_velocity(robot: Robot, state: State) -> tuple[Real, Real]:
    """Velocity (x', y') of a sphere that rolls without slipping, m/s, Eq. (22), Eq. (23).

    Differs from the paper: the printed pair is (-y', -x') of this one.
    """
    now = SpatialState(*state)
    (s_psi, c_psi), (s_theta, _) = sincos(now.precession), sincos(now.lean)
    theta_rate, spin_rate = now.lean_rate, now.spin_rate
    x_rate = robot.shell_radius * (theta_rate * c_psi + spin_rate * s_psi * s_theta)
    y_rate = robot.shell_radius * (theta_rate * s_psi - spin_rate * c_psi * s_theta)
    return x_rate, y_rate


def center_position(robot: Robot, state: State) -> Vector3:
    """Centre of the sphere in O, m; z' = 0 keeps it a radius above the slope, Eq. (24), Eq. (25)."""
    now = SpatialState(*state)
    return now.x, now.y, robot.shell_radius + 0.0 * now.x


def gimbal_position(robot: Robot, state: State) -> Vector3:
    """Centre of mass of the gimbal in O, m: the centre of the sphere, Eq. (30)."""
    return center_position(robot, state)


def shell_angular_velocity(state: State) -> Vector3:
    """Angular velocity of the shell, components in B, rad/s, Eq. (26)."""
    now = SpatialState(*state)
    along_x, along_y, along_z = frame_angular_velocity(state)
    return along_x, along_y, along_z + now.spin_rate


def frame_angular_velocity(state: State) -> Vector3:
    """Angular velocity of frame B itself, components in B, rad/s: precession and lean, no spin."""
    now = SpatialState(*state)
    s_theta, c_theta = sincos(now.lean)
    return -now.precession_rate * s_theta, now.lean_rate, now.precession_rate * c_theta


def gimbal_angular_velocity(state: State) -> Vector3:
    """Angular velocity of the gimbal, components in C, rad/s, Eq. (31).

    Differs from the paper: the last entry adds the rate of beta1, not beta1, and starts from the angular velocity of B.
    """
    now = SpatialState(*state)
    along_x, along_y, along_z = frame_angular_velocity(state)
    s_gimbal, c_gimbal = sincos(now.gimbal_angle)
    return c_gimbal * along_x + s_gimbal * along_y, -s_gimbal * along_x + c_gimbal * along_y, along_z + now.gimbal_rate


def pendulum_angular_velocity(state: State) -> Vector3:
    """Angular velocity of the pendulum, components in D, rad/s."""
    now = SpatialState(*state)
    (x, y, z), (s_pendulum, c_pendulum) = gimbal_angular_velocity(state), sincos(now.pendulum_angle)
    return c_pendulum * x - s_pendulum * z, y + now.pendulum_rate, s_pendulum * x + c_pendulum * z


def pendulum_direction(state: State) -> Vector3:
    """Unit vector from the centre to the bob, components in O."""
    now = SpatialState(*state)
    (s_psi, c_psi), (s_theta, c_theta) = sincos(now.precession), sincos(now.lean)
    along_x, along_y, along_z = pendulum_direction_in_body(state)
    out = c_theta * along_x + s_theta * along_z
    return c_psi * out - s_psi * along_y, s_psi * out + c_psi * along_y, -s_theta * along_x + c_theta * along_z


def pendulum_direction_in_body(state: State) -> Vector3:
    """Unit vector from the centre to the bob, components in B; (1, 0, 0) at beta1 = beta2 = 0."""
    now = SpatialState(*state)
    (s_gimbal, c_gimbal), (s_pendulum, c_pendulum) = sincos(now.gimbal_angle), sincos(now.pendulum_angle)
    return c_gimbal * c_pendulum, s_gimbal * c_pendulum, -s_pendulum


def pendulum_position(robot: Robot, state: State) -> Vector3:
    """Bob of the pendulum in O, m: the centre of the sphere plus l times the pendulum's direction, Eq. (35)."""
    x, y, z = center_position(robot, state)
    along_x, along_y, along_z = pendulum_direction(state)
    length = robot.pendulum_length
    return x + length * along_x, y + length * along_y, z + length * along_z


def pendulum_velocity(robot: Robot, state: State, center: tuple[Real, Real] | None = None) -> Vector3:
    """Velocity of the bob, components in O, m/s; the centre rolls, or moves with the velocity `center` (m/s)."""
    center = rolling_velocity(robot, state) if center is None else center
    rates = (*center, *state[7:], *(jnp.zeros_like(rate) for rate in state[7:]))
    return jax.jvp(lambda *now: pendulum_position(robot, now), tuple(state), rates)[1]


def constraint_matrix(robot: Robot, state: State) -> Array:
    """Matrix A(q) = [I, A2] of the rolling constraints, (2, 7), the one in (40)."""
    now = SpatialState(*state)
    (s_psi, c_psi), (s_theta, _) = sincos(now.precession), sincos(now.lean)
    zero, one, radius = jnp.zeros_like(s_psi), jnp.ones_like(s_psi), robot.shell_radius
    lean_x, spin_x = radius * c_psi, radius * s_psi * s_theta
    lean_y, spin_y = radius * s_psi, -radius * c_psi * s_theta
    return jnp.array(
        [
            [one, zero, zero, -lean_x, -spin_x, zero, zero],
            [zero, one, zero, -lean_y, -spin_y, zero, zero],
        ]
    )


def constraint_residual(robot: Robot, state: State, rates: Sequence[Array]) -> Array:
    """Slip A(q) q' of coordinate rates q' (7), m/s, (2,); zero when the sphere rolls, Eq. (41)."""
    return constraint_matrix(robot, state) @ jnp.stack(tuple(rates))


def null_space(robot: Robot, state: State) -> Array:
    """Matrix C(q), (7, 5), whose columns span the motions that satisfy the constraints, Eq. (42)."""
    free = constraint_matrix(robot, state)[:, 2:]
    return jnp.concatenate([-free, jnp.eye(5, dtype=free.dtype)])


def coordinate_rates(robot: Robot, state: State) -> tuple[Real, ...]:
    """Rates q' = C(q) v of the seven coordinates, m/s and rad/s, Eq. (43)."""
    return (*rolling_velocity(robot, state), *state[7:])


def coordinate_accelerations(robot: Robot, state: State, accelerations: Sequence[Real]) -> tuple[Real, ...]:
    """Second rates q'' = C v' + C' v of the seven coordinates, m/s2 and rad/s2, for given v' (5), Eq. (44)."""
    rates = (*coordinate_rates(robot, state), *accelerations)
    return jax.jvp(lambda *now: coordinate_rates(robot, now), tuple(state), rates)[1]
