"""`jaxsphere reproduce`."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import tyro

import jaxsphere as js
from experiments.cli.options import command
from experiments.cli.tune import specified
from experiments.records import Record
from jaxsphere.checks import require_choice

SPECS = Path(__file__).parent.parent / "specs"
# The paper's own figures, run when nothing is named, so that the first command of a new user ends soon.
PAPER = ("fig4", "fig5")
EXPERIMENTS = (*PAPER, "bound", "robust")


def reproduce(chosen: Any) -> None:
    """Run the named experiments, the paper's figures when none is named, or all of them for "all"."""
    names = EXPERIMENTS if chosen.experiments == ("all",) else chosen.experiments or PAPER
    for name in names:
        require_choice("experiment", name, EXPERIMENTS)
    record = Record(chosen.out)
    metrics: dict[str, Any] = {}
    for name in names:
        print(f"reproducing {name} ...", flush=True)
        study = importlib.import_module(f"experiments.studies.{name}")
        more = {"studies": robust_studies()} if name == "robust" else {}
        metrics[name] = study.reproduce(record, progress=chosen.progress, **more)
        print("\n  ".join([f"{name}:", *metrics[name].pop("summary")]))
        record.finish(metrics, robot=js.Robot(), gains=js.SlidingModeGains())
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


def robust_studies() -> dict[str, dict[str, Any]]:
    """Return the arguments of the robust studies by name, from the specs that ship."""
    return {case: specified(str(SPECS / f"robust_{case}.toml")) for case in ("known", "unknown")}


COMMANDS = {
    "reproduce": command(
        reproduce,
        specified=False,
        experiments=(tyro.conf.Positional[tuple[str, ...]], (), f"Which: {', '.join(EXPERIMENTS)} or all"),
        progress=(bool, True, "Show progress bars"),
    )
}
