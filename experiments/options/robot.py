"""Which robot."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

import jaxsphere as js


@dataclass
class RobotOptions:
    """A published robot, and any field of it changed."""

    name: str | None = None
    """set_a, roboball_ii or rotunbot."""
    shell_mass: float | None = None
    """kg"""
    gimbal_mass: float | None = None
    """kg"""
    pendulum_mass: float | None = None
    """kg"""
    shell_inertia: tuple[float, float, float] | None = None
    """Principal moments x, y, z, kg m2; z is the spin axis."""
    gimbal_inertia: tuple[float, float, float] | None = None
    """Principal moments x, y, z, kg m2."""
    pendulum_length: float | None = None
    """m"""
    shell_radius: float | None = None
    """m"""
    gravity: float | None = None
    """m/s2"""

    def make(self, default: js.Robot | None = None, label: str = "robot") -> js.Robot:
        """Robot with these changes, from `default` (set A) unless a name is given. Raises ValueError as `check_robot`."""
        base = js.robot_named(self.name) if self.name else default or js.Robot()
        changes = {leaf.name: getattr(self, leaf.name) for leaf in fields(self) if leaf.name != "name"}
        chosen = {name: np.array(v) if isinstance(v, tuple) else v for name, v in changes.items() if v is not None}
        return js.check_robot(replace(base, **chosen), label)
