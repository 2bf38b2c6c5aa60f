"""Closed loop of any plant and any control law as a pair (init, step), with a status per lane.

    x       physical state of the plant, a tuple of components
    memory  states of the law, integrated with the plant's
    lane    one rollout of a batch; `jax.vmap` makes every component an array of lanes

A lane that fails is frozen at its last finite state and carries a status. A rollout is a scan over `step`, a search that ends
early a loop over it; a run that pauses keeps its `LoopState` and goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.numerics import Real
from jaxsphere.simulation.integrators import stepper
from jaxsphere.status import ControllerOutput, Status, code

State = tuple[Array, ...]
Law = Callable[[Array, State, State], ControllerOutput]


class Plant(NamedTuple):
    """Dynamics of a robot, and how it tells that a lane has failed."""

    derivative: Callable[[State, State], tuple[Real, ...]]  # (state, torque) -> rate
    status: Callable[[State], Array]  # state -> Status code
    is_velocity: tuple[bool, ...]
    into: Callable[[State], State] | None = None  # components that a user gives -> those that are integrated
    out: Callable[[State, State], tuple[State, Any]] | None = None  # (integrated (T,), given at first) -> (shown, attitude)


def shown_rates(plant: Plant, state: State, torque: State) -> State:
    """Rates of a plant's state in the coordinates of its trajectories."""
    if plant.into is None or plant.out is None:
        return tuple(map(jnp.asarray, plant.derivative(state, torque)))
    out, first = plant.out, jax.lax.stop_gradient(state)
    now = tuple(plant.into(state))

    def show(*parts: Array) -> State:
        return tuple(x[0] for x in out(tuple(part[None] for part in parts), first)[0])

    return jax.jvp(show, now, tuple(map(jnp.asarray, plant.derivative(now, torque))))[1]


class Measure(NamedTuple):
    """A running metric: update(value, time, state, torque, dt) at every step, finish(value) once at the end.

    state: the components that are integrated, those of `Plant.into` where the plant has it.
    """

    initial: Any
    update: Callable[[Any, Array, State, State, Array], Any]
    finish: Callable[[Any], Any]


class LoopState(NamedTuple):
    """Everything that the next step of a closed loop needs."""

    index: Array  # steps taken or passed over since the start
    x: State
    memory: State
    torque: State  # the last one applied, N m
    held: ControllerOutput | None  # of the zero-order hold
    queued: ControllerOutput | None  # computed, applied one control period later
    status: Array
    end_time: Array  # s
    measured: Any


class ClosedLoop(NamedTuple):
    """A plant under a law in discrete time."""

    init: Callable[[State, State], LoopState]  # (state, memory) -> state of the loop at time 0
    step: Callable[[LoopState], tuple[LoopState, State]]  # -> (state one step later, torque applied from now on, N m)
    metrics: Callable[[LoopState], Any]  # of the run so far; None without a measure


def closed_loop(
    plant: Plant,
    law: Law,
    *,
    dt: Array,
    steps: int | Array,
    hold: Array | None = None,
    delayed: Array | None = None,
    torque_limit: Array | None = None,
    measure: Measure | None = None,
    method: str = "rk4",
) -> ClosedLoop:
    """Close the loop of a plant and a law.

    Args:
        plant: the dynamics.
        law: (time, state, memory) -> ControllerOutput.
        dt: time step, s.
        steps: length of the run; a step from there on measures the last state and moves nothing.
        hold: zero-order hold of the controller's output, in steps; None evaluates the law in every stage of the integrator.
        delayed: bool, apply each held output one control period after its sample; the first one then rules two periods.
        torque_limit: each torque is clipped to +-this, N m.
        measure: a running metric, updated at every step.
        method: one of `integrators.METHODS`.

    Returns:
        The functions `init`, `step` and `metrics`.
    """
    control = _limited(law, torque_limit)

    def init(state: State, memory: State = ()) -> LoopState:
        state = tuple(state if plant.into is None else plant.into(state))
        zero = jnp.zeros_like(state[0])
        blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(control, zero, state, memory))
        return LoopState(
            index=jnp.zeros((), jnp.int32),
            x=state,
            memory=tuple(memory),
            torque=blank.torque,
            held=None if hold is None else blank,
            queued=None if hold is None or delayed is None else control(zero, state, memory),
            status=jnp.full(zero.shape, code(Status.OK)),
            end_time=zero,
            measured=None if measure is None else measure.initial,
        )

    def step(loop: LoopState) -> tuple[LoopState, State]:
        size, time = len(loop.x), loop.index * dt
        held, queued = loop.held, loop.queued
        if hold is not None:
            sampled, fresh = loop.index % hold == 0, control(time, loop.x, loop.memory)
            held = where(sampled, fresh if delayed is None else where(delayed, queued, fresh), held)
            queued = None if delayed is None else where(sampled, fresh, queued)

        def field(time: Array, y: State) -> tuple[tuple[Real, ...], ControllerOutput]:
            now = control(time, y[:size], y[size:]) if held is None else held
            with jax.named_scope("plant"):
                return (*plant.derivative(y[:size], now.torque), *now.memory_rate), now

        y = loop.x + loop.memory
        ahead, now = stepper(method, plant.is_velocity + (True,) * len(loop.memory))(field, time, y, dt)
        defined = now.status == Status.OK
        finite = jnp.isfinite(sum(ahead[1:], ahead[0]))
        sound = (loop.status == Status.OK) & (loop.index <= steps) & defined & finite
        moving = (loop.status == Status.OK) & (loop.index < steps)
        moves = moving & sound
        next_status = jnp.where(finite, plant.status(ahead[:size]), code(Status.NONFINITE))
        next_status = jnp.where(defined, next_status, now.status)
        measured = loop.measured
        if measure is not None:
            with jax.named_scope("measure"):
                update = measure.update(measured, time, loop.x, now.torque, jnp.where(moving, dt, 0.0))
            measured = where(sound, update, measured)
        y = where(moves, ahead, y)
        after = LoopState(
            index=loop.index + 1,
            x=y[:size],
            memory=y[size:],
            torque=where(sound, now.torque, loop.torque),
            held=held,
            queued=queued,
            status=jnp.where(moving, next_status, loop.status),
            end_time=jnp.where(moves, time + dt, loop.end_time),
            measured=measured,
        )
        return after, where(sound, now.torque, tuple(jnp.zeros_like(u) for u in now.torque))

    return ClosedLoop(init, step, partial(_metrics, measure))


def _limited(law: Law, torque_limit: Array | None) -> Law:
    def control(time: Array, x: State, memory: State) -> ControllerOutput:
        with jax.named_scope("law"):
            now = law(time, x, memory)
        if torque_limit is None:
            return now
        return now._replace(torque=tuple(jnp.clip(u, -torque_limit, torque_limit) for u in now.torque))

    return control


def _metrics(measure: Measure | None, loop: LoopState) -> Any:
    if measure is None:
        return None
    # A lane that ended early has not been measured at its last state.
    last = measure.update(loop.measured, loop.end_time, loop.x, loop.torque, jnp.zeros_like(loop.end_time))
    return measure.finish(where(loop.status == Status.OK, loop.measured, last))


def where(condition: Array, yes: Any, no: Any) -> Any:
    """Choose between two pytrees of one structure."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
