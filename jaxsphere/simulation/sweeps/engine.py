"""The sweep itself: a lane function is traced once, compiled once for a device and run over chunks of lanes on all of them.

    lanes -> positions along the axes -> values of the leaves -> arguments -> lane function -> record -> shard

A lane's results depend on its number alone: not on the chunk, the devices or the processes that it meets.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun

from jaxsphere.checks import require_choice, require_count
from jaxsphere.simulation.lanes import BLOCK, same_bits
from jaxsphere.simulation.sweeps import axes as ax
from jaxsphere.simulation.sweeps import identity, leaves, processes
from jaxsphere.simulation.sweeps import store as st
from jaxsphere.simulation.sweeps.axes import Axis
from jaxsphere.simulation.sweeps.results import SweepResults
from jaxsphere.simulation.sweeps.store import Shards

CHUNK = 65536  # lanes at most, unless asked for
CHUNK_BYTES = 2**26  # of arguments and results of a chunk
VECTOR = 16  # numbers at most in a register
WIDE_BLOCK = 8192  # lanes that one program computes on anything but a CPU

Progress = Callable[[int, int], None]


class _Program(NamedTuple):
    run: Callable[[dict[str, np.ndarray]], list[tuple[jax.Array, ...]]]  # leaf -> (n,) to outputs, block after block
    layout: np.dtype  # of one lane's record


def sweep(
    lane: Callable[..., Any],
    base: Mapping[str, Any] | None = None,
    axes: Axis | Sequence[Axis] = (),
    *,
    dtype: Any = jnp.float64,
    chunk: int | None = None,
    store: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> SweepResults:
    """Call `lane` with every combination of the axes, in chunks of lanes on all devices and processes.

    Args:
        lane: any function of keyword arguments to a pytree of numbers, e.g. `rest_to_rest`. A Trajectory gives its status,
        end_time, final_state and metrics. It is traced once and must not raise for a lane (type throw=False).
        base: the arguments of every lane. axes: what varies, one axis or several (their product), see `jaxsphere.axes`.
        dtype: of the swept numbers and of the arrays in base; a lane with an argument called dtype gets it too.
        chunk: lanes computed and stored at once, rounded up to whole blocks; by default what 64 MiB hold, 65536 at most.
        store: folder for the results, for sweeps that may be killed or exceed the memory. resume: finish what is there, in
        the chunks it was begun with. progress: called with lanes done and lanes in all (of this process), at first and
        after every chunk.

    With `jax.distributed` every process makes the same call and gets the same results; `store` is a folder that all share.

    Raises:
        ValueError, TypeError: an argument is not admissible. SweepError: the store cannot be written; what is done is safe.
        KeyboardInterrupt: as it came, with a sentence on how to go on.
    """
    axes = ax.product(axes)
    _require_admissible(lane, base, dtype, chunk)
    lanes = ax.lane_count(axes)
    block = min(BLOCK if jax.default_backend() == "cpu" else WIDE_BLOCK, -(-lanes // VECTOR) * VECTOR)
    program = _trace(lane, dict(base or {}), [column.leaf for axis in axes for column in axis.columns], dtype, block)
    chunk = _whole_blocks(chunk, lanes, block, program.layout.itemsize + 8 * len(axes))
    if store is None:
        if resume:
            raise ValueError("resume = True needs the folder of the sweep to finish; type store='...' too")
        memory = st.Memory(lanes, chunk)
        _fill(memory, set(), program, axes, progress, "nothing is kept; type store='...' to be able to go on next time")
        return SweepResults(axes, processes.gather(memory, program.layout))
    spec = identity.described({"lane": lane, "base": base or {}, "axes": axes, "dtype": np.dtype(dtype).name})
    manifest = st.describe(spec, identity.versions(), lanes, chunk, program.layout)
    shards = _open(Path(store), manifest, resume)
    damaged = shards.check(processes.dealt(range(st.shard_count(shards))))
    if damaged:
        listing = ", ".join(map(str, damaged))
        warnings.warn(f"damaged shards of {str(store)!r}, computed again: {listing}", stacklevel=2)
        shards.discard(damaged)
    _fill(shards, set(shards.verified), program, axes, progress, st.RESUME)
    processes.wait_for_all("computed")
    if processes.is_first():
        shards.seal()
    processes.wait_for_all("sealed")
    return SweepResults(axes, shards, tuple(damaged))


def _trace(lane: Callable[..., Any], base: dict[str, Any], names: list[str], dtype: Any, block: int) -> _Program:
    base = leaves.with_dtype(base, dtype)
    if leaves.takes_dtype(lane):
        base = {"dtype": dtype} | base
    leaves.require_arguments(lane, base | dict.fromkeys(name.split(".")[0] for name in names))

    def one(*numbers: jax.Array) -> dict[str, jax.Array]:
        result = lane(**leaves.replaced(base, dict(zip(names, numbers, strict=True))))
        return {name: jnp.asarray(leaf) for name, leaf in leaves.named_outputs(result).items()}

    jaxpr, outputs = jax.make_jaxpr(one, return_shape=True)(*[jax.ShapeDtypeStruct((), dtype)] * len(names))
    if "status" in outputs and not (outputs["status"].shape == () and jnp.issubdtype(outputs["status"].dtype, jnp.integer)):
        raise ValueError(f"the lane function returns status = {outputs['status']}; let it return one js.Status, or rename it")
    traced = jaxpr_as_fun(jaxpr)
    batch = same_bits(lambda *numbers: tuple(traced(*numbers)), block)
    layout = np.dtype([(name, outputs[name].dtype, outputs[name].shape) for name in sorted(outputs)])
    return _Program(lambda values: batch(*(np.asarray(values[name], dtype) for name in names)), layout)


def _fill(
    shards: Shards, done: Set[int], program: _Program, axes: Sequence[Axis], progress: Progress | None, advice: str
) -> None:
    """Compute this process' shards that are not `done`; `advice` says how to go on after Ctrl-C."""
    mine = processes.dealt(range(st.shard_count(shards)))
    sizes = {index: st.bounds(shards, index)[1] - st.bounds(shards, index)[0] for index in mine}
    finished, total = sum(sizes[index] for index in mine if index in done), sum(sizes.values())
    try:
        if progress:
            progress(finished, total)
        for index, record in _records(shards, [index for index in mine if index not in done], program, axes):
            shards.write(index, record)
            finished += sizes[index]
            if progress:
                progress(finished, total)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted after {finished} of {total} lanes; {advice}") from None
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise st.SweepError(f"the memory does not hold chunk = {shards.chunk} lanes; type a smaller chunk") from None


def _records(shards: Shards, todo: Sequence[int], program: _Program, axes: Sequence[Axis]) -> Iterator[tuple[int, np.ndarray]]:
    """Shard numbers with their records; the next one is being computed while one is being written."""
    running: tuple[int, list[tuple[jax.Array, ...]]] | None = None
    for index in todo:
        started = index, program.run(ax.arguments_at(axes, np.arange(*st.bounds(shards, index))))
        if running:
            yield running[0], _fetched(running[1], program.layout, shards, running[0])
        running = started
    if running:
        yield running[0], _fetched(running[1], program.layout, shards, running[0])


def _fetched(blocks: list[tuple[jax.Array, ...]], layout: np.dtype, shards: Shards, index: int) -> np.ndarray:
    first, end = st.bounds(shards, index)
    record = np.empty(end - first, layout)
    for number, name in enumerate(layout.names or ()):
        record[name] = np.concatenate([block[number] for block in blocks])[: end - first]
    return record


def _open(folder: Path, manifest: dict[str, Any], resume: bool) -> st.Store:
    """Start or reopen the store; every process refuses before the first one writes."""
    if resume:
        shards = st.load(folder)
        st.require_same(shards.manifest, manifest, folder)
    else:
        st.require_empty(folder)
        shards = st.Store(folder, manifest)
    processes.wait_for_all("checked")
    if processes.is_first():
        if resume:
            st.sweep_up(folder)
        else:
            st.create(shards)
    processes.wait_for_all("opened")
    return shards


def _whole_blocks(asked: int | None, lanes: int, block: int, lane_bytes: int) -> int:
    """Lanes in a chunk: as asked, or as many as CHUNK_BYTES hold, and no more than there are; in whole blocks."""
    size = min(asked or max(1, min(CHUNK, CHUNK_BYTES // lane_bytes)), lanes)
    return -(-size // block) * block


def _require_admissible(lane: Any, base: Any, dtype: Any, chunk: Any) -> None:
    if not callable(lane):
        raise TypeError(f"lane = {lane!r} is no function; type e.g. jaxsphere.rest_to_rest")
    if base is not None and not isinstance(base, Mapping):
        raise TypeError(f"base = {base!r} is no mapping; type e.g. {{'robot': jaxsphere.Robot(), 'slope': 0.17}}")
    require_choice("dtype", getattr(dtype, "__name__", str(dtype)), ("float64", "float32"))
    if chunk is not None:
        require_count("chunk", chunk)
