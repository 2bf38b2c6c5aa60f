"""The command `jaxsphere`: options, specs and one file per command; what they run is in `studies` and `benchmarks`."""

from experiments.cli.entry import COMMANDS, main

__all__ = ["COMMANDS", "main"]
