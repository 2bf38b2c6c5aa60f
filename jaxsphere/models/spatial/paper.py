"""The dynamics of `dynamics` in the 12 coordinates of the paper, with the lean away from 0 and pi."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_choice
from jaxsphere.models.spatial import attitude, printed
from jaxsphere.models.spatial.attitude import GimbalState
from jaxsphere.models.spatial.dynamics import Affine, derivative_components, reduced
from jaxsphere.models.spatial.frames import SpatialState, State
from jaxsphere.models.spatial.lumped import lump
from jaxsphere.numerics import Real, sincos
from jaxsphere.robot import Robot

CONVENTIONS = ("corrected", "printed")


def derivative(robot: Robot, slope: Real, state: State, torque: Real, convention: str = "corrected") -> Array:
    """Time derivative of one state in paper coordinates.

    Args:
        robot: the robot.
        slope: rad.
        state: (12,) = q, v in m, rad, m/s and rad/s.
        torque: (2,) drive and tilt, N m.
        convention: "corrected" or "printed".

    Returns:
        (12,).

    Raises:
        ValueError: a shape or the convention is not admissible.
    """
    state, torque = jnp.asarray(state), jnp.asarray(torque)
    if state.shape != (12,):
        raise ValueError(f"state has shape {state.shape}; type 12 numbers: {', '.join(SpatialState._fields)} (or use jax.vmap)")
    if torque.shape != (2,):
        raise ValueError(f"torque has shape {torque.shape}; type 2 numbers in N m: drive and tilt (or use jax.vmap)")
    require_choice("convention", convention, CONVENTIONS)
    if convention == "printed":
        return printed.derivative(robot, slope, state, torque)
    now = attitude.of_state(state)
    rates = derivative_components(lump(robot, slope), now, (torque[0], torque[1]))
    return jnp.stack(paper_rates(state, now, rates))


def paper_rates(state: State, now: GimbalState, rates: GimbalState) -> SpatialState:
    """Rates of the 12 paper coordinates `state` that go with rates of the same state `now` in the gimbal's frame."""
    side = jnp.where(sincos(SpatialState(*state).lean)[0] < 0.0, -1.0, 1.0)
    return jax.jvp(lambda *parts: attitude.paper_state(parts, side=side), tuple(now), tuple(rates))[1]


def paper_affine(state: State, now: GimbalState, terms: Affine) -> Affine:
    """Turn u' = drift + drive tau1 + tilt tau2 into v' of the 12 paper coordinates `state` of the same state `now`."""
    zero = jnp.zeros_like(now.x)
    still = GimbalState(*(zero,) * len(now))
    drift = attitude.rates_of(now, (zero, zero), terms.drift)
    moving = (drift, *(GimbalState(*still[:8], *one) for one in terms[1:]))
    return Affine(*(paper_rates(state, now, rates)[7:] for rates in moving))


def mass_matrix(robot: Robot, state: State) -> Array:
    """Inertia matrix C^T M C of the reduced dynamics for v of the 12 paper coordinates `state`, (5, 5), kg m2."""
    state = jnp.asarray(state)
    now = attitude.of_state(state)
    lower = reduced(lump(robot, 0.0), now, attitude.axes_of(now)).inertia
    full = jnp.array([[lower[max(i, j)][min(i, j)] for j in range(5)] for i in range(5)])
    turn = jax.jacfwd(lambda v: jnp.stack(attitude.of_state((*state[:7], *v))[8:]))(state[7:])
    mass = turn.T @ full @ turn
    return 0.5 * (mass + mass.T)
