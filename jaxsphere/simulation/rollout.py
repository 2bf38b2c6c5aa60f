"""A rollout: the scan over the steps of a closed loop, and the trajectory that it returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxsphere.simulation.closed_loop import Law, LoopState, Measure, Plant, State, closed_loop


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Result of a rollout; under `jax.vmap` every leaf gets a leading axis of lanes.

    time: s. state: components of the plant. torque: N m, applied from that time on. memory: states of the law. status: a Status
    code. end_time: when the lane ended, s. metrics, diagnostics: named numbers of the task, or None. attitude: quaternion
    (w, x, y, z) of a plant that has one.
    """

    time: Float[Array, " T"]
    state: Float[Array, "T n"]
    torque: Float[Array, "T m"]
    memory: Float[Array, "T p"]
    status: Int[Array, ""]
    end_time: Float[Array, ""] = field(metadata={"unit": "s"})
    metrics: Any = None
    diagnostics: Any = None
    attitude: Float[Array, "T 4"] | None = None


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
    delayed: Array | None = None,
    torque_limit: Array | None = None,
    measure: Measure | None = None,
    method: str = "rk4",
) -> Trajectory:
    """Roll the closed loop out for `steps` steps of `dt` seconds.

    Args:
        plant: the dynamics.
        law: the controller.
        state: initial components of the plant.
        memory: initial states of the law.
        dt: time step, s.
        steps: how many.
        save_every: keep every so many steps (a divisor of `steps`), or None to keep the end only (T = 1).
        hold, delayed, torque_limit, measure, method: as in `closed_loop`.

    Returns:
        The trajectory of one lane; batch it with `jax.vmap`.
    """
    loop = closed_loop(
        plant,
        law,
        dt=dt,
        steps=steps,
        hold=hold,
        delayed=delayed,
        torque_limit=torque_limit,
        measure=measure,
        method=method,
    )
    block = math.isqrt(steps) + 1 if save_every is None else save_every

    def sample(now: LoopState, _: None) -> tuple[LoopState, tuple[State, State, State] | None]:
        after, torques = jax.lax.scan(lambda one, _: loop.step(one), now, None, length=block)
        return after, None if save_every is None else (now.x, now.memory, tuple(u[0] for u in torques))

    # Without the checkpoint reverse mode would store every intermediate of every step.
    blocks = steps // block + 1
    last, saved = jax.lax.scan(jax.checkpoint(sample, prevent_cse=False), loop.init(state, memory), None, length=blocks)
    if saved is None:
        saved = jax.tree.map(lambda leaf: leaf[None], (last.x, last.memory, last.torque))
    x, memories, torque = saved
    shown, attitude = (x, None) if plant.out is None else plant.out(x, state)
    return Trajectory(
        time=jnp.asarray([steps] if save_every is None else block * jnp.arange(blocks)) * dt,
        state=jnp.stack(shown, -1),
        torque=jnp.stack(torque, -1),
        memory=jnp.stack(memories, -1) if memories else jnp.zeros((len(x[0]), 0), last.end_time.dtype),
        status=last.status,
        end_time=last.end_time,
        metrics=loop.metrics(last),
        attitude=attitude,
    )
