"""Standing on the slope: equilibrium, bound, saddle-node, what lies past it, and the zero dynamics."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import planar_oracle
import pytest

import jaxsphere as js

oracle_acceleration = jax.jit(planar_oracle.acceleration)


def test_equilibrium_swing_of_set_a_at_ten_degrees(slope):
    assert np.rad2deg(js.equilibrium_swing(js.Robot(), slope)) == pytest.approx(32.684, abs=5e-4)  # half the last digit


@pytest.mark.parametrize("fraction", [-0.9, -0.3, 0.0, 0.5, 0.99])
def test_both_equilibria_stand_still_under_the_holding_torque(robot, fraction):
    slope = fraction * js.climbing_bound(robot)
    found = js.equilibria(robot, slope)
    assert found.exists
    for swing in (found.lower, found.upper):
        torque = robot.pendulum_mass * robot.gravity * robot.pendulum_length * jnp.sin(swing)
        rest = jnp.array([0.3, 0.0, swing, 0.0])
        # Gravity's accelerations of some 10 rad/s2 cancel to rounding, amplified by the condition of the inertia matrix.
        np.testing.assert_allclose(oracle_acceleration(robot, slope, rest, torque), 0.0, atol=1e-12)


def test_bound_is_where_the_sine_reaches_one(robot):
    bound = js.climbing_bound(robot)
    assert js.equilibrium.swing_sine(robot, bound) == pytest.approx(1.0, abs=1e-15)  # one rounding
    assert js.equilibrium.can_hold(robot, 0.999 * bound)
    assert js.equilibrium.can_hold(robot, -0.999 * bound)
    assert not js.equilibrium.can_hold(robot, 1.001 * bound)
    assert not js.equilibrium.can_hold(robot, -1.001 * bound)


def test_bound_does_not_depend_on_gravity_or_inertia(robot):
    other = replace(robot, gravity=1.62, shell_inertia=2.0 * robot.shell_inertia, gimbal_inertia=3.0 * robot.gimbal_inertia)
    assert js.climbing_bound(other) == js.climbing_bound(robot)


def test_a_heavy_long_pendulum_holds_every_slope():
    assert js.climbing_bound(replace(js.Robot(), pendulum_mass=20.0, pendulum_length=0.2)) == np.pi / 2


def test_equilibria_merge_like_a_saddle_node(robot):
    bound = js.climbing_bound(robot)
    distances = 1e-3 / 4.0 ** np.arange(5)
    found = jax.vmap(lambda d: js.equilibria(robot, bound - d))(distances)
    gaps = np.asarray(found.upper - found.lower)
    np.testing.assert_allclose(found.upper + found.lower, np.pi, rtol=1e-15)
    # A square root doubles its argument's ratio of 4; the next term of the expansion is of the order of the distance.
    np.testing.assert_allclose(gaps[:-1] / gaps[1:], 2.0, rtol=1e-3)
    assert np.all(gaps > 0.0)
    assert not js.equilibria(robot, bound + 1e-9).exists


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_past_the_bound_nothing_is_nan_and_the_gradient_vanishes(robot, sign):
    slopes = sign * js.climbing_bound(robot) * np.array([1.0 + 1e-12, 1.01, 2.0, 3.0])

    def lean(slope, robot):
        return js.equilibrium_swing(robot, slope)

    value, (by_slope, by_robot) = jax.vmap(jax.value_and_grad(lean, (0, 1)), (0, None))(slopes, robot)
    np.testing.assert_array_equal(value, np.full(4, sign * np.pi / 2))
    for leaf in jax.tree.leaves((by_slope, by_robot)):
        np.testing.assert_array_equal(leaf, 0.0)
    found = jax.vmap(lambda s: js.equilibria(robot, s))(slopes)
    assert not found.exists.any()
    np.testing.assert_array_equal(found.lower, found.upper)
    assert np.isfinite(jax.vmap(lambda s: js.zero_dynamics_poles(robot, s))(slopes)).all()


def test_lanes_below_the_bound_do_not_feel_those_past_it(robot):
    bound = js.climbing_bound(robot)
    slopes = bound * np.array([0.5, 1.5, -0.7, -1.2])
    gradient = jax.vmap(jax.grad(lambda s: js.equilibrium_swing(robot, s)))(slopes)
    ratio = 1.0 / np.sin(bound)
    held = ratio * np.cos(slopes) / np.sqrt(1.0 - np.minimum((ratio * np.sin(slopes)) ** 2, 0.999))
    np.testing.assert_allclose(gradient, np.where([1, 0, 1, 0], held, 0.0), rtol=1e-12)  # the same formula, rounding


def test_bound_is_differentiable_on_both_sides_of_its_own_limit():
    gradient = jax.vmap(jax.grad(lambda mass: js.climbing_bound(replace(js.Robot(), pendulum_length=0.2, pendulum_mass=mass))))
    below, above = gradient(np.array([2.05, 20.0]))
    assert below > 0.0
    assert above == 0.0


def test_zero_dynamics_poles_of_set_a(slope):
    poles = js.zero_dynamics_poles(js.Robot(), slope)
    np.testing.assert_allclose(poles, [-26.81, 26.81], atol=5e-3)  # half the last digit


@pytest.mark.parametrize("degrees", [-6.0, 0.0, 4.0, 10.0])
def test_zero_dynamics_poles_equal_the_formula(robot, degrees):
    slope = np.deg2rad(degrees)
    swing = float(js.equilibrium_swing(robot, slope))
    expected = pole_by_hand(robot, slope, swing)
    # Rounding, amplified by the cancellation in M12 - M22.
    np.testing.assert_allclose(js.zero_dynamics_poles(robot, slope), [-expected, expected], rtol=1e-10, atol=1e-12)


def test_zero_dynamics_at_the_upper_equilibrium(robot, slope):
    upper = float(js.equilibria(robot, slope).upper)
    expected = pole_by_hand(robot, slope, upper)
    np.testing.assert_allclose(js.zero_dynamics_poles(robot, slope, upper), [-expected, expected], rtol=1e-10)


def test_a_heavy_gimbal_turns_the_zero_dynamics_into_a_centre(slope):
    light, swing = js.Robot(), js.equilibrium_swing(js.Robot(), slope)
    arm = light.shell_radius * jnp.cos(swing - slope) - light.pendulum_length
    limit = light.pendulum_mass * light.pendulum_length * arm  # the moment at which M12 = M22
    centre = js.zero_dynamics_poles(replace(light, gimbal_inertia=np.full(3, 1.2 * limit)), slope)
    saddle = js.zero_dynamics_poles(replace(light, gimbal_inertia=np.full(3, 0.8 * limit)), slope)
    np.testing.assert_array_equal(centre.real, 0.0)
    assert np.all(np.abs(centre.imag) > 1.0)
    np.testing.assert_array_equal(saddle.imag, 0.0)
    assert saddle[1].real > 1.0


def pole_by_hand(robot, slope, swing):
    """Square root of m_p g l cos(phi) / (M12 - M22), 1/s."""
    weight = robot.pendulum_mass * robot.gravity * robot.pendulum_length
    m12 = robot.pendulum_mass * robot.shell_radius * robot.pendulum_length * np.cos(swing - slope)
    m22 = robot.pendulum_mass * robot.pendulum_length**2 + robot.gimbal_inertia[2]
    return np.emath.sqrt(weight * np.cos(swing) / (m12 - m22))
