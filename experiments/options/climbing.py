"""Axes and task of the climbing map."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class MapOptions:
    """What the map shows, over what, and how exactly."""

    of: str = "bound"
    """bound (the steepest slope that is climbed) or outcome (how climbs on given slopes end)."""
    x: str = "z_u"
    """A gain (c1, c2, z_u, phi_z, eta, k), pendulum_mass, shell_mass, gimbal_mass, pendulum_length, mass_ratio, length_ratio,
    torque_limit, travel, push or, for outcomes, slope."""
    y: str = "pendulum_mass"
    """Likewise."""
    x_range: tuple[float, float] | None = None
    """Ends of the axis."""
    y_range: tuple[float, float] | None = None
    """Ends of the axis."""
    size: int = 64
    """Values on each axis."""
    tolerance: float = 1e-3
    """Width of the bracket around every bound, rad."""
    refine: bool = True
    """Outcomes: simulate only where neighbours disagree."""
    coarse: int | None = 16
    """Outcomes: nodes between the first ones looked at."""
    slope_deg: float = 10.0
    """Outcomes: slope in degrees unless it is an axis."""
    travel: float = 10.0
    """Angle that the sphere should roll, rad."""
    torque_limit: float | None = None
    """N m; none by default."""
    duration: float = 60.0
    """Time by which the robot must have settled, s."""
    smoothing: float = 0.02
    """Width of the smoothed sign, rad/s; 0 for the hard sign of a sampled controller."""
    control_period: float | None = None
    """Sampling period of the controller, s; continuous by default."""
    dt: float | None = None
    """Time step, s; by default the largest that is stable."""
    dtype: str = "float32"
    """float32 or float64, of the rollouts."""
