"""Gains, move and tuning of the planar robot."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import jaxsphere as js
import tuning


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
    smoothing: tuple[float, ...] = (0.2, 0.1, 0.05)
    """Widths of the smoothed sign, one stage of tuning each, rad/s."""
    stiffness: tuple[float, ...] = (1.0, 4.0, 16.0)
    """Factor of the penalties of the limits in each stage."""
    torque_limit: float = 5.0
    """N m"""
    swing_limit_deg: float = 20.0
    """Swing about equilibrium that is penalised beyond, degrees."""
    optimiser: str = "lm"
    """lm (Levenberg-Marquardt), lbfgs or adam."""
    iterations: int | None = None
    """Steps per start; 35, 60 or 150 by default."""
    starts: int = 8
    """Starts, all optimised at once."""
    learning_rate: float = 0.1
    """Of Adam, in logarithmic gains."""
    seed: int = 0
    """Of the starts."""
    gradient: str = "forward"
    """forward or reverse, for lbfgs and adam."""
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
    examine: bool = True
    """Check the gradient at the answer, the smoothed against the hard sign, and which gains matter."""
    progress: bool = True
    """Show a progress bar."""


@dataclass
class UncertaintyOptions:
    """What varies between the robots that the gains are tuned for; off unless `scenarios` is given."""

    scenarios: int = 0
    """Drawn robots that tuning sees; 0 tunes for the modelled robot alone."""
    known: bool = True
    """Whether the controller knows the drawn robot; otherwise it keeps the modelled one."""
    masses: float = 0.0
    """Half-width of every mass and inertia, relative."""
    lengths: float = 0.0
    """Half-width of the radius and the pendulum's length, relative."""
    slopes_deg: tuple[float, float] | None = None
    """Gentlest and steepest slope, degrees; the slope of the task by default."""
    swing_deg: float = 0.0
    """Half-width of the initial swing about equilibrium, degrees."""
    late: float = 0.0
    """Probability that commands act one control period late."""
    sensor_bias: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Half-widths on alpha, alpha', phi, phi' in rad and rad/s."""
    aggregate: str = "mean"
    """Of the scenarios: mean, cvar or worst."""
    alpha: float = 0.9
    """Of cvar: the mean of the worst share 1 - alpha."""
    samples: int = 2000
    """Fresh robots of the certificate."""
    within: float = 15.0
    """A sample fails when it has not settled to 2 % within this time, s."""

    def make(self, slope: float) -> tuning.Uncertainty:
        """The uncertainty about a task on `slope` (rad)."""
        mass_like = ("shell_mass", "gimbal_mass", "pendulum_mass", "shell_inertia", "gimbal_inertia")
        relative = dict.fromkeys(mass_like, self.masses) | dict.fromkeys(("shell_radius", "pendulum_length"), self.lengths)
        low, high = (slope, slope) if self.slopes_deg is None else map(math.radians, self.slopes_deg)
        return tuning.Uncertainty(
            relative={name: width for name, width in relative.items() if width},
            slope=(low, high),
            swing=math.radians(self.swing_deg),
            known=self.known,
            late=self.late,
            sensor_bias=self.sensor_bias,
        )
