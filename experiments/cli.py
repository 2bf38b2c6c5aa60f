"""The command `jaxsphere`: every subcommand computes, prints, draws and writes metrics.json and manifest.json into --out."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import tyro

from experiments.options.climbing import MapOptions
from experiments.options.planar import MotionOptions, SlidingModeOptions, TuningOptions, UncertaintyOptions
from experiments.options.robot import RobotOptions
from experiments.options.spatial import TrackingGainOptions, TrackOptions, TrackTuningOptions
from experiments.options.spec import load_spec, take_spec
from jaxsphere import RolloutError, SweepError
from jaxsphere.simulation.lanes import use_all_cores


@dataclass
class Specified:
    """What every command has that a TOML file can describe."""

    out: str = "out"
    """Folder for pictures, numbers (metrics.json) and manifest.json."""
    spec: str | None = None
    """TOML file with any of these options, e.g. a table [robot]; the command line overrides it."""


@dataclass
class Reproduce:
    """Reproduce the paper's figures with the corrected equations, the climbing bound and the robust gains."""

    experiments: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which: fig4, fig5, bound."""
    out: str = "out"
    """Folder for pictures, metrics.json and manifest.json."""
    progress: bool = True
    """Show progress bars."""

    def run(self) -> None:
        from experiments.commands import reproduce

        reproduce.reproduce(self.experiments, self.out, self.progress)


@dataclass
class SimulatePlanar(Specified):
    """Roll the sphere from rest to rest on a slope under sliding-mode control."""

    robot: RobotOptions = field(default_factory=RobotOptions)
    plant: RobotOptions = field(default_factory=RobotOptions)
    """The true robot, where it differs from the one that the controller believes in."""
    gains: Annotated[SlidingModeOptions, tyro.conf.arg(name="")] = field(default_factory=SlidingModeOptions)
    motion: Annotated[MotionOptions, tyro.conf.arg(name="")] = field(default_factory=MotionOptions)

    def run(self) -> None:
        from experiments.commands import planar

        planar.simulate(self)


@dataclass
class TunePlanar(Specified):
    """Improve the six gains of the planar controller by gradients through rollouts."""

    robot: RobotOptions = field(default_factory=RobotOptions)
    gains: Annotated[SlidingModeOptions, tyro.conf.arg(name="")] = field(default_factory=SlidingModeOptions)
    """Where to start."""
    tuning: Annotated[TuningOptions, tyro.conf.arg(name="")] = field(default_factory=TuningOptions)
    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions)
    """Tune for a batch of drawn robots instead of one, and certify the gains on fresh ones."""
    checkpoint: str | None = None
    """File, written between chunks of iterations; checkpoint.npz in the folder by default."""

    def run(self) -> None:
        from experiments.commands import planar

        planar.tune(self)


@dataclass
class SimulateSpatial(Specified):
    """Follow a path on the slope with the spatial robot."""

    robot: RobotOptions = field(default_factory=RobotOptions)
    plant: RobotOptions = field(default_factory=RobotOptions)
    """The true robot, where it differs from the one that the controller believes in."""
    gains: Annotated[TrackingGainOptions, tyro.conf.arg(name="")] = field(default_factory=TrackingGainOptions)
    motion: Annotated[TrackOptions, tyro.conf.arg(name="")] = field(default_factory=TrackOptions)

    def run(self) -> None:
        from experiments.commands import spatial

        spatial.simulate(self)


@dataclass
class TuneSpatial(Specified):
    """Improve the gains of the tracking controller by gradients through rollouts."""

    robot: RobotOptions = field(default_factory=RobotOptions)
    gains: Annotated[TrackingGainOptions, tyro.conf.arg(name="")] = field(default_factory=TrackingGainOptions)
    """Where to start."""
    tuning: Annotated[TrackTuningOptions, tyro.conf.arg(name="")] = field(default_factory=TrackTuningOptions)

    def run(self) -> None:
        from experiments.commands import spatial

        spatial.tune(self)


@dataclass
class Sweep:
    """Sweep a task over named axes, in chunks on all devices; what is done outlives a crash."""

    spec: tyro.conf.Positional[str]
    """TOML file with the task, its settings and the axes, e.g. experiments/specs/sweep.toml."""
    out: str = "out"
    """Folder for the picture, metrics.json, manifest.json and the lanes in store/."""
    resume: bool = False
    """Finish the sweep that OUT/store holds."""
    progress: bool = True
    """Show a progress bar."""

    def run(self) -> None:
        from experiments.commands import sweep

        sweep.sweep(self)


@dataclass
class Map(Specified):
    """Map how steep the planar closed loop climbs, or how its climbs end, over two parameters."""

    robot: RobotOptions = field(default_factory=RobotOptions)
    gains: Annotated[SlidingModeOptions, tyro.conf.arg(name="")] = field(default_factory=SlidingModeOptions)
    map: Annotated[MapOptions, tyro.conf.arg(name="")] = field(default_factory=MapOptions)
    progress: bool = True
    """Show a progress bar."""

    def run(self) -> None:
        from experiments.commands import map as commands

        commands.draw(self)


@dataclass
class Bench:
    """Measure speed against peers in the same run."""

    case: str = "planar"
    """What to measure: planar, spatial, tuning, pareto or sweep."""
    lanes: int | None = None
    """Rollouts in the batch, by default 8192 planar, 1024 spatial or 65536 swept ones; for tuning, of each of scipy's
    optimisers, 1200; for pareto, weightings tuned at once, 96."""
    steps: int = 1000
    """Steps of each rollout."""
    out: str = "out"
    """Folder for the picture, metrics.json and manifest.json."""

    def run(self) -> None:
        from experiments.commands import bench

        bench.bench(self.case, self.lanes, self.steps, self.out)


COMMANDS: dict[str, Any] = {
    "reproduce": Reproduce,
    "simulate planar": SimulatePlanar,
    "simulate spatial": SimulateSpatial,
    "tune planar": TunePlanar,
    "tune spatial": TuneSpatial,
    "sweep": Sweep,
    "map": Map,
    "bench": Bench,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. Returns 0, or 2 after one sentence on stderr when an argument is not admissible."""
    words = sys.argv[1:] if arguments is None else arguments
    name = next((name for name in COMMANDS if words[: len(name.split())] == name.split()), None)
    if name is None:
        return _overview(words)
    try:
        kind, rest = COMMANDS[name], words[len(name.split()) :]
        given: dict[str, Any] = {}
        if issubclass(kind, Specified):
            spec, rest = take_spec(rest)
            given = {"default": kind() if spec is None else replace(load_spec(kind(), spec), spec=spec)}
        command = tyro.cli(kind, prog=f"jaxsphere {name}", args=rest, **given)
        use_all_cores()
        command.run()
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


def _overview(words: list[str]) -> int:
    asked = not words or words[0] in ("-h", "--help")
    stream = sys.stdout if asked else sys.stderr
    if not asked:
        print(f"jaxsphere: {' '.join(words[:2])!r} is no command; type one of these", file=stream)
    print("usage: jaxsphere COMMAND [--help] [options]\n", file=stream)
    for name, command in COMMANDS.items():
        print(f"  {name:<18}{(command.__doc__ or '').strip()}", file=stream)
    return 0 if asked else 2


if __name__ == "__main__":
    sys.exit(main())
