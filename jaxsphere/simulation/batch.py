"""Many lanes at once, in cache-sized blocks on all local devices; lanes may take differently long."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.extend.core import get_opaque_trace_state

from jaxsphere.checks import require_count
from jaxsphere.simulation.closed_loop import where
from jaxsphere.simulation.search import Pausable

# The working set of a planar step on one block of lanes stays within the second-level cache of a core.
BLOCK = 512
# Computations of different lengths that are under way at a time.
SLOTS = 256
# XLA compiles for 256-bit vectors unless asked; without 512-bit registers the option has no effect.
CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
# What JAX calls its state while no transformation is under way.
_OUTSIDE = get_opaque_trace_state()


def batch(
    function: Callable[..., Any], *, block: int | None = None, ragged: bool = False, capacity: int = 1
) -> Callable[..., Any]:
    """Return the function that maps `function` over a leading axis of lanes, in blocks and on all local devices.

    Inside `jit`, `grad`, `vmap` and `lax.map` it becomes part of the surrounding program, with the same results to
    rounding. A ragged batch is a while loop: forward derivatives pass through it, reverse ones do not.

    Args:
        function: any function of one lane to a pytree of arrays; for a ragged batch to a `Pausable`.
        block: lanes of one program. If given, no bit of a lane's result depends on how many lanes or devices there are. By
            default 512 on a CPU and all lanes of a device elsewhere, or as many as there are.
        ragged: lanes take differently long; a lane that has finished makes room for the next one.
        capacity: ragged batches of up to so many lanes share one compiled program.

    Returns:
        A function of the same arguments with a leading axis of lanes on every leaf.

    Raises:
        ValueError: `block` is no whole number of at least one; by the returned function, when the leading axes differ or there
            are no lanes.
    """
    if block is not None:
        require_count("block", block)
    run = blocks(function, block, ragged=ragged, capacity=capacity)

    def call(*arguments: Any) -> Any:
        lanes = lane_count(arguments)
        if _is_traced() or any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arguments)):
            if ragged:
                return _work_through(function, block or SLOTS, arguments, jnp.ones(lanes, bool))
            size = block or (BLOCK if jax.default_backend() == "cpu" else lanes)
            if lanes <= size:
                return jax.vmap(function)(*arguments)
            return jax.lax.map(lambda lane: function(*lane), arguments, batch_size=size)
        found = jax.device_put(run(*arguments), jax.local_devices()[0])
        if ragged and len(found) > 1:  # dealt out in turns
            found = [jax.tree.map(lambda *parts: jnp.stack(parts, 1).reshape(-1, *parts[0].shape[1:]), *found)]
        return jax.tree.map(lambda *parts: jnp.concatenate(parts)[:lanes], *found)

    return call


def blocks(
    function: Callable[..., Any],
    block: int | None,
    devices: Sequence[Any] | None = None,
    *,
    ragged: bool = False,
    capacity: int = 1,
) -> Callable[..., list[Any]]:
    """Return `batch` without the last step: a function that returns the results block after block, possibly not yet computed.

    Every device runs the same program. The last block is filled by repeating the last lane. Of a ragged batch there is one
    block a device, and lane n is in block n modulo their number.

    Args:
        function, block, ragged, capacity: as in `batch`.
        devices: all local ones unless given; those that are needed are compiled for, at the same time.
    """
    devices = jax.local_devices() if devices is None else devices
    on_cpu = devices[0].platform == "cpu"
    work = partial(_work_through, function, block or SLOTS) if ragged else lambda lanes, _: jax.vmap(function)(*lanes)
    program = jax.jit(work, compiler_options=CPU_OPTIONS if on_cpu else None)
    compiled: dict[Any, Any] = {}

    def parts_of(arguments: Any, lanes: int) -> list[tuple[Any, np.ndarray | None]]:
        if ragged:
            # Neighbours take equally long: dealt out in turns, every device gets its share of the long ones.
            room = -(-max(lanes, capacity) // len(devices))
            chosen = [np.arange(room) * len(devices) + index for index in range(len(devices))]
            return [(_rows(arguments, rows, lanes), rows < lanes) for rows in chosen]
        share = -(-lanes // len(devices))
        size = block or (min(BLOCK, share) if on_cpu else share)
        return [(_rows(arguments, np.arange(start, start + size), lanes), None) for start in range(0, lanes, size)]

    def call(*arguments: Any) -> list[Any]:
        parts = parts_of(arguments, lane_count(arguments))
        shapes = jax.tree.structure(parts[0]), tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(parts[0]))
        missing = [device for device in devices[: len(parts)] if (device, shapes) not in compiled]
        if missing:
            with ThreadPoolExecutor(len(missing)) as pool:
                programs = pool.map(lambda device: program.lower(*_shapes(parts[0], device)).compile(), missing)
                compiled.update(zip(((device, shapes) for device in missing), programs, strict=True))
        return [
            compiled[device, shapes](*jax.device_put(part, device)) for part, device in zip(parts, cycle(devices), strict=False)
        ]

    return call


def lane_count(arguments: tuple[Any, ...]) -> int:
    """Return the common leading axis of batched arguments. Raises ValueError when there is none, or none in it."""
    counts = sorted({np.shape(leaf)[:1] for leaf in jax.tree.leaves(arguments)})
    if len(counts) != 1 or not counts[0] or counts[0][0] == 0:
        raise ValueError(f"the leading axes of the batched arguments are {counts}; type one positive number of lanes for all")
    return counts[0][0]


def use_all_cores() -> int:
    """Make every CPU core a device of its own and return their number; call it before JAX computes anything."""
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    try:
        jax.config.update("jax_num_cpu_devices", cores)
    except RuntimeError:  # JAX has started already
        return len(jax.local_devices())
    return cores


def _is_traced() -> bool:
    """Tell whether a transformation is under way, even one that only numbers captured by a closure take part in."""
    return get_opaque_trace_state() != _OUTSIDE or jax.config.jax_disable_jit  # type: ignore[attr-defined]


def _rows(arguments: Any, rows: np.ndarray, lanes: int) -> Any:
    """Return the rows of every leaf, the last lane in place of those past it, as arrays of the host but for random keys."""
    rows = np.minimum(rows, lanes - 1)
    return jax.tree.map(lambda leaf: leaf[rows] if _is_key(leaf) else np.asarray(leaf)[rows], arguments)


def _is_key(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jax.dtypes.extended)


def _shapes(arguments: Any, device: Any) -> Any:
    sharding = jax.sharding.SingleDeviceSharding(device)
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), arguments)


class _Queue(NamedTuple):
    index: Array  # (slots,), the lane that each slot works on; the number of lanes where there is none left
    carry: Any
    waiting: Array  # the next lane to begin with
    found: Any  # (lanes + 1, ...), the last row is scratch


def _work_through(make: Callable[..., Pausable], slots: int, arguments: tuple[Any, ...], real: Array) -> Any:
    """Run the computations of the real lanes, the first of the leading axis, and return what they found, lane by lane."""
    lanes, count = real.shape[0], jnp.sum(real)
    slots = min(slots, lanes)

    def begin(lane: tuple[Any, ...]) -> Any:
        computation = make(*lane)
        if not isinstance(computation, Pausable):
            raise TypeError(
                "the function of a ragged batch returns no Pausable; leave ragged out, or type e.g. jaxsphere.slope_search"
            )
        return computation.first

    def proceed(lane: tuple[Any, ...], carry: Any) -> tuple[Any, Array, Any]:
        computation = make(*lane)
        carry = computation.advance(carry)
        return carry, computation.is_done(carry), computation.result(carry)

    def of(index: Array) -> tuple[Any, ...]:
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[jnp.minimum(index, lanes - 1)], arguments)

    def body(queue: _Queue) -> _Queue:
        carry, ended, found = jax.vmap(proceed)(of(queue.index), queue.carry)
        ended = ended & (queue.index < lanes)
        row = jnp.where(ended, queue.index, lanes)
        following = queue.waiting + jnp.cumsum(ended) - 1
        index = jnp.where(ended, jnp.where(following < count, following, lanes), queue.index)
        fresh = jax.vmap(begin)(of(index))
        return _Queue(
            index=index,
            carry=jax.vmap(where)(ended, fresh, carry),
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
