"""Settings of the studies, SI units; the command line makes its options from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import jaxsphere as js
import tuning
from jaxsphere.checks import require_choice, require_scalar

TRAINING_SPEEDS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
VALIDATION_SPEEDS = (0.24, 0.33, 0.43, 0.53, 0.68, 0.78, 0.88, 0.97)
HELD_OUT_SPEEDS = (0.22, 0.25, 0.28, 0.35, 0.38, 0.45, 0.55, 0.58, 0.65, 0.7, 0.75, 0.85, 0.9, 0.95)


def setting(default: Any, unit: str, words: str) -> Any:
    """Return a dataclass field with its unit and its help."""
    return field(default=default, metadata={"unit": unit, "help": words})


@dataclass(frozen=True)
class Search:
    """How gains are searched for."""

    optimiser: str = setting("lm", "", "lm (Levenberg-Marquardt), lbfgs or adam")
    iterations: int | None = setting(None, "", "Steps per start; 35, 60 or 150 if not given")
    starts: int = setting(8, "", "Starts, all optimised at once")
    learning_rate: float = setting(0.1, "", "Of Adam, in logarithmic gains")
    seed: int = setting(0, "", "Of the starts")
    gradient: str = setting("forward", "", "forward or reverse, for lbfgs and adam")
    resume: bool = setting(False, "", "Continue from the checkpoint")
    frozen: tuple[str, ...] = setting((), "", "Gains to keep, e.g. --frozen eta k")
    progress: bool = setting(True, "", "Show a progress bar")

    def arguments(self) -> dict[str, Any]:
        """Return the search's settings as arguments of `tuning.tune`."""
        return {name: getattr(self, name) for name in Search.__dataclass_fields__}


@dataclass(frozen=True)
class PlanarTuning(Search):
    """The planar task that gains are tuned on, the search and the weights of the objective."""

    slope: float = setting(math.radians(10.0), "rad", "Slope")
    travel: float = setting(10.0, "rad", "Angle that the sphere should roll")
    duration: float = setting(8.0, "s", "Horizon of the tuning rollouts")
    dt: float = setting(8e-3, "s", "Time step and control period of the tuning rollouts")
    smoothing: tuple[float, ...] = setting((0.2, 0.1, 0.05), "rad/s", "Widths of the smoothed sign, one stage of tuning each")
    stiffness: tuple[float, ...] = setting((1.0, 4.0, 16.0), "", "Factor of the penalties of the limits in each stage")
    torque_limit: float = setting(5.0, "N m", "Limit of the motor")
    swing_limit: float = setting(math.radians(20.0), "rad", "Swing about equilibrium that is penalised beyond")
    tracking_weight: float = setting(1.0, "", "Of the integral of t |e| / travel")
    swing_weight: float = setting(1.0, "", "Of the squared excess swing")
    torque_weight: float = setting(1e-3, "", "Of the integral of the squared torque")
    chatter_weight: float = setting(0.5, "", "Of the squared switching step of the hard sign")
    examine: bool = setting(True, "", "Check the gradient, the smoothed against the hard sign, and which gains matter")


@dataclass(frozen=True)
class Unlike:
    """What varies between the robots that gains are tuned for; nothing unless `scenarios` is given."""

    scenarios: int = setting(0, "", "Drawn robots that tuning sees; 0 tunes for the modelled robot")
    known: bool = setting(True, "", "Whether the controller knows the drawn robot; otherwise it keeps the modelled one")
    masses: float = setting(0.0, "", "Half-width of every mass and inertia, relative")
    lengths: float = setting(0.0, "", "Half-width of the radius and the pendulum's length, relative")
    slopes: tuple[float, float] | None = setting(None, "rad", "Gentlest and steepest slope; that of the task if not given")
    swing: float = setting(0.0, "rad", "Half-width of the initial swing about equilibrium")
    late: float = setting(0.0, "", "Probability that torques act one control period late")
    sensor_bias: tuple[float, float, float, float] = setting(
        (0.0, 0.0, 0.0, 0.0), "rad, rad/s", "Half-widths on alpha, alpha', phi, phi'"
    )
    aggregate: str = setting("mean", "", "Of the scenarios: mean, cvar or worst")
    alpha: float = setting(0.9, "", "Of cvar: the mean of the worst share 1 - alpha")
    samples: int = setting(2000, "", "Fresh robots of the certificate")
    within: float = setting(15.0, "s", "A sample fails when it has not settled to 2 % within this time")

    def uncertainty(self, slope: float) -> tuning.Uncertainty:
        """Return the uncertainty about a task on `slope` (rad)."""
        mass_like = ("shell_mass", "gimbal_mass", "pendulum_mass", "shell_inertia", "gimbal_inertia")
        relative = dict.fromkeys(mass_like, self.masses) | dict.fromkeys(("shell_radius", "pendulum_length"), self.lengths)
        return tuning.Uncertainty(
            relative={name: width for name, width in relative.items() if width},
            slope=(slope, slope) if self.slopes is None else self.slopes,
            swing=self.swing,
            known=self.known,
            late=self.late,
            sensor_bias=self.sensor_bias,
        )


@dataclass(frozen=True)
class LineTuning(Search):
    """The lines that tracking gains are tuned on, and the search."""

    slope: float = setting(math.radians(10.0), "rad", "Slope")
    speeds: tuple[float, ...] = setting(TRAINING_SPEEDS, "m/s", "Of the lines tuned on, one rollout each")
    validation_speeds: tuple[float, ...] = setting(VALIDATION_SPEEDS, "m/s", "Choose among the answers of the starts")
    held_out_speeds: tuple[float, ...] = setting(HELD_OUT_SPEEDS, "m/s", "Neither the search nor the choice sees them")
    duration: float = setting(
        4.0, "s", "Horizon of the tuning rollouts; errors depend chaotically on the gains over longer ones"
    )
    dt: float = setting(4e-3, "s", "Time step and control period of the tuning rollouts")
    torque_limit: float = setting(5.0, "N m", "Limit of the motors")
    lean_limit: float = setting(math.radians(43.0), "rad", "Lean of the spin axis that is penalised beyond")
    friction_limit: float = setting(0.5, "", "Coefficient of friction that rolling may need; more is penalised")
    iterations: int = setting(12, "", "Steps per start")  # pyright: ignore[reportIncompatibleVariableOverride]
    starts: int = setting(16, "", "Starts, all optimised at once")
    learning_rate: float = setting(0.05, "", "Of Adam, in logarithmic gains")
    checkpoint: str | None = setting(None, "", "File, written between chunks of iterations, e.g. out/tuning.npz")


@dataclass(frozen=True)
class Path:
    """A path on the slope."""

    path: str = setting("line", "", "line (through the origin), circle or eight")
    speed: float = setting(0.5, "m/s", "Along a line or a circle")
    size: float = setting(1.0, "m", "Radius of the circle or half-width of the eight")
    period: float = setting(15.0, "s", "Of the eight")

    def reference(self) -> js.references.ReferenceFunction:
        """Return the path as a function of time. Raises ValueError for an unknown path or a size that is not positive."""
        require_choice("path", self.path, ("line", "circle", "eight"))
        require_scalar("size", self.size, above=0.0, unit="m")
        require_scalar("period", self.period, above=0.0, unit="s")
        require_scalar("speed", self.speed, unit="m/s")
        if self.path == "line":
            return js.references.line(self.speed)
        if self.path == "circle":
            return js.references.circle(self.size, self.speed)
        return js.references.figure_eight(self.size, self.period)


@dataclass(frozen=True)
class Map:
    """What a climbing map shows, over what, and how exactly."""

    of: str = setting("bound", "", "bound (the steepest slope that is climbed) or outcome (how climbs on given slopes end)")
    x: str = setting(
        "z_u", "", "A gain, a mass, pendulum_length, mass_ratio, length_ratio, torque_limit, travel, push or slope"
    )
    y: str = setting("pendulum_mass", "", "Likewise")
    x_range: tuple[float, float] | None = setting(None, "", "Ends of the axis")
    y_range: tuple[float, float] | None = setting(None, "", "Ends of the axis")
    size: int = setting(64, "", "Values on each axis")
    tolerance: float = setting(1e-3, "rad", "Width of the bracket around every bound")
    refine: bool = setting(True, "", "Outcomes: simulate only where neighbours disagree")
    coarse: int | None = setting(16, "", "Outcomes: nodes between the first ones looked at")
    duration: float = setting(60.0, "s", "Simulated time after which a climb is too slow")
    dt: float | None = setting(None, "s", "Time step; the largest that is stable if not given")
    dtype: str = setting("float32", "", "float32 or float64, of the rollouts")
