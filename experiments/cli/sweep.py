"""`jaxsphere sweep`."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import tyro

import jaxsphere as js
from experiments.cli.options import command
from experiments.cli.sweep_spec import read_spec
from experiments.records import Record, progress_bar


def sweep(options: Any) -> None:
    """Sweep what the spec says into OUT/store, print and draw what came out."""
    from experiments.plots.sweep import sweep_figure

    spec = read_spec(options.spec)
    record = Record(options.out)
    store = record.folder / "store"
    with progress_bar("lane", options.progress) as report:
        results = js.sweep(
            spec.task,
            spec.base,
            spec.axes,
            outputs=spec.outputs,
            dtype=spec.base["dtype"],
            chunk=spec.chunk,
            store=store,
            resume=options.resume,
            progress=report,
        )
    counts = {status.name.lower(): count for status, count in results.counts().items()}
    numbers = {"lanes": results.lanes, "shape": results.shape, "axes": results.dimensions, "statuses": counts}
    numbers["outputs"] = summary(results)
    print(f"{results.lanes} lanes: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    print(f"  {'of the lanes that are ok':<28}{'least':>12}{'median':>12}{'largest':>12}")
    for name, row in numbers["outputs"].items():
        print(f"  {name:<28}{row['least']:>12.4g}{row['median']:>12.4g}{row['largest']:>12.4g}")
    try:
        record.picture("sweep", sweep_figure(results))
        record.finish({"sweep": numbers}, sweep=spec.base | {"axes": spec.axes})
    except OSError as error:
        raise js.SweepError(
            f"out = {options.out!r} cannot be written ({error.strerror}); the lanes are safe in {store}"
        ) from None
    print(f"sweep.png, metrics.json and manifest.json are in {record.folder}, all lanes in {store} (js.open_sweep reads them)")


def summary(results: js.SweepResults) -> dict[str, dict[str, float]]:
    """Least, median and largest value of every output that is one number, over the lanes that are ok."""
    ok = results.status == js.Status.OK
    found = {}
    for name in results.values:
        array = results.values[name]
        if name == "status" or array.shape != results.shape:
            continue
        kept = array[ok]
        rows = (np.min, np.median, np.max)
        values = [float(row(kept)) if len(kept) else math.nan for row in rows]
        found[name] = dict(zip(("least", "median", "largest"), values, strict=True))
    return found


COMMANDS = {
    "sweep": command(
        sweep,
        specified=False,
        spec=(tyro.conf.Positional[str], dataclasses.MISSING, "TOML file with the task, its settings and the axes"),
        resume=(bool, False, "Finish the sweep that OUT/store holds"),
        progress=(bool, True, "Show a progress bar"),
    )
}
