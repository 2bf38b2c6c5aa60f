"""`sweep`: a lane function is traced, compiled once for a device and run over chunks of lanes on all devices.

    lanes -> positions along the axes -> values of the leaves -> arguments -> lane function -> outputs -> store

A lane's results depend on its number alone: not on the chunk, the devices or the processes that it meets.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsphere import identity
from jaxsphere.checks import require_choice, require_count
from jaxsphere.simulation.batch import BLOCK
from jaxsphere.sweep import axes as ax
from jaxsphere.sweep import processes, schema
from jaxsphere.sweep import store as st
from jaxsphere.sweep.axes import Axis
from jaxsphere.sweep.chunks import Chunks, cut
from jaxsphere.sweep.memory import Memory, Record, Shards
from jaxsphere.sweep.program import Program, trace
from jaxsphere.sweep.refine import Boundaries, Guesses, require_refinable
from jaxsphere.sweep.results import SweepResults
from jaxsphere.units import declared_units

CHUNK = 65536  # lanes at most, unless asked for
CHUNK_BYTES = 2**26  # of arguments and results of a chunk
VECTOR = 16  # numbers at most in a register
WIDE_BLOCK = 8192  # lanes that one program computes on anything but a CPU

Progress = Callable[[int, int], None]


def sweep(
    lane: Callable[..., Any],
    base: Mapping[str, Any] | None = None,
    axes: Axis | Sequence[Axis] = (),
    *,
    outputs: Sequence[str] = (),
    refine: Boundaries | Guesses | None = None,
    dtype: Any = jnp.float64,
    chunk: int | None = None,
    store: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> SweepResults:
    """Call `lane` with every combination of the axes and return its outputs as arrays over them.

    The lanes are computed in chunks, on all devices and processes. With `jax.distributed` every process makes the same call and
    gets the same results; `store` is a folder that all share.

    Args:
        lane: any function of keyword arguments to a pytree of numbers, e.g. `rest_to_rest`. A Trajectory gives its status,
            end_time, final_state and metrics; a `Pausable`, e.g. of `slope_search`, what it finds. It is traced and must not
            raise for a lane (type throw=False).
        base: the arguments of every lane.
        axes: what varies, one axis or several (their product), see `jaxsphere.axes`.
        outputs: names of the outputs to keep beside the status; all of them by default.
        refine: for two axes, `Boundaries` computes lanes only where neighbours disagree, `Guesses` gives every lane the mean of
            its neighbours on a coarser grid; every lane alike by default.
        dtype: of the swept numbers and of the arrays in base; a lane with an argument called dtype gets it too.
        chunk: lanes computed and stored at once, at most; by default what 64 MiB hold, 65536 at most.
        store: folder for the results, for sweeps that may be killed or exceed the memory; `xarray.open_zarr(store)` reads it.
        resume: finish what is in the store, in the chunks it was begun with.
        progress: called with lanes done and lanes in all (of this process), at first and after every chunk.

    Returns:
        The results over the named axes.

    Raises:
        ValueError, TypeError: an argument is not admissible.
        SweepError: the store cannot be written; what is done is safe.
        KeyboardInterrupt: as it came, with a sentence on how to go on.
    """
    axes = ax.product(axes)
    _require_admissible(lane, base, dtype, chunk)
    axes = ax.with_units(axes, declared_units(dict(base or {})))
    lanes = ax.lane_count(axes)
    block = min(BLOCK if jax.default_backend() == "cpu" else WIDE_BLOCK, -(-lanes // VECTOR) * VECTOR)
    names = [column.leaf for axis in axes for column in axis.columns]
    names += [refine.argument] if isinstance(refine, Guesses) else []
    program = trace(lane, dict(base or {}), names, outputs, dtype, block)
    if refine is not None:
        program = _refinable(program, refine, axes)
    fill = _fill if refine is None else partial(_fill_refined, refine)
    lane_bytes = program.layout.itemsize + 8 * len(axes)
    chunks = cut(ax.shape(axes), chunk or max(block, min(CHUNK, CHUNK_BYTES // lane_bytes)))
    if store is None:
        if resume:
            raise ValueError("resume = True needs the folder of the sweep to finish; type store='...' too")
        memory = Memory(chunks, program.layout, program.units)
        fill(memory, set(), program, axes, progress, "nothing is kept; type store='...' to be able to go on next time")
        return SweepResults(axes, processes.gather(memory))
    schema.require_storable(program.layout.names or (), axes)
    shards = _open(Path(store), st.describe(_spec(program, base, axes, dtype, refine), identity.versions(), chunks), resume)
    whole, damaged = shards.check(processes.dealt(len(shards.chunks)))
    if damaged:
        listing = ", ".join(map(str, damaged))
        warnings.warn(f"damaged chunks of {str(store)!r}, computed again: {listing}", stacklevel=2)
        shards.discard(damaged)
    fill(shards, whole, program, axes, progress, st.RESUME)
    processes.wait_for_all("computed")
    return SweepResults(axes, shards, tuple(damaged))


def _spec(program: Program, base: Mapping[str, Any] | None, axes: Sequence[Axis], dtype: Any, refine: Any) -> dict[str, Any]:
    kinds = program.layout
    outputs = {
        name: {"dtype": kinds[name].base.str, "shape": list(kinds[name].shape), "unit": program.units[name]}
        for name in kinds.names or ()
    }
    said = identity.described({"base": base or {}, "axes": axes, "dtype": np.dtype(dtype).name, "outputs": outputs})
    return {"lane": program.fingerprint} | said | ({} if refine is None else {"refine": identity.described(refine)})


def _refinable(program: Program, refine: Boundaries | Guesses, axes: Sequence[Axis]) -> Program:
    """The program with what a refinement adds to its outputs."""
    require_refinable(refine, ax.shape(axes), program.layout.names or ())
    if jax.process_count() > 1:
        raise ValueError("refine works in one process; leave it out, or start one process")
    if isinstance(refine, Guesses):
        return program
    kinds = [(name, program.layout[name].base, program.layout[name].shape) for name in program.layout.names or ()]
    return program._replace(layout=np.dtype([*kinds, ("simulated", np.bool_)]), units=program.units | {"simulated": ""})


def _fill(
    shards: Shards, done: Set[int], program: Program, axes: Sequence[Axis], progress: Progress | None, advice: str
) -> None:
    """Compute this process' chunks that are not `done`; `advice` says how to go on after Ctrl-C."""
    chunks = shards.chunks
    mine = processes.dealt(len(chunks))
    total = chunks.lanes if len(mine) == len(chunks) else sum(map(chunks.count, mine))
    finished = sum(map(chunks.count, done))
    try:
        if progress:
            progress(finished, total)
        for index, record in _records(chunks, (index for index in mine if index not in done), program, axes):
            shards.write(index, record)
            finished += chunks.count(index)
            if progress:
                progress(finished, total)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted after {finished} of {total} lanes; {advice}") from None
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise st.SweepError(f"the memory does not hold chunk = {chunks.size} lanes; type a smaller chunk") from None


def _fill_refined(
    refine: Boundaries | Guesses,
    shards: Shards,
    done: Set[int],
    program: Program,
    axes: Sequence[Axis],
    progress: Progress | None,
    advice: str,
) -> None:
    """Compute the lanes that the plan asks for and write all chunks that are not `done` at the end.

    What is computed until then lies in the journal of the store. The whole grid is in memory.
    """
    chunks, layout = shards.chunks, program.layout
    if len(done) == len(chunks):
        return
    names = layout.names or ()
    found = {n: np.full((chunks.lanes, *layout[n].shape), schema.missing(layout[n].base)) for n in names}
    plan, finished, batch = refine.plan((chunks.shape[0], chunks.shape[1])), 0, 0
    try:
        rows, columns, guess = next(plan)
        while True:
            lanes = rows * chunks.shape[1] + columns
            for start in range(0, len(lanes), chunks.size):
                part = slice(start, start + chunks.size)
                record = shards.recall(batch)
                if record is None:
                    values = ax.arguments_at(axes, lanes[part])
                    values |= {} if guess is None else {refine.argument: guess[part]}  # type: ignore[union-attr]
                    record = _fetched(program.run(values), layout, len(lanes[part]))
                    shards.remember(batch, record)
                for name, one in record.items():
                    found[name][lanes[part]] = one
                finished, batch = finished + len(lanes[part]), batch + 1
                if progress:
                    progress(finished, chunks.lanes)
            rows, columns, guess = plan.send(found[refine.output][lanes])
    except StopIteration as stop:
        if stop.value is not None:
            found[refine.output][:] = stop.value.outcomes.ravel()
            found["simulated"][:] = stop.value.simulated.ravel()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted after {finished} of at most {chunks.lanes} lanes; {advice}") from None
    drawn = [column.leaf for axis in axes for column in axis.columns if ax.differs_by_lane(column)]
    for index in set(range(len(chunks))) - done:
        lanes = np.arange(*chunks.bounds(index))
        values = ax.values_at(axes, lanes)
        shards.write(index, {name: one[lanes] for name, one in found.items()} | {leaf: values[leaf] for leaf in drawn})
    shards.forget()


def _records(
    chunks: Chunks, todo: Iterable[int], program: Program, axes: Sequence[Axis]
) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Numbers of chunks with what is stored of them; the next one is being computed while one is being written."""
    drawn = [column.leaf for axis in axes for column in axis.columns if ax.differs_by_lane(column)]
    running: tuple[int, list[tuple[jax.Array, ...]], Record] | None = None
    for index in todo:
        values = ax.values_at(axes, np.arange(*chunks.bounds(index)))
        started = index, program.run(ax.in_radians(axes, values)), {leaf: values[leaf] for leaf in drawn}
        if running:
            yield running[0], {**_fetched(running[1], program.layout, chunks.count(running[0])), **running[2]}
        running = started
    if running:
        yield running[0], {**_fetched(running[1], program.layout, chunks.count(running[0])), **running[2]}


def _fetched(blocks: list[tuple[jax.Array, ...]], layout: np.dtype, count: int) -> dict[str, np.ndarray]:
    names = [name for name in layout.names or () if name != "simulated" or len(blocks[0]) == len(layout.names or ())]
    return {name: np.concatenate([block[number] for block in blocks])[:count] for number, name in enumerate(names)}


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
        if not resume or st.changed_files(shards):
            st.create(shards)
        if resume:
            shards.sweep_up()
    processes.wait_for_all("opened")
    return shards


def _require_admissible(lane: Any, base: Any, dtype: Any, chunk: Any) -> None:
    if not callable(lane):
        raise TypeError(f"lane = {lane!r} is no function; type e.g. jaxsphere.rest_to_rest")
    if base is not None and not isinstance(base, Mapping):
        raise TypeError(f"base = {base!r} is no mapping; type e.g. {{'robot': jaxsphere.Robot(), 'slope': 0.17}}")
    require_choice("dtype", getattr(dtype, "__name__", str(dtype)), ("float64", "float32"))
    if chunk is not None:
        require_count("chunk", chunk)
