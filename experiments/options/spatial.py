"""Gains, path and tuning of the spatial robot."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import jaxsphere as js
from experiments import lines
from jaxsphere.checks import require_choice, require_scalar


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
    speeds: tuple[float, ...] = lines.TRAINING_SPEEDS
    """Of the lines tuned on, m/s, one rollout each."""
    validation_speeds: tuple[float, ...] = lines.VALIDATION_SPEEDS
    """Speeds that choose among the answers of the starts, m/s."""
    held_out_speeds: tuple[float, ...] = lines.HELD_OUT_SPEEDS
    """Speeds that neither the search nor the choice sees, m/s."""
    duration: float = 4.0
    """Horizon of the tuning rollouts, s; errors depend chaotically on the gains over much longer ones."""
    dt: float = 4e-3
    """Time step and control period of the tuning rollouts, s."""
    torque_limit: float = 5.0
    """N m"""
    lean_limit_deg: float = 43.0
    """Lean of the spin axis that is penalised beyond, degrees."""
    friction_limit: float = 0.5
    """Coefficient of friction that rolling may need; more is penalised."""
    optimiser: str = "lm"
    """lm (Levenberg-Marquardt), lbfgs or adam."""
    iterations: int = 12
    """Steps per start."""
    starts: int = 16
    """Starts, all optimised at once."""
    learning_rate: float = 0.05
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
    """Gains to keep, e.g. --frozen k_p k_d a_max"""
    progress: bool = True
    """Show a progress bar."""
