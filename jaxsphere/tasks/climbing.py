"""How steep does a closed loop climb: how one climb ends, and the steepest slope up to which climbs succeed.

    climbs      the robot starts at rest at phi_0 and is within 2 % of the travel at the end, the pendulum never over the top
    gamma*      the steepest slope (rad) up to which a closed loop climbs, the closed-loop bound; never above (4)

Two shortcuts decide a climb before its end (`early`): a lane that is deep inside the settling band, near an equilibrium whose
sliding motion is stable, has settled; one that has rolled away by three travels (at least 30 rad) has failed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_scalar
from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import climbing_bound, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.simulation.closed_loop import LoopState
from jaxsphere.simulation.host import cast
from jaxsphere.simulation.search import Pausable, Trial, largest_success, outcome, run
from jaxsphere.status import Status, code
from jaxsphere.tasks.metrics import SETTLING_BAND
from jaxsphere.tasks.numerics import Numerics
from jaxsphere.tasks.planar import PlanarTask
from jaxsphere.tasks.simulate import checked, closed_loop_of

# A climb that has not settled by then is called too slow.
MINUTE = Numerics(duration=60.0)
# Simulated seconds between two looks at a lane, at most.
_SEGMENT = 1.0
# Shares of the settling band and of the way to the merging point within which a lane has settled.
_DEEP = 0.25
_NEAR = 0.1
# Travels (of at least 10 rad) from the target beyond which a lane has failed.
_LOST = 3.0
# The holding torque may be at most this share of the limit for the linearisation to decide.
_TORQUE_RESERVE = 0.98


class Outcome(NamedTuple):
    """How one climb ended."""

    UNITS = {"seconds": "s"}  # noqa: RUF012

    status: Array  # a Status code; OK when it settled
    seconds: Array  # simulated until that was decided, s


class SteepestSlope(NamedTuple):
    """What a search for the steepest slope found; every entry a scalar per lane."""

    UNITS = {"value": "rad", "lower": "rad", "upper": "rad", "seconds": "s"}  # noqa: RUF012

    value: Array  # rad, middle of the bracket; NaN where even the flat fails
    lower: Array  # rad, steepest slope seen to succeed; NaN where none was
    upper: Array  # rad, least slope seen to fail, or the end of the search
    status: Array  # Status code at `upper`; OK where nothing below the end of the search failed
    rollouts: Array  # simulated on the way
    seconds: Array  # simulated in all of them, s


def climb_outcome(
    task: PlanarTask, gains: SlidingModeGains | None = None, numerics: Numerics = MINUTE, *, early: bool = True
) -> Outcome:
    """Tell how the climb of a task ends. Batch it with `jax.vmap`, or `outcome_run` with `js.batch(..., ragged=True)`.

    Args:
        task: what climbs, how far and on which slope.
        gains: Table 3 by default.
        numerics: time step, duration, integrator and precision; nothing is saved.
        early: decide clear cases before the duration is over.

    Raises:
        ValueError: an argument is not admissible.
    """
    return _climb(*_prepared(task, gains, numerics), early=early)


def outcome_run(
    task: PlanarTask, gains: SlidingModeGains | None = None, numerics: Numerics = MINUTE, *, early: bool = True
) -> Pausable:
    """Return the simulation of `climb_outcome`, with the same arguments, unstarted."""
    task, given, numerics = _prepared(task, gains, numerics)
    ending = outcome(_trial(task, given, numerics, early), jnp.asarray(task.slope))
    segment = _segment(numerics) * numerics.dt
    return ending._replace(result=lambda carry: Outcome(ending.result(carry)[0], ending.result(carry)[1] * segment))


def steepest_slope(
    task: PlanarTask,
    gains: SlidingModeGains | None = None,
    numerics: Numerics = MINUTE,
    *,
    tolerance: Real = 1e-5,
    guess: Real | None = None,
    early: bool = True,
) -> SteepestSlope:
    """Find the closed-loop bound gamma* (rad): the steepest slope, up to the bound (4), that the controlled robot climbs.

    Bisection takes the outcome for monotone in the slope; `climb_outcome` on a scan of slopes shows whether it is. Batch it
    with `jax.vmap`, or `slope_search` with `js.batch(..., ragged=True)`.

    Args:
        task: what climbs, and how far; its own slope plays no part.
        gains, numerics, early: as in `climb_outcome`.
        tolerance: rad, width of the bracket.
        guess: rad, where to look first, e.g. the bound of a neighbour; the middle of the interval by default.

    Raises:
        ValueError: an argument is not admissible.
    """
    _require_search(tolerance, guess)
    task, gains, numerics = _prepared(task, gains, numerics)
    return _search(task, gains, numerics, *cast((tolerance, guess), numerics.dtype), early=early)


def slope_search(
    task: PlanarTask,
    gains: SlidingModeGains | None = None,
    numerics: Numerics = MINUTE,
    *,
    tolerance: Real = 1e-5,
    guess: Real | None = None,
    early: bool = True,
) -> Pausable:
    """Return the search of `steepest_slope`, with the same arguments, unstarted."""
    _require_search(tolerance, guess)
    task, given, numerics = _prepared(task, gains, numerics)
    width, near = jax.tree.map(jnp.asarray, cast((tolerance, guess), numerics.dtype))
    limit = climbing_bound(task.robot if task.plant is None else task.plant)
    # Half a bracket below a good guess: the next step closes the bracket around it.
    first, step = (None, None) if near is None else (near - 0.5 * width, width)
    search = largest_success(_trial(task, given, numerics, early), jnp.zeros_like(limit), limit, width, first, step)
    return in_seconds(search, _segment(numerics) * numerics.dt)


def in_seconds(search: Pausable, segment: Real) -> Pausable:
    """Let a search for a slope, in segments of so many seconds, end with a `SteepestSlope`."""

    def result(carry: Any) -> SteepestSlope:
        bound = search.result(carry)
        return SteepestSlope(bound.value, bound.lower, bound.upper, bound.status, bound.trials, bound.segments * segment)

    return search._replace(result=result)


@partial(jax.jit, static_argnames=("numerics", "early"))
def _climb(task: PlanarTask, gains: SlidingModeGains, numerics: Numerics, *, early: bool) -> Outcome:
    return run(outcome_run(task, gains, numerics, early=early))


@partial(jax.jit, static_argnames=("numerics", "early"))
def _search(
    task: PlanarTask, gains: SlidingModeGains, numerics: Numerics, tolerance: Real, guess: Real | None, *, early: bool
) -> SteepestSlope:
    return run(slope_search(task, gains, numerics, tolerance=tolerance, guess=guess, early=early))


def _prepared(task: PlanarTask, gains: SlidingModeGains | None, numerics: Numerics) -> tuple[Any, Any, Numerics]:
    if not isinstance(task, PlanarTask):
        raise TypeError(f"task = {task!r} is no PlanarTask; type jaxsphere.PlanarTask(travel=10.0)")
    gains, numerics = task.default_gains() if gains is None else gains, checked(task, replace(numerics, save_every=None))
    task.check(gains)
    return *cast((task, gains), numerics.dtype), numerics


def _require_search(tolerance: Real, guess: Real | None) -> None:
    require_scalar("tolerance", tolerance, above=0.0, unit="rad")
    if guess is not None:
        require_scalar("guess", guess, unit="rad")


def _steps(numerics: Numerics) -> int:
    return round((numerics.duration or 0.0) / numerics.dt)


def _segment(numerics: Numerics) -> int:
    """Steps of one segment: the most that divide the rollout and last a second at most."""
    most = max(1, min(_steps(numerics), math.floor(_SEGMENT / numerics.dt + 1e-9)))
    return next(count for count in range(most, 0, -1) if _steps(numerics) % count == 0)


def _trial(task: PlanarTask, gains: SlidingModeGains, numerics: Numerics, early: bool) -> Trial:
    target, travel = task.target(), jnp.abs(jnp.asarray(task.travel))

    def start(slope: Array) -> LoopState:
        here = replace(task, slope=slope)
        return closed_loop_of(here, gains, numerics).init(*here.start())

    def advance(slope: Array, now: LoopState) -> tuple[LoopState, Array, Array]:
        step = closed_loop_of(replace(task, slope=slope), gains, numerics).step
        now, _ = jax.lax.scan(lambda one, _: (step(one)[0], None), now, None, length=_segment(numerics))
        error = jnp.abs(now.x[0] - target)
        ended = now.status != Status.OK
        status = jnp.where(ended | (error <= SETTLING_BAND * travel), now.status, code(Status.NOT_SETTLED))
        lost = error > _LOST * jnp.maximum(travel, 10.0)
        status = jnp.where(lost & ~ended, code(Status.DIVERGED), status)
        decided = ended | (now.index >= _steps(numerics))
        return now, decided | (early & (lost | _has_settled(task, gains, slope, now.x))), status

    return Trial(start, advance)


def _has_settled(task: PlanarTask, gains: SlidingModeGains, slope: Array, state: planar.State) -> Array:
    """Tell (bool) whether the linearised sliding motion alone decides the rest of the climb."""
    alpha, alpha_rate, swing, swing_rate = state
    lumped, rest = planar.lump(task.robot, slope), equilibrium_swing(task.robot, slope)
    zero = jnp.zeros_like(rest)
    m11, m12, m22 = planar.inertia(lumped, (zero, zero, rest, zero))
    # Routh's conditions of the paper's law; with k_i the target is reached more slowly and nothing is decided early.
    stable = (gains.c1 < gains.c2) & (gains.c2 * gains.z_u * (m12 - m22) < gains.phi_z * (m11 - m12)) & (gains.k_i == 0.0)
    # They know neither another plant nor what the sensors and the hold add.
    stable = stable & (task.plant is None and task.sensor_bias is None and task.delayed is None)
    if task.torque_limit is not None:
        stable = stable & (jnp.abs(lumped.slope_torque) < _TORQUE_RESERVE * task.torque_limit)
    deep = _DEEP * SETTLING_BAND * jnp.abs(task.travel)
    near = _NEAR * (0.5 * jnp.pi - jnp.abs(rest))
    at_target = (jnp.abs(alpha - task.target()) <= deep) & (jnp.abs(alpha_rate) <= gains.c1 * deep)
    return stable & at_target & (jnp.abs(swing - rest) <= near) & (jnp.abs(swing_rate) <= gains.c2 * near)
