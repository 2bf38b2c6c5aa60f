"""The sliding-mode law at single states: its surfaces, its divisor, its effect on s2 and its poles."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere import sliding_mode
from jaxsphere.controllers import printed

TABLE_3 = js.SlidingModeGains()
SEEKING = js.SlidingModeGains(0.72, 3.3, 0.76, 9.0, 6.0, 10.0, 0.05)
TARGET = 10.0
SMOOTHING = 0.05

poles_of = jax.jit(js.sliding_mode_poles, static_argnames="seeking")


def test_defaults_are_table_3():
    assert [getattr(TABLE_3, leaf.name) for leaf in fields(TABLE_3)] == [0.5501, 2.3272, 0.9626, 7.4822, 2.7688, 0.6769, 0.0]


@pytest.mark.parametrize(("convention", "sign"), [("corrected", -1.0), ("printed", 1.0)])
def test_surfaces_by_hand(convention, sign, slope, random_states, rng):
    states, corrections = random_states(100), rng.uniform(-0.3, 0.3, 100)
    now = evaluate(js.Robot(), slope, SEEKING, states, corrections, convention)
    alpha, alpha_rate, swing, swing_rate = states.T
    s1 = 0.72 * (alpha - TARGET) + alpha_rate
    z = sign * 0.76 * np.tanh(s1 / 9.0)
    s2 = 3.3 * (swing - js.equilibrium_swing(js.Robot(), slope) - z - corrections) + swing_rate
    for ours, by_hand in ((now.s1, s1), (now.z, z), (now.s2, s2), (now.lyapunov, s2**2 / 2)):
        np.testing.assert_allclose(ours, by_hand, rtol=1e-12, atol=1e-14)  # rounding
    np.testing.assert_allclose(now.correction_rate, -0.05 * np.tanh(s1), rtol=1e-12)


@pytest.mark.parametrize("gains", [TABLE_3, printed.sliding_mode_gains(TABLE_3)], ids=printed.CONVENTIONS)
def test_slope_of_the_asked_swing_is_its_derivative(gains, rng):
    s1 = rng.normal(0.0, 10.0, 50)
    slope = jax.vmap(jax.grad(lambda s: sliding_mode.asked_swing(gains, s)))(s1)
    np.testing.assert_allclose(sliding_mode.asked_swing_slope(gains, s1), slope, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("gains", [TABLE_3, SEEKING])
@pytest.mark.parametrize("smoothing", [SMOOTHING, 0.0])
@pytest.mark.parametrize("convention", printed.CONVENTIONS)
def test_law_prescribes_the_rate_of_s2_through_the_dynamics(robot, slope, gains, smoothing, convention, random_states, rng):
    states, corrections = random_states(200), rng.uniform(-0.3, 0.3, 200)
    s2, rate, scale = surface_rate(robot, slope, gains, states, corrections, smoothing, convention)
    sign = np.tanh(s2 / smoothing) if smoothing else np.sign(s2)
    asked = -(gains.eta * sign + gains.k * s2)
    # Rounding relative to the largest term that cancels: the torque's part of phi'' against the drift.
    assert np.max(np.abs(rate - asked) / scale) < 1e-11
    lyapunov_rate = sliding_mode.lyapunov_rate(gains, s2, smoothing)
    np.testing.assert_allclose(lyapunov_rate, s2 * asked, rtol=1e-12, atol=1e-14)
    assert np.all(lyapunov_rate <= 0.0)


def test_hard_sign_meets_the_reaching_bound_with_equality_and_the_smooth_one_stays_below(rng):
    s2 = np.concatenate([rng.normal(size=100), [0.0]])
    bound = -TABLE_3.eta * np.abs(s2) - TABLE_3.k * s2**2
    np.testing.assert_allclose(sliding_mode.lyapunov_rate(TABLE_3, s2, 0.0), bound, rtol=1e-14)
    smooth = np.asarray(sliding_mode.lyapunov_rate(TABLE_3, s2, SMOOTHING))
    assert np.all(smooth >= bound * (1.0 + 1e-14))  # rounding where tanh is 1
    outside = np.abs(s2) > 3 * SMOOTHING  # there tanh is within 0.5 % of the sign
    np.testing.assert_allclose(smooth[outside], bound[outside], rtol=5e-3)


def test_hard_sign_has_finite_derivatives():
    rate = jax.jacfwd(lambda smoothing: sliding_mode.reaching_rate(TABLE_3, jnp.array([-0.3, 0.0, 0.3]), smoothing))(0.0)
    np.testing.assert_array_equal(rate, np.zeros(3))
    by_eta = jax.grad(lambda eta: sliding_mode.reaching_rate(replace(TABLE_3, eta=eta), 0.3, 0.0))(2.0)
    assert by_eta == 1.0


def test_margin_of_table_3():
    # Both numbers of the condition with two digits: 0.30 against 16.9.
    steepest = TABLE_3.z_u * TABLE_3.c2 / TABLE_3.phi_z
    assert steepest == pytest.approx(0.30, abs=5e-3)
    assert steepest / (1.0 - js.nonsingularity_margin(js.Robot(), TABLE_3)) == pytest.approx(16.9, abs=0.05)


def test_positive_margin_keeps_the_divisor_positive_and_a_negative_one_does_not(robot, slope, random_states, rng):
    count = 2000
    steep = np.exp(rng.uniform(np.log(0.1), np.log(1e4), count))  # c2 z_U / Phi_z; the limits are 16.9 and 24
    z_u, phi_z = rng.uniform(0.05, 0.95, count), rng.uniform(0.5, 20.0, count)
    gains = js.SlidingModeGains(rng.uniform(0.1, 3.0, count), steep * phi_z / z_u, z_u, phi_z)
    margin = np.asarray(js.nonsingularity_margin(robot, gains))
    assert 0.2 * count < np.sum(margin > 0.0) < 0.8 * count
    states = random_states(count)
    # Half of the states sit where the divisor is smallest, s1 = 0 and phi = gamma, the others anywhere.
    worst = np.arange(count) % 2 == 0
    states[worst, 1] = -np.asarray(gains.c1)[worst] * (states[worst, 0] - TARGET)
    states[worst, 2] = slope
    per_lane = jax.jit(jax.vmap(lambda gains, state: signals_of(robot, slope, gains, state, 0.0).decoupling))
    divisor = np.asarray(per_lane(js.SlidingModeGains(*map(jnp.asarray, per_field(gains, count))), states))
    assert np.all(divisor[margin > 0.0] > 0.0)
    assert np.all(divisor[worst & (margin < 0.0)] < 0.0)
    assert np.any(divisor[~worst & (margin < 0.0)] > 0.0)  # so that between the two there is a state that divides by zero


def test_margin_is_differentiable():
    gradient = jax.grad(lambda gains: js.nonsingularity_margin(js.Robot(), gains))(TABLE_3)
    ratio = 1.0 - js.nonsingularity_margin(js.Robot(), TABLE_3)
    expected = {"c2": -ratio / TABLE_3.c2, "z_u": -ratio / TABLE_3.z_u, "phi_z": ratio / TABLE_3.phi_z}
    for leaf in fields(gradient):
        assert getattr(gradient, leaf.name) == pytest.approx(expected.get(leaf.name, 0.0), rel=1e-12)


@pytest.mark.parametrize(("gains", "seeking"), [(TABLE_3, False), (TABLE_3, True), (SEEKING, True)])
@pytest.mark.parametrize("degrees", [-5.0, 0.0, 10.0])
def test_sliding_mode_poles_are_the_roots_of_the_polynomial(robot, gains, seeking, degrees):
    slope = np.deg2rad(degrees)
    poles = poles_of(robot, slope, gains, seeking=seeking)
    roots = np.roots(polynomial(robot, slope, gains, seeking))
    # Roots of a cubic or quartic with well separated roots lose a few digits of sixteen.
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(roots), rtol=1e-8, atol=1e-8)


def test_poles_of_table_3_are_hurwitz_and_those_of_a_stiff_outer_loop_are_not(slope):
    assert np.all(poles_of(js.Robot(), slope, TABLE_3, seeking=False).real < 0.0)
    eager = replace(TABLE_3, c1=8.0)
    assert np.any(poles_of(js.Robot(), slope, eager, seeking=False).real > 0.0)


def test_correction_stops_at_its_limit_and_returns(slope):
    far, limit = np.array([-20.0, 0.0, 0.5, 0.0]), sliding_mode.CORRECTION_LIMIT
    assert signals_of(js.Robot(), slope, SEEKING, far, limit).correction_rate == 0.0
    assert signals_of(js.Robot(), slope, SEEKING, far, -limit).correction_rate > 0.0
    assert signals_of(js.Robot(), slope, SEEKING, -2.0 * far, limit).correction_rate < 0.0
    assert signals_of(js.Robot(), slope, SEEKING, -2.0 * far, -limit).correction_rate == 0.0


@pytest.mark.parametrize("field", ["c1", "c2", "z_u", "phi_z", "eta", "k"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_gains_must_be_positive(field, value):
    with pytest.raises(ValueError, match=rf"gains\.{field} = {value:g} is not admissible; type a") as caught:
        sliding_mode.check_gains(replace(TABLE_3, **{field: value}))
    assert "\n" not in str(caught.value)


def test_other_gain_faults():
    with pytest.raises(ValueError, match=r"gains\.z_u = 1 .* above 0 and below 1"):
        sliding_mode.check_gains(replace(TABLE_3, z_u=1.0))
    with pytest.raises(ValueError, match=r"gains\.k_i = -0\.1 .* at least 0"):
        sliding_mode.check_gains(replace(TABLE_3, k_i=-0.1))
    with pytest.raises(TypeError, match=r"gains = \{.* are no SlidingModeGains"):
        sliding_mode.check_gains({"c1": 1.0})


def polynomial(robot, slope, gains, seeking):
    """Coefficients of A s^2 (s + c2) - (D s^2 - G) c2 (kappa_z + k_i / s) (s + c1), times s with the seeking integral."""
    swing = float(js.equilibrium_swing(robot, slope))
    m11, m12, m22 = (float(x) for x in js.planar.inertia(js.planar.lump(robot, slope), (0.0, 0.0, swing, 0.0)))
    weight = robot.pendulum_mass * robot.gravity * robot.pendulum_length * np.cos(swing)
    feedback = np.poly1d([gains.z_u / gains.phi_z])
    left = np.poly1d([m11 - m12, 0.0, 0.0]) * np.poly1d([1.0, gains.c2])
    if seeking:
        feedback = feedback * np.poly1d([1.0, 0.0]) + gains.k_i
        left = left * np.poly1d([1.0, 0.0])
    return (left - np.poly1d([m12 - m22, 0.0, -weight]) * gains.c2 * feedback * np.poly1d([1.0, gains.c1])).coeffs


def per_field(gains, count):
    """Every gain as a vector of lanes, in the order of the fields."""
    return [np.broadcast_to(getattr(gains, leaf.name), (count,)) for leaf in fields(gains)]


def signals_of(robot, slope, gains, state, correction, smoothing=SMOOTHING, convention="corrected"):
    """Signals of the law at one state (4,)."""
    lumped, equilibrium = js.planar.lump(robot, slope), js.equilibrium_swing(robot, slope)
    state = tuple(jnp.asarray(state))
    gains = printed.sliding_mode_gains(gains) if convention == "printed" else gains
    return sliding_mode.signals(lumped, equilibrium, gains, state, jnp.asarray(correction), TARGET, smoothing)


def evaluate(robot, slope, gains, states, corrections, convention):
    """Signals of the law at many states."""
    lanes = jax.vmap(lambda x, zeta: signals_of(robot, slope, gains, x, zeta, convention=convention))
    return jax.jit(lanes)(states, corrections)


def surface_rate(robot, slope, gains, states, corrections, smoothing, convention):
    """Value and rate of s2 along the motion under the law's torque, and the largest term of the rate."""

    def one(state, correction):
        now = signals_of(robot, slope, gains, state, correction, smoothing, convention)
        torque = now.equivalent + now.switching
        rate = jnp.stack(js.planar.derivative(js.planar.lump(robot, slope), tuple(state), (torque,)))

        def surface(state, correction):
            return signals_of(robot, slope, gains, state, correction, smoothing, convention).s2

        s2, s2_rate = jax.jvp(surface, (state, correction), (rate, now.correction_rate))
        b1, b2 = (jnp.abs(js.planar.canonical_form(js.planar.lump(robot, slope), tuple(state))[i]) for i in (1, 3))
        return s2, s2_rate, 1.0 + (gains.c2 * b1 + b2) * jnp.abs(torque)

    return (np.asarray(x) for x in jax.jit(jax.vmap(one))(states, corrections))


def test_three_poles_of_a_seeking_law_are_those_without_seeking(slope):
    poles = js.sliding_mode_poles(js.Robot(), slope, SEEKING)
    roots = np.roots(polynomial(js.Robot(), slope, replace(SEEKING, k_i=0.0), False))
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(roots), rtol=1e-8)
