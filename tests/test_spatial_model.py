"""The spatial model: against the plane, a second derivation, its own identities and MuJoCo."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import mujoco_robot
import numpy as np
import pytest
import spatial_oracle as oracle

import jaxsphere as js
from jaxsphere.controllers import sliding_mode
from jaxsphere.models import spatial
from jaxsphere.models.spatial import contact, printed
from jaxsphere.models.spatial import energy as spatial_energy
from jaxsphere.models.spatial import frames as kinematics
from jaxsphere.simulation.integrators import rk4
from jaxsphere.simulation.rollout import rollout
from jaxsphere.tasks.spatial import spatial_plant

UNEQUAL = dataclasses.replace(
    js.Robot(), shell_inertia=np.array([0.02, 0.02, 0.027]), gimbal_inertia=np.array([0.003, 0.0021, 0.0011])
)
LIGHT = dataclasses.replace(UNEQUAL, gravity=1.62, pendulum_length=0.09, pendulum_mass=1.1)
CASES = {
    "set_a": (js.Robot(), 0.1745),
    "unequal": (UNEQUAL, -0.3),
    "light": (LIGHT, 0.25),
    "rotunbot": (js.robot_named("rotunbot"), 0.1),
}
cases = pytest.mark.parametrize(("robot", "slope"), CASES.values(), ids=CASES)
derivative = jax.jit(spatial.derivative, static_argnames="convention")
kinetic_energy, lagrangian = jax.jit(spatial_energy.kinetic_energy), jax.jit(spatial_energy.lagrangian)
oracle_kinetic, oracle_potential = jax.jit(oracle.kinetic), jax.jit(oracle.potential)
contact_of = jax.jit(lambda *now: (contact.contact(*now), contact.constraint_force(*now)))


@jax.jit
def total_energy(robot, slope, state):
    return spatial_energy.kinetic_energy(robot, state) + spatial_energy.potential_energy(robot, slope, state)


def draw(rng, count):
    """Random states (count, 12), away from the singular leans, and torques (count, 2)."""
    state = rng.normal(size=(count, 12)) * np.array([*(0.5,) * 2, *(1.5,) * 5, *(2.0,) * 5])
    state[:, 3] = rng.uniform(0.4, 2.7, count) * rng.choice([-1.0, 1.0], count)
    return state, rng.normal(size=(count, 2)) * 3.0


def relative(value, reference):
    value, reference = np.asarray(value), np.asarray(reference)
    return np.max(np.abs(value - reference)) / np.max(np.abs(reference))


def planar_as_spatial(slope, planar_state):
    alpha, alpha_rate, swing, swing_rate = planar_state
    right = 0.5 * np.pi
    return np.array([0.0, 0.0, right, right, alpha, slope - swing, 0.0, 0.0, 0.0, alpha_rate, -swing_rate, 0.0])


@cases
def test_reduces_to_the_plane(robot, slope):
    rng = np.random.default_rng(1)
    for _ in range(10):
        state, torque = rng.normal(size=4) * 2.0, rng.normal() * 3.0
        alpha, swing = np.asarray(js.planar.acceleration(robot, slope, state, torque))
        rates = derivative(robot, slope, planar_as_spatial(slope, state), np.array([torque, 0.0]))
        expected = np.array([0.0, 0.0, alpha, -swing, 0.0])
        assert relative(rates[7:], expected) < 1e-10
        assert relative(rates[:2], [robot.shell_radius * state[1], 0.0]) < 1e-10
        wrong = derivative(robot, slope, planar_as_spatial(slope, state), np.array([torque, 0.0]), convention="printed")
        assert relative(wrong[7:], expected) > 1e-2


def test_sliding_mode_drives_the_spatial_plant_as_it_drives_the_planar_one():
    robot, slope = js.Robot(), 0.1745
    planar_law = sliding_mode.law(robot, slope, js.SlidingModeGains(), 10.0, 0.02)

    def law(time, state, memory):
        now = spatial.paper_state(state)
        planar_state = (now.spin, now.spin_rate, slope - now.gimbal_angle, -now.gimbal_rate)
        command = planar_law(time, planar_state, memory)
        return command._replace(torque=(*command.torque, jnp.zeros_like(state[0])))

    start = (0.0, 0.0, float(js.equilibrium_swing(robot, slope)), 0.0)
    plant = spatial_plant(robot, slope)
    components = tuple(jnp.asarray(planar_as_spatial(slope, start)))
    settings = {"dt": jnp.asarray(1e-3), "steps": 4000, "save_every": 100}
    spatial_run = rollout(plant, law, components, (jnp.zeros(()),), **settings)
    planar_run = js.rest_to_rest(robot, slope, duration=4.0, save_every=100)
    assert int(spatial_run.status) == js.Status.OK
    np.testing.assert_allclose(spatial_run.state[:, 4], planar_run.state[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(slope - spatial_run.state[:, 5], planar_run.state[:, 2], rtol=0, atol=1e-9)
    assert planar_run.state[-1, 0] > 1.0


@cases
@pytest.mark.parametrize("convention", spatial.CONVENTIONS)
def test_two_derivations_agree(robot, slope, convention):
    for state, torque in zip(*draw(np.random.default_rng(2), 20), strict=True):
        fast = derivative(robot, slope, state, torque, convention=convention)
        assert relative(fast, oracle.derivative(robot, slope, state, torque, convention=convention)) < 1e-10


@cases
def test_energies_match_the_second_derivation(robot, slope):
    for state, _ in zip(*draw(np.random.default_rng(3), 5), strict=True):
        q, q_rate = jnp.asarray(state[:7]), oracle.null_space(robot, state[:7], "corrected") @ state[7:]
        expected = float(oracle_kinetic(robot, q, q_rate))
        assert kinetic_energy(robot, state) == pytest.approx(expected, rel=1e-12)
        assert kinetic_energy(robot, state) == pytest.approx(0.5 * state[7:] @ spatial.mass_matrix(robot, state) @ state[7:])
        assert lagrangian(robot, slope, state) == pytest.approx(expected - float(oracle_potential(robot, slope, q)), rel=1e-10)


@jax.jit
def passivity_terms(robot, slope, state):
    """Inertia, its rate, the C built from the Christoffel symbols of the free robot, and the bias without gravity."""
    q, v = state[:7], state[7:]
    free = oracle.null_space(robot, q, "corrected")
    q_rate = free @ v
    free_rate = oracle.rate(lambda p: oracle.null_space(robot, p, "corrected"), q, q_rate)
    inertia = jax.hessian(lambda w: oracle.kinetic(robot, q, w))(q_rate)
    weightless = dataclasses.replace(robot, gravity=0.0)
    christoffel = 0.5 * jax.jacfwd(lambda w: oracle.euler_lagrange(weightless, slope, q, w)[1])(q_rate)
    coriolis = free.T @ (inertia @ free_rate + christoffel @ free)
    along = jnp.concatenate([q_rate, jnp.zeros(5)])
    mass, mass_rate = jax.jvp(lambda s: spatial.mass_matrix(robot, s), (state,), (along,))
    bias = -mass @ spatial.derivative(weightless, slope, state, jnp.zeros(2))[7:]
    return mass, mass_rate, coriolis, bias


@cases
def test_inertia_is_symmetric_positive_definite_and_the_bias_passive(robot, slope):
    """M' - 2 C is skew for a C with C v = bias, so the bias does no work beyond changing M."""
    for state, _ in zip(*draw(np.random.default_rng(4), 10), strict=True):
        mass, mass_rate, coriolis, bias = passivity_terms(robot, slope, state)
        assert np.array_equal(mass, mass.T)
        assert np.linalg.eigvalsh(mass).min() > 0.0
        assert relative(coriolis @ state[7:], bias) < 1e-10
        skew = mass_rate - 2.0 * coriolis
        assert np.max(np.abs(skew + skew.T)) < 1e-10 * np.max(np.abs(mass_rate))
        assert abs(state[7:] @ (mass_rate @ state[7:] - 2.0 * bias)) < 1e-10 * np.abs(state[7:]) @ np.abs(bias)


@pytest.mark.parametrize("convention", spatial.CONVENTIONS)
def test_constraints_hold_at_rounding(convention):
    robot = UNEQUAL
    room = printed if convention == "printed" else kinematics
    for state, torque in zip(*draw(np.random.default_rng(5), 10), strict=True):
        rates = derivative(robot, 0.2, state, torque, convention=convention)
        assert np.max(np.abs(room.constraint_matrix(robot, state) @ rates[:7])) < 1e-14
        free = room.null_space(robot, state)
        assert np.max(np.abs(room.constraint_matrix(robot, state) @ free)) < 1e-15
        np.testing.assert_allclose(free @ state[7:], rates[:7], rtol=0, atol=1e-14)
        np.testing.assert_allclose(free, oracle.null_space(robot, state[:7], convention), rtol=0, atol=1e-15)
    other = printed if convention == "corrected" else kinematics
    assert np.max(np.abs(other.constraint_matrix(robot, state) @ rates[:7])) > 1e-3
    assert np.max(np.abs(kinematics.constraint_residual(robot, state, derivative(robot, 0.2, state, torque)[:7]))) < 1e-14


def test_kinematics_match_rotation_matrices():
    robot = UNEQUAL
    for state, torque in zip(*draw(np.random.default_rng(6), 5), strict=True):
        q = jnp.asarray(state[:7])
        q_rate = oracle.null_space(robot, q, "corrected") @ state[7:]
        rotation = oracle.about_z(q[2]) @ oracle.about_y(q[3])
        np.testing.assert_allclose(kinematics.body_rotation(state), rotation, rtol=0, atol=1e-15)
        turning = oracle.shell_rotation(q) @ oracle.turning_in_body(oracle.shell_rotation, q, q_rate)
        np.testing.assert_allclose(kinematics.angular_velocity(state), turning, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rotation @ np.array(kinematics.shell_angular_velocity(state)), turning, rtol=0, atol=1e-13)
        np.testing.assert_allclose(
            kinematics.gimbal_angular_velocity(state), oracle.turning_in_body(oracle.gimbal_rotation, q, q_rate), atol=1e-13
        )
        np.testing.assert_allclose(kinematics.pendulum_position(robot, state), oracle.bob(robot, q), rtol=0, atol=1e-14)
        np.testing.assert_allclose(kinematics.center_velocity(robot, state)[:2], q_rate[:2], rtol=0, atol=1e-14)
        np.testing.assert_allclose(kinematics.rolling_velocity(robot, state), q_rate[:2], rtol=0, atol=1e-14)
        np.testing.assert_allclose(printed.angular_velocity(state), [-turning[1], turning[0], turning[2]], rtol=0, atol=1e-13)
        rates = derivative(robot, 0.2, state, torque)
        second = jnp.stack(kinematics.coordinate_accelerations(robot, state, rates[7:]))
        expected = oracle.rate(lambda s: oracle.null_space(robot, s[:7], "corrected") @ s[7:], state, rates)
        np.testing.assert_allclose(second, expected, rtol=0, atol=1e-12 * np.max(np.abs(rates)))


@partial(jax.jit, static_argnames=("steps", "convention"))
def roll(robot, slope, state, dt, steps, convention="corrected", wave=(0.0, 0.0, 0.0)):
    lumped = spatial.lump(robot, slope)
    mirrored = convention == "printed"
    start = tuple(state) if mirrored else spatial.of_state(state)

    def field(time, x):
        torque = (wave[0] + wave[1] * jnp.sin(7.0 * time), wave[2] * jnp.cos(5.0 * time))
        if mirrored:
            return tuple(printed.derivative(robot, slope, jnp.stack(x), jnp.stack(torque))), None
        return tuple(spatial.derivative_components(lumped, x, torque)), None

    def step(x, index):
        return rk4(field, index * dt, x, dt)[0], x

    end, states = jax.lax.scan(step, tuple(start), jnp.arange(steps))
    states = tuple(jnp.append(x, last) for x, last in zip(states, end, strict=True))
    return jnp.stack(states if mirrored else spatial.paper_states(states, state)[0], axis=1)


GENERIC = np.array([0.1, -0.2, 0.7, 1.3, 0.4, 0.5, -0.3, 0.5, -0.4, 1.5, 0.8, 0.6])


@pytest.mark.parametrize("robot", [js.Robot(), UNEQUAL], ids=["set_a", "unequal"])
def test_energy_is_conserved_to_fourth_order(robot):
    drifts = []
    for dt, steps in ((4e-3, 200), (2e-3, 400), (1e-3, 800)):
        states = roll(robot, 0.2, GENERIC, dt, steps)
        drifts.append(float(abs(total_energy(robot, 0.2, tuple(states[-1])) - total_energy(robot, 0.2, tuple(GENERIC)))))
    assert drifts[2] < 1e-8
    assert 3.8 < np.log2(drifts[1] / drifts[2]) < 5.2


@cases
def test_power_balance(robot, slope):
    for state, torque in zip(*draw(np.random.default_rng(7), 10), strict=True):
        rates = derivative(robot, slope, state, torque)
        gained = jax.jvp(partial(total_energy, robot, slope), (jnp.asarray(state),), (rates,))[1]
        scale = abs(torque[0]) * (abs(state[9]) + abs(state[10])) + np.abs(rates[7:]) @ np.abs(state[7:])
        assert float(gained - spatial_energy.power(state, torque)) == pytest.approx(0.0, abs=1e-10 * scale)
        drive, tilt = torque
        assert spatial_energy.power(state, torque) == pytest.approx(drive * (state[9] - state[10]) + tilt * state[11])


def exciting_start(rng):
    place, attitude = rng.normal(size=2) * 0.2, [rng.uniform(-3, 3), rng.uniform(1.0, 2.1), rng.uniform(-1, 1)]
    return np.concatenate([place, attitude, rng.uniform(-0.5, 0.5, 2), rng.normal(size=5) * 0.8])


@pytest.mark.parametrize("seed", range(6))
def test_against_mujoco(seed):
    """The corrected model is what MuJoCo's robot does; the printed one is centimetres and half a radian away."""
    robot = UNEQUAL if seed % 2 else js.Robot()
    state, wave = exciting_start(np.random.default_rng(seed)), (0.1, 0.3, 0.2)

    def excite(time, _):
        return wave[0] + wave[1] * np.sin(7.0 * time), wave[2] * np.cos(5.0 * time)

    engine = mujoco_robot.simulate(robot, 0.15, state, excite, duration=0.4, dt=1e-4, hold=1e-4, save=0.02)
    ours = np.asarray(roll(robot, 0.15, state, 1e-3, 400, "corrected", wave))[::20]
    mirrored = np.asarray(roll(robot, 0.15, state, 1e-3, 400, "printed", wave))[::20]
    assert np.abs(engine[0] - state).max() < 1e-6
    assert np.linalg.norm(engine[-1, :2] - state[:2]) > 0.005
    assert np.abs(ours - engine)[:, :2].max() < 1e-4
    assert np.abs(ours - engine)[:, 5:7].max() < 1e-3
    assert np.abs(ours - engine)[:, 3].max() < 1e-3
    assert np.abs(mirrored - engine)[:, :2].max() > 1e-2
    assert np.abs(mirrored - engine)[:, 5:7].max() > 0.1


@cases
def test_contact_forces(robot, slope):
    for state, torque in zip(*draw(np.random.default_rng(8), 5), strict=True):
        forces, multipliers = contact_of(robot, slope, tuple(state), tuple(torque))
        expected = oracle.constraint_force(robot, slope, state, oracle.derivative(robot, slope, state, torque))
        assert relative(jnp.stack(forces.friction), expected) < 1e-10
        assert relative(jnp.stack(multipliers), expected) < 1e-10
        if forces.normal > 0:
            assert forces.friction_coefficient == pytest.approx(float(np.hypot(*forces.friction) / forces.normal))
        else:
            assert np.isinf(forces.friction_coefficient)


def test_contact_at_rest_carries_the_weight():
    robot, slope = js.Robot(), 0.1745
    swing = float(js.equilibrium_swing(robot, slope))
    weight = 9.81 * (robot.shell_mass + robot.gimbal_mass + robot.pendulum_mass)
    hold = robot.pendulum_mass * 9.81 * robot.pendulum_length * np.sin(swing)
    state = tuple(planar_as_spatial(slope, (0.0, 0.0, swing, 0.0)))
    forces, _ = contact_of(robot, slope, state, (hold, 0.0))
    assert forces.normal == pytest.approx(weight * np.cos(slope), rel=1e-12)
    np.testing.assert_allclose(forces.friction, [weight * np.sin(slope), 0.0], atol=1e-12 * weight)
    assert forces.friction_coefficient == pytest.approx(np.tan(slope), rel=1e-12)


@pytest.mark.parametrize(("seed", "lean"), [(3, 0.0), (4, 0.01), (5, np.pi), (11, 0.3)])
def test_against_mujoco_at_leans_that_the_paper_cannot_describe(seed, lean):
    """From the poles of the attitude angles, from beside one, and past one within 0.03 rad."""
    robot, wave = UNEQUAL, (0.1, 0.3, 0.2)
    state = exciting_start(np.random.default_rng(seed))
    state[3] = lean
    passing = lean == 0.3
    state[7:] = (0.0, -2.5, 0.3, 0.3, 0.4) if passing else state[7:]

    def excite(time, _):
        return wave[0] + wave[1] * np.sin(7.0 * time), wave[2] * np.cos(5.0 * time)

    # The engine's error is of first order in its step; two steps extrapolate it away.
    steps = (5e-5, 2.5e-5) if passing else (2e-4, 1e-4)
    read = mujoco_robot.get_pose
    coarse, fine = (mujoco_robot.simulate(robot, 0.15, state, excite, 0.6, dt, dt, 0.02, read) for dt in steps)
    ours = np.asarray(roll(robot, 0.15, state, 1e-3, 600, wave=wave))
    error = np.abs(np.asarray(jax.vmap(mujoco_robot.pose_of)(ours[::20])) - (2.0 * fine - coarse))
    assert np.abs(np.sin(ours[:, 3])).min() < 0.03
    assert error[:, :2].max() < 1e-4
    assert error[:, 2:].max() < 1e-3


def test_angles_are_continuous_through_a_pole():
    time = np.linspace(-1.0, 1.0, 21)
    path = np.zeros((21, 12))
    path[:, 2:7] = np.stack([2.0 + 9.0 * time, 0.3 * time, 5.0 * time, 1.0 - 4.0 * time, 0.1 * time], axis=1)
    path[:, 7:] = 9.0, 0.3, 5.0, -4.0, 0.1
    moved = jax.vmap(spatial.of_state)(path)
    again = np.stack(spatial.paper_states(tuple(moved), path[0])[0], axis=1)
    away = np.delete(np.arange(21), 10)  # at the pole itself only psi + beta1 is defined
    np.testing.assert_allclose(again[away], path[away], rtol=0, atol=1e-12)


def test_paper_coordinates_there_and_back():
    states, _ = draw(np.random.default_rng(12), 50)
    for state in states:
        again = spatial.paper_states(tuple(x[None] for x in spatial.of_state(jnp.asarray(state))), tuple(state))[0]
        np.testing.assert_allclose(np.concatenate(again), state, rtol=0, atol=1e-13 * np.abs(state).max())
    upright = spatial.GimbalState(*(jnp.asarray(x) for x in (0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)))
    pole = spatial.paper_state(upright)
    assert (pole.lean, pole.precession_rate, pole.gimbal_rate) == (0.0, 0.0, 0.5)
    assert np.all(np.isfinite(jax.jacfwd(lambda w: jnp.stack(spatial.paper_state(upright._replace(turning_x=w))))(0.1)))


def test_energy_is_conserved_through_twenty_seconds_that_cross_the_poles():
    state = GENERIC.copy()
    state[7:10] = 0.5, -2.5, 1.0
    states = roll(js.Robot(), 0.0, state, 1e-3, 20000)
    energies = np.asarray(jax.vmap(partial(total_energy, js.Robot(), 0.0))(states[::500]))
    assert np.ptp(energies) < 1e-6 * (energies.max() + 10.0)
    nearest = np.abs(np.sin(np.asarray(states)[:, 3])).min()
    assert nearest < 0.05, "the rollout should come nearer to a pole than the Euler angles allowed"
    assert np.all(np.isfinite(states))


def test_wrong_input_is_told():
    with pytest.raises(ValueError, match="12 numbers"):
        spatial.derivative(js.Robot(), 0.1, np.zeros(11), np.zeros(2))
    with pytest.raises(ValueError, match="drive and tilt"):
        spatial.derivative(js.Robot(), 0.1, GENERIC, 0.0)
    with pytest.raises(ValueError, match="corrected, printed"):
        spatial.derivative(js.Robot(), 0.1, GENERIC, np.zeros(2), "original")
    lopsided = dataclasses.replace(js.Robot(), shell_inertia=np.array([0.018, 0.019, 0.018]))
    with pytest.raises(ValueError, match="equal x and y moments"):
        spatial.check_spatial_robot(lopsided)
    assert spatial.check_spatial_robot(UNEQUAL) is UNEQUAL


def test_a_batch_is_its_lanes():
    states, torques = draw(np.random.default_rng(9), 7)
    batch = jax.vmap(partial(spatial.derivative, UNEQUAL, 0.2))(states, torques)
    single = np.stack([derivative(UNEQUAL, 0.2, s, t) for s, t in zip(states, torques, strict=True)])
    assert relative(batch, single) < 1e-13


def test_derivative_is_differentiable():
    state, torque = GENERIC, np.array([0.4, -0.2])
    forward = jax.jit(jax.jacfwd(spatial.derivative, argnums=2))(js.Robot(), 0.2, state, torque)
    reverse = jax.jit(jax.jacrev(spatial.derivative, argnums=2))(js.Robot(), 0.2, state, torque)
    assert relative(forward, reverse) < 1e-12
    step = 1e-6 * np.eye(12)
    ends = [[derivative(js.Robot(), 0.2, state + sign * e, torque) for e in step] for sign in (1.0, -1.0)]
    assert relative(forward, (np.array(ends[0]) - np.array(ends[1])).T / 2e-6) < 1e-7
