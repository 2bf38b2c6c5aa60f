"""Closed loop of any plant and any law under `lax.scan`, with a status per lane.

    x       physical state of the plant, a tuple of components
    memory  states of the law, integrated with the plant's
    lane    one rollout of a batch; `jax.vmap` makes every component an array of lanes

A lane that ends early (`Status`) keeps its last finite state to the end: nothing raises, nothing becomes NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.command import Command, Status, code
from jaxsphere.numerics import Real
from jaxsphere.simulation.integrators import stepper

State = tuple[Array, ...]
Law = Callable[[Array, State, State], Command]


class Plant(NamedTuple):
    """What a rollout needs to know of a robot."""

    derivative: Callable[[State, State], tuple[Real, ...]]  # (state, torque) -> rate
    status: Callable[[State], Array]  # state -> Status code
    is_velocity: tuple[bool, ...]


class Measure(NamedTuple):
    """A running metric: update(value, time, state, torque, dt) at every step, finish(value) once at the end."""

    initial: Any
    update: Callable[[Any, Array, State, State, Array], Any]
    finish: Callable[[Any], Any]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a rollout returns; under `jax.vmap` every leaf gets a leading axis of lanes.

    time (T,), s. state (T, n). torque (T, m), N m, the one applied from that time on. memory (T, p), states of the law.
    status (), a Status code. end_time (), s, when the lane ended. metrics, diagnostics: named numbers of the task, or None.
    """

    time: Array
    state: Array
    torque: Array
    memory: Array
    status: Array
    end_time: Array
    metrics: Any = None
    diagnostics: Any = None


class _Loop(NamedTuple):
    x: State
    memory: State
    torque: State  # the last one applied
    held: Command | None
    queued: Command | None  # computed, not applied before the next period
    status: Array
    end_time: Array
    measured: Any


def rollout(
    plant: Plant,
    law: Law,
    state: State,
    memory: State = (),
    *,
    dt: Array,
    steps: int,
    save_every: int | None = 1,
    hold: Array | None = None,
    late: Array | None = None,
    torque_limit: Array | None = None,
    measure: Measure | None = None,
    method: str = "rk4",
) -> Trajectory:
    """Roll the closed loop out for `steps` steps of `dt` seconds.

    Args:
        plant, law: the robot and its controller. state, memory: their initial components.
        save_every: keep every so many steps (a divisor of `steps`), or None to keep the end only (T = 1).
        hold: zero-order hold of the command, in steps; None evaluates the law continuously, in every stage.
        late: bool, apply each held command one period after its sample; the first one then rules two periods.
        torque_limit: each torque is clipped to +-this, N m. measure: a running metric, updated at every step.
        method: one of `integrators.METHODS`.
    """
    step = stepper(method, plant.is_velocity + (True,) * len(memory))
    block = math.isqrt(steps) + 1 if save_every is None else save_every
    zero = jnp.zeros_like(state[0])

    def command(time: Array, x: State, memory: State) -> Command:
        now = law(time, x, memory)
        if torque_limit is None:
            return now
        return now._replace(torque=tuple(jnp.clip(u, -torque_limit, torque_limit) for u in now.torque))

    def advance(loop: _Loop, index: Array) -> tuple[_Loop, State]:
        """Measure the state at `index` and, but for the last one, step on from it."""
        time = index * dt
        held, queued = loop.held, loop.queued
        if hold is not None:
            sampled, fresh = index % hold == 0, command(time, loop.x, loop.memory)
            held = _where(sampled, fresh if late is None else _where(late, queued, fresh), held)
            queued = None if late is None else _where(sampled, fresh, queued)

        def field(time: Array, y: State) -> tuple[tuple[Real, ...], Command]:
            x, memory = y[: len(state)], y[len(state) :]
            now = command(time, x, memory) if held is None else held
            return (*plant.derivative(x, now.torque), *now.memory_rate), now

        y = loop.x + loop.memory
        ahead, now = step(field, time, y, dt)
        alive = (loop.status == Status.OK) & (index <= steps)
        defined = now.status == Status.OK
        finite = jnp.isfinite(sum(ahead[1:], ahead[0]))
        moving = alive & (index < steps)
        sound = alive & defined & finite
        moves = moving & sound
        fate = jnp.where(finite, plant.status(ahead[: len(state)]), code(Status.NONFINITE))
        fate = jnp.where(defined, fate, now.status)

        measured = loop.measured
        if measure is not None:
            update = measure.update(measured, time, loop.x, now.torque, jnp.where(moving, dt, 0.0))
            measured = _where(sound, update, measured)
        y = _where(moves, ahead, y)
        after = _Loop(
            x=y[: len(state)],
            memory=y[len(state) :],
            torque=_where(sound, now.torque, loop.torque),
            held=held,
            queued=queued,
            status=jnp.where(moving, fate, loop.status),
            end_time=jnp.where(moves, time + dt, loop.end_time),
            measured=measured,
        )
        return after, _where(sound, now.torque, tuple(jnp.zeros_like(u) for u in now.torque))

    def sample(loop: _Loop, first: Array) -> tuple[_Loop, tuple[State, State, State] | None]:
        after, torques = jax.lax.scan(advance, loop, first + jnp.arange(block))
        return after, None if save_every is None else (loop.x, loop.memory, tuple(u[0] for u in torques))

    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(command, zero, state, memory))
    loop = _Loop(
        x=state,
        memory=memory,
        torque=blank.torque,
        held=None if hold is None else blank,
        queued=None if hold is None or late is None else command(zero, state, memory),
        status=jnp.full(zero.shape, code(Status.OK)),
        end_time=zero,
        measured=None if measure is None else measure.initial,
    )
    # Without the checkpoint reverse mode would store every intermediate of every step.
    blocks = block * jnp.arange(steps // block + 1)
    loop, saved = jax.lax.scan(jax.checkpoint(sample, prevent_cse=False), loop, blocks)
    if saved is None:
        saved = jax.tree.map(lambda leaf: leaf[None], (loop.x, loop.memory, loop.torque))
    x, memory, torque = saved
    metrics = None
    if measure is not None:
        # A lane that ended early has not been measured at its last state.
        last = measure.update(loop.measured, loop.end_time, loop.x, loop.torque, zero)
        metrics = measure.finish(_where(loop.status == Status.OK, loop.measured, last))
    return Trajectory(
        time=jnp.asarray([steps] if save_every is None else blocks) * dt,
        state=jnp.stack(x, -1),
        torque=jnp.stack(torque, -1),
        memory=jnp.stack(memory, -1) if memory else jnp.zeros((len(x[0]), 0), zero.dtype),
        status=loop.status,
        end_time=loop.end_time,
        metrics=metrics,
    )


def _where(condition: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
