"""A closed loop about the steady motion of its task, and what its matrices tell.

    x   state of the plant less that of the steady motion, then the law's memory     x' = A x + B u     u = -K x

The steady motion is rest at the target (`PlanarTask`) or straight rolling along the reference (`SpatialTask`), in the
coordinates of trajectories. Torque limits and sampling are left out, and so are coordinates that neither plant nor law depends
on: the spin of the spatial robot.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float

from jaxsphere.simulation.closed_loop import State, shown_rates


class Linearisation(NamedTuple):
    """Matrices of the plant and of the closed loop; every entry may be batched by `jax.vmap`."""

    point: Float[Array, " s"]  # state of the plant in the steady motion, all of it
    plant: Float[Array, "n n"]  # A; the law's memory stands still without the law
    inputs: Float[Array, "n m"]  # B
    feedback: Float[Array, "m n"]  # K
    closed_loop: Float[Array, "n n"]  # A - B K, with the law's memory at work


def linearise(task: Any, gains: Any = None) -> Linearisation:
    """Return the closed loop of a task, linearised about its steady motion.

    Args:
        task: a `SpatialTask` that follows a straight line at constant speed, or a `PlanarTask` with smoothing above 0.
        gains: of its controller; the task's default ones if not given.

    Returns:
        A Linearisation.

    Raises:
        ValueError: an argument is not admissible, the reference is not a straight line at constant speed, or a planar robot
            cannot hold its slope.
    """
    gains = task.default_gains() if gains is None else gains
    task.check(gains)
    state, memory = task.steady_motion()
    return _matrices(task, gains, tuple(state), tuple(memory))


@jax.jit
def _matrices(task: Any, gains: Any, state: State, memory: State) -> Linearisation:
    point = jnp.stack([jnp.asarray(x, float) for x in (*state, *memory)])
    kept = np.array([i for i in range(len(point)) if i not in task.CYCLIC])
    plant, law, size = task.dynamics(), task.law(gains), len(state)

    def output(x: Array) -> Array:
        now = law(jnp.zeros_like(x[0]), tuple(x[:size]), tuple(x[size:]))
        return jnp.stack([*now.torque, *now.memory_rate])

    def rates(motion: Array) -> Array:
        return jnp.stack(shown_rates(plant, tuple(motion[:size]), tuple(motion[size:])))

    count = output(point).shape[0] - len(memory)
    driven = _jacobian(rates, jnp.concatenate([point[:size], output(point)[:count]]))
    of_law = _jacobian(output, point)
    inert = jnp.zeros((len(memory), len(point)))
    matrix = jnp.concatenate([jnp.pad(driven[:, :size], ((0, 0), (0, len(memory)))), inert])
    inputs = jnp.pad(driven[:, size:], ((0, len(memory)), (0, 0)))
    closed = (matrix + inputs @ of_law[:count]).at[size:].add(of_law[count:])
    square = np.ix_(kept, kept)
    return Linearisation(point[:size], matrix[square], inputs[kept], -of_law[:count, kept], closed[square])


def _jacobian(function: Callable[[Array], Array], point: Array) -> Array:
    """Jacobian column by column: compiles in a fraction of the time of `jax.jacfwd`."""
    return jax.lax.map(lambda along: jax.jvp(function, (point,), (along,))[1], jnp.eye(len(point))).T


def poles(linear: Linearisation) -> Complex[Array, " n"]:
    """Poles of the closed loop, 1/s; straight rolling keeps one pole at 0, its vertical spin, which no torque reaches."""
    return jnp.linalg.eigvals(linear.closed_loop)


def unreachable_poles(linear: Linearisation, tolerance: float = 1e-8) -> np.ndarray:
    """Poles of the plant (1/s, complex) that no torque moves; on the host, of one linearisation.

    Args:
        linear: not batched.
        tolerance: a direction counts as reached if it is longer than this after one more step, relative to the matrix.
    """
    matrix, reached = np.asarray(linear.plant), np.zeros((len(linear.plant), 0))
    fresh = np.asarray(linear.inputs) / np.linalg.norm(linear.inputs)
    while fresh.shape[1] > 0:
        fresh = fresh - reached @ (reached.T @ fresh)
        basis, sizes, _ = np.linalg.svd(fresh, full_matrices=False)
        basis = basis[:, sizes > tolerance]
        reached = np.concatenate([reached, basis], axis=1)
        fresh = matrix @ basis / np.linalg.norm(matrix)
    rest = np.linalg.svd(reached)[0][:, reached.shape[1] :]
    return np.linalg.eigvals(rest.T @ matrix @ rest)


def return_difference(linear: Linearisation, frequencies: Any = None) -> Float[Array, ""]:
    """Least singular value of I + K (jw - A)^-1 B over the frequencies: 1 is ideal, 0 is the edge of instability.

    With m the value, every torque may be scaled by 1/(1 + m) ... 1/(1 - m), or delayed by a phase of 2 asin(m / 2).

    Args:
        linear: of a law without memory.
        frequencies: rad/s; 400 from 0.1 to 1000 by default.
    """
    frequencies = np.geomspace(0.1, 1e3, 400) if frequencies is None else frequencies
    size, count = linear.inputs.shape

    def least(frequency: Array) -> Array:
        response = jnp.linalg.solve(1j * frequency * jnp.eye(size) - linear.plant, linear.inputs.astype(complex))
        return jnp.linalg.svd(jnp.eye(count) + linear.feedback @ response, compute_uv=False)[-1]

    return jnp.min(jax.vmap(least)(jnp.asarray(frequencies)))
