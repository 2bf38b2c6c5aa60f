"""`simulate`: run a task, whichever it is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import require_choice
from jaxsphere.simulation.closed_loop import ClosedLoop, Law, Measure, Plant, State, closed_loop
from jaxsphere.simulation.host import cast, check_control_period, check_time_grid, raise_early_end
from jaxsphere.simulation.integrators import METHODS
from jaxsphere.simulation.rollout import Trajectory, rollout
from jaxsphere.status import Status
from jaxsphere.tasks.numerics import Numerics


class Task(Protocol):
    """What `simulate` needs to know of a task."""

    torque_limit: Any
    control_period: Any
    delayed: Any

    def default_gains(self) -> Any:
        """Gains where none are given."""
        ...

    def default_duration(self) -> float:
        """Length of a rollout where none is given, s."""
        ...

    def check(self, gains: Any, duration: float) -> None:
        """Raise ValueError for the first number on the host that is not admissible."""
        ...

    def start(self) -> tuple[State, State]:
        """Initial components of the plant, and of the law's memory."""
        ...

    def dynamics(self) -> Plant:
        """The plant."""
        ...

    def law(self, gains: Any) -> Law:
        """The controller, as it sees the plant."""
        ...

    def measure(self) -> Measure:
        """The metrics."""
        ...

    def conclude(self, gains: Any, trajectory: Trajectory, dt: Array, diagnostics: bool) -> Trajectory:
        """The trajectory with its final status, metrics and diagnostics."""
        ...

    def advice(self) -> dict[Status, str]:
        """What to change after a single rollout that ended with one of these statuses."""
        ...


def simulate(
    task: Any,
    gains: Any = None,
    numerics: Numerics = Numerics(),
    *,
    measure: Measure | None = None,
    diagnostics: bool = False,
    throw: bool = True,
) -> Trajectory:
    """Simulate a task under its controller.

    Batch it with `jax.vmap` or `js.batch` over any leaf of `task` and `gains`.

    Args:
        task: a `PlanarTask` or a `SpatialTask`.
        gains: of its controller; the paper's by default.
        numerics: time step, duration, integrator, what is saved and in which precision.
        measure: a running metric of your own in place of the task's; the trajectory is then returned as it ended.
        diagnostics: compute the controller's signals at the saved states.
        throw: raise when a single rollout ends early; otherwise, and always under vmap and jit, `status` tells.

    Returns:
        A Trajectory with the task's metrics.

    Raises:
        ValueError: an argument is not admissible.
        RolloutError: a single rollout ended early and `throw` is set.
    """
    numerics = checked(task, numerics)
    gains = task.default_gains() if gains is None else gains
    task.check(gains, float(numerics.duration or 0.0))
    task, gains = cast((task, gains), np.dtype(numerics.dtype))
    if measure is not None:
        return _simulate(task, gains, numerics, measure, False)
    trajectory = _compiled(task, gains, numerics, diagnostics and numerics.save_every is not None)
    return raise_early_end(trajectory, task.advice) if throw else trajectory


def closed_loop_of(task: Any, gains: Any, numerics: Numerics, measure: Measure | None = None) -> ClosedLoop:
    """Return the closed loop of a task, for runs that pause, end early or look at single steps.

    Args:
        task, gains, numerics, measure: as in `simulate`, on arrays of one dtype; no measure unless one is given.
    """
    numerics = checked(task, numerics)
    return closed_loop(task.dynamics(), task.law(gains), measure=measure, **_settings(task, numerics))


def checked(task: Any, numerics: Numerics) -> Numerics:
    """Return the numerics with the task's own duration where none is given. Raises ValueError for one that does not fit."""
    if not hasattr(task, "default_duration"):
        raise TypeError(f"task = {task!r} is no task; type jaxsphere.PlanarTask(...) or jaxsphere.SpatialTask(...)")
    if not isinstance(numerics, Numerics):
        raise TypeError(f"numerics = {numerics!r} are no Numerics; type jaxsphere.Numerics(dt=1e-3)")
    duration = task.default_duration() if numerics.duration is None else numerics.duration
    check_time_grid(duration, numerics.dt, numerics.save_every)
    check_control_period(task.control_period, numerics.dt)
    require_choice("method", numerics.method, METHODS)
    require_choice("dtype", numerics.dtype, ("float64", "float32"))
    return replace(numerics, duration=float(duration), dt=float(numerics.dt))


def _settings(task: Any, numerics: Numerics) -> dict[str, Any]:
    dt = jnp.asarray(numerics.dt, numerics.dtype)
    hold = None if task.control_period is None else jnp.round(task.control_period / dt).astype(jnp.int32)
    return {
        "dt": dt,
        "steps": check_time_grid(numerics.duration or 0.0, numerics.dt, numerics.save_every),
        "hold": hold,
        "delayed": task.delayed,
        "torque_limit": task.torque_limit,
        "method": numerics.method,
    }


def _simulate(task: Any, gains: Any, numerics: Numerics, measure: Measure | None, diagnostics: bool) -> Trajectory:
    settings = _settings(task, numerics)
    state, memory = task.start()
    own = task.measure() if measure is None else measure
    run = rollout(task.dynamics(), task.law(gains), state, memory, save_every=numerics.save_every, measure=own, **settings)
    return run if measure is not None else task.conclude(gains, run, settings["dt"], diagnostics)


@partial(jax.jit, static_argnames=("numerics", "diagnostics"))
def _compiled(task: Any, gains: Any, numerics: Numerics, diagnostics: bool) -> Trajectory:
    return _simulate(task, gains, numerics, None, diagnostics)
