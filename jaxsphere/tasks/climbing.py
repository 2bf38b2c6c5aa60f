"""How steep does a closed loop climb: the fate of one climb, and the steepest slope up to which climbs succeed.

    climbs      the robot starts at rest at phi_0 and is within 2 % of the travel at the end, the pendulum never over the top
    gamma*      the steepest slope (rad) up to which a closed loop climbs, the closed-loop bound; never above (4)

Two shortcuts decide a climb before its end (`early`): a lane that is deep inside the settling band, near an equilibrium whose
sliding motion is stable, has settled; one that has rolled away by three travels (at least 30 rad) has failed.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import is_concrete, require_finite_vector, require_scalar
from jaxsphere.controllers import sliding_mode
from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import climbing_bound, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation.bisection import Trial, largest_success, outcome
from jaxsphere.simulation.closed_loop import ClosedLoop, LoopState, closed_loop
from jaxsphere.simulation.host import cast, check_control_period, check_time_grid
from jaxsphere.simulation.pausable import Pausable, run
from jaxsphere.status import Status, code
from jaxsphere.tasks.metrics import SETTLING_BAND
from jaxsphere.tasks.planar import planar_plant

# Simulated seconds between two looks at a lane.
_SEGMENT = 1.0
# Shares of the settling band and of the way to the merging point within which a lane has settled.
_DEEP = 0.25
_NEAR = 0.1
# Travels (of at least 10 rad) from the target beyond which a lane has failed.
_LOST = 3.0
# The holding torque may be at most this share of the limit for the linearisation to decide.
_TORQUE_RESERVE = 0.98


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Climb:
    """A climb under sliding-mode control on a slope still to be named; every field of the first block is a leaf.

    robot: the one the controller believes in, and the plant too unless `plant` is given. gains: Table 3 by default. travel:
    rad. torque_limit: N m, None for no limit. smoothing: epsilon of the switching term, rad/s, 0 for the hard sign. plant:
    the true robot. disturbance: (4,), added to rest at phi_0, where a climb begins.

    duration: s. dt: s, of RK4. control_period: s, of a sampled controller, None for a continuous one. early: decide clear
    cases before `duration`.
    """

    robot: Robot = field(default_factory=Robot)
    gains: SlidingModeGains = field(default_factory=SlidingModeGains)
    travel: Real = 10.0
    torque_limit: Real | None = None
    smoothing: Real = 0.02
    plant: Robot | None = None
    disturbance: Real | None = None

    duration: float = field(default=60.0, metadata={"static": True})
    dt: float = field(default=1e-3, metadata={"static": True})
    control_period: float | None = field(default=None, metadata={"static": True})
    early: bool = field(default=True, metadata={"static": True})


class Outcome(NamedTuple):
    """How one climb ended."""

    status: Array  # a Status code; OK when it settled
    seconds: Array  # simulated until that was decided, s


class SteepestSlope(NamedTuple):
    """What a search for the steepest slope found; every entry a scalar per lane."""

    value: Array  # rad, middle of the bracket; NaN where even the flat fails
    lower: Array  # rad, steepest slope seen to succeed; NaN where none was
    upper: Array  # rad, least slope seen to fail, or the end of the search
    status: Array  # Status code at `upper`; OK where nothing below the end of the search failed
    rollouts: Array  # simulated on the way
    seconds: Array  # simulated in all of them, s


def climb_outcome(climb: Climb, slope: Real, dtype: Any = None) -> Outcome:
    """Tell how a climb on the slope (rad) ends. Batch it with `jax.vmap`, or `outcome_run` with `js.over_queue`.

    Raises:
        ValueError: an argument is not admissible.
    """
    return _run(outcome_run, climb, slope, dtype)


def outcome_run(climb: Climb, slope: Real, dtype: Any = None) -> Pausable:
    """Return the simulation of `climb_outcome`, with the same arguments, unstarted."""
    require_scalar("slope", slope, above=-math.pi / 2, below=math.pi / 2, unit="rad", hint="type radians, e.g. jnp.deg2rad(10)")
    climb, slope = cast((check_climb(climb), slope), dtype or jnp.float64)
    fate, segment = outcome(_climb_trial(climb), jnp.asarray(slope)), _segment_steps(climb) * climb.dt
    return fate._replace(result=lambda carry: Outcome(fate.result(carry)[0], fate.result(carry)[1] * segment))


def steepest_slope(climb: Climb, tolerance: Real = 1e-5, guess: Real | None = None, dtype: Any = None) -> SteepestSlope:
    """Find the closed-loop bound gamma* (rad): the steepest slope, up to the bound (4), that the controlled robot climbs.

    Bisection takes the outcome for monotone in the slope; `climb_outcome` on a scan of slopes shows whether it is. Batch it
    with `jax.vmap`, or `slope_search` with `js.over_queue`.

    Args:
        climb: what climbs, and how far. tolerance: rad, width of the bracket. guess: rad, where to look first, e.g. the bound
        of a neighbour; the middle of the interval by default. dtype: float64 unless given.

    Raises:
        ValueError: an argument is not admissible.
    """
    return _run(slope_search, climb, tolerance, guess, dtype)


def slope_search(climb: Climb, tolerance: Real = 1e-5, guess: Real | None = None, dtype: Any = None) -> Pausable:
    """Return the search of `steepest_slope`, with the same arguments, unstarted."""
    require_scalar("tolerance", tolerance, above=0.0, unit="rad")
    if guess is not None:
        require_scalar("guess", guess, unit="rad")
    climb, tolerance, guess = cast((check_climb(climb), tolerance, guess), dtype or jnp.float64)
    limit = climbing_bound(climb.robot if climb.plant is None else climb.plant)
    tolerance = jnp.asarray(tolerance)
    # Half a bracket below a good guess: the next step closes the bracket around it.
    first, step = (None, None) if guess is None else (guess - 0.5 * tolerance, tolerance)
    search = largest_success(_climb_trial(climb), jnp.zeros_like(limit), limit, tolerance, first, step)
    return in_seconds(search, _segment_steps(climb) * climb.dt)


def _run(make: Any, *arguments: Any) -> Any:
    numbers, dtype = arguments[:-1], arguments[-1]
    leaves, shape = jax.tree.flatten(numbers)
    make(*numbers, dtype)  # checks the numbers while they are on the host
    return _compiled(make, shape, dtype)(*cast(leaves, dtype or jnp.float64))


@functools.cache
def _compiled(make: Any, shape: Any, dtype: Any) -> Any:
    return jax.jit(lambda *leaves: run(make(*jax.tree.unflatten(shape, leaves), dtype)))


def in_seconds(search: Pausable, segment: Real) -> Pausable:
    """Let a search for a slope, in segments of so many seconds, end with a `SteepestSlope`."""

    def result(carry: Any) -> SteepestSlope:
        bound = search.result(carry)
        return SteepestSlope(bound.value, bound.lower, bound.upper, bound.status, bound.trials, bound.segments * segment)

    return search._replace(result=result)


def check_climb(climb: Climb) -> Climb:
    """Check a climb on the host and return it; traced fields are passed over. Raises ValueError for the first fault."""
    if not isinstance(climb, Climb):
        raise TypeError(f"climb = {climb!r} is no Climb; type jaxsphere.Climb(gains=..., travel=10.0)")
    check_robot(climb.robot)
    sliding_mode.check_gains(climb.gains)
    if climb.plant is not None:
        check_robot(climb.plant, "plant")
    require_scalar("travel", climb.travel, unit="rad")
    if is_concrete(climb.travel) and float(climb.travel) == 0.0:
        raise ValueError("travel = 0 rad is no climb; type the angle that the sphere should roll, e.g. 10.0")
    require_scalar("smoothing", climb.smoothing, above=0.0, or_equal=True, unit="rad/s")
    if climb.torque_limit is not None:
        require_scalar("torque_limit", climb.torque_limit, above=0.0, unit="N m")
    if climb.disturbance is not None:
        require_finite_vector("disturbance", climb.disturbance, 4, "on alpha, alpha', phi, phi' of rest at phi_0")
    _segment_steps(climb)
    return climb


def _hold(climb: Climb) -> int | None:
    """Steps between two samples of the controller, None where it is continuous."""
    hold = check_control_period(climb.control_period, climb.dt)
    return None if hold is None else int(hold)


def _segment_steps(climb: Climb) -> int:
    """Steps of one segment: the most that divide the rollout, keep the sampling and last a second at most."""
    steps, hold = check_time_grid(climb.duration, climb.dt, None), _hold(climb) or 1
    most = max(hold, min(steps, math.floor(_SEGMENT / climb.dt + 1e-9)))
    for count in range(most - most % hold, 0, -hold):
        if steps % count == 0:
            return count
    raise ValueError(
        f"control_period = {climb.control_period} s does not divide the duration of {climb.duration:g} s; type one that does"
    )


def _climb_trial(climb: Climb) -> Trial:
    robot, gains, travel = climb.robot, climb.gains, jnp.asarray(climb.travel)
    true = robot if climb.plant is None else climb.plant
    zero = jnp.zeros_like(climbing_bound(robot))
    hold, steps = _hold(climb), _segment_steps(climb)
    total = round(climb.duration / climb.dt)

    def loop(slope: Array) -> ClosedLoop:
        return closed_loop(
            planar_plant(true, slope, zero, travel),
            sliding_mode.law(robot, slope, gains, travel, jnp.asarray(climb.smoothing)),
            dt=jnp.asarray(climb.dt, zero.dtype),
            steps=total,
            hold=None if hold is None else jnp.int32(hold),
            torque_limit=None if climb.torque_limit is None else jnp.asarray(climb.torque_limit),
        )

    def start(slope: Array) -> LoopState:
        rest = (zero, zero, equilibrium_swing(robot, slope), zero)
        if climb.disturbance is not None:
            rest = tuple(x + push for x, push in zip(rest, jnp.asarray(climb.disturbance), strict=True))
        return loop(slope).init(rest, (zero,))

    def advance(slope: Array, now: LoopState) -> tuple[LoopState, Array, Array]:
        step = loop(slope).step
        now, _ = jax.lax.scan(lambda one, _: (step(one)[0], None), now, None, length=steps)
        error = jnp.abs(now.x[0] - travel)
        ended = now.status != Status.OK
        inside = error <= SETTLING_BAND * jnp.abs(travel)
        status = jnp.where(ended | inside, now.status, code(Status.NOT_SETTLED))
        lost = error > _LOST * jnp.maximum(jnp.abs(travel), 10.0)
        status = jnp.where(lost & ~ended, code(Status.DIVERGED), status)
        decided = ended | (now.index >= total)
        if climb.early:
            decided = decided | lost
            if climb.plant is None:
                decided = decided | _has_settled(climb, slope, now.x)
        return now, decided, status

    return Trial(start, advance)


def _has_settled(climb: Climb, slope: Array, state: planar.State) -> Array:
    """Tell (bool) whether the linearised sliding motion alone decides the rest of the climb."""
    alpha, alpha_rate, swing, swing_rate = state
    robot, gains = climb.robot, climb.gains
    lumped, rest = planar.lump(robot, slope), equilibrium_swing(robot, slope)
    zero = jnp.zeros_like(rest)
    m11, m12, m22 = planar.inertia(lumped, (zero, zero, rest, zero))
    # Routh's conditions of the paper's law; with k_i the target is reached more slowly and nothing is decided early.
    stable = (gains.c1 < gains.c2) & (gains.c2 * gains.z_u * (m12 - m22) < gains.phi_z * (m11 - m12)) & (gains.k_i == 0.0)
    if climb.torque_limit is not None:
        stable = stable & (jnp.abs(lumped.slope_torque) < _TORQUE_RESERVE * climb.torque_limit)
    deep = _DEEP * SETTLING_BAND * jnp.abs(climb.travel)
    near = _NEAR * (0.5 * jnp.pi - jnp.abs(rest))
    at_target = (jnp.abs(alpha - climb.travel) <= deep) & (jnp.abs(alpha_rate) <= gains.c1 * deep)
    return stable & at_target & (jnp.abs(swing - rest) <= near) & (jnp.abs(swing_rate) <= gains.c2 * near)
