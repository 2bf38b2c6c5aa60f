"""Constants of the spatial equations: a robot that they hold for, on one slope."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxsphere.checks import is_concrete
from jaxsphere.models.friction import Losses, losses
from jaxsphere.numerics import Real
from jaxsphere.numerics.linear_algebra import Vector3
from jaxsphere.robot import Robot


class Lumped(NamedTuple):
    """Constants of the spatial equations for one robot on one slope; every entry a scalar."""

    central_mass: Real  # m + m_i, kg
    pendulum_mass: Real  # m_p, kg
    shell_transverse: Real  # I_xxs = I_yys, kg m2
    shell_axial: Real  # I_zzs, kg m2
    gimbal_inertia: Vector3  # I_xxi, I_yyi, I_zzi, kg m2
    pendulum_inertia: Vector3  # about the centre of the sphere, along d and across it, kg m2
    radius: Real  # r, m
    length: Real  # l, m
    along_slope: Real  # g sin(gamma), m/s2
    into_slope: Real  # g cos(gamma), m/s2
    losses: Losses | None  # of friction


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
    shell, gimbal, bob = robot.shell_inertia, robot.gimbal_inertia, robot.pendulum_inertia
    offset = robot.pendulum_mass * robot.pendulum_length**2
    return Lumped(
        central_mass=robot.shell_mass + robot.gimbal_mass,
        pendulum_mass=robot.pendulum_mass,
        shell_transverse=0.5 * (shell[0] + shell[1]),
        shell_axial=shell[2],
        gimbal_inertia=(gimbal[0], gimbal[1], gimbal[2]),
        pendulum_inertia=(bob[0], bob[1] + offset, bob[2] + offset),
        radius=robot.shell_radius,
        length=robot.pendulum_length,
        along_slope=robot.gravity * jnp.sin(slope),
        into_slope=robot.gravity * jnp.cos(slope),
        losses=losses(robot, slope),
    )
