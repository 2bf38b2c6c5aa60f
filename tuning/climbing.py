"""What raises the closed-loop bound gamma*: its derivatives from a smooth margin, and gains tuned to climb.

A climb fails at gamma* in one of two ways, and each has a smooth margin m(gamma, p), zero at the bound:

    past the saddle    the closed loop has a second equilibrium, at rest with the pendulum at pi - phi_0; at the bound the climb
                       ends on it. m is the distance from the saddle along its unstable direction, at a time when the climb
                       lingers there: m = w (x(T) - x_saddle), w the left eigenvector.
    too slow           m is what is left of the settling band at the end: m = 2 % |travel| - |e(T)|.

With m = 0 along gamma*(p), dgamma*/dp = -(dm/dp) / (dm/dgamma).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.controllers import sliding_mode
from jaxsphere.models import planar
from jaxsphere.tasks.climbing import MINUTE
from jaxsphere.tasks.metrics import SETTLING_BAND
from tuning.objectives import RestToRest, Weights
from tuning.second_order import levenberg_marquardt
from tuning.tuner import tune

GAINS = ("c1", "c2", "z_u", "phi_z", "eta", "k")
DESIGN = ("shell_mass", "gimbal_mass", "pendulum_mass", "pendulum_length", "shell_radius", "shell_inertia", "gimbal_inertia")
TASK = ("travel", "torque_limit")

# The margin is read when two climbs that differ by the bracket have come this far apart, in units of the state.
_APART = 1e-4
# Where the next slope to tune on is, in gaps between gamma* and the bound (4).
_LONGEST = 0.12  # of a step in the logarithms of the gains
_AHEAD = 0.5
_BEHIND = 0.1


class Sensitivity(NamedTuple):
    """Derivatives of gamma* with respect to the logarithms of named quantities, rad, and what they were taken at."""

    names: tuple[str, ...]
    derivative: np.ndarray  # dgamma* / d ln p, rad: a hundredth of it per per cent
    slope: float  # gamma*, rad
    mode: str  # "past the saddle" or "too slow"
    time: float  # at which the margin was read, s
    margins: tuple[float, float]  # at both ends of the bracket: of opposite signs when the margin has its zero there


def scaled(
    task: js.PlanarTask, gains: js.SlidingModeGains, names: Sequence[str], logarithms: Array
) -> tuple[js.PlanarTask, js.SlidingModeGains]:
    """Return task and gains with the named quantities (of gains, robot or task) multiplied by the exponentials (n,)."""
    for name, logarithm in zip(names, logarithms, strict=True):
        require_choice("name", name, (*GAINS, *DESIGN, *TASK))
        factor = jnp.exp(logarithm)
        if name in GAINS:
            gains = replace(gains, **{name: getattr(gains, name) * factor})
        elif name in TASK:
            task = replace(task, **{name: getattr(task, name) * factor})
        else:
            task = replace(task, robot=replace(task.robot, **{name: getattr(task.robot, name) * factor}))
    return task, gains


def saddle(task: js.PlanarTask, gains: js.SlidingModeGains) -> Array:
    """Second equilibrium (4,) of the closed loop, at rest with the pendulum at pi - phi_0; NaN where there is none.

    There z of (8) holds the pendulum beyond the merging point: e = -(Phi_z / c1) artanh((pi - 2 phi_0) / z_U), which needs
    z_U > pi - 2 phi_0. With smaller z_U the pendulum is never asked to go where it no longer pushes the robot up.
    """
    swing = js.equilibria(task.robot, task.slope).upper
    beyond = swing - js.equilibrium_swing(task.robot, task.slope)
    error = -gains.phi_z / gains.c1 * jnp.arctanh(beyond / gains.z_u)
    zero = jnp.zeros_like(swing)
    return jnp.stack([task.travel + error, zero, swing, zero])


def unstable_direction(task: js.PlanarTask, gains: js.SlidingModeGains) -> tuple[float, np.ndarray]:
    """Pole (1/s) and left eigenvector (4,) of the one direction in which climbs leave the `saddle`."""
    lumped, rest = planar.lump(task.robot, task.slope), js.equilibrium_swing(task.robot, task.slope)

    def motion(state: Array) -> Array:
        parts = tuple(state)
        zero = jnp.zeros_like(state[0])
        now = sliding_mode.signals(lumped, rest, gains, parts, zero, task.travel, task.smoothing)
        return jnp.stack(planar.derivative(lumped, parts, (now.equivalent + now.switching,)))

    poles, vectors = np.linalg.eig(np.asarray(jax.jacfwd(motion)(saddle(task, gains))).T)
    index = int(np.argmax(np.real(poles)))
    return float(np.real(poles[index])), np.real(vectors[:, index])


def climb_sensitivity(
    task: js.PlanarTask,
    gains: js.SlidingModeGains | None = None,
    numerics: js.Numerics = MINUTE,
    names: Sequence[str] = (*GAINS, *DESIGN),
    tolerance: float = 1e-10,
) -> Sensitivity:
    """Differentiate gamma* by the implicit function theorem, in one rollout with forward derivatives.

    Args:
        task: with a continuous controller and smoothing > 0, without plant or disturbance; its slope plays no part.
        gains: Table 3 by default.
        numerics: of the climbs.
        names: of the quantities, of GAINS, DESIGN or TASK.
        tolerance: rad, to which gamma* is bisected first.

    Raises:
        ValueError: an argument is not admissible, or the climb succeeds on every slope up to the bound (4).
    """
    gains = js.SlidingModeGains() if gains is None else gains
    _require_smooth(task)
    bound = js.steepest_slope(task, gains, numerics, tolerance=tolerance)
    if int(bound.status) == js.Status.OK or not np.isfinite(float(bound.value)):
        raise ValueError("gamma* of this task is the bound (4) itself or does not exist; type another task, e.g. longer travel")
    task = replace(task, slope=float(bound.value))
    too_slow = int(bound.status) == js.Status.NOT_SETTLED
    time = numerics.duration if too_slow else _parting_time(task, gains, numerics, (float(bound.lower), float(bound.upper)))
    end = replace(numerics, duration=time, save_every=None)
    direction = None if too_slow else unstable_direction(task, gains)[1]

    def margin(slope: Any, logarithms: Array) -> Array:
        here, changed = scaled(replace(task, slope=slope), gains, names, logarithms)
        last = js.simulate(here, changed, end, throw=False).state[-1]
        if direction is None:
            return SETTLING_BAND * jnp.abs(here.travel) - jnp.abs(last[0] - here.travel)
        return jnp.sum(direction * (last - saddle(here, changed)))

    none = jnp.zeros(len(names))
    by_slope, by_logarithm = jax.jit(jax.jacfwd(margin, (0, 1)))(task.slope, none)
    ends = (float(margin(float(bound.lower), none)), float(margin(float(bound.upper), none)))
    mode = "too slow" if too_slow else "past the saddle"
    return Sensitivity(tuple(names), np.asarray(-by_logarithm / by_slope), float(bound.value), mode, float(time or 0.0), ends)


def sensitivity_by_differences(
    task: js.PlanarTask,
    gains: js.SlidingModeGains,
    names: Sequence[str],
    numerics: js.Numerics = MINUTE,
    step: float = 1e-3,
    tolerance: float = 1e-9,
) -> np.ndarray:
    """Central differences (n,) of the bisected gamma* over `step` in the logarithms of the named quantities, rad."""
    size = len(names)

    def search(logarithms: Array) -> Any:
        return js.slope_search(*scaled(task, gains, names, logarithms), numerics, tolerance=tolerance)

    value = np.asarray(js.batch(search, ragged=True)(step * np.concatenate([np.eye(size), -np.eye(size)])).value)
    return (value[:size] - value[size:]) / (2.0 * step)


def _require_smooth(task: js.PlanarTask) -> None:
    if task.control_period is not None or task.plant is not None or task.disturbance is not None:
        raise ValueError("task is sampled, disturbed or has another plant, which the margin does not know; leave them None")
    require_scalar("smoothing", task.smoothing, above=0.0, unit="rad/s")


def _parting_time(
    task: js.PlanarTask, gains: js.SlidingModeGains, numerics: js.Numerics, bracket: tuple[float, float]
) -> float:
    """Last time (s) at which the climbs at both ends of the bracket are still together."""
    stride = max(1, round(0.1 / numerics.dt))
    steps = round((numerics.duration or 0.0) / numerics.dt)
    saved = replace(numerics, duration=(steps - steps % stride) * numerics.dt, save_every=stride)
    one, other = (np.asarray(js.simulate(replace(task, slope=slope), gains, saved, throw=False).state) for slope in bracket)
    apart = np.max(np.abs(one - other), axis=1) > _APART
    return max(int(np.argmax(apart)) - 1, 1) * stride * numerics.dt


class ClimbTuning(NamedTuple):
    """Gains tuned to climb, and how gamma* (rad) grew: before, and after every round."""

    gains: js.SlidingModeGains
    bounds: tuple[float, ...]
    static_bound: float


def tune_to_climb(
    task: js.PlanarTask,
    gains: js.SlidingModeGains | None = None,
    numerics: js.Numerics = MINUTE,
    rounds: int = 4,
    iterations: int = 25,
    dt: float = 1.6e-2,
    smoothing: float = 0.2,
    progress: bool = True,
) -> ClimbTuning:
    """Raise gamma* by gradients: tune the gains on a slope just below it, find the new gamma*, and go on from there.

    On a slope near the bound (4) the fastest climb keeps the pendulum near pi/2, where its pull is largest, and the integral
    of t |e| alone tells the gains to ask for no more swing than that.

    Args:
        task: what climbs; its slope plays no part.
        gains: where to begin, Table 3 by default.
        numerics: of the climbs.
        rounds: slopes in turn.
        iterations: of Levenberg-Marquardt on each.
        dt: step and hold of the tuning rollouts, s.
        smoothing: of the sign in them, rad/s.
        progress: show progress bars.
    """
    require_count("rounds", rounds)
    best = js.SlidingModeGains() if gains is None else gains
    static = float(js.climbing_bound(task.robot))
    found = js.steepest_slope(task, best, numerics)
    bounds = [float(found.value)]
    if not np.isfinite(bounds[0]):
        raise ValueError("the gains do not climb even the flat; type others, e.g. jaxsphere.SlidingModeGains()")
    duration = round((numerics.duration or 0.0) / dt) * dt
    limit = None if task.torque_limit is None else float(task.torque_limit)
    for _ in range(rounds):
        # Beyond gamma* where climbs are only too slow; where they fall off the ridge they teach nothing, so just below it.
        too_slow = int(found.status) == js.Status.NOT_SETTLED
        slope = max(float(found.lower) + (_AHEAD if too_slow else -_BEHIND) * (static - bounds[-1]), 0.0)
        weights = Weights(swing=0.0, prior=0.003)
        objective = RestToRest(task.robot, slope, task.travel, duration, dt, smoothing, limit, weights=weights)
        # Long steps find gains that are quicker on this slope and fall off the ridge on the next.
        rule = levenberg_marquardt(longest=_LONGEST)
        tuned = tune(objective, best, optimiser=rule, iterations=iterations, progress=progress).gains
        better = js.steepest_slope(task, tuned, numerics)
        if not float(better.value) > bounds[-1]:
            break
        best, found = tuned, better
        bounds.append(float(better.value))
    return ClimbTuning(best, tuple(bounds), static)
