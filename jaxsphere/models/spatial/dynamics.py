"""Dynamics of the spatial robot on a slope: equations (45) and (46), in the gimbal's frame C.

The two torques (N m) are

    tau1    drive: between gimbal and shell, about the spin axis; tau1 > 0 rolls the shell forward
    tau2    tilt: between gimbal and pendulum, about y of C

The speeds are u = (omega, nu, beta2'), see `attitude`; in C they need no sine but that of beta2, and shell and gimbal have
constant moments there. With k the normal of the slope, d the pendulum's direction, Omega = omega + nu e3 and
Pi = omega + beta2' e2 the angular velocities of shell and pendulum, all in C, the bodies move with

    v = r Omega x k      v + l Pi x d      Omega      omega      Pi        and        M u' + h = (0, 0, 0, tau1, tau2)

follows from the balance of power for every u. As in `planar`, `lump` gathers constants, and the functions on a `Lumped` are
what a rollout evaluates; they take states of 13 components, or of the 12 of the paper.

Differs from the paper:
    B in (40)   has +1 on spin and +1 on beta1. Both turn about z of B in the same sense, so a motor between shell and gimbal
                acts with opposite signs, (+1, -1); the printed pair is a torque from outside the robot.
    (27)        takes I_xxs and I_yys in B, which does not spin. That holds for I_xxs = I_yys only: `check_spatial_robot`.
    tau1, tau2  are named tilt and drive in the text; by B it is the other way round.
`paper` has all this in the paper's coordinates, `printed` the model with the printed constraints and B.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.friction import Losses, joint_loss, smooth_sign
from jaxsphere.models.spatial import attitude
from jaxsphere.models.spatial.attitude import Axes, GimbalState
from jaxsphere.models.spatial.frames import State
from jaxsphere.models.spatial.lumped import Lumped
from jaxsphere.numerics import Real, evaluate_once, sincos
from jaxsphere.numerics.linear_algebra import Vector3, combine, cross, dot, solve_positive_definite

# What drive and tilt torque do on u.
INPUT_COLUMNS = (0.0, 0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0)


class Reduced(NamedTuple):
    """Reduced dynamics M u' + h = (0, 0, 0, tau1, tau2) at one state, by components."""

    inertia: tuple[tuple[Real, ...], ...]  # lower triangle of M, kg m2
    bias: tuple[Real, ...]  # h, N m


class Affine(NamedTuple):
    """u' = drift + drive tau1 + tilt tau2; each entry is (5), rad/s2 and 1/(kg m2)."""

    drift: tuple[Array, ...]
    drive: tuple[Array, ...]
    tilt: tuple[Array, ...]


def pendulum_turning(direction: tuple[Real, Real], speeds: Sequence[Real]) -> Vector3:
    """Angular velocity of the pendulum in its own frame D, rad/s; `direction` is that of the bob, x and z in C."""
    (dx, dz), (x, y, z, _, swing) = direction, speeds
    return dx * x + dz * z, y + swing, dx * z - dz * x


def _out_of_pendulum(direction: tuple[Real, Real], vector: Vector3) -> Vector3:
    """Turn components in the pendulum's frame D into components in C."""
    (dx, dz), (x, y, z) = direction, vector
    return dx * x - dz * z, y, dz * x + dx * z


def bob_spin(lumped: Lumped, now: GimbalState) -> Vector3:
    """Angular momentum of the bob about its own centre of mass, in C, N m s."""
    direction, offset = direction_of(now), lumped.pendulum_mass * lumped.length**2
    (a, b, c), (x, y, z) = lumped.pendulum_inertia, pendulum_turning(direction, now[8:])
    return _out_of_pendulum(direction, (a * x, (b - offset) * y, (c - offset) * z))


def direction_of(now: GimbalState) -> tuple[Array, Array]:
    """Direction of the bob from the centre, x and z in C; there is no y."""
    sine, cosine = sincos(now.pendulum_angle)
    return cosine, -sine


def reduced(lumped: Lumped, now: GimbalState, axes: Axes) -> Reduced:
    """Assemble M and h of C^T (M C v' + M C' v + N) = C^T B tau for the speeds u, Eq. (45)."""
    direction = direction_of(now)
    bias = _bias(lumped, now, axes, direction)
    if lumped.losses is not None:
        bias = tuple(a + b for a, b in zip(bias, friction_torques(lumped.losses, now, axes), strict=True))
    return Reduced(_inertia(lumped, axes.normal, direction), bias)


def friction_torques(terms: Losses, now: GimbalState, axes: Axes) -> tuple[Real, ...]:
    """Torques against the speeds u that friction makes, N m: spinning and rolling on the shell, and both joints."""
    turning = attitude.shell_turning_of(now)
    spin = dot(axes.normal, turning)
    level = combine((1.0, turning), (-spin, axes.normal))
    spinning, square = terms.spinning * smooth_sign(spin), dot(level, level)
    rolling = [terms.rolling * smooth_sign(part, square) for part in level]
    x, y, z = (a + spinning * b for a, b in zip(rolling, axes.normal, strict=True))
    return x, y, z, z + joint_loss(terms.drive, now.relative_rate), joint_loss(terms.tilt, now.pendulum_rate)


def _inertia(lumped: Lumped, normal: Vector3, direction: tuple[Array, Array]) -> tuple[tuple[Real, ...], ...]:
    (x, y, z), (dx, dz) = normal, direction
    rolling = (lumped.central_mass + lumped.pendulum_mass) * lumped.radius**2
    coupling = lumped.pendulum_mass * lumped.radius * lumped.length
    about_d, about_y, across = lumped.pendulum_inertia
    # Of shell and masses on Omega; of the product of Omega and Pi; of the pendulum on Pi.
    shell_xx, shell_yy = lumped.shell_transverse + rolling * (1.0 - x * x), lumped.shell_transverse + rolling * (1.0 - y * y)
    shell_xy, shell_xz, shell_yz = -rolling * x * y, -rolling * x * z, -rolling * y * z
    shell_zz = lumped.shell_axial + rolling * (1.0 - z * z)
    both_xx, both_zz, both_xy, both_zy = coupling * dz * z, coupling * dx * x, -coupling * dx * y, -coupling * dz * y
    both_xz, both_zx = -coupling * dx * z, -coupling * dz * x
    both_yy = both_xx + both_zz
    swing_xx, swing_zz = across * dz * dz + about_d * dx * dx, across * dx * dx + about_d * dz * dz
    swing_xz = (about_d - across) * dx * dz
    gimbal_x, gimbal_y, gimbal_z = lumped.gimbal_inertia
    return (
        (shell_xx + 2.0 * both_xx + swing_xx + gimbal_x,),
        (shell_xy + both_xy, shell_yy + 2.0 * both_yy + about_y + gimbal_y),
        (
            shell_xz + both_xz + both_zx + swing_xz,
            shell_yz + both_zy,
            shell_zz + 2.0 * both_zz + swing_zz + gimbal_z,
        ),
        (shell_xz + both_zx, shell_yz + both_zy, shell_zz + both_zz, shell_zz),
        (both_xy, both_yy + about_y, both_zy, both_zy, about_y),
    )


def _bias(lumped: Lumped, now: GimbalState, axes: Axes, direction: tuple[Array, Array]) -> tuple[Real, ...]:
    normal, length, radius = axes.normal, lumped.length, lumped.radius
    turning, swinging = attitude.turning_of(now), pendulum_turning(direction, now[8:])
    x, y, z = swinging
    about_d, about_y, across = lumped.pendulum_inertia
    rate = now.pendulum_rate
    torque = _out_of_pendulum(
        direction,
        (
            (across - about_y) * y * z - about_d * rate * z,
            (about_d - across) * z * x,
            (about_y - about_d) * x * y + across * rate * x,
        ),
    )
    lift = centre_drift(lumped, now, normal)
    lift = tuple(a + lumped.along_slope * b + lumped.into_slope * c for a, b, c in zip(lift, axes.upslope, normal, strict=True))
    moment = lumped.pendulum_mass * length
    mass = lumped.central_mass + lumped.pendulum_mass
    fall = _out_of_pendulum(direction, (-y * y - z * z, (rate + y) * x, x * z))
    force = [evaluate_once(jnp.asarray(mass * a + moment * b)) for a, b in zip(lift, fall, strict=True)]
    spin = lumped.shell_axial * (now.turning_z + now.relative_rate) - lumped.shell_transverse * now.turning_z
    px, py, pz = cross(normal, (force[0], force[1], force[2]))
    shell = (radius * px + turning[1] * spin, radius * py - turning[0] * spin, evaluate_once(jnp.asarray(radius * pz)))
    gx, gy, gz = (inertia * w for inertia, w in zip(lumped.gimbal_inertia, turning, strict=True))
    gimbal = cross(turning, (gx, gy, gz))
    (dx, dz), (lx, ly, lz) = direction, lift
    pendulum = (
        torque[0] - moment * dz * ly,
        evaluate_once(torque[1] + moment * (dz * lx - dx * lz)),
        torque[2] + moment * dx * ly,
    )
    all_three = [evaluate_once(jnp.asarray(a + b + c)) for a, b, c in zip(shell, gimbal, pendulum, strict=True)]
    return (*all_three, shell[2], pendulum[1])


def centre_drift(lumped: Lumped, now: GimbalState, normal: Vector3) -> Vector3:
    """Acceleration of the centre while u stays constant, in C, m/s2."""
    x, y, z = normal
    pull = lumped.radius * now.relative_rate
    return -pull * now.turning_x * z, -pull * now.turning_y * z, pull * (now.turning_x * x + now.turning_y * y)


def rolled(lumped: Lumped, axes: Axes, speeds: Sequence[Real]) -> Vector3:
    """Velocity r Omega x k of the centre for speeds u, or the part of its acceleration that u' makes; in C."""
    x, y, z, spin, _ = speeds
    a, b, c = cross((x, y, z + spin), axes.normal)
    return lumped.radius * a, lumped.radius * b, lumped.radius * c


def bob_acceleration(lumped: Lumped, now: GimbalState, accelerations: Sequence[Real]) -> Vector3:
    """Acceleration of the bob relative to the centre under u', in C, m/s2."""
    direction = direction_of(now)
    x, y, z = pendulum_turning(direction, now[8:])
    _, y_rate, z_rate = pendulum_turning(direction, accelerations)
    fall = (-y * y - z * z, z_rate + (now.pendulum_rate + y) * x, x * z - y_rate)
    return combine((lumped.length, _out_of_pendulum(direction, fall)))


def affine(lumped: Lumped, state: State) -> Affine:
    """Solve the reduced dynamics for u', affine in the torques: f2 and the columns of G of (46)."""
    now = attitude.of_state(state)
    terms = reduced(lumped, now, attitude.axes_of(now))
    return Affine(*solve_positive_definite(terms.inertia, [-bias for bias in terms.bias], *INPUT_COLUMNS))


def derivative_components(lumped: Lumped, state: State, torque: Sequence[Array]) -> GimbalState:
    """Time derivative of a state in the gimbal's frame under drive and tilt torque, by components, Eq. (46)."""
    now = attitude.of_state(state)
    axes = attitude.axes_of(now)
    terms, (drive, tilt) = reduced(lumped, now, axes), torque
    (x, y, z, spin, swing) = terms.bias
    (accelerations,) = solve_positive_definite(terms.inertia, (-x, -y, -z, drive - spin, tilt - swing))
    turning = attitude.shell_turning_of(now)
    velocity = lumped.radius * dot(axes.across, turning), -lumped.radius * dot(axes.upslope, turning)
    return attitude.rates_of(now, velocity, accelerations)
