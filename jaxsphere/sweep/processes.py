"""Several processes, started by `jax.distributed.initialize`, share the chunks. With one process these functions do nothing."""

from __future__ import annotations

import jax
import numpy as np

from jaxsphere.sweep.memory import Memory


def is_first() -> bool:
    """Tell whether this process writes what is written once."""
    return jax.process_index() == 0


def dealt(chunks: int) -> range:
    """Return the numbers of the chunks, of so many, that this process computes."""
    return range(jax.process_index(), chunks, jax.process_count())


def wait_for_all(reason: str) -> None:
    """Return when every process has come here."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(f"sweep: {reason}")


def gather(memory: Memory) -> Memory:
    """Give every process the results of all; they travel as bytes, so every bit arrives."""
    count = jax.process_count()
    if count == 1:
        return memory
    from jax.experimental import multihost_utils

    turns = -(-len(memory.chunks) // count)
    mine = np.zeros((turns, memory.chunks.size), memory.layout)
    for index, record in memory.records.items():
        for name, values in record.items():
            mine[name][index // count, : len(values)] = values
    everyone = np.asarray(multihost_utils.process_allgather(mine.view(np.uint8)))
    records = {}
    for index in range(len(memory.chunks)):
        rows = everyone[index % count, index // count].view(memory.layout)[: memory.chunks.count(index)]
        records[index] = {name: rows[name] for name in memory.layout.names or ()}
    return Memory(memory.chunks, memory.layout, memory.units, records)
