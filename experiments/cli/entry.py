"""The command `jaxsphere`: every subcommand computes, prints, draws and writes metrics.json and manifest.json into --out."""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import replace
from typing import Any

import tyro

from experiments.cli.options import as_typed
from experiments.cli.spec import fill, read_toml, take_spec
from jaxsphere import RolloutError, SweepError
from jaxsphere.simulation.batch import use_all_cores

# Name -> the file of this folder whose COMMANDS has it, and what it does; a file is imported when its command runs.
COMMANDS = {
    "reproduce": (
        "reproduce",
        "Reproduce the paper's figures with the corrected equations, the climbing bound and the robust gains.",
    ),
    "simulate planar": ("simulate", "Roll the sphere from rest to rest on a slope under sliding-mode control."),
    "simulate spatial": ("simulate", "Follow a path on the slope with the spatial robot."),
    "tune planar": ("tune", "Improve the six gains of the planar controller by gradients through rollouts."),
    "tune spatial": ("tune", "Improve the gains of the tracking controller by gradients through rollouts."),
    "sweep": ("sweep", "Sweep a task over named axes, in chunks on all devices; what is done outlives a crash."),
    "map": ("map", "Map how steep the planar closed loop climbs, or how its climbs end, over two parameters."),
    "bench": ("bench", "Measure speed against peers in the same run."),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. Returns 0, or 2 after one sentence on stderr when an argument is not admissible."""
    words = sys.argv[1:] if arguments is None else arguments
    name = next((name for name in COMMANDS if words[: len(name.split())] == name.split()), None)
    if name is None:
        return _overview(words)
    try:
        _run(name, words[len(name.split()) :])
        sys.stdout.flush()
    except (ValueError, RolloutError, SweepError) as error:
        print(f"jaxsphere {name}: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of stdout, e.g. head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except KeyboardInterrupt as error:
        print(f"jaxsphere {name}: {error or 'interrupted'}", file=sys.stderr)
        return 130
    return 0


def _run(name: str, words: list[str]) -> None:
    file, summary = COMMANDS[name]
    command = importlib.import_module(f"experiments.cli.{file}").COMMANDS[name]
    content: dict[str, Any] = {}
    given: dict[str, Any] = {}
    if command.specified:
        spec, words = take_spec(words)
        given = {"default": command.options()}
        if spec is not None:
            content = read_toml(spec)
            given = {"default": replace(fill(command.options(), content, f"spec = {spec!r}"), spec=spec)}
    chosen = tyro.cli(command.options, prog=f"jaxsphere {name}", description=summary, args=words, **given)
    use_all_cores()
    try:
        command.run(chosen)
    except ValueError as error:
        raise ValueError(as_typed(str(error), command.options, words, content)) from error


def _overview(words: list[str]) -> int:
    asked = not words or words[0] in ("-h", "--help")
    stream = sys.stdout if asked else sys.stderr
    if not asked:
        print(f"jaxsphere: {' '.join(words[:2])!r} is no command; type one of these", file=stream)
    print("usage: jaxsphere COMMAND [--help] [options]\n", file=stream)
    for name, (_, summary) in COMMANDS.items():
        print(f"  {name:<18}{summary}", file=stream)
    return 0 if asked else 2
