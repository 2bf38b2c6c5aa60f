"""`jaxsphere tune planar` and `jaxsphere tune spatial`."""

from __future__ import annotations

from typing import Any

import jaxsphere as js
from experiments.cli.options import RobotOptions, arguments, command, options, robot
from experiments.cli.printing import print_numbers
from experiments.cli.simulate import PlanarGains, SpatialGains
from experiments.cli.spec import load_spec
from experiments.records import Record
from experiments.studies.settings import LineTuning, PlanarTuning, Unlike

PlanarTuningOptions = options("PlanarTuningOptions", PlanarTuning)
LineTuningOptions = options("LineTuningOptions", LineTuning)
UncertaintyOptions = options("UncertaintyOptions", Unlike)


def planar_study(chosen: Any) -> dict[str, Any]:
    """Return the options of `tune planar` as arguments of `studies.planar_tuning.study`. Raises ValueError as it does."""
    return {
        "settings": PlanarTuning(**arguments(chosen.tuning)),
        "unlike": Unlike(**arguments(chosen.uncertainty)),
        "robot": robot(chosen.robot),
        "initial": js.sliding_mode.check_gains(js.SlidingModeGains(**arguments(chosen.gains))),
    }


def specified(path: str) -> dict[str, Any]:
    """Return what a TOML file of `tune planar` asks for, as arguments of `studies.planar_tuning.study`."""
    return planar_study(load_spec(COMMANDS["tune planar"].options(), path))


def tune_planar(chosen: Any) -> None:
    """Tune the gains, score them with the hard sign and a 1 kHz hold, and draw one page."""
    from experiments.plots import report
    from experiments.studies import fig4, planar_tuning

    asked = planar_study(chosen)
    planar_tuning.check(**asked)
    record = Record(chosen.out)
    found = planar_tuning.study(**asked, checkpoint=chosen.checkpoint or str(record.folder / "checkpoint.npz"))
    found.result.save(record.folder / "tuning.json")
    many = f", {chosen.uncertainty.scenarios} drawn robots" if chosen.uncertainty.scenarios else ""
    title = f"Tuning of the planar controller on a {chosen.tuning.slope_deg:g}° slope{many}"
    subject = {"robot": found.robot, "gains": found.result.initial_gains, "settings": chosen.tuning}
    record.finish({"tuning": planar_tuning.numbers(found)}, **subject, uncertainty=chosen.uncertainty)
    record.picture("tuning", report.planar_page(found, title))
    print(found.result.report())
    for name, trajectory in found.scored.items():
        print(f"\n{name}, scored with the hard sign and a 1 kHz hold:")
        print_numbers(fig4.figures(trajectory))
    print()
    for sentence in planar_tuning.sentences(found):
        print(sentence)
    print(f"\ntuning.png, tuning.json, metrics.json and manifest.json are in {record.folder}")


def tune_spatial(chosen: Any) -> None:
    """Tune the tracking gains on lines, score them at these and at held-out speeds, and draw before and after."""
    from experiments.studies import line_tuning, lines

    settings = LineTuning(**arguments(chosen.tuning))
    believed = js.spatial.check_spatial_robot(robot(chosen.robot))
    initial = js.tracking.check_gains(js.TrackingGains(**arguments(chosen.gains)))
    line_tuning.objective(settings, believed)
    record = Record(chosen.out)
    found, scored, numbers = line_tuning.study(settings, believed, initial, record)
    found.save(record.folder / "tuning.json")
    record.finish({"tuning": numbers}, robot=believed, gains=initial, settings=chosen.tuning)
    print(found.report())
    print(f"chosen among the starts' answers at {', '.join(f'{v:g}' for v in settings.validation_speeds)} m/s")
    print("\nscored over 20 s with a 1 kHz hold from 2 starts (tuned on) or 3 (held out); means over the lanes that end early")
    print("with neither gains:")
    for name, (speeds, scores) in scored.items():
        print("\n".join(["", *lines.table(name, speeds, scores)]))
    print(f"\npictures, tuning.json, metrics.json and manifest.json are in {record.folder}")


COMMANDS = {
    "tune planar": command(
        tune_planar,
        robot=RobotOptions,
        gains=PlanarGains,
        tuning=PlanarTuningOptions,
        uncertainty=UncertaintyOptions,
        checkpoint=(str | None, None, "File, written between chunks of iterations; checkpoint.npz in the folder if not given"),
    ),
    "tune spatial": command(tune_spatial, robot=RobotOptions, gains=SpatialGains, tuning=LineTuningOptions),
}
