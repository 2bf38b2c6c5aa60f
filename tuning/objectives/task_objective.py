"""What objectives that hold a task share: how they are set up, and their value as a weighted sum of terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from jaxsphere.numerics import Real
from tuning.objectives.terms import Term, first_not_finite, require_terms, weighted_sum

Task = TypeVar("Task", js.PlanarTask, js.SpatialTask)

# What gains are scored with: a 1 kHz hold, and the end of the rollout only.
SCORING = {"dt": 1e-3, "control_period": 1e-3, "save_every": None}


def with_settings(task: Task, numerics: js.Numerics, settings: Mapping[str, Any]) -> tuple[Task, js.Numerics]:
    """Return a task and its numerics with named fields changed, each in whichever of the two has it.

    A change of `dt` alone keeps the number of steps between two samples of the controller.

    Raises:
        ValueError: a name is a field of neither.
    """
    numerical = {name: settings[name] for name in settings if name in js.Numerics.__dataclass_fields__}
    changes = {name: settings[name] for name in settings if name not in numerical}
    known = [leaf.name for leaf in fields(task)]
    if unknown := [name for name in changes if name not in known]:
        every = ", ".join([*known, *js.Numerics.__dataclass_fields__])
        raise ValueError(f"{unknown[0]!r} is no setting of the task or its numerics; type one of {every}")
    if "dt" in numerical and "control_period" not in changes and task.control_period is not None:
        changes["control_period"] = round(float(task.control_period) / numerics.dt) * numerical["dt"]
    return replace(task, **changes), replace(numerics, **numerical)


@dataclass(frozen=True, eq=False, init=False)
class TaskObjective:
    """Weighted sum of terms of the rollouts of a task."""

    task: Any
    numerics: js.Numerics
    weights: Any
    extra: tuple[Term, ...]

    def __init__(self, robot: js.Robot | None = None, slope: Real | None = None, **settings: Any):
        """Set the objective up.

        Args:
            robot: of the task.
            slope: of the task, rad.
            settings: any attribute of the objective, and any field of its task and its numerics.
        """
        own = {leaf.name: settings.pop(leaf.name, leaf.default) for leaf in fields(self)}
        leading = {name: value for name, value in (("robot", robot), ("slope", slope)) if value is not None}
        own["task"], own["numerics"] = with_settings(own["task"], own["numerics"], leading | settings)
        for name, value in own.items():
            object.__setattr__(self, name, value)

    def __call__(self: Any, gains: Any) -> Float[Array, ""]:
        """Return the weighted sum of the terms.

        Its forward gradient needs no memory in the horizon, but for terms of the user's own.
        """
        if self.extra:
            residuals = self.residuals(gains)
            return jnp.sum(residuals * residuals)
        self.require_sound()
        return weighted_sum(self.weights, self.streamed(gains))

    def require_sound(self) -> None:
        """Raise ValueError when there is no term."""
        require_terms(self.weights, self.extra)

    def explain(self: Any, gains: Any) -> str:
        """Return a phrase that says when and where the objective ceases to be finite."""
        return first_not_finite(self.series(gains))

    @property
    def duration(self) -> float:
        """Length of a rollout, s."""
        return self.task.default_duration() if self.numerics.duration is None else self.numerics.duration
