"""From rest to rest as one call: the planar robot under sliding-mode control (the case of Fig. 4)."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import is_concrete, require_choice, require_finite_vector, require_scalar
from jaxsphere.command import Status, code
from jaxsphere.controllers import sliding_mode
from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import can_hold, climbing_bound, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation import metrics
from jaxsphere.simulation.host import cast, check_control_period, check_time_grid, is_single, raise_early_end
from jaxsphere.simulation.integrators import METHODS
from jaxsphere.simulation.rollout import Law, Plant, Trajectory, rollout


def rest_to_rest(
    robot: Robot,
    slope: Real,
    gains: SlidingModeGains | None = None,
    travel: Real = 10.0,
    duration: float = 30.0,
    dt: Real = 1e-3,
    smoothing: Real = 0.02,
    torque_limit: Real | None = None,
    *,
    plant: Robot | None = None,
    initial_state: Real | None = None,
    control_period: float | None = None,
    late: Real | None = None,
    sensor_bias: Real | None = None,
    convention: str = "corrected",
    method: str = "rk4",
    save_every: int | None = 1,
    dtype: Any = None,
    throw: bool = True,
) -> Trajectory:
    """Roll the sphere by `travel` from rest to rest on a slope under decoupled sliding-mode control (the case of Fig. 4).

    Batch it with `jax.vmap` over any leaf of robot, plant, slope, gains, travel, initial_state, smoothing, torque_limit.

    Args:
        robot: the robot that the controller believes in, and the plant too unless `plant` is given.
        slope: rad. gains: Table 3 by default. travel: alpha_d, rad. duration, dt: s. smoothing: epsilon, rad/s, 0 for the
        hard sign. torque_limit: N m, None for no limit. plant: the true robot, where it differs from the modelled one.
        initial_state: (4,) alpha, alpha', phi, phi'; rest at phi_0 of the modelled robot by default.
        control_period: s, a multiple of dt, for a sampled controller with a zero-order hold; None for a continuous one.
        late: bool, each command acts one control period after its sample. sensor_bias: (4,), added to the state that the
        controller sees. convention: "corrected" or "printed" sign of z. method: an integrator. save_every: keep every so
        many steps (a divisor of their number), None for the last state only. dtype: float64 unless given.
        throw: raise when a single rollout ends early; otherwise, and always under vmap and jit, `status` tells.

    Returns:
        A Trajectory with `RegulationMetrics` and, unless `save_every` is None, the controller's `Signals` (T,).

    Raises:
        ValueError: an argument is not admissible. RolloutError: a single rollout ended early and `throw` is set.
    """
    gains = SlidingModeGains() if gains is None else gains
    steps = check_time_grid(duration, dt, save_every)
    check_robot(robot)
    sliding_mode.check_gains(gains)
    if plant is not None:
        check_robot(plant, "plant")
    require_scalar("slope", slope, above=-math.pi / 2, below=math.pi / 2, unit="rad", hint="type radians, e.g. jnp.deg2rad(10)")
    require_scalar("travel", travel, unit="rad")
    if is_concrete(travel) and float(travel) == 0.0:
        raise ValueError("travel = 0 rad is no move; type the angle that the sphere should roll, e.g. 10.0")
    require_scalar("smoothing", smoothing, above=0.0, or_equal=True, unit="rad/s")
    if torque_limit is not None:
        require_scalar("torque_limit", torque_limit, above=0.0, unit="N m")
    if initial_state is not None:
        require_finite_vector("initial_state", initial_state, 4, "alpha, alpha', phi, phi'")
    if sensor_bias is not None:
        require_finite_vector("sensor_bias", sensor_bias, 4, "on alpha, alpha', phi, phi'")
    if late is not None and control_period is None:
        raise ValueError("late needs a sampled controller; type control_period=1e-3")
    require_choice("convention", convention, sliding_mode.CONVENTIONS)
    require_choice("method", method, METHODS)
    numbers = (robot, plant, slope, gains, travel, dt, smoothing, torque_limit, initial_state, sensor_bias)
    trajectory = _rest_to_rest(
        *cast(numbers, dtype or jnp.float64),
        late=None if late is None else jnp.asarray(late, bool),
        hold=check_control_period(control_period, dt),
        steps=steps,
        save_every=save_every,
        convention=convention,
        method=method,
    )
    if throw:
        if is_single(trajectory) and int(trajectory.status) == Status.INFEASIBLE_LEAN:
            require_holdable(robot, slope)
        raise_early_end(trajectory)
    return trajectory


@partial(jax.jit, static_argnames=("steps", "save_every", "convention", "method"))
def _rest_to_rest(
    robot: Robot,
    plant: Robot | None,
    slope: Array,
    gains: SlidingModeGains,
    travel: Array,
    dt: Array,
    smoothing: Array,
    torque_limit: Array | None,
    initial_state: Array | None,
    sensor_bias: Array | None,
    late: Array | None,
    hold: Array | None,
    *,
    steps: int,
    save_every: int | None,
    convention: str,
    method: str,
) -> Trajectory:
    equilibrium = equilibrium_swing(robot, slope)
    zero = jnp.zeros_like(equilibrium)
    state = (zero, zero, equilibrium, zero) if initial_state is None else tuple(initial_state)
    target = state[0] + travel
    trajectory = rollout(
        planar_plant(robot if plant is None else plant, slope, state[0], travel),
        seen_with(sensor_bias, sliding_mode.law(robot, slope, gains, target, smoothing, convention)),
        state,
        (zero,),
        dt=dt,
        steps=steps,
        save_every=save_every,
        hold=hold,
        late=late,
        torque_limit=torque_limit,
        measure=metrics.regulation(target, travel, equilibrium),
        method=method,
    )
    settled = jnp.isfinite(trajectory.metrics.settling_time)
    status = jnp.where((trajectory.status == Status.OK) & ~settled, code(Status.NOT_SETTLED), trajectory.status)
    signals = None
    if save_every is not None:
        lumped = planar.lump(robot, slope)
        states, corrections = tuple(trajectory.state.T), trajectory.memory[:, 0]
        signals = sliding_mode.signals(lumped, equilibrium, gains, states, corrections, target, smoothing, convention)
    return dataclasses.replace(trajectory, status=status, diagnostics=signals)


def seen_with(bias: Array | None, law: Law) -> Law:
    """Let `law` see the state plus `bias`, one number per component."""
    if bias is None:
        return law
    return lambda time, state, memory: law(time, tuple(x + b for x, b in zip(state, bias, strict=True)), memory)


def planar_plant(robot: Robot, slope: Array, start: Array, travel: Array) -> Plant:
    """Planar robot as a rollout sees it: whirling beyond |phi| = pi, diverged beyond 100 travels (at least 1000 rad)."""
    lumped = planar.lump(robot, slope)
    range_ = 100.0 * jnp.maximum(jnp.abs(travel), 10.0)

    def status(state: planar.State) -> Array:
        alpha, _, swing, _ = state
        away = jnp.where(jnp.abs(alpha - start) > range_, code(Status.DIVERGED), code(Status.OK))
        return jnp.where(jnp.abs(swing) > jnp.pi, code(Status.WHIRLING), away)

    return Plant(partial(planar.derivative, lumped), status, planar.IS_VELOCITY)


def require_holdable(robot: Robot, slope: Real) -> None:
    """Raise ValueError when the slope (rad) is past the climbing bound (4) of the robot; for single robots on the host."""
    if not bool(can_hold(robot, slope)):
        bound = float(climbing_bound(robot))
        raise ValueError(
            f"slope = {float(slope):.4g} rad ({math.degrees(float(slope)):.2f} deg) is past the climbing bound of the robot, "
            f"{bound:.4g} rad ({math.degrees(bound):.2f} deg): no swing of its pendulum holds it; type a smaller slope"
        )
