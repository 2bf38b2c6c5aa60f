"""`jaxsphere bench`."""

from __future__ import annotations

from experiments import benchmark
from experiments.records import Record
from jaxsphere.checks import require_choice, require_count


def bench(case: str, lanes: int | None, steps: int, out: str) -> None:
    """Run one benchmark."""
    require_choice("case", case, tuple(benchmark.CASES))
    if lanes is not None:
        require_count("lanes", lanes)
    require_count("steps", steps)
    record = Record(out)
    run, default = benchmark.CASES[case]
    lanes = lanes or default
    record.finish({case: run(record, lanes, steps)}, settings={"case": case, "lanes": lanes, "steps": steps})
