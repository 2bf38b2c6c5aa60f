"""Controller output and status codes of a rollout."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array


class Status(IntEnum):
    """How a lane ended. Every code but OK and NOT_SETTLED ends the lane early and freezes its last finite state."""

    OK = 0
    NOT_SETTLED = 1  # ran to the end, but is not within the settling band
    WHIRLING = 2  # the pendulum went over the top
    DIVERGED = 3  # a coordinate left the range that makes sense for the task
    SINGULAR_DECOUPLING = 4  # the controller divides by zero
    SINGULAR_JOINTS = 5  # the pendulum points along the spin axis, where no gimbal angle moves it
    INFEASIBLE_LEAN = 6  # no pendulum lean balances the demand, e.g. a slope past the bound (4)
    NONFINITE = 7  # the next state is not finite


def code(status: Status) -> Array:
    """Status as the small integer that a lane carries."""
    return jnp.int32(status)


class ControllerOutput(NamedTuple):
    """Torques (N m), the rates of the law's own states, and a Status code (0 while the law is well defined)."""

    torque: tuple[Array, ...]
    memory_rate: tuple[Array, ...]
    status: Array
