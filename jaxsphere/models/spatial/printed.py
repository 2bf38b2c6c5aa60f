"""The spatial model as the paper prints it, to show what fails: (20), (22), (23), A(q) of (40) and the input matrix B.

The rolling constraints are a mirror image of rolling, and B lets the drive act with +1 on spin and gimbal angle alike. Moments,
gravity, (26) and the corrected (31) stay. Nothing here is fast: M and N of (40) are differentiated from the Lagrangian (39).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.models.spatial import energy, frames
from jaxsphere.models.spatial.frames import State
from jaxsphere.numerics import Real
from jaxsphere.numerics.linear_algebra import Vector3
from jaxsphere.robot import Robot

# Rows: psi, theta, phi, beta1, beta2; columns: drive and tilt.
_INPUT = ((0.0, 0.0), (0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0))


def angular_velocity(state: State) -> Vector3:
    """Angular velocity of the shell as printed in (20): the true one turned by +90 degrees about the normal, rad/s."""
    x, y, z = frames.angular_velocity(state)
    return -y, x, z


def constraint_matrix(robot: Robot, state: State) -> Array:
    """Matrix A(q) of the constraints printed in (22) and (23), (2, 7): (x', y') stand for (-y', -x')."""
    rolling = frames.constraint_matrix(robot, state)
    return jnp.concatenate([rolling[:, :2], -rolling[::-1, 2:]], axis=1)


def null_space(robot: Robot, state: State) -> Array:
    """Matrix C(q), (7, 5), whose columns span the motions that satisfy the printed constraints."""
    free = constraint_matrix(robot, state)[:, 2:]
    return jnp.concatenate([-free, jnp.eye(5, dtype=free.dtype)])


def derivative(robot: Robot, slope: Real, state: Array, torque: Array) -> Array:
    """Time derivative (12,) of a state (12,) under drive and tilt torque (2,), with C^T (M C v' + M C' v + N) = C^T B tau."""
    place, velocity = state[:7], state[7:]
    rates = null_space(robot, state) @ velocity
    free, free_rate = jax.jvp(lambda q: null_space(robot, (*q, *velocity)), (place,), (rates,))

    def lagrangian(q: Array, rates: Array) -> Array:
        return jnp.asarray(energy.lagrangian(robot, slope, (*q, *rates[2:]), (rates[0], rates[1])))

    momentum = jax.grad(lagrangian, argnums=1)
    inertia = jax.jacfwd(momentum, argnums=1)(place, rates)
    transport = jax.jvp(lambda q: momentum(q, rates), (place,), (rates,))[1]
    bias = transport - jax.grad(lagrangian)(place, rates) + inertia @ (free_rate @ velocity)
    pushed = jnp.asarray(_INPUT, state.dtype) @ torque - free.T @ bias
    return jnp.concatenate([rates, jnp.linalg.solve(free.T @ inertia @ free, pushed)])
