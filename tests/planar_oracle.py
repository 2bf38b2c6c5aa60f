"""The planar robot a second time, slowly: positions of its bodies, a Lagrangian, and automatic differentiation.

Nothing of `jaxsphere.models` is used. World frame: x horizontal, y up. The sphere rolls without slipping on a line of slope
gamma; the motor acts between shell and pendulum, so its generalised force is the gradient of their relative rotation.
"""

import jax
import jax.numpy as jnp

import jaxsphere as js


def centre(robot, slope, q):
    """Position (2,) of the centre of the sphere."""
    along = jnp.array([jnp.cos(slope), jnp.sin(slope)])
    normal = jnp.array([-jnp.sin(slope), jnp.cos(slope)])
    return robot.shell_radius * (q[0] * along + normal)


def bob(robot, slope, q):
    """Position (2,) of the pendulum's bob."""
    return centre(robot, slope, q) + robot.pendulum_length * jnp.array([jnp.sin(q[1]), -jnp.cos(q[1])])


def rotations(q):
    """Counter-clockwise rotations of shell and pendulum: the shell turns clockwise as it rolls up-slope."""
    return jnp.array([-q[0], q[1]])


def relative_rotation(q):
    """Rotation of the pendulum against the shell, the angle that the motor works on."""
    shell, pendulum = rotations(q)
    return pendulum - shell


def kinetic(robot, slope, q, v):
    """Kinetic energy, J."""
    _, centre_velocity = jax.jvp(lambda q: centre(robot, slope, q), (q,), (v,))
    _, bob_velocity = jax.jvp(lambda q: bob(robot, slope, q), (q,), (v,))
    _, spins = jax.jvp(rotations, (q,), (v,))
    translation = (robot.shell_mass + robot.gimbal_mass) * centre_velocity @ centre_velocity
    translation = translation + robot.pendulum_mass * bob_velocity @ bob_velocity
    swinging = robot.gimbal_inertia[2] + robot.pendulum_inertia[2]
    return 0.5 * (translation + robot.shell_inertia[2] * spins[0] ** 2 + swinging * spins[1] ** 2)


def potential(robot, slope, q):
    """Potential energy, J, zero with all masses at the height of the contact point of alpha = 0."""
    moment = (robot.shell_mass + robot.gimbal_mass) * centre(robot, slope, q)[1]
    moment = moment + robot.pendulum_mass * bob(robot, slope, q)[1]
    return robot.gravity * moment


def acceleration(robot: js.Robot, slope, state, torque):
    """Accelerations (2,) from d/dt dL/dv - dL/dq = tau d(relative rotation)/dq."""
    q, v = state[0::2], state[1::2]

    def lagrangian(q, v):
        return kinetic(robot, slope, q, v) - potential(robot, slope, q)

    momentum = jax.grad(lagrangian, 1)
    mass = jax.jacfwd(momentum, 1)(q, v)
    _, transport = jax.jvp(lambda q: momentum(q, v), (q,), (v,))
    force = torque * jax.grad(relative_rotation)(q)
    return jnp.linalg.solve(mass, force + jax.grad(lagrangian)(q, v) - transport)
