"""From rest to rest in the plane under sliding-mode control (the case of Fig. 4), as data and as one call."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_choice, require_finite_vector, require_scalar
from jaxsphere.controllers import printed, sliding_mode
from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import can_hold, climbing_bound, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation.closed_loop import Law, Measure, Plant, State
from jaxsphere.simulation.host import RolloutError
from jaxsphere.simulation.rollout import Trajectory
from jaxsphere.status import Status, code
from jaxsphere.tasks import metrics
from jaxsphere.tasks.numerics import Numerics
from jaxsphere.tasks.simulate import simulate
from jaxsphere.units import quantity

TEN_DEGREES = math.radians(10.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PlanarTask:
    """A move of the sphere from rest to rest on a slope; every field but `convention` is a leaf.

    Where `plant` is given the controller still believes in `robot`. The initial state is rest at phi_0 of `robot` unless given.
    """

    CYCLIC: ClassVar[tuple[int, ...]] = ()  # coordinates that nothing depends on

    robot: Robot = field(default_factory=Robot, metadata={"help": "that the controller believes in"})
    slope: Real = quantity(TEN_DEGREES, "rad", "slope, positive up-slope")
    travel: Real = quantity(10.0, "rad", "angle that the sphere should roll")
    plant: Robot | None = field(default=None, metadata={"help": "true robot, where it differs from the modelled one"})
    initial_state: Any = quantity(None, "", "(4,) alpha, alpha', phi, phi', rad and rad/s; rest at phi_0 if not given")
    torque_limit: Real | None = quantity(None, "N m", "motor limit; None for none")
    smoothing: Real = quantity(0.02, "rad/s", "width of the smoothed sign; 0 for the hard sign")
    control_period: Real | None = quantity(None, "s", "sampling period of the controller, a multiple of dt; None: continuous")
    delayed: Array | bool | None = field(default=None, metadata={"help": "each torque acts one control period later"})
    sensor_bias: Any = quantity(None, "", "(4,) added to the alpha, alpha', phi, phi' that the controller sees, rad and rad/s")
    disturbance: Any = quantity(None, "", "(4,) added to the initial state, rad and rad/s")
    convention: str = field(default="corrected", metadata={"static": True, "help": "sign of z in (8): corrected or printed"})

    def default_gains(self) -> SlidingModeGains:
        """Table 3."""
        return SlidingModeGains()

    def default_duration(self) -> float:
        """Length of a rollout where none is given, s."""
        return 30.0

    def check(self, gains: SlidingModeGains, duration: float = 0.0) -> None:
        """Raise ValueError for the first number on the host that is not admissible."""
        del duration
        check_robot(self.robot)
        sliding_mode.check_gains(gains)
        if self.plant is not None:
            check_robot(self.plant, "plant")
        limit, hint = math.pi / 2, "type radians, e.g. jnp.deg2rad(10)"
        require_scalar("slope", self.slope, above=-limit, below=limit, unit="rad", hint=hint)
        require_scalar("travel", self.travel, unit="rad")
        if is_concrete(self.travel) and float(self.travel) == 0.0:
            raise ValueError("travel = 0 rad is no move; type the angle that the sphere should roll, e.g. 10.0")
        require_scalar("smoothing", self.smoothing, above=0.0, or_equal=True, unit="rad/s")
        if self.torque_limit is not None:
            require_scalar("torque_limit", self.torque_limit, above=0.0, unit="N m")
        for name, entries in (
            ("initial_state", "alpha, alpha', phi, phi'"),
            ("sensor_bias", "on alpha, alpha', phi, phi'"),
            ("disturbance", "on alpha, alpha', phi, phi' of the initial state"),
        ):
            if getattr(self, name) is not None:
                require_finite_vector(name, getattr(self, name), 4, entries)
        if self.delayed is not None and self.control_period is None:
            raise ValueError("delayed needs a sampled controller; type control_period=1e-3")
        require_choice("convention", self.convention, printed.CONVENTIONS)

    def start(self) -> tuple[State, State]:
        """Initial state (alpha, alpha', phi, phi') and the law's memory zeta."""
        equilibrium = equilibrium_swing(self.robot, self.slope)
        zero = jnp.zeros_like(equilibrium)
        rest = planar.PlanarState(zero, zero, equilibrium, zero)
        state = tuple(rest if self.initial_state is None else self.initial_state)
        if self.disturbance is not None:
            state = tuple(x + push for x, push in zip(state, jnp.asarray(self.disturbance), strict=True))
        return state, (zero,)

    def target(self) -> Array:
        """Sphere angle alpha_d that the move ends at, rad: `travel` from the initial one, whatever the disturbance."""
        return jnp.asarray(self.travel) + self._first_angle()

    def steady_motion(self) -> tuple[State, State]:
        """State of rest at the target, and the law's memory. Raises ValueError where there is none or the sign is hard."""
        require_scalar("smoothing", self.smoothing, above=0.0, unit="rad/s")
        if is_concrete((self.robot, self.slope)) and np.ndim(self.slope) == 0:
            with jax.ensure_compile_time_eval():
                require_holdable(self.robot, self.slope)
        equilibrium = equilibrium_swing(self.robot, self.slope)
        zero = jnp.zeros_like(equilibrium)
        return (self.target() + zero, zero, equilibrium, zero), (zero,)

    def dynamics(self) -> Plant:
        """Plant of this task."""
        robot = self.robot if self.plant is None else self.plant
        return planar_plant(robot, jnp.asarray(self.slope), jnp.asarray(self._first_angle()), jnp.asarray(self.travel))

    def _first_angle(self) -> Real:
        return 0.0 if self.initial_state is None else planar.PlanarState(*self.initial_state).alpha

    def law(self, gains: SlidingModeGains) -> Law:
        """Sliding-mode law of this task, with the bias of its sensors."""
        law = sliding_mode.law(self.robot, self.slope, self._in_convention(gains), self.target(), self.smoothing)
        if self.sensor_bias is None:
            return law
        bias = self.sensor_bias
        return lambda time, state, memory: law(time, tuple(x + b for x, b in zip(state, bias, strict=True)), memory)

    def _in_convention(self, gains: SlidingModeGains) -> SlidingModeGains:
        return printed.sliding_mode_gains(gains) if self.convention == "printed" else gains

    def measure(self) -> Measure:
        """Metrics of the move."""
        return metrics.regulation(self.target(), jnp.asarray(self.travel), equilibrium_swing(self.robot, self.slope))

    def conclude(self, gains: SlidingModeGains, trajectory: Trajectory, dt: Array, diagnostics: bool) -> Trajectory:
        """Trajectory with NOT_SETTLED where it did not settle, and the controller's `Signals` (T,) where asked for."""
        del dt
        settled = jnp.isfinite(trajectory.metrics.settling_time)
        status = jnp.where((trajectory.status == Status.OK) & ~settled, code(Status.NOT_SETTLED), trajectory.status)
        signals = None
        if diagnostics:
            lumped, equilibrium = planar.lump(self.robot, self.slope), equilibrium_swing(self.robot, self.slope)
            states, corrections = tuple(trajectory.state.T), trajectory.memory[:, 0]
            gains = self._in_convention(gains)
            signals = sliding_mode.signals(lumped, equilibrium, gains, states, corrections, self.target(), self.smoothing)
        return dataclasses.replace(trajectory, status=status, diagnostics=signals)

    def advice(self) -> dict[Status, str]:
        """What to change after a single rollout that ended with one of these statuses."""
        steep = "no swing of the pendulum balances the demand; lower the slope"
        steep = past_bound(self.robot, self.slope) or steep
        return {
            Status.WHIRLING: "the pendulum went over the top; lower z_u or the slope",
            Status.DIVERGED: "the robot rolled away; check the sign convention, the gains and the torque limit",
            Status.SINGULAR_DECOUPLING: "it divides by zero; make nonsingularity_margin positive by lowering z_u c2 / phi_z",
            Status.INFEASIBLE_LEAN: steep,
            Status.NONFINITE: "the next state is not finite; lower dt",
        }


def rest_to_rest(
    robot: Robot,
    slope: Real,
    gains: SlidingModeGains | None = None,
    travel: Real = 10.0,
    duration: float = 30.0,
    dt: float = 1e-3,
    smoothing: Real = 0.02,
    torque_limit: Real | None = None,
    *,
    plant: Robot | None = None,
    initial_state: Any = None,
    control_period: Real | None = None,
    delayed: Array | bool | None = None,
    sensor_bias: Any = None,
    convention: str = "corrected",
    method: str = "rk4",
    save_every: int | None = 1,
    dtype: Any = None,
    throw: bool = True,
) -> Trajectory:
    """Roll the sphere by `travel` from rest to rest on a slope under decoupled sliding-mode control (the case of Fig. 4).

    It builds a `PlanarTask` and simulates it. Batch it with `jax.vmap` over any leaf of the task's fields and the gains.

    Args:
        robot: that the controller believes in, and the plant too unless `plant` is given.
        slope: rad.
        gains: Table 3 by default.
        travel: alpha_d, rad.
        duration, dt, method, save_every, dtype: as in `Numerics`.
        smoothing, torque_limit, plant, initial_state, control_period, delayed, sensor_bias, convention: as in `PlanarTask`.
        throw: raise when a single rollout ends early; otherwise, and always under vmap and jit, `status` tells.

    Returns:
        A Trajectory with `RegulationMetrics` and, unless `save_every` is None, the controller's `Signals` (T,).

    Raises:
        ValueError: an argument is not admissible.
        RolloutError: a single rollout ended early and `throw` is set.
    """
    task = PlanarTask(
        robot=robot,
        slope=slope,
        travel=travel,
        plant=plant,
        initial_state=initial_state,
        torque_limit=torque_limit,
        smoothing=smoothing,
        control_period=control_period,
        delayed=None if delayed is None else jnp.asarray(delayed, bool),
        sensor_bias=sensor_bias,
        convention=convention,
    )
    numerics = Numerics(dt, duration, method, save_every, np.dtype(dtype or "float64").name)
    try:
        return simulate(task, gains, numerics, diagnostics=True, throw=throw)
    except RolloutError as error:
        if int(error.trajectory.status) == Status.INFEASIBLE_LEAN:
            require_holdable(robot, slope)
        raise


def planar_plant(robot: Robot, slope: Array, start: Array, travel: Array) -> Plant:
    """Planar robot as a rollout sees it: whirling beyond |phi| = pi, diverged beyond 100 travels (at least 1000 rad)."""
    lumped = planar.lump(robot, slope)
    range_ = 100.0 * jnp.maximum(jnp.abs(travel), 10.0)

    def status(state: planar.State) -> Array:
        now = planar.PlanarState(*state)
        away = jnp.where(jnp.abs(now.alpha - start) > range_, code(Status.DIVERGED), code(Status.OK))
        return jnp.where(jnp.abs(now.swing) > jnp.pi, code(Status.WHIRLING), away)

    return Plant(partial(planar.derivative, lumped), status, planar.IS_VELOCITY)


def require_holdable(robot: Robot, slope: Real) -> None:
    """Raise ValueError when the slope (rad) is past the climbing bound (4) of the robot; for single robots on the host."""
    if sentence := past_bound(robot, slope):
        raise ValueError(sentence)


def past_bound(robot: Robot, slope: Real) -> str:
    """Sentence that says by how much the slope (rad) is past the climbing bound (4), empty where it is not."""
    if bool(can_hold(robot, slope)):
        return ""
    bound = float(climbing_bound(robot))
    return (
        f"slope = {float(slope):.4g} rad ({math.degrees(float(slope)):.2f} deg) is past the climbing bound of the robot, "
        f"{bound:.4g} rad ({math.degrees(bound):.2f} deg): no swing of its pendulum holds it; type a smaller slope"
    )
