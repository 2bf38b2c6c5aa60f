"""The robot: a shell, a gimbal and a pendulum, as one frozen pytree, and the published robots by name.

Shell and gimbal have three principal moments (x, y, z) about the centre of the sphere; z is the spin axis, the one about
which the robot rolls straight ahead, so the plane uses the z entries. Those of the pendulum's bob are about itself, x along the
rod and y about the tilt axis; 0 is the paper's point mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
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
class Friction:
    """Friction of both joints and at the contact point (see `models.friction`)."""

    drive_viscous: Real = quantity(0.0, "N m s", "viscous friction of the drive joint")
    drive_coulomb: Real = quantity(0.0, "N m", "Coulomb friction of the drive joint")
    tilt_viscous: Real = quantity(0.0, "N m s", "viscous friction of the tilt joint")
    tilt_coulomb: Real = quantity(0.0, "N m", "Coulomb friction of the tilt joint")
    rolling: Real = quantity(0.0, "m", "rolling resistance, torque over normal force")
    spinning: Real = quantity(0.0, "m", "torsional friction at the contact, torque over normal force")


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
    pendulum_inertia: Array = quantity(_moments(0.0, 0.0, 0.0), "kg m2", "moments of the bob about itself: x (rod), y, z")
    friction: Friction | None = field(default=None, metadata={"help": "of joints and contact; None for none"})


def set_a() -> Robot:
    """BYQ-family robot of Yu & Sun (2014), the default.

    Gaps: only the planar moments are printed; no motor data. The public code also has a pendulum moment of 0.0006 kg m2 and a
    damping of 0.03 N m s, which neither the report nor the paper prints; they are left out here.
    """
    return Robot()


def roboball_ii() -> Robot:
    """RoboBall II, from the repository mjoo-man/Drake_Based_Pendulum_Driven_Spherical_Robot.

    Its axes are x for steering (our y), y for driving (our z) and z along the pendulum (our x). Gaps: the gimbal's centre of
    mass, 5 cm below the centre, and 3 mm of the pendulum's are left out. The friction of both joints is the one with which the
    public log of a free swing is met; the file prints 0.7 N m and 0.104 N m s. It cannot hold 10 degrees: its bound is 9.2.
    """
    return Robot(
        shell_mass=16.536,
        gimbal_mass=2.779,
        pendulum_mass=22.03,
        shell_inertia=_moments(1.04, 1.04, 0.641)(),
        gimbal_inertia=_moments(0.0144, 0.0184, 0.0075)(),
        pendulum_inertia=_moments(0.32633, 0.44235, 0.49888)(),
        friction=Friction(drive_viscous=0.22, drive_coulomb=0.8, tilt_viscous=0.22, tilt_coulomb=0.8),
        pendulum_length=0.095,
        shell_radius=0.3175,
    )


def rotunbot() -> Robot:
    """Rotunbot, from the repository Foki-J/spherical-robot-pinocchio-simulation.

    Its axes are x for tilting (our y), y for driving (our z) and z along the pendulum (our x). Gaps: a flywheel is left out.
    The pendulum's 6.9568 and 7.9816 kg m2 are taken about the centre of the sphere: about its own centre of mass they would
    need a body that does not fit into the shell.
    """
    return Robot(
        shell_mass=27.83,
        gimbal_mass=20.41,
        pendulum_mass=82.8,
        shell_inertia=_moments(2.36, 2.36, 1.88)(),
        gimbal_inertia=_moments(0.97, 0.80, 0.47)(),
        pendulum_inertia=_moments(1.7644, 6.9568 - 82.8 * 0.270**2, 7.9816 - 82.8 * 0.270**2)(),
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


def total_mass(robot: Robot) -> Real:
    """Mass of shell, gimbal and pendulum, kg."""
    return robot.shell_mass + robot.gimbal_mass + robot.pendulum_mass


def check_robot(robot: Robot, name: str = "robot") -> Robot:
    """Check one robot on the host and return it; traced fields are passed over.

    Raises:
        TypeError: `robot` is no Robot, or its friction no Friction.
        ValueError: a field is not one finite positive number (gravity, friction, and moments of gimbal and pendulum may be
            zero), a moment breaks the triangle inequality, or the pendulum does not fit into the shell.
    """
    if not isinstance(robot, Robot):
        raise TypeError(f"{name} = {robot!r} is no Robot; type jaxsphere.Robot(...) or jaxsphere.robots()['set_a']")
    for leaf in fields(Robot):
        value = getattr(robot, leaf.name)
        if value is None or not is_concrete(value):
            continue
        if leaf.name == "friction":
            if not isinstance(value, Friction):
                raise TypeError(f"{name}.friction = {value!r} is no Friction; type jaxsphere.Friction(rolling=0.01), or None")
            for term in fields(value):
                require_scalar(f"{name}.friction.{term.name}", getattr(value, term.name), above=0.0, or_equal=True)
            continue
        if leaf.name.endswith("inertia"):
            _check_moments(f"{name}.{leaf.name}", value, zero_allowed=leaf.name != "shell_inertia")
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
