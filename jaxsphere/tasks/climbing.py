"""How steep: the fate of one climb, the steepest slope that a closed loop climbs, and the bound (4) found by simulation.

    climbs      the robot starts at rest at phi_0 and is within 2 % of the travel at the end, the pendulum never over the top
    gamma*      the steepest slope (rad) up to which a closed loop climbs, the closed-loop bound; never above (4)
    holds       the robot, released beside phi_0 under the torque that balances the slope, does not whirl

Two shortcuts decide a climb before its end (`early`): a lane that is deep inside the settling band, near an equilibrium whose
sliding motion is stable, has settled; one that has rolled away by three travels (at least 30 rad) has failed.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import is_concrete, require_finite_vector, require_scalar
from jaxsphere.command import Command, Status, code
from jaxsphere.controllers import sliding_mode
from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models import climbing, planar
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation.bisection import Bound, Trial, largest_success, outcome
from jaxsphere.simulation.host import cast, check_control_period, check_time_grid
from jaxsphere.simulation.metrics import SETTLING_BAND
from jaxsphere.simulation.rollout import rollout
from jaxsphere.tasks.regulation import planar_plant

# Simulated seconds between two looks at a lane.
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

    status: Array  # a Status code; OK when it settled
    seconds: Array  # simulated until that was decided, s


class _Climb(NamedTuple):
    """The numbers of a climb, all traced."""

    robot: Robot
    gains: SlidingModeGains
    travel: Any
    torque_limit: Any
    smoothing: Any
    plant: Robot | None
    disturbance: Any
    dt: Any


class _Grid(NamedTuple):
    """The choices of a climb that fix the compiled loop."""

    segments: int
    steps: int  # of a segment
    hold: int | None  # of the sampled controller, in steps
    early: bool


def climb_outcome(
    robot: Robot,
    slope: Real,
    gains: SlidingModeGains | None = None,
    travel: Real = 10.0,
    torque_limit: Real | None = None,
    smoothing: Real = 0.02,
    *,
    plant: Robot | None = None,
    disturbance: Real | None = None,
    duration: float = 60.0,
    dt: float = 1e-3,
    control_period: float | None = None,
    early: bool = True,
) -> Outcome:
    """Tell how a climb by `travel` (rad) ends under sliding-mode control; batch it with `jax.vmap` or `js.over_lanes`.

    Args: as `steepest_slope`, and slope: rad.

    Raises:
        ValueError: an argument is not admissible.
    """
    require_scalar("slope", slope, above=-math.pi / 2, below=math.pi / 2, unit="rad", hint="type radians, e.g. jnp.deg2rad(10)")
    climb, grid = _checked(robot, gains, travel, torque_limit, smoothing, plant, disturbance, duration, dt, control_period, early)
    return _outcome(climb, *cast((slope,), jnp.float64), grid=grid)


@partial(jax.jit, static_argnames="grid")
def _outcome(climb: _Climb, slope: Array, *, grid: _Grid) -> Outcome:
    status, segments = outcome(_climb_trial(climb, grid), jnp.asarray(slope))
    return Outcome(status, segments * (grid.steps * climb.dt))


def steepest_slope(
    robot: Robot,
    gains: SlidingModeGains | None = None,
    travel: Real = 10.0,
    torque_limit: Real | None = None,
    smoothing: Real = 0.02,
    *,
    plant: Robot | None = None,
    disturbance: Real | None = None,
    duration: float = 60.0,
    dt: float = 1e-3,
    control_period: float | None = None,
    early: bool = True,
    tolerance: Real = 1e-5,
    guess: Real | None = None,
) -> Bound:
    """Find the closed-loop bound gamma* (rad): the steepest slope, up to the bound (4), that the controlled robot climbs.

    Batch it with `jax.vmap` or, faster, `js.over_lanes`, over any of robot, gains, travel, torque_limit, smoothing, plant,
    disturbance, tolerance, guess. Bisection takes the outcome for monotone in the slope; `climb_outcome` on a scan of slopes
    shows whether it is.

    Args:
        robot: the robot that the controller believes in, and the plant too unless `plant` is given. gains: Table 3 by
        default. travel: rad. torque_limit: N m, None for no limit. smoothing: epsilon of the switching term, rad/s, 0 for
        the hard sign. plant: the true robot. disturbance: (4,), added to rest at phi_0, where a climb begins. duration: s, of
        one climb. dt: s, of RK4. control_period: s, of a sampled controller, None for a continuous one. early: decide clear
        cases before `duration`. tolerance: rad, width of the bracket. guess: rad, where to look first, e.g. the bound of a
        neighbour; the middle of the bracket by default.

    Returns:
        A `Bound` in rad; its value is NaN where even the flat is not climbed.

    Raises:
        ValueError: an argument is not admissible.
    """
    require_scalar("tolerance", tolerance, above=0.0, unit="rad")
    if guess is not None:
        require_scalar("guess", guess, unit="rad")
    climb, grid = _checked(robot, gains, travel, torque_limit, smoothing, plant, disturbance, duration, dt, control_period, early)
    return _steepest(climb, *cast((tolerance, guess), jnp.float64), grid=grid)


@partial(jax.jit, static_argnames="grid")
def _steepest(climb: _Climb, tolerance: Array, guess: Array | None, *, grid: _Grid) -> Bound:
    limit = climbing.climbing_bound(climb.robot if climb.plant is None else climb.plant)
    step = None if guess is None else jnp.asarray(tolerance)
    # Half a bracket below a good guess: the next step closes the bracket around it.
    first = None if guess is None else guess - 0.5 * tolerance
    return largest_success(_climb_trial(climb, grid), jnp.zeros_like(limit), limit, jnp.asarray(tolerance), first, step)


def _checked(
    robot: Robot,
    gains: SlidingModeGains | None,
    travel: Real,
    torque_limit: Real | None,
    smoothing: Real,
    plant: Robot | None,
    disturbance: Real | None,
    duration: float,
    dt: float,
    control_period: float | None,
    early: bool,
) -> tuple[_Climb, _Grid]:
    check_robot(robot)
    gains = sliding_mode.check_gains(SlidingModeGains() if gains is None else gains)
    if plant is not None:
        check_robot(plant, "plant")
    require_scalar("travel", travel, unit="rad")
    if is_concrete(travel) and float(travel) == 0.0:
        raise ValueError("travel = 0 rad is no climb; type the angle that the sphere should roll, e.g. 10.0")
    require_scalar("smoothing", smoothing, above=0.0, or_equal=True, unit="rad/s")
    if torque_limit is not None:
        require_scalar("torque_limit", torque_limit, above=0.0, unit="N m")
    if disturbance is not None:
        require_finite_vector("disturbance", disturbance, 4, "on alpha, alpha', phi, phi' of rest at phi_0")
    steps = check_time_grid(duration, dt, None)
    hold = check_control_period(control_period, dt)
    held = None if hold is None else int(hold)
    segment = _segment_steps(steps, float(dt), held or 1)
    numbers = _Climb(robot, gains, travel, torque_limit, smoothing, plant, disturbance, dt)
    return cast(numbers, jnp.float64), _Grid(steps // segment, segment, held, bool(early))


def _segment_steps(steps: int, dt: float, hold: int) -> int:
    """Steps of one segment: the most that divide the rollout, keep the sampling and last a second at most."""
    most = max(hold, min(steps, math.floor(_SEGMENT / dt + 1e-9)))
    for count in range(most - most % hold, 0, -hold):
        if steps % count == 0:
            return count
    raise ValueError(f"control_period = {hold * dt:g} s does not divide the duration of {steps * dt:g} s; type one that does")


def _climb_trial(climb: _Climb, grid: _Grid) -> Trial:
    robot, gains, travel = climb.robot, climb.gains, jnp.asarray(climb.travel)
    true = robot if climb.plant is None else climb.plant
    zero = jnp.zeros_like(climbing.equilibrium_swing(robot, 0.0))

    def start(slope: Array) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
        rest = (zero, zero, climbing.equilibrium_swing(robot, slope), zero)
        if climb.disturbance is not None:
            rest = tuple(x + push for x, push in zip(rest, climb.disturbance, strict=True))
        return rest, (zero,), jnp.zeros((), jnp.int32)

    def advance(slope: Array, carry: tuple[tuple[Array, ...], tuple[Array, ...], Array]) -> tuple[Any, Array, Array]:
        state, memory, count = carry
        trajectory = rollout(
            planar_plant(true, slope, zero, travel),
            sliding_mode.law(robot, slope, gains, travel, climb.smoothing),
            state,
            memory,
            dt=jnp.asarray(climb.dt),
            steps=grid.steps,
            save_every=None,
            hold=None if grid.hold is None else jnp.int32(grid.hold),
            torque_limit=climb.torque_limit,
        )
        state, count = tuple(trajectory.state[-1]), count + 1
        error = jnp.abs(state[0] - travel)
        ended = trajectory.status != Status.OK
        over = count >= grid.segments
        inside = error <= SETTLING_BAND * jnp.abs(travel)
        status = jnp.where(ended | inside, trajectory.status, code(Status.NOT_SETTLED))
        decided = ended | over
        if grid.early:
            lost = error > _LOST * jnp.maximum(jnp.abs(travel), 10.0)
            status = jnp.where(lost & ~ended, code(Status.DIVERGED), status)
            decided = decided | lost
            if climb.plant is None:
                decided = decided | _has_settled(climb, slope, state)
        return (state, tuple(trajectory.memory[-1]), count), decided, status

    return Trial(start, advance)


def _has_settled(climb: _Climb, slope: Array, state: planar.State) -> Array:
    """Tell (bool) whether the linearised sliding motion alone decides the rest of the climb."""
    alpha, alpha_rate, swing, swing_rate = state
    robot, gains = climb.robot, climb.gains
    lumped, rest = planar.lump(robot, slope), climbing.equilibrium_swing(robot, slope)
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


def static_bound_by_release(robot: Robot, tolerance: Real = 1e-5, offset: Real = 1e-3) -> Bound:
    """Find the bound (4) by simulation: the steepest slope (rad) on which a released robot is held by a constant torque.

    The torque is the one that balances the slope, tau = (m + m_i + m_p) g r sin(gamma), whatever the pendulum does. Row 1 of
    (1) then conserves M11 alpha' + M12 phi', so that the sphere moves only as the pendulum does, and the pendulum is a ball on
    the washboard of its weight and this torque: it has a hollow at phi_0 and a rim at pi - phi_0 as long as (2) has a
    solution. Released at rest `offset` (rad) up-slope of phi_0 (of pi/2 where there is none), it rocks in the hollow or
    whirls. (Clamping the sphere's angle instead would be no test: there phi_0 is a saddle, see `zero_dynamics_poles`.)

    Args:
        robot: the robot. tolerance: rad, width of the bracket. offset: rad. Batch it with `jax.vmap` or `js.over_lanes`.
    """
    check_robot(robot)
    require_scalar("tolerance", tolerance, above=0.0, unit="rad")
    require_scalar("offset", offset, above=0.0, unit="rad")
    return _static(*cast((robot, tolerance, offset), jnp.float64))


# In units of the pendulum's own time sqrt(I / (m_p g l)): beside the bound by 1e-6 of the torque the whirl takes about 100.
_RELEASE_STEP = 0.05
_RELEASE_STEPS = 250
_RELEASE_SEGMENTS = 20


@jax.jit
def _static(robot: Robot, tolerance: Array, offset: Array) -> Bound:
    zero = jnp.zeros_like(climbing.climbing_bound(robot))

    def start(slope: Array) -> tuple[tuple[Array, ...], Array]:
        return (zero, zero, climbing.equilibrium_swing(robot, slope) + offset, zero), jnp.zeros((), jnp.int32)

    def advance(slope: Array, carry: tuple[tuple[Array, ...], Array]) -> tuple[Any, Array, Array]:
        state, count = carry
        lumped = planar.lump(robot, slope)
        own_time = jnp.sqrt(lumped.pendulum_inertia / lumped.pendulum_weight)

        def hold(time: Array, state: planar.State, memory: tuple[Array, ...]) -> Command:
            del time, state, memory
            return Command((lumped.slope_torque,), (), code(Status.OK))

        plant = planar_plant(robot, slope, zero, zero)
        trajectory = rollout(plant, hold, state, dt=_RELEASE_STEP * own_time, steps=_RELEASE_STEPS, save_every=None)
        decided = (trajectory.status != Status.OK) | (count + 1 >= _RELEASE_SEGMENTS)
        return (tuple(trajectory.state[-1]), count + 1), decided, trajectory.status

    return largest_success(Trial(start, advance), zero, zero + 0.5 * jnp.pi, tolerance)
