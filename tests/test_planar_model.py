"""The planar dynamics against an independent derivation, and the identities that any mechanical system obeys."""

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
    fast = jax.jacfwd(js.planar.acceleration, (1, 2, 3))(robot, slope, state, 1.3)
    slow = jax.jacfwd(planar_oracle.acceleration, (1, 2, 3))(robot, slope, state, 1.3)
    for ours, theirs in zip(fast, slow, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())  # one digit lost to the solve


def test_mass_matrix_is_that_of_the_kinetic_energy_and_positive_definite(robot, slope, random_states):
    for state in random_states(50):
        matrix = js.planar.mass_matrix(robot, slope, state)
        hessian = jax.hessian(planar_oracle.kinetic, 3)(robot, slope, state[0::2], state[1::2])
        np.testing.assert_allclose(matrix, hessian, rtol=1e-12)  # rounding of sums of a few products
        assert np.min(np.linalg.eigvalsh(matrix)) > 0.0


def test_energies_equal_those_of_the_positions(robot, slope, random_states):
    states = random_states(50)
    reference = potential_of(robot, slope, np.array([0.0, 0.0, np.pi / 2, 0.0]))
    for state in states:
        kinetic = planar_oracle.kinetic(robot, slope, state[0::2], state[1::2])
        assert js.planar.kinetic_energy(robot, slope, state) == pytest.approx(float(kinetic), rel=1e-12)  # rounding
        potential = potential_of(robot, slope, state) - reference
        assert js.planar.potential_energy(robot, slope, state) == pytest.approx(float(potential), rel=1e-11, abs=1e-11)


def test_power_balance_holds_at_random_states(robot, slope, random_states, rng):
    def energy(state):
        return planar_oracle.kinetic(robot, slope, state[0::2], state[1::2]) + potential_of(robot, slope, state)

    for state, torque in zip(random_states(50), rng.uniform(-5.0, 5.0, 50), strict=True):
        alpha_rate, swing_rate = state[1], state[3]
        alpha_acceleration, swing_acceleration = js.planar.acceleration(robot, slope, state, torque)
        rate = jnp.stack([alpha_rate, alpha_acceleration, swing_rate, swing_acceleration])
        gradient = jax.grad(energy)(state)
        power = torque * (alpha_rate + swing_rate)
        assert js.planar.power(state, (torque,)) == pytest.approx(power, rel=1e-14)
        # The terms of the sum cancel down to the power; rounding is relative to the largest of them.
        assert float(gradient @ rate) == pytest.approx(power, abs=1e-12 * float(jnp.abs(gradient * rate).max()))


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
    start = (0.0, 1.0, 1.2, -2.0)
    counts = (200, 400, 800, 1600)
    drifts = [free_drift(robot, slope, start, duration=4.0, steps=steps) for steps in counts]
    orders = np.log2(np.array(drifts[:-1]) / np.array(drifts[1:]))
    # Fourth-order accuracy of the state gives at least this; the leading error term of a pendulum may conserve energy.
    assert orders[-1] > 3.8
    assert drifts[-1] < 1e-7


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


def potential_of(robot, slope, state):
    """Potential energy of the oracle at a state, J."""
    return planar_oracle.potential(robot, slope, state[0::2])


def free_drift(robot, slope, start, duration, steps):
    """Largest change of the oracle's energy along a motion without torque, J."""
    lumped = js.planar.lump(robot, slope)
    alive = js.Plant(lambda x, u: js.planar.derivative(lumped, x, u), lambda x: jnp.int32(js.Status.OK), js.planar.IS_VELOCITY)
    idle = js.Command((jnp.zeros(()),), (), jnp.int32(js.Status.OK))
    state = tuple(map(jnp.asarray, start))
    states = js.rollout(alive, lambda *_: idle, state, dt=jnp.asarray(duration / steps), steps=steps).state
    energy = jax.vmap(lambda x: planar_oracle.kinetic(robot, slope, x[0::2], x[1::2]) + potential_of(robot, slope, x))(states)
    return float(jnp.max(jnp.abs(energy - energy[0])))
