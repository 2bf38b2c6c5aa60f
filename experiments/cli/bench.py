"""`jaxsphere bench`."""

from __future__ import annotations

import importlib
from typing import Any

from experiments.cli.options import command
from experiments.records import Record
from jaxsphere.checks import require_choice, require_count

# The file of `benchmarks` that has each case, and its lanes if none are given.
CASES = {"planar": ("loops", 8192), "spatial": ("loops", 1024), "tuning": ("tuning", 1200), "pareto": ("pareto", 96)}
CASES["sweep"] = ("sweep", 65536)
LANES = """Rollouts in the batch, by default 8192 planar, 1024 spatial or 65536 swept ones; for tuning, of each of scipy's
optimisers, 1200; for pareto, weightings tuned at once, 96."""


def bench(chosen: Any) -> None:
    """Run one benchmark."""
    require_choice("case", chosen.case, tuple(CASES))
    if chosen.lanes is not None:
        require_count("lanes", chosen.lanes)
    require_count("steps", chosen.steps)
    file, default = CASES[chosen.case]
    run = getattr(importlib.import_module(f"experiments.benchmarks.{file}"), f"{chosen.case}_case")
    record, lanes = Record(chosen.out), chosen.lanes or default
    settings = {"case": chosen.case, "lanes": lanes, "steps": chosen.steps}
    record.finish({chosen.case: run(record, lanes, chosen.steps)}, settings=settings)


COMMANDS = {
    "bench": command(
        bench,
        specified=False,
        case=(str, "planar", f"What to measure: {', '.join(CASES)}"),
        lanes=(int | None, None, LANES),
        steps=(int, 1000, "Steps of each rollout"),
    )
}
