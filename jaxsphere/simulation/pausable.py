"""Computations that end at different times, and a queue that keeps every lane of a batch busy with them.

Under `jax.vmap` a loop lasts as long as its slowest lane. A `Pausable` can be advanced piece by piece instead, so that
`over_queue` gives a lane the next computation as soon as it has finished one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxsphere.simulation.lanes import CPU_OPTIONS, lane_count


class Pausable(NamedTuple):
    """A computation cut into pieces."""

    first: Any  # carry before the first piece
    advance: Callable[[Any], Any]  # carry -> carry after one more piece
    is_done: Callable[[Any], Array]  # carry -> bool
    result: Callable[[Any], Any]  # carry of a finished computation -> what it found


class _Queue(NamedTuple):
    index: Array  # (slots,), the lane that each slot works on; the number of lanes where there is none left
    carry: Any
    waiting: Array  # the next lane to begin with
    found: Any  # (lanes + 1, ...), the last row is scratch


def run(computation: Pausable) -> Any:
    """Run one computation to its end; batch it with `jax.vmap`, or better with `over_queue`."""
    last = jax.lax.while_loop(lambda carry: ~computation.is_done(carry), computation.advance, computation.first)
    return computation.result(last)


def over_queue(make: Callable[..., Pausable], slots: int = 256, capacity: int = 1) -> Callable[..., Any]:
    """Like `js.over_lanes(lambda *lane: run(make(*lane)))`, for computations whose lengths differ.

    Args:
        make: the numbers of one lane -> its computation. slots: computations under way at a time on each device. capacity:
        batches of up to so many lanes share one compiled program, whatever their number.

    Returns:
        A function of the same arguments with a leading axis of lanes on every leaf. It raises ValueError when the leading
        axes differ or there are no lanes.
    """
    mesh = Mesh(np.array(jax.local_devices()), ("lane",))
    spec = PartitionSpec("lane")
    on_cpu = mesh.devices.flat[0].platform == "cpu"

    @partial(jax.jit, compiler_options=CPU_OPTIONS if on_cpu else None)
    def batched(arguments: tuple[Any, ...], real: Array) -> Any:
        work = partial(_work_through, make, slots)
        return jax.shard_map(work, mesh=mesh, in_specs=(spec, spec), out_specs=spec, check_vma=False)(arguments, real)

    def call(*arguments: Any) -> Any:
        lanes = lane_count(arguments)
        # Neighbours take equally long: dealt out in turns, every device gets its share of the long ones.
        room = max(lanes, capacity)
        order = np.arange(room + -room % mesh.size).reshape(-1, mesh.size).T.ravel()
        dealt = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf))[np.minimum(order, lanes - 1)], arguments)
        found = batched(*jax.device_put((dealt, order < lanes), NamedSharding(mesh, spec)))
        back = np.argsort(order)[:lanes]
        return jax.tree.map(lambda leaf: np.asarray(leaf)[back], found)

    return call


def _work_through(make: Callable[..., Pausable], slots: int, arguments: tuple[Any, ...], real: Array) -> Any:
    """Run the computations of the real lanes, the first of the leading axis, and return what they found, lane by lane."""
    lanes, count = real.shape[0], jnp.sum(real)
    slots = min(slots, lanes)

    def begin(lane: tuple[Any, ...]) -> Any:
        return make(*lane).first

    def proceed(lane: tuple[Any, ...], carry: Any) -> tuple[Any, Array, Any]:
        computation = make(*lane)
        carry = computation.advance(carry)
        return carry, computation.is_done(carry), computation.result(carry)

    def of(index: Array) -> tuple[Any, ...]:
        return jax.tree.map(lambda leaf: leaf[jnp.minimum(index, lanes - 1)], arguments)

    def body(queue: _Queue) -> _Queue:
        carry, ended, found = jax.vmap(proceed)(of(queue.index), queue.carry)
        ended = ended & (queue.index < lanes)
        row = jnp.where(ended, queue.index, lanes)
        following = queue.waiting + jnp.cumsum(ended) - 1
        index = jnp.where(ended, jnp.where(following < count, following, lanes), queue.index)
        fresh = jax.vmap(begin)(of(index))
        return _Queue(
            index=index,
            carry=jax.tree.map(lambda new, old: jnp.where(_like(ended, new), new, old), fresh, carry),
            waiting=queue.waiting + jnp.sum(ended),
            found=jax.tree.map(lambda all_, new: all_.at[row].set(new), queue.found, found),
        )

    index = jnp.where(jnp.arange(slots) < count, jnp.arange(slots), lanes)
    carry = jax.vmap(begin)(of(index))
    shapes = jax.eval_shape(lambda: jax.vmap(proceed)(of(index), carry))[2]
    found = jax.tree.map(lambda leaf: jnp.zeros((lanes + 1, *leaf.shape[1:]), leaf.dtype), shapes)
    queue = _Queue(index, carry, jnp.asarray(slots), found)
    last = jax.lax.while_loop(lambda queue: jnp.any(queue.index < lanes), body, queue)
    return jax.tree.map(lambda leaf: leaf[:lanes], last.found)


def _like(flags: Array, leaf: Array) -> Array:
    return flags.reshape(flags.shape + (1,) * (leaf.ndim - 1))
