"""Friction and a bob with moments of its own: energy balances in both models, MuJoCo, and a published free swing."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import mujoco_robot
import numpy as np
import pytest
import spatial_oracle as oracle

import jaxsphere as js
from jaxsphere.models.spatial import energy, frames
from jaxsphere.simulation.rollout import rollout
from jaxsphere.status import ControllerOutput, Status
from jaxsphere.tasks.spatial import spatial_plant

TERMS = [leaf.name for leaf in fields(js.Friction)]
VALUES = {"drive_viscous": 0.03, "tilt_viscous": 0.02, "drive_coulomb": 0.05, "tilt_coulomb": 0.04, "rolling": 2e-3}
VALUES["spinning"] = 3e-3
BULKY = js.Robot(pendulum_inertia=np.array([0.002, 0.003, 0.004]))
SLOPE, WIDTH = 0.2, 0.05


def with_friction(**terms):
    return replace(BULKY, friction=js.Friction(**(dict.fromkeys(TERMS, 0.0) | terms)))


def sign(rate):
    return rate / np.sqrt(rate**2 + WIDTH**2)


def spatial_loss(name, robot, state):
    """Power that one term takes out of the spatial robot, W."""
    drive, tilt = state[9] - state[10], state[11]
    spin = state[7] + state[9] * np.cos(state[3])
    level = np.hypot(*np.array(frames.rolling_velocity(robot, state))) / robot.shell_radius
    weight = 5.1 * 9.81 * np.cos(SLOPE)
    return (
        VALUES[name]
        * {
            "drive_viscous": drive**2,
            "tilt_viscous": tilt**2,
            "drive_coulomb": drive * sign(drive),
            "tilt_coulomb": tilt * sign(tilt),
            "rolling": weight * level * sign(level),
            "spinning": weight * spin * sign(spin),
        }[name]
    )


@jax.jit
def spatial_balance(robot, state, torque):
    rates = js.spatial.derivative(robot, SLOPE, state, torque)
    total = lambda s: energy.kinetic_energy(robot, s) + energy.potential_energy(robot, SLOPE, s)  # noqa: E731
    return jax.jvp(total, (state,), (rates,))[1] - energy.power(state, torque)


@pytest.mark.parametrize("name", TERMS)
def test_each_term_takes_its_power_out_of_the_spatial_robot(name):
    rng, robot = np.random.default_rng(1), with_friction(**{name: VALUES[name]})
    for _ in range(5):
        state, torque = rng.normal(size=12), rng.normal(size=2)
        state[3] = rng.uniform(0.5, 2.5)
        loss = spatial_loss(name, robot, state)
        assert loss > 0.0
        assert float(spatial_balance(robot, state, torque)) == pytest.approx(-loss, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("name", ["drive_viscous", "drive_coulomb", "rolling"])
def test_each_term_takes_its_power_out_of_the_planar_robot(name):
    rng, robot = np.random.default_rng(2), with_friction(**{name: VALUES[name]})
    for _ in range(5):
        state, torque = jnp.asarray(rng.normal(size=4)), rng.normal()
        alpha, swing = js.planar.acceleration(robot, SLOPE, state, torque)
        total = lambda s: js.planar.kinetic_energy(robot, SLOPE, s) + js.planar.potential_energy(robot, SLOPE, s)  # noqa: E731
        rates = jnp.stack([state[1], alpha, state[3], swing])
        gained = jax.jvp(total, (state,), (rates,))[1] - js.planar.power(state, (torque,))
        joint, weight = float(state[1] + state[3]), 5.1 * 9.81 * np.cos(SLOPE)
        loss = {"drive_viscous": joint**2, "drive_coulomb": joint * sign(joint)}
        loss["rolling"] = weight * float(state[1]) * sign(float(state[1]))
        assert float(gained) == pytest.approx(-VALUES[name] * loss[name], rel=1e-9, abs=1e-12)


def test_the_planar_robot_is_the_spatial_one_that_rolls_straight():
    robot, right = with_friction(**VALUES), 0.5 * np.pi
    state = np.array([0.3, 1.1, 0.6, -0.7])
    upright = np.array([0.0, 0.0, right, right, 0.3, SLOPE - 0.6, 0.0, 0.0, 0.0, 1.1, 0.7, 0.0])
    alpha, swing = js.planar.acceleration(robot, SLOPE, state, 0.2)
    rates = js.spatial.derivative(robot, SLOPE, upright, np.array([0.2, 0.0]))
    np.testing.assert_allclose(rates[7:], [0.0, 0.0, alpha, -swing, 0.0], rtol=1e-10, atol=1e-10)


def test_a_bob_with_moments_obeys_euler_and_lagrange():
    rng = np.random.default_rng(3)
    for _ in range(5):
        state, torque = rng.normal(size=12), rng.normal(size=2)
        state[3] = rng.uniform(0.5, 2.5)
        slow = oracle.derivative(BULKY, SLOPE, state, torque)
        np.testing.assert_allclose(js.spatial.derivative(BULKY, SLOPE, state, torque), slow, rtol=1e-9, atol=1e-10)


def test_joint_damping_and_torsional_friction_of_mujoco():
    """Both have the same law there; the normal force of the engine is the true one, so only a calm motion agrees."""
    robot = with_friction(drive_viscous=0.03, tilt_viscous=0.02, spinning=2e-3)
    state = np.array([0.0, 0.0, 0.3, 1.5, 0.0, 0.1, 0.05, 3.0, 0.0, 1.0, 0.1, 0.1])
    idle = ControllerOutput((jnp.zeros(()), jnp.zeros(())), (), jnp.int32(Status.OK))
    run = rollout(
        spatial_plant(robot, jnp.asarray(0.0)),
        lambda *_: idle,
        tuple(map(jnp.asarray, state)),
        dt=jnp.asarray(1e-3),
        steps=400,
        save_every=20,
    )
    free = replace(robot, friction=None)
    engine, without = (
        mujoco_robot.simulate(one, 0.0, state, lambda *_: np.zeros(2), 0.4, 1e-4, 1e-3, 0.02) for one in (robot, free)
    )
    error = np.abs(np.asarray(run.state) - engine)
    assert error[:, :2].max() < 1e-3
    assert error[:, [2, 3, 5, 6]].max() < 2e-2
    assert np.abs(without - engine)[-1, 2] > 0.1, "friction should matter"


def test_roboball_swings_on_its_stand_as_its_public_log_does():
    """Small swings of 1.15...1.25 s, and peaks of 0.600, 0.337 and 0.141 rad on one side after a release from about 1.1."""
    robot = js.robot_named("roboball_ii")

    def swing(robot, first, steps):
        lumped = js.planar.lump(robot, 0.0)

        def rate(x):
            return jnp.stack([x[1], -js.planar.bias(lumped, (0.0, 0.0, x[0], x[1]))[1] / lumped.pendulum_inertia])

        def step(x, _):
            half = x + 5e-4 * rate(x)
            return x + 1e-3 * rate(half), x

        return np.asarray(jax.lax.scan(step, jnp.array([first, 0.0]), None, length=steps)[1])

    small = swing(replace(robot, friction=None), 0.05, 4000)[:, 0]
    upward = np.flatnonzero((small[:-1] < 0.0) & (small[1:] >= 0.0)) * 1e-3
    assert 1.15 < np.diff(upward).mean() < 1.25
    released = swing(robot, 1.1, 6000)
    turns = np.flatnonzero((released[:-1, 1] < 0.0) & (released[1:, 1] >= 0.0))
    np.testing.assert_allclose(-released[turns, 0][1:4], [0.600, 0.337, 0.141], atol=0.015)


def test_inadmissible_friction_and_moments_are_told():
    with pytest.raises(ValueError, match=r"robot\.friction\.rolling = -0\.1"):
        js.check_robot(with_friction(rolling=-0.1))
    with pytest.raises(ValueError, match=r"robot\.pendulum_inertia .* triangle inequality"):
        js.check_robot(replace(js.Robot(), pendulum_inertia=np.array([0.001, 0.001, 0.003])))
