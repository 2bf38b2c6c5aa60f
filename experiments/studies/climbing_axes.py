"""What a climbing map can have on its axes, and the setting that it changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxsphere as js
from experiments.plots.climbing import Axis
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.robot import total_mass
from jaxsphere.tasks.simulate import checked

# Time steps that divide a minute, s, and the largest product with a rate (1/s); RK4 is stable up to 2.78.
_STEPS = (15e-3, 12e-3, 10e-3, 8e-3, 6e-3, 5e-3, 4e-3, 3e-3, 2e-3, 1e-3)
_STABLE = 2.2


class Setting(NamedTuple):
    """One point of a map: what climbs, under which gains, and how it is simulated."""

    task: js.PlanarTask = js.PlanarTask()
    gains: js.SlidingModeGains = js.SlidingModeGains()
    numerics: js.Numerics = js.Numerics(duration=60.0)


def _of_task(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: setting._replace(task=replace(setting.task, **{name: value}))


def _of_gains(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: setting._replace(gains=replace(setting.gains, **{name: value}))


def _of_robot(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: _of_task("robot")(setting, replace(setting.task.robot, **{name: value}))


def _push(setting: Setting, value: Any) -> Setting:
    return _of_task("disturbance")(setting, jnp.zeros(4).at[1].set(value))


def _mass_ratio(setting: Setting, value: Any) -> Setting:
    """Move mass between pendulum and shell, whose moment follows; the total stays."""
    robot = setting.task.robot
    pendulum = value * total_mass(robot)
    shell = total_mass(robot) - robot.gimbal_mass - pendulum
    inertia = robot.shell_inertia * (shell / robot.shell_mass)
    return _of_task("robot")(setting, replace(robot, pendulum_mass=pendulum, shell_mass=shell, shell_inertia=inertia))


def _length_ratio(setting: Setting, value: Any) -> Setting:
    return _of_robot("pendulum_length")(setting, value * setting.task.robot.shell_radius)


def stable_step(setting: Setting, *axes: Axis) -> float:
    """Largest usual time step (s) with which RK4 stays stable within the smoothed sign, for every point of the axes.

    Raises:
        ValueError: the sign is hard and the controller continuous, or no usual step is short enough.
    """
    largest = {name: float(getattr(setting.gains, name)) for name in ("eta", "k", "c2")}
    largest |= {which.name: float(which.values.max()) for which in axes if which.name in largest}
    smoothing = float(setting.task.smoothing)
    if setting.task.control_period is not None:
        return float(setting.task.control_period)
    if smoothing == 0.0:
        raise ValueError("smoothing = 0 needs a sampled controller; type --control-period 1e-3")
    rate = largest["eta"] / smoothing + largest["k"] + largest["c2"]
    for step in _STEPS:
        if step * rate <= _STABLE:
            return step
    raise ValueError(f"smoothing = {smoothing:g} rad/s is too narrow for eta = {largest['eta']:g} rad/s2; type a larger one")


class Quantity(NamedTuple):
    """A parameter that can be an axis: its label, the range drawn by default, and how it enters a setting."""

    label: str
    low: float
    high: float
    enter: Callable[[Setting, Any], Setting]


QUANTITIES = {
    "c1": Quantity("gain c1 (1/s)", 0.2, 1.5, _of_gains("c1")),
    "c2": Quantity("gain c2 (1/s)", 1.0, 8.0, _of_gains("c2")),
    "z_u": Quantity("largest asked swing z_U (rad)", 0.05, 0.98, _of_gains("z_u")),
    "phi_z": Quantity("width Φ_z (rad/s)", 2.0, 20.0, _of_gains("phi_z")),
    "eta": Quantity("switching gain η (rad/s²)", 0.5, 10.0, _of_gains("eta")),
    "k": Quantity("reaching gain k (1/s)", 0.2, 10.0, _of_gains("k")),
    "pendulum_mass": Quantity("pendulum mass m_p (kg)", 0.5, 6.0, _of_robot("pendulum_mass")),
    "shell_mass": Quantity("shell mass m (kg)", 0.3, 4.0, _of_robot("shell_mass")),
    "gimbal_mass": Quantity("gimbal mass m_i (kg)", 0.3, 4.0, _of_robot("gimbal_mass")),
    "pendulum_length": Quantity("pendulum length l (m)", 0.03, 0.145, _of_robot("pendulum_length")),
    "mass_ratio": Quantity("pendulum mass / total mass", 0.05, 0.6, _mass_ratio),
    "length_ratio": Quantity("pendulum length / shell radius", 0.2, 0.95, _length_ratio),
    "torque_limit": Quantity("torque limit (N m)", 0.5, 4.0, _of_task("torque_limit")),
    "travel": Quantity("travel (rad)", 1.0, 40.0, _of_task("travel")),
    "push": Quantity("rate of the sphere at the start (rad/s)", -2.0, 2.0, _push),
    "slope": Quantity("slope γ (rad)", 0.0, 0.34, _of_task("slope")),
}


def axis(name: str, count: int, low: float | None = None, high: float | None = None) -> Axis:
    """Axis of `count` values from `low` to `high`. Raises ValueError for an unknown name or an empty range."""
    require_choice("axis", name, tuple(QUANTITIES))
    require_count("size", count)
    quantity = QUANTITIES[name]
    first, last = (quantity.low if low is None else low), (quantity.high if high is None else high)
    require_scalar(f"{name} axis begins at", first)
    require_scalar(f"{name} axis ends at", last, above=first)
    return Axis(name, np.linspace(first, last, count), quantity.label)


def at(setting: Setting, **values: Any) -> Setting:
    """Return the setting with the named quantities at these values."""
    for name, value in values.items():
        setting = QUANTITIES[name].enter(setting, value)
    return setting


def check(setting: Setting, x: Axis, y: Axis) -> None:
    """Check the four corners of a map on the host. Raises ValueError for the first that is not admissible."""
    for xv in (x.values[0], x.values[-1]):
        for yv in (y.values[0], y.values[-1]):
            here = at(setting, **{x.name: float(xv), y.name: float(yv)})
            checked(here.task, here.numerics)
            try:
                here.task.check(here.gains)
            except ValueError as error:
                name, _, words = str(error).partition(" = ")
                if (leaf := name.rpartition(".")[2]) in (x.name, y.name):
                    raise ValueError(f"{leaf} axis reaches {words}") from None
                raise
