"""`jaxsphere reproduce`."""

from __future__ import annotations

from typing import Any

import jaxsphere as js
from experiments import bound, fig4, fig5, robustness
from experiments.records import Record
from jaxsphere.checks import require_choice

# The paper's own figures, run when nothing is named, so that the first command of a new user ends soon.
PAPER = ("fig4", "fig5")
EXPERIMENTS = {
    "fig4": fig4.reproduce,
    "fig5": fig5.reproduce,
    "bound": bound.reproduce,
    "robust": robustness.reproduce,
}


def reproduce(names: tuple[str, ...], out: str, progress: bool) -> None:
    """Run the named experiments, the paper's figures when none is named, or all of them for "all"."""
    names = tuple(EXPERIMENTS) if names == ("all",) else names or PAPER
    for name in names:
        require_choice("experiment", name, tuple(EXPERIMENTS))
    record = Record(out)
    metrics = {}
    for name in names:
        print(f"reproducing {name} ...", flush=True)
        metrics[name] = EXPERIMENTS[name](record, progress)
        print(_summary(name, metrics[name]))
        record.finish(metrics, robot=js.Robot(), gains=js.SlidingModeGains())
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


def _summary(name: str, metrics: dict[str, Any]) -> str:
    lines = [f"{name}:"]
    for row in metrics.pop("summary"):
        lines.append("  " + row)
    return "\n".join(lines)
