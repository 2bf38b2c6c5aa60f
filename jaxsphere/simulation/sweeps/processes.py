"""Several processes, started by `jax.distributed.initialize`: shards are dealt to them in turn; alone, all this is nothing."""

from __future__ import annotations

from collections.abc import Iterable

import jax
import numpy as np

from jaxsphere.simulation.sweeps.store import Memory, bounds, shard_count


def is_first() -> bool:
    """Tell whether this process writes what is written once."""
    return jax.process_index() == 0


def dealt(shards: Iterable[int]) -> list[int]:
    """Those shards that this process computes."""
    return [index for index in shards if index % jax.process_count() == jax.process_index()]


def wait_for_all(reason: str) -> None:
    """Return when every process has come here."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(f"sweep: {reason}")


def gather(shards: Memory, layout: np.dtype) -> Memory:
    """Give every process the records of all; they travel as bytes, so every bit arrives."""
    count = jax.process_count()
    if count == 1:
        return shards
    from jax.experimental import multihost_utils

    turns = -(-shard_count(shards) // count)
    mine = np.zeros((turns, shards.chunk), layout)
    for index, record in shards.records.items():
        mine[index // count, : len(record)] = record
    everyone = np.asarray(multihost_utils.process_allgather(mine.view(np.uint8)))
    records = {}
    for index in range(shard_count(shards)):
        first, end = bounds(shards, index)
        records[index] = everyone[index % count, index // count].view(layout)[: end - first]
    return Memory(shards.lanes, shards.chunk, records)
