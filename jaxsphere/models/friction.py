"""Friction of the joints and at the contact point, smooth at zero: Coulomb's sign is s(rate) = rate / sqrt(rate^2 + WIDTH^2).

The normal force of rolling and spinning friction is the weight of the robot at rest, (m + m_i + m_p) g cos(gamma).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.numerics import Real
from jaxsphere.robot import Friction, Robot, total_mass

# rad/s; far below the rates of a robot that moves, far above those that a step of 1 ms can change at once.
WIDTH = 0.05


class Losses(NamedTuple):
    """Constants of friction for one robot on one slope; `joint_loss` turns a rate of a joint into the torque against it."""

    drive: tuple[Real, Real]  # viscous, N m s, and Coulomb, N m
    tilt: tuple[Real, Real]
    rolling: Real  # N m
    spinning: Real  # N m


def losses(robot: Robot, slope: Real) -> Losses | None:
    """Gather the friction of `robot` on a `slope` (rad); None where the robot has none."""
    friction: Friction | None = robot.friction
    if friction is None:
        return None
    weight = total_mass(robot) * robot.gravity * jnp.cos(slope)
    return Losses(
        drive=(friction.drive_viscous, friction.drive_coulomb),
        tilt=(friction.tilt_viscous, friction.tilt_coulomb),
        rolling=friction.rolling * weight,
        spinning=friction.spinning * weight,
    )


def smooth_sign(rate: Real, square: Real | None = None) -> Array:
    """Sign of a rate (rad/s), or that of one component of a vector whose square is given."""
    return rate / jnp.sqrt((rate * rate if square is None else square) + WIDTH**2)


def joint_loss(coefficients: tuple[Real, Real], rate: Real) -> Array:
    """Torque against the rate (rad/s) of a joint, N m."""
    viscous, coulomb = coefficients
    return viscous * rate + coulomb * smooth_sign(rate)
