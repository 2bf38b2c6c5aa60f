"""The robot: a shell, a gimbal and a pendulum, as one frozen pytree, and the published robots by name.

Both inertias hold the three principal moments (x, y, z) about the centre of the sphere; z is the spin axis, the one about
which the robot rolls straight ahead, so the plane uses the z entries. The pendulum's bob is a point mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_scalar
from jaxsphere.numerics import Real
from jaxsphere.units import quantity


def _moments(*values: float) -> Callable[[], Any]:
    return partial(np.array, values, dtype=np.float64)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Robot:
    """Masses, moments and lengths of a pendulum-driven spherical robot (Tables 1 and 2); SI units, every field a leaf.

    The default is set A: Yu & Sun, "Variable Structure Control of Spherical Robots with Exponential Reaching Law",
    Studies in System Science 2 (2014), also used in the public MATLAB code mateus-amarante/spherical_robot. That source
    gives one shell and one gimbal moment; the other two of each are taken equal here, an assumption of this package.
    """

    shell_mass: Real = quantity(1.2, "kg", "mass m of the shell")
    gimbal_mass: Real = quantity(1.85, "kg", "mass m_i of the gimbal")
    pendulum_mass: Real = quantity(2.05, "kg", "mass m_p of the pendulum")
    shell_inertia: Array = quantity(_moments(0.018, 0.018, 0.018), "kg m2", "moments I_s of the shell: x, y, z (spin axis)")
    gimbal_inertia: Array = quantity(_moments(0.0017, 0.0017, 0.0017), "kg m2", "moments I_i of the gimbal: x, y, z")
    pendulum_length: Real = quantity(0.12, "m", "length l from the centre to the bob")
    shell_radius: Real = quantity(0.15, "m", "radius r of the shell")
    gravity: Real = quantity(9.81, "m/s2", "gravity g")


def set_a() -> Robot:
    """BYQ-family robot of Yu & Sun (2014), the default. Gaps: only the planar moments are printed; no motor data."""
    return Robot()


def roboball_ii() -> Robot:
    """RoboBall II, from the repository mjoo-man/Drake_Based_Pendulum_Driven_Spherical_Robot.

    Gaps: it gives one moment for steering and one for driving each; drive goes to z, steer to x and y. It cannot hold a
    slope of 10 degrees: its bound (4) is 9.2 degrees.
    """
    return Robot(
        shell_mass=16.536,
        gimbal_mass=2.779,
        pendulum_mass=22.03,
        shell_inertia=_moments(1.04, 1.04, 0.641)(),
        gimbal_inertia=_moments(0.0184, 0.0184, 0.0075)(),
        pendulum_length=0.095,
        shell_radius=0.3175,
    )


def rotunbot() -> Robot:
    """Rotunbot, from the repository Foki-J/spherical-robot-pinocchio-simulation.

    Gaps: that model orders its axes differently and its bodies do not map one to one onto shell, gimbal and pendulum; the
    mapping (spin axis = its 1.88 and 0.47 kg m2) is ours.
    """
    return Robot(
        shell_mass=27.83,
        gimbal_mass=20.41,
        pendulum_mass=82.8,
        shell_inertia=_moments(2.36, 2.36, 1.88)(),
        gimbal_inertia=_moments(0.80, 0.97, 0.47)(),
        pendulum_length=0.270,
        shell_radius=0.4,
    )


_ROBOTS: dict[str, Callable[[], Robot]] = {"set_a": set_a, "roboball_ii": roboball_ii, "rotunbot": rotunbot}


def robots() -> dict[str, Robot]:
    """Every published robot that ships with the package, by name."""
    return {name: make() for name, make in _ROBOTS.items()}


def robot_named(name: str) -> Robot:
    """Return one published robot. Raises ValueError with the known names when there is none called `name`."""
    if name not in _ROBOTS:
        raise ValueError(f"robot = {name!r} is not known; type one of {', '.join(_ROBOTS)}")
    return _ROBOTS[name]()


def check_robot(robot: Robot, name: str = "robot") -> Robot:
    """Check one robot on the host and return it; traced fields are passed over.

    Raises:
        TypeError: `robot` is no Robot. ValueError: a field is not one finite positive number (gravity and gimbal moments
        may be zero), a moment breaks the triangle inequality, or the pendulum does not fit into the shell.
    """
    if not isinstance(robot, Robot):
        raise TypeError(f"{name} = {robot!r} is no Robot; type jaxsphere.Robot(...) or jaxsphere.robots()['set_a']")
    for leaf in fields(Robot):
        value = getattr(robot, leaf.name)
        if not is_concrete(value):
            continue
        if leaf.name.endswith("inertia"):
            _check_moments(f"{name}.{leaf.name}", value, zero_allowed=leaf.name == "gimbal_inertia")
        else:
            require_scalar(f"{name}.{leaf.name}", value, above=0.0, or_equal=leaf.name == "gravity")
    length, radius = robot.pendulum_length, robot.shell_radius
    if is_concrete(length) and is_concrete(radius) and not float(length) < float(radius):
        raise ValueError(
            f"{name}.pendulum_length = {float(length):g} m does not fit into the shell; type a length below "
            f"{name}.shell_radius = {float(radius):g} m"
        )
    return robot


def _check_moments(name: str, value: Real, zero_allowed: bool) -> None:
    try:
        moments = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value!r} are no numbers; type three principal moments (x, y, z) in kg m2") from None
    bound = "finite and not negative" if zero_allowed else "finite and positive"
    if moments.shape != (3,):
        raise ValueError(f"{name} has shape {moments.shape}; type three principal moments (x, y, z) in kg m2")
    if not (np.all(np.isfinite(moments)) and np.all(moments >= 0.0) and (zero_allowed or np.all(moments > 0.0))):
        raise ValueError(f"{name} = {moments.tolist()} kg m2 must be {bound}; type three such principal moments")
    if 2.0 * moments.max() > moments.sum() * (1.0 + 1e-12):
        raise ValueError(
            f"{name} = {moments.tolist()} kg m2 belongs to no rigid body: the largest moment exceeds the sum of the other "
            "two; type moments that satisfy the triangle inequality"
        )
