"""What raises the closed-loop bound gamma*: its derivatives from a smooth margin, and gains tuned to climb.

A climb fails at gamma* in one of two ways, and each has a smooth margin m(gamma, p), zero at the bound:

    past the saddle    the closed loop has a second equilibrium, at rest with the pendulum at pi - phi_0; at the bound the climb
                       ends on it. m is the distance from the saddle along its unstable direction, at a time when the climb
                       lingers there: m = w (x(T) - x_saddle), w the left eigenvector.
    too slow           m is what is left of the settling band at the end: m = 2 % |travel| - |e(T)|.

With m = 0 along gamma*(p), dgamma*/dp = -(dm/dp) / (dm/dgamma).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from jaxsphere.numerics import Real
from jaxsphere.tasks.metrics import SETTLING_BAND
from tuning.objectives.regulation import RestToRest, Weights
from tuning.optimisers.levenberg_marquardt import levenberg_marquardt
from tuning.search import tune

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


def scaled(climb: js.Climb, names: Sequence[str], logarithms: Array) -> js.Climb:
    """Return the climb with the named quantities (of gains, robot or task) multiplied by the exponentials (n,)."""
    for name, logarithm in zip(names, logarithms, strict=True):
        require_choice("name", name, (*GAINS, *DESIGN, *TASK))
        factor = jnp.exp(logarithm)
        if name in TASK:
            climb = replace(climb, **{name: getattr(climb, name) * factor})
        else:
            part = "gains" if name in GAINS else "robot"
            whole = getattr(climb, part)
            climb = replace(climb, **{part: replace(whole, **{name: getattr(whole, name) * factor})})
    return climb


def saddle(climb: js.Climb, slope: Real) -> Array:
    """Second equilibrium (4,) of the closed loop, at rest with the pendulum at pi - phi_0; NaN where there is none.

    There z of (8) holds the pendulum beyond the merging point: e = -(Phi_z / c1) artanh((pi - 2 phi_0) / z_U), which needs
    z_U > pi - 2 phi_0. With smaller z_U the pendulum is never asked to go where it no longer pushes the robot up.
    """
    gains, swing = climb.gains, js.equilibria(climb.robot, slope).upper
    beyond = swing - js.equilibrium_swing(climb.robot, slope)
    error = -gains.phi_z / gains.c1 * jnp.arctanh(beyond / gains.z_u)
    zero = jnp.zeros_like(swing)
    return jnp.stack([climb.travel + error, zero, swing, zero])


def unstable_direction(climb: js.Climb, slope: float) -> tuple[float, np.ndarray]:
    """Pole (1/s) and left eigenvector (4,) of the one direction in which climbs leave the `saddle`."""
    lumped, rest = planar.lump(climb.robot, slope), js.equilibrium_swing(climb.robot, slope)

    def motion(state: Array) -> Array:
        parts = tuple(state)
        zero = jnp.zeros_like(state[0])
        now = sliding_mode.signals(lumped, rest, climb.gains, parts, zero, climb.travel, climb.smoothing)
        return jnp.stack(planar.derivative(lumped, parts, (now.equivalent + now.switching,)))

    poles, vectors = np.linalg.eig(np.asarray(jax.jacfwd(motion)(saddle(climb, slope))).T)
    index = int(np.argmax(np.real(poles)))
    return float(np.real(poles[index])), np.real(vectors[:, index])


def climb_sensitivity(climb: js.Climb, names: Sequence[str] = (*GAINS, *DESIGN), tolerance: float = 1e-10) -> Sensitivity:
    """Differentiate gamma* by the implicit function theorem, in one rollout with forward derivatives.

    Args:
        climb: with a continuous controller and smoothing > 0, without plant or disturbance. names: of the quantities, of
        GAINS, DESIGN or TASK. tolerance: rad, to which gamma* is bisected first.

    Raises:
        ValueError: an argument is not admissible, or the climb succeeds on every slope up to the bound (4).
    """
    _require_smooth(climb)
    bound = js.steepest_slope(climb, tolerance)
    if int(bound.status) == js.Status.OK or not np.isfinite(float(bound.value)):
        raise ValueError(
            "gamma* of this climb is the bound (4) itself or does not exist; type another climb, e.g. longer travel"
        )
    slope = float(bound.value)
    too_slow = int(bound.status) == js.Status.NOT_SETTLED
    time = climb.duration if too_slow else _parting_time(climb, float(bound.lower), float(bound.upper))
    margin = _band_margin(climb, names) if too_slow else _saddle_margin(climb, names, slope, time)
    none = jnp.zeros(len(names))
    by_slope, by_logarithm = jax.jit(jax.jacfwd(margin, (0, 1)))(slope, none)
    ends = tuple(float(margin(float(end), none)) for end in (bound.lower, bound.upper))
    mode = "too slow" if too_slow else "past the saddle"
    return Sensitivity(tuple(names), np.asarray(-by_logarithm / by_slope), slope, mode, time, ends)  # type: ignore[arg-type]


def sensitivity_by_differences(
    climb: js.Climb, names: Sequence[str], step: float = 1e-3, tolerance: float = 1e-9
) -> np.ndarray:
    """Central differences (n,) of the bisected gamma* over `step` in the logarithms of the named quantities, rad."""
    size = len(names)
    run = js.over_queue(lambda logarithms: js.slope_search(scaled(climb, names, logarithms), tolerance))
    value = run(step * np.concatenate([np.eye(size), -np.eye(size)])).value
    return (value[:size] - value[size:]) / (2.0 * step)


def _require_smooth(climb: js.Climb) -> None:
    if climb.control_period is not None or climb.plant is not None or climb.disturbance is not None:
        raise ValueError("climb is sampled, disturbed or has another plant, which the margin does not know; leave them None")
    require_scalar("smoothing", climb.smoothing, above=0.0, unit="rad/s")


def _final_state(climb: js.Climb, slope: Real, duration: float) -> Array:
    run = js.rest_to_rest(
        climb.robot,
        slope,
        climb.gains,
        climb.travel,
        duration,
        climb.dt,
        climb.smoothing,
        climb.torque_limit,
        save_every=None,
        throw=False,
    )
    return run.state[-1]


def _band_margin(climb: js.Climb, names: Sequence[str]) -> Callable[[Any, Array], Array]:
    def margin(slope: Any, logarithms: Array) -> Array:
        here = scaled(climb, names, logarithms)
        error = _final_state(here, slope, climb.duration)[0] - here.travel
        return SETTLING_BAND * jnp.abs(here.travel) - jnp.abs(error)

    return margin


def _saddle_margin(climb: js.Climb, names: Sequence[str], bound: float, time: float) -> Callable[[Any, Array], Array]:
    _, direction = unstable_direction(climb, bound)

    def margin(slope: Any, logarithms: Array) -> Array:
        here = scaled(climb, names, logarithms)
        return jnp.sum(direction * (_final_state(here, slope, time) - saddle(here, slope)))

    return margin


def _parting_time(climb: js.Climb, lower: float, upper: float) -> float:
    """Last time (s) at which the climbs at both ends of the bracket are still together."""
    stride = max(1, round(0.1 / climb.dt))
    steps = round(climb.duration / climb.dt)
    states = [
        np.asarray(
            js.rest_to_rest(
                climb.robot,
                slope,
                climb.gains,
                climb.travel,
                (steps - steps % stride) * climb.dt,
                climb.dt,
                climb.smoothing,
                climb.torque_limit,
                save_every=stride,
                throw=False,
            ).state
        )
        for slope in (lower, upper)
    ]
    apart = np.max(np.abs(states[0] - states[1]), axis=1) > _APART
    return max(int(np.argmax(apart)) - 1, 1) * stride * climb.dt


class ClimbTuning(NamedTuple):
    """Gains tuned to climb, and how gamma* (rad) grew: before, and after every round."""

    gains: js.SlidingModeGains
    bounds: tuple[float, ...]
    static_bound: float


def tune_to_climb(
    climb: js.Climb, rounds: int = 4, iterations: int = 25, dt: float = 1.6e-2, smoothing: float = 0.2, progress: bool = True
) -> ClimbTuning:
    """Raise gamma* by gradients: tune the gains on a slope just below it, find the new gamma*, and go on from there.

    On a slope near the bound (4) the fastest climb keeps the pendulum near pi/2, where its pull is largest, and the integral
    of t |e| alone tells the gains to ask for no more swing than that.

    Args:
        climb: what climbs; its gains are where to begin. rounds: slopes in turn. iterations: of Levenberg-Marquardt on each.
        dt: step and hold of the tuning rollouts, s. smoothing: of the sign in them, rad/s. progress: show progress bars.
    """
    require_count("rounds", rounds)
    static = float(js.climbing_bound(climb.robot))
    found = js.steepest_slope(climb)
    bounds = [float(found.value)]
    if not np.isfinite(bounds[0]):
        raise ValueError("the gains do not climb even the flat; type others, e.g. jaxsphere.SlidingModeGains()")
    steps = round(climb.duration / dt)
    for _ in range(rounds):
        # Beyond gamma* where climbs are only too slow; where they fall off the ridge they teach nothing, so just below it.
        too_slow = int(found.status) == js.Status.NOT_SETTLED
        slope = max(float(found.lower) + (_AHEAD if too_slow else -_BEHIND) * (static - bounds[-1]), 0.0)
        objective = RestToRest(
            climb.robot,
            slope,
            travel=climb.travel,
            duration=steps * dt,
            dt=dt,
            smoothing=smoothing,
            torque_limit=None if climb.torque_limit is None else float(climb.torque_limit),
            weights=Weights(swing=0.0, prior=0.003),
        )
        # Long steps find gains that are quicker on this slope and fall off the ridge on the next.
        rule = levenberg_marquardt(longest=_LONGEST)
        gains = tune(objective, climb.gains, optimiser=rule, iterations=iterations, progress=progress).gains
        better = js.steepest_slope(replace(climb, gains=gains))
        if not float(better.value) > bounds[-1]:
            break
        climb, found = replace(climb, gains=gains), better
        bounds.append(float(better.value))
    return ClimbTuning(climb.gains, tuple(bounds), static)
