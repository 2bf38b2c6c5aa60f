"""The planar dynamics against an independent derivation, and the identities that any mechanical system obeys."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import planar_oracle
import pytest

import jaxsphere as js

SLOPES = (np.deg2rad(10.0), np.deg2rad(-7.0), 0.0)


@pytest.mark.parametrize("slope", SLOPES)
def test_acceleration_equals_euler_lagrange_from_positions(robot, slope, random_states, rng):
    states, torques = random_states(300), rng.uniform(-5.0, 5.0, 300)
    fast = jax.vmap(js.planar.acceleration, (None, None, 0, 0))(robot, slope, states, torques)
    slow = jax.jit(jax.vmap(planar_oracle.acceleration, (None, None, 0, 0)))(robot, slope, states, torques)
    error = np.linalg.norm(fast - slow, axis=1) / np.linalg.norm(slow, axis=1)
    assert np.max(error) < 1e-10  # the two derivations share no operation but rounding


def test_acceleration_is_differentiable_like_the_oracle(robot, slope, random_states):
    state = random_states(1)[0]
    fast = jax.jit(jax.jacfwd(js.planar.acceleration, (1, 2, 3)))(robot, slope, state, 1.3)
    slow = jax.jit(jax.jacfwd(planar_oracle.acceleration, (1, 2, 3)))(robot, slope, state, 1.3)
    for ours, theirs in zip(fast, slow, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())  # one digit lost to the solve


def test_mass_matrix_is_that_of_the_kinetic_energy_and_positive_definite(robot, slope, random_states):
    states = random_states(50)
    matrices = jax.vmap(js.planar.mass_matrix, (None, None, 0))(robot, slope, states)
    hessian = jax.jit(jax.vmap(jax.hessian(planar_oracle.kinetic, 3), (None, None, 0, 0)))
    np.testing.assert_allclose(matrices, hessian(robot, slope, states[:, 0::2], states[:, 1::2]), rtol=1e-12)  # rounding
    assert np.min(np.linalg.eigvalsh(matrices)) > 0.0


def test_energies_equal_those_of_the_positions(robot, slope, random_states):
    states = np.vstack([[0.0, 0.0, np.pi / 2, 0.0], random_states(50)])  # the first is the zero of the potential energy
    kinetic, potential = oracle_energies(robot, slope, states)
    ours = jax.vmap(lambda x: (js.planar.kinetic_energy(robot, slope, x), js.planar.potential_energy(robot, slope, x)))(states)
    np.testing.assert_allclose(ours[0], kinetic, rtol=1e-12, atol=1e-14)  # rounding of sums of a few products
    np.testing.assert_allclose(ours[1], potential - potential[0], rtol=1e-11, atol=1e-11)


def test_power_balance_holds_at_random_states(robot, slope, random_states, rng):
    states, torques = random_states(50), rng.uniform(-5.0, 5.0, 50)
    accelerations = jax.vmap(js.planar.acceleration, (None, None, 0, 0))(robot, slope, states, torques)
    rates = np.stack([states[:, 1], accelerations[:, 0], states[:, 3], accelerations[:, 1]], axis=1)
    gradient = np.asarray(jax.jit(jax.vmap(jax.grad(lambda x: sum(energies(robot, slope, x)))))(states))
    power = torques * (states[:, 1] + states[:, 3])
    np.testing.assert_allclose(js.planar.power(states.T, (torques,)), power, rtol=1e-15)  # the same product
    # The terms of the sum cancel down to the power; rounding is relative to the largest of them.
    error = np.sum(gradient * rates, axis=1) - power
    assert np.max(np.abs(error) / np.abs(gradient * rates).max(axis=1)) < 1e-12


def test_canonical_form_solves_the_equations_of_motion(robot, slope, random_states):
    lumped = js.planar.lump(robot, slope)
    for state in random_states(50):
        form = js.planar.canonical_form(lumped, tuple(state))
        matrix = np.asarray(js.planar.mass_matrix(robot, slope, state))
        bias = np.asarray(js.planar.bias(lumped, tuple(state)))
        scale = 1e-12 * np.abs(matrix).max() * np.abs([*form]).max()  # rounding of the products that cancel
        np.testing.assert_allclose(matrix @ np.array([form.f1, form.f2]), -bias, atol=scale)
        np.testing.assert_allclose(matrix @ np.array([form.b1, form.b2]), [1.0, 1.0], atol=scale)


def test_derivative_is_affine_in_the_torque(robot, slope, random_states):
    lumped, state = js.planar.lump(robot, slope), tuple(random_states(1)[0])
    form = js.planar.canonical_form(lumped, state)
    rates = js.planar.derivative(lumped, state, (2.5,))
    assert (rates[0], rates[2]) == (state[1], state[3])
    np.testing.assert_array_equal(rates[1::2], [form.f1 + 2.5 * form.b1, form.f2 + 2.5 * form.b2])


def test_energy_drift_without_torque_falls_at_fourth_order(robot, slope):
    drifts = np.array([free_drift(robot, slope, steps) for steps in (800, 1600, 3200)])
    orders = np.log2(drifts[:-1] / drifts[1:])
    assert abs(orders[-1] - 4.0) < 0.2  # wide enough for the next term of the expansion, too narrow for another order
    assert drifts[-1] < 1e-7  # far above rounding (1e-13 J), far below the 1 J that the motion exchanges


def test_mirrored_slope_mirrors_the_motion(robot, slope, random_states):
    for state in random_states(20):
        right = js.planar.acceleration(robot, slope, state, 1.7)
        left = js.planar.acceleration(robot, -slope, -state, -1.7)
        np.testing.assert_allclose(left, -right, rtol=1e-12)  # even and odd polynomials: rounding only


def test_state_of_the_wrong_length_is_refused(slope):
    with pytest.raises(ValueError, match=r"state has shape \(3,\); type 4 numbers"):
        js.planar.acceleration(js.Robot(), slope, np.zeros(3), 0.0)
    with pytest.raises(ValueError, match=r"torque has shape \(1,\); type one number"):
        js.planar.acceleration(js.Robot(), slope, np.zeros(4), np.zeros(1))


def energies(robot, slope, state):
    """Kinetic and potential energy of the oracle at a state, J."""
    q, v = state[0::2], state[1::2]
    return planar_oracle.kinetic(robot, slope, q, v), planar_oracle.potential(robot, slope, q)


oracle_energies = jax.jit(jax.vmap(energies, (None, None, 0)))


@partial(jax.jit, static_argnames="steps")
def free_drift(robot, slope, steps):
    """Largest change of the oracle's energy along 4 s of motion without torque, J."""
    lumped = js.planar.lump(robot, slope)
    alive = js.Plant(partial(js.planar.derivative, lumped), lambda x: jnp.int32(js.Status.OK), js.planar.IS_VELOCITY)
    idle = js.ControllerOutput((jnp.zeros(()),), (), jnp.int32(js.Status.OK))
    start = tuple(map(jnp.asarray, (0.0, 1.0, 1.2, -2.0)))
    states = js.rollout(alive, lambda *_: idle, start, dt=jnp.asarray(4.0 / steps), steps=steps).state
    energy = sum(oracle_energies(robot, slope, states))
    return jnp.max(jnp.abs(energy - energy[0]))
