"""Tracking as one call: the spatial robot follows a reference on the slope (the case of Fig. 5)."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import is_concrete, require_choice, require_finite_vector, require_scalar
from jaxsphere.command import Status, code
from jaxsphere.controllers import references, tracking
from jaxsphere.controllers.references import Pair, ReferenceFunction
from jaxsphere.controllers.tracking import TrackingGains
from jaxsphere.models import spatial
from jaxsphere.models.spatial import contact
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation import metrics
from jaxsphere.simulation.host import cast, check_control_period, check_time_grid, raise_early_end
from jaxsphere.simulation.integrators import METHODS
from jaxsphere.simulation.rollout import Plant, Trajectory, rollout


class Diagnostics(NamedTuple):
    """What a saved tracking rollout also tells, (T,) each."""

    signals: tracking.Signals
    contact: contact.Contact | None  # None for "ideal", which has no torques


def track_line(
    robot: Robot,
    slope: Real,
    gains: TrackingGains | None = None,
    speed: Real = 0.5,
    realisation: str = "pendulum_attitude",
    duration: float = 20.0,
    dt: float = 1e-3,
    torque_limit: Real | None = 5.0,
    *,
    heading: Real = 0.25 * math.pi,
    start: Pair = (0.3, 0.1),
    **options: Any,
) -> Trajectory:
    """Follow a straight line through the origin at constant speed, from Table 4's start at rest; y = x by default.

    Args:
        speed: v_f, m/s. heading: of the line and of the robot at the start, rad, from up-slope. start: of the centre, m.
        Everything else, `options` too, is as in `track`.
    """
    require_scalar("speed", speed, unit="m/s")
    require_scalar("heading", heading, unit="rad")
    reference = references.line(speed, heading)
    options = {"start": start, "heading": heading} | options
    return track(robot, slope, reference, gains, realisation, duration, dt, torque_limit, **options)


def track(
    robot: Robot,
    slope: Real,
    reference: ReferenceFunction,
    gains: TrackingGains | None = None,
    realisation: str = "pendulum_attitude",
    duration: float = 20.0,
    dt: float = 1e-3,
    torque_limit: Real | None = 5.0,
    *,
    start: Pair | None = None,
    heading: Real | None = None,
    initial_state: Array | None = None,
    plant: Robot | None = None,
    control_period: float | None = None,
    tolerance: Real = 0.05,
    settled_after: Real = 5.0,
    method: str = "rk4",
    save_every: int | None = 1,
    diagnostics: bool = False,
    dtype: Any = None,
    throw: bool = True,
) -> Trajectory:
    """Follow a reference with the centre of the sphere.

    Batch it with `jax.vmap` over any leaf of robot, plant, slope, reference, gains, start, initial_state.

    Args:
        robot: the robot that the controller believes in, and the plant too unless `plant` is given. slope: rad.
        reference: time -> position, velocity, acceleration (see `controllers.references`). gains: Table 4 by default.
        realisation: one of `tracking.REALISATIONS`. duration, dt: s. torque_limit: N m, None for no limit.
        start, heading: where the robot rests at first, m and rad; on the reference and
        along it by default. initial_state: (12,), in place of both. control_period: s, a multiple of dt, for a zero-order
        hold; None for a continuous controller. tolerance: m; an error above it later than `settled_after` (s) is
        NOT_SETTLED. method: an integrator. save_every: keep every so many steps, None for the last state only.
        diagnostics: compute `Diagnostics` of the saved states. dtype: float64 unless given.
        throw: raise when a single rollout ends early or does not follow; otherwise `status` tells.

    Returns:
        A Trajectory with `TrackingMetrics`; its torques are drive and tilt, or five accelerations for "ideal".

    Raises:
        ValueError: an argument is not admissible. RolloutError: a single rollout failed and `throw` is set.
    """
    gains = TrackingGains() if gains is None else gains
    steps = check_time_grid(duration, dt, save_every)
    for name, one in (("robot", robot), ("plant", plant)):
        if one is not None:
            spatial.check_spatial_robot(check_robot(one, name), name)
    tracking.check_gains(gains)
    half_turn = math.pi / 2
    require_scalar("slope", slope, above=-half_turn, below=half_turn, unit="rad", hint="type radians, e.g. jnp.deg2rad(10)")
    require_choice("realisation", realisation, tracking.REALISATIONS)
    require_choice("method", method, METHODS)
    require_scalar("tolerance", tolerance, above=0.0, unit="m")
    require_scalar("settled_after", settled_after, above=0.0, or_equal=True, unit="s")
    if torque_limit is not None:
        require_scalar("torque_limit", torque_limit, above=0.0, unit="N m")
    if initial_state is not None:
        require_finite_vector("initial_state", initial_state, 12, ", ".join(spatial.STATE_NAMES))
        _require_regular(initial_state)
    reference = references.as_reference(reference)
    references.check_reference(reference, duration)

    numbers = (robot, plant, slope, reference, gains, dt, torque_limit, start, heading, initial_state)
    trajectory = _track(
        *cast((*numbers, tolerance, settled_after), dtype or jnp.float64),
        hold=check_control_period(control_period, dt),
        steps=steps,
        save_every=save_every,
        realisation=realisation,
        method=method,
        diagnostics=diagnostics and save_every is not None,
    )
    if throw:
        lost = "the error stays above tolerance: motor or a_max cannot follow; lower the speed or raise torque_limit or a_max"
        raise_early_end(trajectory, {Status.NOT_SETTLED: lost})
    return trajectory


@partial(jax.jit, static_argnames=("steps", "save_every", "realisation", "method", "diagnostics"))
def _track(
    robot: Robot,
    plant: Robot | None,
    slope: Array,
    reference: ReferenceFunction,
    gains: TrackingGains,
    dt: Array,
    torque_limit: Array | None,
    start: Pair | None,
    heading: Array | None,
    initial_state: Array | None,
    tolerance: Array,
    settled_after: Array,
    hold: Array | None,
    *,
    steps: int,
    save_every: int | None,
    realisation: str,
    method: str,
    diagnostics: bool,
) -> Trajectory:
    ideal = realisation == "ideal"
    state = _start(robot, slope, reference, start, heading) if initial_state is None else tuple(initial_state)
    trajectory = rollout(
        spatial_plant(robot if plant is None else plant, slope, ideal),
        tracking.law(robot, slope, gains, reference, realisation),
        state,
        dt=dt,
        steps=steps,
        save_every=save_every,
        hold=hold,
        torque_limit=None if ideal else torque_limit,
        measure=metrics.tracking(lambda time: reference(time).position, settled_after),
        method=method,
    )
    measured = trajectory.metrics
    measured = measured._replace(rms_error=jnp.sqrt(measured.rms_error / jnp.maximum(trajectory.end_time, dt)))
    lost = (trajectory.status == Status.OK) & (measured.late_error > tolerance)
    status = jnp.where(lost, code(Status.NOT_SETTLED), trajectory.status)
    trajectory = dataclasses.replace(trajectory, status=status, metrics=measured)
    if not diagnostics:
        return trajectory
    lumped = spatial.lump(robot, slope)

    def diagnose(time: Array, state: Array, torque: Array) -> Diagnostics:
        now = tracking.signals(lumped, gains, reference(time), tuple(state), realisation)
        return Diagnostics(now, None if ideal else contact.contact(robot, slope, tuple(state), tuple(torque)))

    return dataclasses.replace(trajectory, diagnostics=jax.vmap(diagnose)(trajectory.time, trajectory.state, trajectory.torque))


def spatial_plant(robot: Robot, slope: Array, ideal: bool = False) -> Plant:
    """Spatial robot as a rollout sees it; `ideal` takes five accelerations in place of two torques, (48)."""
    field = (
        partial(tracking.ideal_derivative, robot)
        if ideal
        else partial(spatial.derivative_components, spatial.lump(robot, slope))
    )
    return Plant(field, spatial.status, spatial.IS_VELOCITY)


def _start(
    robot: Robot, slope: Array, reference: ReferenceFunction, start: Pair | None, heading: Array | None
) -> tuple[Array, ...]:
    first = reference(jnp.zeros_like(slope))
    if heading is None:
        east, north = first.velocity
        moving = east**2 + north**2 > 0.0
        heading = jnp.where(moving, jnp.arctan2(jnp.where(moving, north, 0.0), jnp.where(moving, east, 1.0)), 0.0)
    position = first.position if start is None else start
    return tuple(jnp.asarray(x, slope.dtype) for x in tracking.resting_state(robot, slope, position, heading))


def _require_regular(state: Array) -> None:
    if is_concrete(state) and abs(math.sin(float(state[3]))) < math.sin(spatial.SINGULAR_LEAN):
        raise ValueError(
            f"initial_state has a lean theta = {float(state[3]):g} rad, where the attitude angles are singular; type one away "
            "from 0 and pi, e.g. pi/2"
        )
