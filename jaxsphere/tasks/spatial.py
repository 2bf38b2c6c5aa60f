"""Tracking as one call: the spatial robot follows a reference on the slope (the case of Fig. 5)."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_choice, require_finite_vector, require_scalar
from jaxsphere.controllers import printed, references, tracking
from jaxsphere.controllers.references import Pair, ReferenceFunction
from jaxsphere.controllers.tracking import TrackingGains
from jaxsphere.models import spatial
from jaxsphere.models.spatial import contact
from jaxsphere.numerics import Real, safe_sqrt
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation.closed_loop import Law, Measure, Plant, State
from jaxsphere.simulation.rollout import Trajectory
from jaxsphere.status import Status, code
from jaxsphere.tasks import metrics
from jaxsphere.tasks.numerics import Numerics
from jaxsphere.tasks.simulate import simulate
from jaxsphere.units import quantity


class Diagnostics(NamedTuple):
    """What a saved tracking rollout also tells, (T,) each."""

    signals: tracking.Signals
    contact: contact.Contact | None  # None for "ideal", which has no torques


def track_line(
    robot: Robot,
    slope: Real,
    gains: TrackingGains | None = None,
    speed: Real = 0.5,
    realisation: str = "axis_aligned",
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
        robot, slope, gains, realisation, duration, dt, torque_limit, options: as in `track`.
        speed: v_f, m/s.
        heading: of the line and of the robot at the start, rad, from up-slope.
        start: of the centre, m.

    Returns:
        As `track`.
    """
    require_scalar("speed", speed, unit="m/s")
    require_scalar("heading", heading, unit="rad")
    reference = references.line(speed, heading)
    options = {"start": start, "heading": heading} | options
    return track(robot, slope, reference, gains, realisation, duration, dt, torque_limit, **options)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SpatialTask:
    """Following a reference on the slope with the centre of the sphere; every field but `realisation` is a leaf.

    The robot rests at first on the reference and along it unless `start_position`, `heading` or `initial_state` say otherwise.
    """

    CYCLIC: ClassVar[tuple[int, ...]] = (4,)  # coordinates that nothing depends on: the spin

    robot: Robot = field(default_factory=Robot, metadata={"help": "that the controller believes in"})
    slope: Real = quantity(math.radians(10.0), "rad", "slope; x points up-slope")
    reference: Any = field(default_factory=lambda: references.line(0.5), metadata={"help": "time -> Reference"})
    plant: Robot | None = field(default=None, metadata={"help": "true robot, where it differs from the modelled one"})
    start_position: Any = quantity(None, "m", "of the centre at rest")
    heading: Real | None = quantity(None, "rad", "of the robot at rest, from up-slope")
    initial_state: Any = quantity(None, "", "(12,), m, rad and their rates, in place of both")
    torque_limit: Real | None = quantity(5.0, "N m", "of both motors; None for none")
    control_period: Real | None = quantity(None, "s", "sampling period; None: continuous")
    delayed: Any = field(default=None, metadata={"help": "each torque acts one control period later"})
    tolerance: Real = quantity(0.05, "m", "error above which the reference is not followed")
    settled_after: Real = quantity(5.0, "s", "time allowed for settling")
    realisation: str = field(default="axis_aligned", metadata={"static": True, "help": ", ".join(tracking.REALISATIONS)})

    def default_gains(self) -> TrackingGains:
        """The tuned gains for "axis_aligned", Table 4 for the other realisations."""
        return TrackingGains() if self.realisation == "axis_aligned" else tracking.TABLE_4

    def default_duration(self) -> float:
        """Length of a rollout where none is given, s."""
        return 20.0

    def check(self, gains: TrackingGains, duration: float = 20.0) -> None:
        """Raise ValueError for the first number on the host that is not admissible."""
        for name, one in (("robot", self.robot), ("plant", self.plant)):
            if one is not None:
                spatial.check_spatial_robot(check_robot(one, name), name)
        tracking.check_gains(gains)
        limit, hint = math.pi / 2, "type radians, e.g. jnp.deg2rad(10)"
        require_scalar("slope", self.slope, above=-limit, below=limit, unit="rad", hint=hint)
        require_choice("realisation", self.realisation, tracking.REALISATIONS)
        require_scalar("tolerance", self.tolerance, above=0.0, unit="m")
        require_scalar("settled_after", self.settled_after, above=0.0, or_equal=True, unit="s")
        if self.torque_limit is not None:
            require_scalar("torque_limit", self.torque_limit, above=0.0, unit="N m")
        if self.initial_state is not None:
            require_finite_vector("initial_state", self.initial_state, 12, ", ".join(spatial.SpatialState._fields))
        if self.start_position is not None:
            _require_place("start_position", self.start_position)
        if self.heading is not None:
            require_scalar("heading", self.heading, unit="rad")
        if self.delayed is not None and self.control_period is None:
            raise ValueError("delayed needs a sampled controller; type control_period=1e-3")
        references.check_reference(self.reference, duration)

    def start(self) -> tuple[State, State]:
        """Initial state, 12 paper coordinates; the law has no memory."""
        if self.initial_state is not None:
            return tuple(self.initial_state), ()
        slope = jnp.asarray(self.slope)
        return _start(self.robot, slope, self.reference, self.start_position, self.heading), ()

    def steady_motion(self) -> tuple[State, State]:
        """State of straight rolling along the reference at time 0, or of rest. Raises ValueError for a curved reference."""
        now = self.reference(jnp.zeros(()))
        bent = jnp.abs(jnp.stack([*now.acceleration, *self.reference(jnp.ones(())).acceleration]))
        if is_concrete(bent) and float(jnp.max(bent)) > 1e-9:
            raise ValueError("reference is no straight line at constant speed; type e.g. reference=references.line(0.5)")
        direction = _direction(now, 0.0 if self.heading is None else self.heading)
        state = _start(self.robot, jnp.asarray(self.slope, float), self.reference, now.position, direction)
        spin_rate = jnp.hypot(*now.velocity) / self.robot.shell_radius
        return (*state[:9], spin_rate, *state[10:]), ()

    def dynamics(self) -> Plant:
        """Plant of this task."""
        robot = self.robot if self.plant is None else self.plant
        return ideal_plant(robot) if self.realisation == "ideal" else spatial_plant(robot, jnp.asarray(self.slope))

    def law(self, gains: TrackingGains) -> Law:
        """Tracking law of this task."""
        return tracking.law(self.robot, self.slope, gains, self.reference, self.realisation)

    def measure(self) -> Measure:
        """Metrics of the tracking."""
        return metrics.tracking(lambda time: self.reference(time).position, jnp.asarray(self.settled_after))

    def conclude(self, gains: TrackingGains, trajectory: Trajectory, dt: Array, diagnostics: bool) -> Trajectory:
        """Trajectory with NOT_SETTLED where it did not follow, the rms error, and `Diagnostics` (T,) where asked for."""
        measured = trajectory.metrics
        measured = measured._replace(rms_error=safe_sqrt(measured.rms_error / jnp.maximum(trajectory.end_time, dt)))
        lost = (trajectory.status == Status.OK) & (measured.late_error > self.tolerance)
        status = jnp.where(lost, code(Status.NOT_SETTLED), trajectory.status)
        trajectory = dataclasses.replace(trajectory, status=status, metrics=measured)
        if not diagnostics:
            return trajectory
        lumped, ideal = spatial.lump(self.robot, self.slope), self.realisation == "ideal"

        def diagnose(time: Array, state: Array, torque: Array) -> Diagnostics:
            now = tracking.signals(lumped, gains, self.reference(time), tuple(state), self.realisation)
            return Diagnostics(now, None if ideal else contact.contact(self.robot, self.slope, tuple(state), tuple(torque)))

        found = jax.vmap(diagnose)(trajectory.time, trajectory.state, trajectory.torque)
        return dataclasses.replace(trajectory, diagnostics=found)

    def advice(self) -> dict[Status, str]:
        """What to change after a single rollout that ended with one of these statuses."""
        return {
            Status.NOT_SETTLED: "the error stays above tolerance: motor or a_max cannot follow; lower the speed or raise "
            "torque_limit or a_max",
            Status.DIVERGED: "the robot rolled away; check the gains and the torque limit",
            Status.SINGULAR_DECOUPLING: "no torques give what the law asks for; lower the speed or the gains",
            Status.SINGULAR_JOINTS: "the pendulum points along the spin axis and the gimbal cannot turn it; lower the demand",
            Status.INFEASIBLE_LEAN: "no swing of the pendulum balances the demand; lower the slope or the demand",
            Status.NONFINITE: "the next state is not finite; lower dt",
        }


def track(
    robot: Robot,
    slope: Real,
    reference: ReferenceFunction,
    gains: TrackingGains | None = None,
    realisation: str = "axis_aligned",
    duration: float = 20.0,
    dt: float = 1e-3,
    torque_limit: Real | None = 5.0,
    *,
    start: Pair | None = None,
    heading: Real | None = None,
    initial_state: Any = None,
    plant: Robot | None = None,
    control_period: Real | None = None,
    tolerance: Real = 0.05,
    settled_after: Real = 5.0,
    method: str = "rk4",
    save_every: int | None = 1,
    diagnostics: bool = False,
    dtype: Any = None,
    throw: bool = True,
) -> Trajectory:
    """Follow a reference with the centre of the sphere.

    It builds a `SpatialTask` and simulates it. Batch it with `jax.vmap` over any leaf of the task's fields and the gains.

    Args:
        robot: that the controller believes in, and the plant too unless `plant` is given.
        slope: rad.
        reference: time -> position, velocity, acceleration (see `controllers.references`).
        gains: tuned ones for "axis_aligned" by default, `TABLE_4` for the other realisations.
        realisation: one of `tracking.REALISATIONS`.
        start: where the robot rests at first, m; on the reference by default.
        duration, dt, method, save_every, dtype: as in `Numerics`.
        torque_limit, heading, initial_state, plant, control_period, tolerance, settled_after: as in `SpatialTask`.
        diagnostics: compute `Diagnostics` of the saved states.
        throw: raise when a single rollout ends early or does not follow; otherwise `status` tells.

    Returns:
        A Trajectory with `TrackingMetrics`; its torques are drive and tilt, or five accelerations for "ideal".

    Raises:
        ValueError: an argument is not admissible.
        RolloutError: a single rollout failed and `throw` is set.
    """
    if start is not None:
        _require_place("start", start)
    task = SpatialTask(
        robot=robot,
        slope=slope,
        reference=references.as_reference(reference),
        plant=plant,
        start_position=start,
        heading=heading,
        initial_state=initial_state,
        torque_limit=None if realisation == "ideal" else torque_limit,
        control_period=control_period,
        tolerance=tolerance,
        settled_after=settled_after,
        realisation=realisation,
    )
    if realisation == "ideal" and torque_limit is not None:
        require_scalar("torque_limit", torque_limit, above=0.0, unit="N m")
    numerics = Numerics(dt, duration, method, save_every, np.dtype(dtype or "float64").name)
    return simulate(task, gains, numerics, diagnostics=diagnostics, throw=throw)


def _require_place(name: str, value: Any) -> None:
    if not hasattr(value, "__len__") or len(value) != 2:
        raise ValueError(f"{name} = {value!r} is no place on the slope; type two numbers in m: x, y")
    for axis, number in zip("xy", value, strict=True):
        require_scalar(f"{name}, {axis}", number, unit="m")


def spatial_plant(robot: Robot, slope: Array) -> Plant:
    """Spatial robot as a rollout sees it: integrated in the gimbal's frame, given and shown in paper coordinates."""
    field = partial(spatial.derivative_components, spatial.lump(robot, slope))
    return Plant(field, _alive, spatial.IS_VELOCITY, spatial.of_state, spatial.paper_states)


def ideal_plant(robot: Robot) -> Plant:
    """Robot whose five accelerations are the input, (48), in paper coordinates."""
    return Plant(partial(printed.ideal_derivative, robot), _alive, (*(False,) * 7, *(True,) * 5))


def _alive(state: State) -> Array:
    return jnp.full_like(state[0], code(Status.OK), jnp.int32)


def _start(
    robot: Robot, slope: Array, reference: ReferenceFunction, start: Pair | None, heading: Real | None
) -> tuple[Array, ...]:
    first = reference(jnp.zeros_like(slope))
    heading = _direction(first, 0.0) if heading is None else heading
    position = first.position if start is None else start
    return tuple(jnp.asarray(x, slope.dtype) for x in tracking.resting_state(robot, slope, position, heading))


def _direction(reference: references.Reference, standing: Real) -> Array:
    """Direction of motion, rad from up-slope; `standing` where there is none."""
    east, north = reference.velocity
    moving = east**2 + north**2 > 0.0
    return jnp.where(moving, jnp.arctan2(jnp.where(moving, north, 0.0), jnp.where(moving, east, 1.0)), standing)
