"""Memory: a stored sweep ten times as long needs no more of it, and no lane is lost."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxsphere as js
from experiments.plots.style import bars_figure
from experiments.records import Record

DT = 5e-3


def sweep_case(record: Record, lanes: int, steps: int) -> dict[str, Any]:
    """Sweep a tenth of the lanes, then all, in closed loops from random states on random slopes; print time and peak memory."""
    numbers: dict[str, Any] = {"peak_memory_before_MB": _peak_memory()}
    print(f"stored sweep of planar closed loops of {steps} steps, {len(jax.local_devices())} devices")
    for count in (max(lanes // 10, 1), lanes):
        with tempfile.TemporaryDirectory(dir=record.folder) as folder:
            numbers[f"{count} lanes"] = _measured(count, steps, Path(folder) / "store")
    title = f"Stored sweep of closed loops of {steps} steps"
    labels = [name for name in numbers if name.endswith("lanes")]
    memory = [numbers[name]["peak_memory_MB"] for name in labels]
    record.picture("bench_sweep", bars_figure(title, labels, memory, "peak memory (MB)"))
    return numbers


def _measured(lanes: int, steps: int, store: Path) -> dict[str, Any]:
    axes = [
        js.axes.latin_hypercube({"slope": (0.0, 20.0)}, lanes, unit="deg", name="slope"),
        js.axes.uniform({"initial_state.1": (-2.0, 2.0), "initial_state.2": (-0.5, 1.0)}, 1),
    ]
    base = {"robot": js.Robot(), "initial_state": np.zeros(4), "duration": steps * DT, "dt": DT}
    start = time.perf_counter()
    results = js.sweep(_end, base, axes, store=store)
    counts = results.counts()
    seconds = time.perf_counter() - start
    total = sum(counts.values())
    if total != lanes:
        raise RuntimeError(f"{lanes - total} of {lanes} lanes are lost")
    megabytes = sum(path.stat().st_size for path in store.rglob("*") if path.is_file()) / 1e6
    peak = _peak_memory()
    named = ", ".join(f"{count} {status.name.lower()}" for status, count in counts.items())
    print(
        f"  {lanes:>10} lanes  {seconds:8.1f} s  {lanes / seconds:.3g} lanes/s  store {megabytes:.0f} MB  "
        f"peak memory {peak:.0f} MB"
    )
    print(f"  {'':>10} {named}; sum {total}")
    return {
        "seconds": seconds,
        "lanes_per_second": lanes / seconds,
        "peak_memory_MB": peak,
        "store_MB": megabytes,
        "sum_of_statuses": total,
        "statuses": {status.name.lower(): count for status, count in counts.items()},
    }


def _end(**arguments: Any) -> dict[str, jax.Array]:
    trajectory = js.rest_to_rest(**arguments, save_every=None)
    assert trajectory.metrics is not None
    return {"status": trajectory.status, "final_error": trajectory.metrics.final_error}


def _peak_memory() -> float:
    """Largest resident memory of this process so far, MB; Linux counts in kB, macOS in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1e-6 if sys.platform == "darwin" else 1e-3)
