"""Many lanes at once: batched in cache-sized blocks, spread over all local devices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import cycle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

# The working set of a planar step on one block of lanes stays within the second-level cache of a core.
BLOCK = 512

# XLA compiles for 256-bit vectors unless asked; without 512-bit registers the option has no effect.
CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


def over_lanes(function: Callable[..., Any], block: int = BLOCK) -> Callable[..., Any]:
    """Like `jax.jit(jax.vmap(function))`, but in blocks of lanes and on all local devices.

    Args:
        function: any function of one lane to a pytree of arrays. block: lanes per block on the CPU; elsewhere one block
        takes all lanes of a device.

    Returns:
        A function of the same arguments with a leading axis of lanes on every leaf.
        It raises ValueError when the leading axes differ or there are no lanes.
    """
    mesh = Mesh(np.array(jax.local_devices()), ("lane",))
    spec = PartitionSpec("lane")
    on_cpu = mesh.devices.flat[0].platform == "cpu"

    @partial(jax.jit, static_argnames="size", compiler_options=CPU_OPTIONS if on_cpu else None)
    def batched(arguments: tuple[Any, ...], size: int) -> Any:
        def shard(arguments: tuple[Any, ...]) -> Any:
            if not on_cpu:
                return jax.vmap(function)(*arguments)
            blocks = jax.tree.map(lambda leaf: leaf.reshape(-1, size, *leaf.shape[1:]), arguments)
            results = jax.lax.map(lambda block: jax.vmap(function)(*block), blocks)
            return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), results)

        return jax.shard_map(shard, mesh=mesh, in_specs=(spec,), out_specs=spec, check_vma=False)(arguments)

    def call(*arguments: Any) -> Any:
        lanes = lane_count(arguments)
        size = min(block, -(-lanes // mesh.size))
        padding = -lanes % (size * mesh.size)
        padded = jax.tree.map(lambda leaf: _repeat_last(_strong(leaf), padding), arguments)
        # Placed alike whatever made them, so that results fed back in do not compile anew.
        padded = jax.device_put(padded, NamedSharding(mesh, spec))
        return jax.tree.map(lambda leaf: leaf[:lanes], batched(padded, size))

    return call


def same_bits(function: Callable[..., Any], block: int, devices: Sequence[Any] | None = None) -> Callable[..., list[Any]]:
    """Like `jax.vmap(function)`, but no bit of a lane's result depends on how many lanes or devices there are.

    Every device runs one and the same program of `block` lanes. `over_lanes` cannot promise that: a program of several
    partitions orders its operations in another way than a program of one, and then rounds differently.

    Args:
        function: any function of one lane to a pytree of arrays. block: lanes of the program. devices: all local ones unless
        given; those that are needed are compiled for, at the same time.

    Returns:
        A function of the same arguments with a leading axis of lanes on every leaf. It returns the results block after block,
        possibly still being computed; the last block is filled by repeating the last lane. It raises ValueError when the
        leading axes differ or there are no lanes.
    """
    devices = jax.local_devices() if devices is None else devices
    options = CPU_OPTIONS if devices[0].platform == "cpu" else None
    program = jax.jit(jax.vmap(function), compiler_options=options)
    compiled: dict[Any, Any] = {}

    def call(*arguments: Any) -> list[Any]:
        lanes = lane_count(arguments)
        parts = [jax.tree.map(partial(_host_block, start, block), arguments) for start in range(0, lanes, block)]
        used = devices[: len(parts)]
        missing = [device for device in used if device not in compiled]
        if missing:
            with ThreadPoolExecutor(len(missing)) as pool:
                programs = pool.map(lambda device: program.lower(*_shapes(parts[0], device)).compile(), missing)
                compiled.update(zip(missing, programs, strict=True))
        return [compiled[device](*jax.device_put(part, device)) for part, device in zip(parts, cycle(used), strict=False)]

    return call


def _host_block(start: int, block: int, leaf: Any) -> np.ndarray:
    part = np.asarray(leaf[start : start + block])
    return part if len(part) == block else np.concatenate([part, np.repeat(part[-1:], block - len(part), axis=0)])


def _shapes(arguments: Any, device: Any) -> Any:
    sharding = jax.sharding.SingleDeviceSharding(device)
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), arguments)


def lane_count(arguments: tuple[Any, ...]) -> int:
    """Return the common leading axis of batched arguments. Raises ValueError when there is none, or none in it."""
    counts = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(arguments)}
    if len(counts) != 1 or counts in ({()}, {(0,)}):
        raise ValueError(
            f"the leading axes of the batched arguments are {sorted(counts)}; type one positive number of lanes for all"
        )
    return counts.pop()[0]


def _strong(leaf: Any) -> jax.Array:
    return jnp.asarray(leaf, jnp.result_type(leaf))


def _repeat_last(leaf: jax.Array, count: int) -> jax.Array:
    return leaf if count == 0 else jnp.concatenate([leaf, jnp.repeat(leaf[-1:], count, axis=0)])


def use_all_cores() -> int:
    """Make every CPU core a device of its own and return their number; call it before JAX computes anything."""
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    try:
        jax.config.update("jax_num_cpu_devices", cores)
    except RuntimeError:  # JAX has started already
        return len(jax.local_devices())
    return cores
