"""The state that a rollout integrates: the attitude of the gimbal as a quaternion, which has no singular direction.

    Q       (w, x, y, z) of frame C, from C to O      omega   angular velocity of C, in C, rad/s
    beta2   pendulum angle about y of C, rad          nu      relative rate phi' - beta1' of the drive joint, rad/s
    chi     phi - beta1, rad

`of_state` makes it of the 12 paper coordinates of `frames`, `paper_state` turns it back. R(Q) is divided by |Q|^2, so that
nothing has to be projected. Only the paper coordinates are singular, where the spin axis is normal to the slope; there
beta1 = psi' = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial.frames import SpatialState, State
from jaxsphere.numerics import Real, evaluate_once, sincos
from jaxsphere.numerics.linear_algebra import Vector3, cross, dot

# Square of the sine of the lean below which the spin axis counts as normal to the slope.
_NORMAL = 1e-24


class GimbalState(NamedTuple):
    """The components of a state in the gimbal's frame by name, in their order."""

    x: Array  # m
    y: Array  # m
    quaternion_w: Array
    quaternion_x: Array
    quaternion_y: Array
    quaternion_z: Array
    pendulum_angle: Array  # beta2, rad
    relative_angle: Array  # chi, rad
    turning_x: Array  # omega in C, rad/s
    turning_y: Array
    turning_z: Array
    relative_rate: Array  # nu, rad/s
    pendulum_rate: Array  # beta2', rad/s


IS_VELOCITY = (*(False,) * 8, *(True,) * 5)


class Axes(NamedTuple):
    """Axes of O in components of C: the rows of the rotation from C to O."""

    upslope: Vector3
    across: Vector3
    normal: Vector3


def of_state(state: State) -> GimbalState:
    """Return a state as components in the gimbal's frame: of 12 paper coordinates, or of 13 components as they are."""
    components = tuple(state)
    if len(components) == len(GimbalState._fields):
        return GimbalState(*components)
    now = SpatialState(*components)
    (s_half, c_half) = sincos(0.5 * now.lean)
    s_sum, c_sum = sincos(0.5 * (now.precession + now.gimbal_angle))
    s_difference, c_difference = sincos(0.5 * (now.precession - now.gimbal_angle))
    s_gimbal, c_gimbal = sincos(now.gimbal_angle)
    s_theta, c_theta = sincos(now.lean)
    down, side = now.precession_rate * s_theta, now.lean_rate
    return GimbalState(
        x=now.x,
        y=now.y,
        quaternion_w=c_half * c_sum,
        quaternion_x=-s_half * s_difference,
        quaternion_y=s_half * c_difference,
        quaternion_z=c_half * s_sum,
        pendulum_angle=now.pendulum_angle,
        relative_angle=now.spin - now.gimbal_angle,
        turning_x=s_gimbal * side - c_gimbal * down,
        turning_y=c_gimbal * side + s_gimbal * down,
        turning_z=now.precession_rate * c_theta + now.gimbal_rate,
        relative_rate=now.spin_rate - now.gimbal_rate,
        pendulum_rate=now.pendulum_rate,
    )


def axes_of(now: GimbalState) -> Axes:
    """Evaluate the rotation from C to O, whatever the length of the quaternion."""
    w, x, y, z = now.quaternion_w, now.quaternion_x, now.quaternion_y, now.quaternion_z
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    rows = (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )
    return Axes(*((evaluate_once(a), evaluate_once(b), evaluate_once(c)) for a, b, c in rows))


def rates_of(now: GimbalState, velocity: tuple[Real, Real], accelerations: Sequence[Real]) -> GimbalState:
    """Rates of a state whose centre has a velocity (m/s) and whose speeds u have rates u'; Q' = Q omega / 2."""
    w, vector, turning = now.quaternion_w, (now.quaternion_x, now.quaternion_y, now.quaternion_z), turning_of(now)
    x, y, z = (0.5 * (w * rate + more) for rate, more in zip(turning, cross(vector, turning), strict=True))
    scalar = -0.5 * dot(vector, turning)
    parts = (*velocity, scalar, x, y, z, now.pendulum_rate, now.relative_rate, *accelerations)
    return GimbalState(*map(jnp.asarray, parts))


def turning_of(now: GimbalState) -> Vector3:
    """Angular velocity of the gimbal, in C, rad/s."""
    return now.turning_x, now.turning_y, now.turning_z


def shell_turning_of(now: GimbalState) -> Vector3:
    """Angular velocity of the shell, in C, rad/s."""
    return now.turning_x, now.turning_y, now.turning_z + now.relative_rate


def to_slope(axes: Axes, vector: Vector3) -> Vector3:
    """Turn components in C into components in O."""
    return dot(axes.upslope, vector), dot(axes.across, vector), dot(axes.normal, vector)


def to_gimbal(axes: Axes, vector: Vector3) -> Vector3:
    """Turn components in O into components in C."""
    x, y, z = (sum(vector[i] * axes[i][j] for i in range(3)) for j in range(3))
    return x, y, z


def cosine_of_lean(state: State) -> Array:
    """Cosine of the angle theta between the spin axis and the normal of the slope."""
    return jnp.asarray(axes_of(of_state(state)).normal[2])


def lean_from_upright(state: State) -> Array:
    """Angle between the spin axis and the slope, |theta - pi/2|, rad."""
    return jnp.arcsin(jnp.minimum(jnp.abs(cosine_of_lean(state)), 1.0 - 1e-12))


def paper_state(state: State, near: tuple[Real, Real, Real] | None = None, side: Real = 1.0) -> SpatialState:
    """Return the 12 paper coordinates of a state in the gimbal's frame.

    Args:
        state: 13 components.
        near: psi, theta and beta1 (rad) that the angles should be closest to; otherwise they are within half a turn of 0.
        side: 1 for a lean between 0 and pi, -1 for the same attitude with a lean between -pi and 0.
    """
    now = GimbalState(*state)
    axes, (x, y, z) = axes_of(now), turning_of(now)
    level_x, level_y, upright = axes.normal
    square = level_x * level_x + level_y * level_y
    clear = square > _NORMAL
    sine = side * jnp.sqrt(jnp.where(clear, square, 1.0))
    c_gimbal, s_gimbal = jnp.where(clear, -level_x / sine, 1.0), jnp.where(clear, level_y / sine, 0.0)
    c_psi = jnp.where(clear, axes.upslope[2] / sine, upright * axes.upslope[0])
    s_psi = jnp.where(clear, axes.across[2] / sine, upright * axes.across[0])
    psi_rate = jnp.where(clear, (s_gimbal * y - c_gimbal * x) / sine, 0.0)
    gimbal_rate = z - psi_rate * upright
    angles = [jnp.arctan2(s_psi, c_psi), jnp.arctan2(jnp.where(clear, sine, 0.0), upright), jnp.arctan2(s_gimbal, c_gimbal)]
    if near is not None:
        turn = 2.0 * jnp.pi
        angles = [angle + turn * jnp.round((close - angle) / turn) for angle, close in zip(angles, near, strict=True)]
    return SpatialState(
        x=now.x,
        y=now.y,
        precession=angles[0],
        lean=angles[1],
        spin=angles[2] + now.relative_angle,
        gimbal_angle=angles[2],
        pendulum_angle=now.pendulum_angle,
        precession_rate=psi_rate,
        lean_rate=s_gimbal * x + c_gimbal * y,
        spin_rate=gimbal_rate + now.relative_rate,
        gimbal_rate=gimbal_rate,
        pendulum_rate=now.pendulum_rate,
    )


def paper_states(states: Sequence[Array], first: State) -> tuple[SpatialState, Array]:
    """Return states along a rollout in paper coordinates, their angles continuous in time, and the quaternions (T, 4).

    Args:
        states: 13 components (T,).
        first: state whose angles those of the rollout begin with, up to rounding.
    """

    def follow(last: tuple[Real, Real, Real], state: tuple[Array, ...]) -> tuple[tuple[Real, Real, Real], SpatialState]:
        both = [paper_state(state, last, side) for side in (1.0, -1.0)]
        steps = [sum(abs(a - b) for a, b in zip(_attitude(one), last, strict=True)) for one in both]
        chosen = SpatialState(*(jnp.where(steps[1] < steps[0], b, a) for a, b in zip(*both, strict=True)))
        return _attitude(chosen), chosen

    start = SpatialState(*first) if len(first) == len(SpatialState._fields) else paper_state(first)
    near = jax.tree.map(lambda angle: jnp.asarray(angle, states[0].dtype), _attitude(start))
    paper = jax.lax.scan(follow, near, tuple(states))[1]
    now = GimbalState(*states)
    quaternion = jnp.stack([now.quaternion_w, now.quaternion_x, now.quaternion_y, now.quaternion_z], axis=-1)
    return paper, quaternion / jnp.linalg.norm(quaternion, axis=-1, keepdims=True)


def _attitude(now: SpatialState) -> tuple[Array, Array, Array]:
    return now.precession, now.lean, now.gimbal_angle
