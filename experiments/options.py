"""Options of the command line as typed dataclasses; each makes the library's own object from its fields."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

import jaxsphere as js
from jaxsphere.checks import require_choice, require_scalar


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


@dataclass
class SlidingModeOptions:
    """Gains of the sliding-mode controller; Table 3 by default."""

    c1: float = 0.5501
    """Slope of the sphere's sliding surface, 1/s."""
    c2: float = 2.3272
    """Slope of the pendulum's sliding surface, 1/s."""
    z_u: float = 0.9626
    """Largest swing asked for beyond equilibrium, rad, below 1."""
    phi_z: float = 7.4822
    """Width over which it is reached, rad/s."""
    eta: float = 2.7688
    """Switching gain, rad/s2."""
    k: float = 0.6769
    """Proportional reaching gain, 1/s."""
    k_i: float = 0.0
    """Equilibrium-seeking gain, rad/s; 0 is the paper's law."""

    def make(self) -> js.SlidingModeGains:
        """The gains. Raises ValueError for one that is not admissible."""
        gains = js.SlidingModeGains(**{leaf.name: getattr(self, leaf.name) for leaf in fields(self)})
        return js.sliding_mode.check_gains(gains)


@dataclass
class MotionOptions:
    """The move, the motor and the integration."""

    slope_deg: float = 10.0
    """Slope in degrees, positive up-slope."""
    travel: float = 10.0
    """Angle that the sphere should roll, rad."""
    duration: float = 30.0
    """s"""
    dt: float = 1e-3
    """Time step, s."""
    smoothing: float = 0.02
    """Width of the smoothed sign, rad/s; 0 for the hard sign."""
    torque_limit: float | None = None
    """N m; none by default."""
    control_period: float | None = None
    """Sampling period of the controller, s, a multiple of dt; continuous by default."""
    initial_state: tuple[float, float, float, float] | None = None
    """alpha, alpha', phi, phi' in rad and rad/s; rest at equilibrium by default."""
    convention: str = "corrected"
    """Sign of z in (8): corrected or printed."""
    method: str = "rk4"
    """rk4, dopri5 or semi_implicit_euler."""

    @property
    def slope(self) -> float:
        """Slope in rad."""
        return math.radians(self.slope_deg)


@dataclass
class TrackingGainOptions:
    """Gains of the tracking controller; Table 4 by default."""

    k1: float = 49.0
    """On the error of x, 1/s2."""
    k2: float = 14.0
    """On its rate, 1/s."""
    k3: float = 49.0
    """On the error of y, 1/s2."""
    k4: float = 14.0
    """On its rate, 1/s."""
    k_p: float = 900.0
    """Of both joints, 1/s2."""
    k_d: float = 60.0
    """Of both joints, 1/s."""
    a_max: float = 1.0
    """Largest acceleration asked for, m/s2."""

    def make(self) -> js.TrackingGains:
        """The gains. Raises ValueError for one that is not admissible."""
        return js.tracking.check_gains(js.TrackingGains(**{leaf.name: getattr(self, leaf.name) for leaf in fields(self)}))


@dataclass
class TrackOptions:
    """The path, the motor and the integration."""

    path: str = "line"
    """line (through the origin), circle or eight."""
    speed: float = 0.5
    """Along a line or a circle, m/s."""
    size: float = 1.0
    """Radius of the circle or half-width of the eight, m."""
    period: float = 15.0
    """Of the eight, s."""
    slope_deg: float = 10.0
    """Slope in degrees; x points up-slope."""
    start: tuple[float, float] = (0.3, 0.1)
    """Where the robot rests at first when it follows a line, m; on the path for the others."""
    realisation: str = "pendulum_attitude"
    """pendulum_attitude, exact, pseudo_inverse or ideal."""
    duration: float = 20.0
    """s"""
    dt: float = 1e-3
    """Time step, s."""
    torque_limit: float | None = 5.0
    """N m"""
    control_period: float | None = None
    """Sampling period of the controller, s, a multiple of dt; continuous by default."""
    method: str = "rk4"
    """rk4, dopri5 or semi_implicit_euler."""

    @property
    def slope(self) -> float:
        """Slope in rad."""
        return math.radians(self.slope_deg)

    def reference(self) -> js.references.ReferenceFunction:
        """The path as a function of time. Raises ValueError for an unknown path or a size that is not positive."""
        require_choice("path", self.path, ("line", "circle", "eight"))
        require_scalar("size", self.size, above=0.0, unit="m")
        require_scalar("period", self.period, above=0.0, unit="s")
        require_scalar("speed", self.speed, unit="m/s")
        if self.path == "line":
            return js.references.line(self.speed)
        if self.path == "circle":
            return js.references.circle(self.size, self.speed)
        return js.references.figure_eight(self.size, self.period)


@dataclass
class TrackTuningOptions:
    """The lines that the gains are tuned on, and the search."""

    slope_deg: float = 10.0
    """Slope in degrees."""
    speeds: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
    """Of the lines, m/s, one rollout each."""
    duration: float = 6.0
    """Horizon of the tuning rollouts, s; errors depend chaotically on the gains over much longer ones."""
    dt: float = 4e-3
    """Time step and control period of the tuning rollouts, s."""
    torque_limit: float = 5.0
    """N m"""
    iterations: int = 40
    """Steps per start."""
    starts: int = 12
    """Starts, all optimised at once."""
    learning_rate: float = 0.05
    """Of Adam, in logarithmic gains."""
    seed: int = 0
    """Of the starts."""
    gradient: str = "forward"
    """forward or reverse."""
    frozen: tuple[str, ...] = ("k_p", "k_d", "a_max")
    """Gains to keep; --frozen with no names tunes all."""
    progress: bool = True
    """Show a progress bar."""


@dataclass
class TuningOptions:
    """The task that the gains are tuned on, the search and the weights of the objective."""

    slope_deg: float = 10.0
    """Slope in degrees."""
    travel: float = 10.0
    """rad"""
    duration: float = 8.0
    """Horizon of the tuning rollouts, s."""
    dt: float = 8e-3
    """Time step and control period of the tuning rollouts, s."""
    smoothing: float = 0.2
    """Width of the smoothed sign while tuning, rad/s."""
    torque_limit: float = 5.0
    """N m"""
    swing_limit_deg: float = 20.0
    """Swing about equilibrium that is penalised beyond, degrees."""
    optimiser: str = "lm"
    """lm (Levenberg-Marquardt), lbfgs or adam."""
    iterations: int | None = None
    """Steps per start; 80, 60 or 150 by default."""
    starts: int = 8
    """Starts, all optimised at once."""
    learning_rate: float = 0.1
    """Of Adam, in logarithmic gains."""
    seed: int = 0
    """Of the starts."""
    gradient: str = "forward"
    """forward or reverse, for lbfgs and adam."""
    checkpoint: str | None = None
    """File, written between chunks of iterations, e.g. out/tuning.npz."""
    resume: bool = False
    """Continue from the checkpoint."""
    frozen: tuple[str, ...] = ()
    """Gains to keep, e.g. --frozen eta k"""
    tracking_weight: float = 1.0
    """Of the integral of t |e| / travel."""
    swing_weight: float = 1.0
    """Of the squared excess swing."""
    torque_weight: float = 1e-3
    """Of the integral of the squared torque."""
    chatter_weight: float = 0.5
    """Of the squared switching step of the hard sign."""
    progress: bool = True
    """Show a progress bar."""
