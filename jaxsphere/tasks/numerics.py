"""Numerical settings of a simulation: static, so that another setting compiles another program."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Numerics:
    """How a task is integrated and what is kept of it."""

    dt: float = field(default=1e-3, metadata={"unit": "s", "help": "time step"})
    duration: float | None = field(default=None, metadata={"unit": "s", "help": "of the rollout; the task's own by default"})
    method: str = field(default="rk4", metadata={"help": "rk4, dopri5 or semi_implicit_euler"})
    save_every: int | None = field(default=1, metadata={"help": "keep every so many steps; None keeps the end only"})
    dtype: str = field(default="float64", metadata={"help": "float64 or float32"})
