"""The spatial robot a second time: rotation matrices, positions, a Lagrangian and Euler-Lagrange by automatic differentiation.

Shares no code with `jaxsphere.models`. q = (x, y, psi, theta, phi, beta1, beta2); the shell is given its own rotation, so the
moments of the shell are taken in the frame that spins.
"""

import jax
import jax.numpy as jnp

INPUT = {
    "corrected": jnp.array([[0.0, 0, 0, 0, 1, -1, 0], [0, 0, 0, 0, 0, 0, 1]]).T,
    "printed": jnp.array([[0.0, 0, 0, 0, 1, 1, 0], [0, 0, 0, 0, 0, 0, 1]]).T,
}


def about_y(angle):
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def about_z(angle):
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def center(robot, q):
    return jnp.array([q[0], q[1], robot.shell_radius])


def shell_rotation(q):
    return about_z(q[2]) @ about_y(q[3]) @ about_z(q[4])


def gimbal_rotation(q):
    return about_z(q[2]) @ about_y(q[3]) @ about_z(q[5])


def bob(robot, q):
    return center(robot, q) + gimbal_rotation(q) @ about_y(q[6]) @ jnp.array([robot.pendulum_length, 0.0, 0.0])


def rate(function, q, q_rate):
    return jax.jvp(function, (q,), (q_rate,))[1]


def turning_in_body(rotation, q, q_rate):
    """Angular velocity in the body's own axes, from R^T R'."""
    skew = rotation(q).T @ rate(rotation, q, q_rate)
    return jnp.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def kinetic(robot, q, q_rate):
    center_rate = rate(lambda p: center(robot, p), q, q_rate)
    bob_rate = rate(lambda p: bob(robot, p), q, q_rate)
    shell, gimbal = (turning_in_body(rotation, q, q_rate) for rotation in (shell_rotation, gimbal_rotation))
    translation = (robot.shell_mass + robot.gimbal_mass) * center_rate @ center_rate + robot.pendulum_mass * bob_rate @ bob_rate
    pendulum = turning_in_body(lambda p: gimbal_rotation(p) @ about_y(p[6]), q, q_rate)
    turning = shell @ (robot.shell_inertia * shell) + gimbal @ (robot.gimbal_inertia * gimbal)
    return 0.5 * (translation + turning + pendulum @ (robot.pendulum_inertia * pendulum))


def potential(robot, slope, q):
    up = jnp.array([jnp.sin(slope), 0.0, jnp.cos(slope)])
    weighted = (robot.shell_mass + robot.gimbal_mass) * center(robot, q) + robot.pendulum_mass * bob(robot, q)
    return robot.gravity * up @ weighted


def null_space(robot, q, convention):
    """Columns: rates q' of a sphere that rolls with unit psi', theta', phi', beta1', beta2'."""

    def roll(v):
        rotation = about_z(q[2]) @ about_y(q[3])
        turning = v[0] * jnp.array([0.0, 0.0, 1.0]) + v[1] * about_z(q[2])[:, 1] + v[2] * rotation[:, 2]
        x_rate, y_rate, _ = jnp.cross(turning, jnp.array([0.0, 0.0, robot.shell_radius]))
        pair = [-y_rate, -x_rate] if convention == "printed" else [x_rate, y_rate]
        return jnp.concatenate([jnp.stack(pair), v])

    return jax.jacfwd(roll)(jnp.zeros(5))


def euler_lagrange(robot, slope, q, q_rate):
    """Inertia matrix (7, 7) and the terms N (7) of M q'' + N = A^T lambda + B tau."""
    inertia = jax.hessian(lambda w: kinetic(robot, q, w))(q_rate)
    momentum = lambda p, w: jax.grad(lambda u: kinetic(robot, p, u))(w)  # noqa: E731
    drift = jax.jvp(lambda p: momentum(p, q_rate), (q,), (q_rate,))[1]
    lagrangian = lambda p: kinetic(robot, p, q_rate) - potential(robot, slope, p)  # noqa: E731
    return inertia, drift - jax.grad(lagrangian)(q)


@jax.jit(static_argnames="convention")
def derivative(robot, slope, state, torque, convention="corrected"):
    """(q', v') of the constrained robot, (12,)."""
    q, v = state[:7], state[7:]
    free = null_space(robot, q, convention)
    q_rate = free @ v
    free_rate = rate(lambda p: null_space(robot, p, convention), q, q_rate)
    inertia, nonlinear = euler_lagrange(robot, slope, q, q_rate)
    right = INPUT[convention] @ torque - nonlinear - inertia @ (free_rate @ v)
    return jnp.concatenate([q_rate, jnp.linalg.solve(free.T @ inertia @ free, free.T @ right)])


@jax.jit
def constraint_force(robot, slope, state, rates):
    """Lambda (2,), N, from the first two rows of the unreduced equations; `rates` is `derivative` at `state`."""
    q, v, q_rate = state[:7], state[7:], rates[:7]
    free = null_space(robot, q, "corrected")
    q_acceleration = free @ rates[7:] + rate(lambda p: null_space(robot, p, "corrected"), q, q_rate) @ v
    inertia, nonlinear = euler_lagrange(robot, slope, q, q_rate)
    return (inertia @ q_acceleration + nonlinear)[:2]
