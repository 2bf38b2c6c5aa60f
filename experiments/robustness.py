"""Gains that survive robots they have not seen: two studies, each certified on 2000 fresh robots beside Table 3."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jaxsphere as js
import tuning
from experiments import planar_tuning, report
from experiments.options.spec import load_spec
from experiments.records import Record

SPECS = Path(__file__).parent / "specs"
CASES = {
    "known": "a family of robots, the controller knows each",
    "unknown": "robots unlike the modelled one, the controller does not know",
}


def reproduce(record: Record, progress: bool = True) -> dict[str, Any]:
    """Run both studies, save a page each into `record` and return their numbers."""
    rows, metrics = [], {}
    for case, words in CASES.items():
        options = specified(case)
        options = replace(options, tuning=replace(options.tuning, progress=progress))
        found = planar_tuning.study(options)
        found.result.save(record.folder / f"robust_{case}_tuning.json")
        table = planar_tuning.certify(options, js.SlidingModeGains())
        found = found._replace(certificates={"Table 3": table, "after": found.certificates["after"]})
        record.picture(f"robust_{case}", report.planar_page(found, f"Tuning for {words}"))
        metrics[case] = planar_tuning.numbers(found)
        rows += [f"{words}:", *(f"  {name + ':':<9} {one.sentence()}" for name, one in found.certificates.items())]
        rows.append("  " + tuned_gains(found.result))
    return {"summary": rows, **metrics}


def specified(case: str) -> Any:
    """Options of one of `CASES` from its TOML spec."""
    from experiments.cli import TunePlanar

    return load_spec(TunePlanar(), str(SPECS / f"robust_{case}.toml"))


def tuned_gains(result: tuning.TuningResult) -> str:
    """The gains as they can be typed."""
    return result.report().splitlines()[-1]
