"""What tuning found, as text and as a file."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from jaxsphere import SlidingModeGains, TrackingGains
from jaxsphere.files import to_plain, write_json

FORMAT = 2
_GAINS = {kind.__name__: kind for kind in (SlidingModeGains, TrackingGains)}


@dataclass(frozen=True, eq=False)
class TuningResult:
    """What tuning found.

    Attributes:
        gains: the best gains seen in any start that keeps the limits; `objective` is their value.
        initial_gains, initial_objective: where it began.
        history: "objective" and "gradient_norm", each (iterations, starts).
        status: "finished", "interrupted" (by Ctrl-C), "infeasible" (no start keeps the limits) or "zero gradient" (in every
            free gain wherever it was evaluated: nothing was tuned).
        names: the free gains.
        evaluations: rollouts with gradient.
        optimiser: its name.
        bests: best objective of every start (starts,), NaN where it never was finite.
        answers: the gains of every start there, frozen ones too, name -> (starts,).
        feasible: which of them keep the limits.
        limits: what the best gains break, as text.
    """

    gains: Any
    objective: float
    initial_gains: Any
    initial_objective: float
    history: dict[str, np.ndarray]
    status: str
    names: tuple[str, ...]
    evaluations: int
    optimiser: str
    bests: np.ndarray
    answers: dict[str, np.ndarray]
    feasible: np.ndarray
    limits: str = ""

    def near_best(self, share: float = 0.02) -> float:
        """Return the fraction of the starts whose best objective is within `share` of the best of all."""
        return float(np.mean(self.bests <= self.objective + share * abs(self.objective))) if self.bests.size else 0.0

    def report(self) -> str:
        """Return a table of the gains and the objective before and after, the starts, and the gains to copy, as text."""
        rows = [f"{'gain':<10}{'before':>12}{'after':>12}"]
        for leaf in fields(self.gains):
            before, after = (float(getattr(gains, leaf.name)) for gains in (self.initial_gains, self.gains))
            rows.append(f"{leaf.name:<10}{before:>12.4f}{after:>12.4f}{'' if leaf.name in self.names else '  frozen'}")
        rows.append(f"{'objective':<10}{self.initial_objective:>12.4f}{self.objective:>12.4f}")
        near = round(self.near_best() * self.bests.size)
        rows.append(
            f"{self.status}: {self.evaluations} rollouts with gradient, {near} of {self.bests.size} starts within 2 % of "
            "the best"
        )
        if self.status == "infeasible":
            rows.append(f"all {self.bests.size} starts ended infeasible: the best {self.limits}; type wider limits")
        if self.status == "zero gradient":
            rows.append("the objective does not change with any free gain: nothing was tuned; type a smooth one")
        copy = ", ".join(f"{leaf.name}={float(getattr(self.gains, leaf.name)):.6g}" for leaf in fields(self.gains))
        rows.append(f"jaxsphere.{type(self.gains).__name__}({copy})")
        return "\n".join(rows)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the result to a JSON file, atomically, and return its path."""
        content = {leaf.name: to_plain(getattr(self, leaf.name)) for leaf in fields(self)}
        return write_json(path, {"format": FORMAT, "gains_type": type(self.gains).__name__, **content})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> TuningResult:
        """Return a result that `save` wrote. Raises ValueError if the file is none."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            kind = _GAINS[content.pop("gains_type")]
            if content.pop("format") != FORMAT:
                raise KeyError("format")
            for name in ("gains", "initial_gains"):
                content[name] = kind(**content[name])
            history = content.pop("history")
            arrays = {name: np.array(rows, dtype=np.float64).reshape(len(rows), -1) for name, rows in history.items()}
            content |= {"names": tuple(content["names"]), "feasible": np.array(content["feasible"], dtype=bool)}
            content |= {"bests": np.array(content["bests"], dtype=np.float64)}
            content |= {"answers": {name: np.array(row, dtype=np.float64) for name, row in content["answers"].items()}}
            return cls(history=arrays, **content)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(
                f"{os.fspath(path)} is no tuning result of this version; type a file that TuningResult.save wrote"
            ) from error
