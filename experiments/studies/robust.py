"""Gains that survive robots they have not seen: two studies, each certified on 2000 fresh robots beside Table 3."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jaxsphere as js
from experiments.plots import report
from experiments.records import Record
from experiments.studies import planar_tuning

CASES = {
    "known": "a family of robots, the controller knows each",
    "unknown": "robots unlike the modelled one, the controller does not know",
}


def reproduce(record: Record, studies: dict[str, dict[str, Any]], progress: bool = True) -> dict[str, Any]:
    """Run both studies, save a page each into `record` and return their numbers.

    Args:
        record: where pictures and results go.
        studies: arguments of `planar_tuning.study` by the names of `CASES`.
        progress: show progress bars.
    """
    rows, metrics = [], {}
    for case, words in CASES.items():
        asked = studies[case] | {"settings": replace(studies[case]["settings"], progress=progress)}
        found = planar_tuning.study(**asked)
        found.result.save(record.folder / f"robust_{case}_tuning.json")
        table = planar_tuning.certify(asked["settings"], asked["unlike"], asked["robot"], js.SlidingModeGains())
        found = found._replace(certificates={"Table 3": table, "after": found.certificates["after"]})
        record.picture(f"robust_{case}", report.planar_page(found, f"Tuning for {words}"))
        metrics[case] = planar_tuning.numbers(found)
        rows += [f"{words}:", *(f"  {name + ':':<9} {one.sentence()}" for name, one in found.certificates.items())]
        rows.append("  " + found.result.report().splitlines()[-1])
    return {"summary": rows, **metrics}
