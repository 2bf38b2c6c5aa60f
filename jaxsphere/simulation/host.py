"""Argument checks before a rollout and errors after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere.checks import is_concrete, require_scalar
from jaxsphere.numerics import Real
from jaxsphere.simulation.rollout import Trajectory
from jaxsphere.status import Status


class RolloutError(RuntimeError):
    """A single rollout ended early; `trajectory` holds what it did until then."""

    def __init__(self, message: str, trajectory: Trajectory):
        super().__init__(message)
        self.trajectory = trajectory

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.trajectory)


def is_single(trajectory: Trajectory) -> bool:
    """Tell whether this is one rollout on the host, not a batch and not traced."""
    return is_concrete(trajectory.status) and jnp.ndim(trajectory.status) == 0


def raise_early_end(trajectory: Trajectory, advice: Callable[[], Mapping[Status, str]]) -> Trajectory:
    """Raise RolloutError if a single rollout on the host ended early; pass batches and traced rollouts on.

    Args:
        trajectory: the rollout.
        advice: returns what to change, for every status that is a failure of the task.
    """
    ended = Status(int(trajectory.status)) if is_single(trajectory) else Status.OK
    if ended != Status.OK and ended in (sentences := advice()):
        raise RolloutError(
            f"the rollout ended at {float(trajectory.end_time):.3f} s with status {ended.name.lower()}: {sentences[ended]}, "
            "or type throw=False to get the trajectory up to there",
            trajectory,
        )
    return trajectory


def check_time_grid(duration: float, dt: Real, save_every: int | None) -> int:
    """Return the number of steps. Raises ValueError unless duration, dt and save_every divide evenly and are positive."""
    if not is_concrete(duration):
        raise ValueError("duration is traced; type a plain number, it fixes the length of the compiled loop")
    require_scalar("duration", duration, above=0.0, unit="s")
    if not is_concrete(dt):
        raise ValueError("dt is traced; type a plain number, with duration it fixes the length of the compiled loop")
    require_scalar("dt", dt, above=0.0, unit="s")
    if float(dt) > float(duration):
        raise ValueError(f"dt = {float(dt):g} s exceeds duration = {float(duration):g} s; type a smaller dt, e.g. 1e-3")
    steps = _whole_multiple("duration", float(duration), float(dt))
    if save_every is not None and not (
        isinstance(save_every, int | np.integer) and save_every >= 1 and steps % save_every == 0
    ):
        raise ValueError(f"save_every = {save_every!r} must be None or a whole number that divides the {steps} steps")
    return steps


def check_control_period(period: Real | None, dt: Real) -> None:
    """Raise ValueError unless the sampling period (s) is None, traced or a multiple of dt."""
    if period is not None and is_concrete(period):
        require_scalar("control_period", period, above=0.0, unit="s")
        _whole_multiple("control_period", float(period), float(dt))


def _whole_multiple(name: str, value: float, dt: float) -> int:
    count = round(value / dt)
    if count < 1 or abs(count * dt - value) > 1e-6 * dt * max(count, 1):
        raise ValueError(f"{name} = {value:g} s is no whole multiple of dt = {dt:g} s; type e.g. {max(count, 1) * dt:g}")
    return count


def cast(tree: Any, dtype: Any) -> Any:
    """Return `tree` with every leaf but bools as an array of `dtype`, so that a changed number never compiles anew."""
    return jax.tree.map(lambda leaf: _as_array(leaf, dtype), tree)


def _as_array(leaf: Any, dtype: Any) -> Array | np.ndarray:
    if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_):
        return np.asarray(leaf) if is_concrete(leaf) else jnp.asarray(leaf)
    return np.asarray(leaf, dtype) if is_concrete(leaf) else jnp.asarray(leaf, dtype)
