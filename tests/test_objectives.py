"""The terms of the objective, recomputed from the rollout; the residual form, user's terms and the stability margin."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning.objectives.stability import characteristic_polynomial, hurwitz_margin, hurwitz_margins, routh_column

GAINS = js.SlidingModeGains(c1=0.7, eta=4.0)
OBJECTIVE = tuning.RestToRest(duration=1.2, dt=8e-3, swing_limit=float(np.deg2rad(5.0)))
# Divides by nearly zero and has c1 > c2.
WILD = js.SlidingModeGains(c1=4.0, c2=1.0, z_u=0.9, phi_z=0.06, eta=4.0)
RUSHED = js.SlidingModeGains(c1=4.0, c2=1.0, z_u=0.9, phi_z=0.6, eta=4.0)
EVERY = tuning.Weights(*(0.5 + i for i in range(len(tuning.Weights._fields))))


def test_terms_equal_those_of_the_saved_rollout():
    terms = jax.jit(OBJECTIVE.terms)(GAINS)
    found = OBJECTIVE.rollout(GAINS)
    time, alpha, swing = np.asarray(found.time)[:-1], np.asarray(found.state[:-1, 0]), np.asarray(found.state[:-1, 2])
    deviation = np.abs(swing - float(js.equilibrium_swing(js.Robot(), OBJECTIVE.task.slope)))
    excess = np.rad2deg(np.maximum(deviation - OBJECTIVE.swing_limit, 0.0))
    step = GAINS.eta / np.asarray(found.diagnostics.decoupling)[:-1]
    error = alpha / 10.0 - 1.0
    expected = {
        "itae": 8e-3 * np.sum(time * (np.sqrt(error**2 + 1e-6) - 1e-3)),
        "swing": 8e-3 * np.sum(2.0 * (np.sqrt(1.0 + excess**2) - 1.0)),
        "torque": 8e-3 * np.sum(np.asarray(found.torque[:-1]) ** 2),
        "chatter": np.mean(step**2),
        "settling": 8e-3 * np.sum(1.0 / (1.0 + np.exp(-(np.sqrt(error**2 + 1e-6) - 0.02) / 4e-3))),
        "prior": np.log(0.7 / 0.5501) ** 2 + np.log(0.9626 / 0.35) ** 2 + np.log(4.0 / 2.7688) ** 2,
    }
    for name, value in expected.items():
        assert value > 0.0
        assert getattr(terms, name) == pytest.approx(value, rel=1e-10), name  # sums in another order
    assert terms.overshoot == terms.singularity == terms.stability == 0.0


def test_overshoot_is_counted_beyond_its_limit():
    objective = replace(OBJECTIVE, travel=1.0, duration=2.4, overshoot_limit=0.05)
    error = np.asarray(objective.rollout(RUSHED).state[:-1, 0]) - 1.0
    excess = 100.0 * np.maximum(error - 0.05, 0.0)
    assert excess.max() > 1.0
    expected = 8e-3 * np.sum(2.0 * (np.sqrt(1.0 + excess**2) - 1.0))
    assert objective.terms(RUSHED).overshoot == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("continuous", [False, True])
@pytest.mark.parametrize("slope", [0.17, 0.4], ids=["settles", "past the bound"])
def test_objective_is_the_weighted_sum_of_its_terms_and_of_its_squared_residuals(slope, continuous):
    objective = replace(OBJECTIVE, weights=EVERY, control_period=None if continuous else 8e-3, slope=slope)

    @jax.jit
    def evaluate(gains):
        residuals = objective.residuals(gains)
        return objective(gains), objective.terms(gains), jnp.sum(residuals * residuals), objective.rollout(gains).status

    value, terms, squares, status = evaluate(GAINS)
    assert status == (js.Status.NOT_SETTLED if slope == 0.17 else js.Status.INFEASIBLE_LEAN)
    expected = sum(w * float(t) for w, t in zip(EVERY, terms, strict=True))
    assert value == pytest.approx(expected, rel=1e-10)  # the first sums inside the rollout, the second over what it saved
    assert squares == pytest.approx(expected, rel=1e-12)


def test_gradient_of_the_streamed_sum_is_that_of_the_residuals():
    objective = replace(OBJECTIVE, weights=EVERY, duration=0.8)
    streamed = jax.jit(jax.jacfwd(objective))(GAINS)
    saved = jax.jit(jax.grad(lambda gains: jnp.sum(objective.residuals(gains) ** 2)))(GAINS)
    for name in ("c1", "c2", "z_u", "phi_z", "eta", "k"):
        assert getattr(streamed, name) == pytest.approx(float(getattr(saved, name)), rel=1e-9), name
        assert getattr(streamed, name) != 0.0


def test_plant_start_delay_and_bias_reach_both_forms_of_the_objective():
    base = replace(OBJECTIVE, weights=EVERY, duration=0.4)
    nothing = (js.Robot(), jnp.array([0.0, 0.0, 0.57, 0.0]), jnp.asarray(False), jnp.zeros(4))
    given = (
        replace(js.Robot(), pendulum_mass=2.2),
        jnp.array([1.5, 0.1, 0.5, 0.2]),
        jnp.asarray(True),
        jnp.array([0.1, 0.0, 0.05, 0.0]),
    )

    @jax.jit
    def evaluate(plant, initial_state, late, sensor_bias):
        names = {"plant": plant, "initial_state": initial_state, "delayed": late, "sensor_bias": sensor_bias}
        objective = replace(base, **names)
        return objective(GAINS), jnp.sum(objective.residuals(GAINS) ** 2), objective.cost_so_far(GAINS)[-1]

    @jax.jit
    def tracking(plant, initial_state, late, sensor_bias):
        found = js.rest_to_rest(
            js.Robot(), base.task.slope, GAINS, 10.0, 0.4, 8e-3, base.task.smoothing, 5.0, plant=plant,
            initial_state=initial_state, delayed=late, sensor_bias=sensor_bias, control_period=8e-3, throw=False,
        )  # fmt: skip
        return found.state, replace(
            base, plant=plant, initial_state=initial_state, delayed=late, sensor_bias=sensor_bias
        ).rollout(GAINS).state

    plain = evaluate(*nothing)[0]
    for index in range(len(nothing)):
        mixed = [*nothing]
        mixed[index] = given[index]
        streamed, squares, so_far = evaluate(*mixed)
        assert streamed == pytest.approx(float(squares), rel=1e-9)  # one sums inside the rollout, one over what it saved
        assert so_far == pytest.approx(float(squares), rel=1e-9)
        assert abs(float(streamed / plain) - 1.0) > 1e-6, index
        np.testing.assert_allclose(*tracking(*mixed), rtol=1e-9, atol=1e-12)


def test_swing_within_its_limit_costs_nothing():
    assert replace(OBJECTIVE, swing_limit=1.0).terms(GAINS).swing == 0.0


def test_barriers_vanish_inside_and_rise_outside():
    terms = OBJECTIVE.terms(WILD)
    margin = float(js.nonsingularity_margin(js.Robot(), WILD))
    assert terms.singularity == pytest.approx((1.0 - margin / 0.2) ** 2)
    hurwitz = np.asarray(hurwitz_margins(js.Robot(), OBJECTIVE.task.slope, WILD))
    assert hurwitz.min() < 0.0
    assert terms.stability == pytest.approx(np.sum(np.maximum(1.0 - hurwitz / 0.1, 0.0) ** 2))


def test_own_term_adds_its_weighted_square():
    peak = tuning.Term("peak rate", lambda trajectory: jnp.max(trajectory.state[:, 1]), weight=0.25)
    value = float(jnp.max(OBJECTIVE.rollout(GAINS).state[:, 1]))
    with_own = replace(OBJECTIVE, extra=(peak,))
    assert with_own(GAINS) == pytest.approx(float(OBJECTIVE(GAINS)) + 0.25 * value**2, rel=1e-10)


def test_faulty_terms_get_one_sentence():
    vector = tuning.Term("rates", lambda trajectory: trajectory.state[:, 1])
    with pytest.raises(ValueError, match=r"term 'rates' returns shape \(151,\); return one scalar"):
        replace(OBJECTIVE, extra=(vector,))(GAINS)
    nothing = replace(OBJECTIVE, weights=tuning.Weights(*(0.0,) * len(tuning.Weights._fields)))
    for function in (nothing, nothing.residuals):
        with pytest.raises(ValueError, match=r"weights leaves the objective without terms; type a positive one"):
            function(GAINS)


def test_routh_counts_the_roots_in_the_right_half_plane(rng):
    for size in (4, 5):
        for _ in range(100):
            coefficients = rng.normal(size=size)
            column = np.asarray(routh_column(jnp.asarray(coefficients)))
            changes = np.sum(np.diff(np.sign(column)) != 0)
            assert changes == np.sum(np.roots(coefficients).real > 0.0)


@pytest.mark.parametrize("k_i", [0.0, 0.05])
def test_polynomial_has_the_sliding_mode_poles_and_the_margin_their_sign(robot, rng, k_i):
    for draw in rng.uniform(0.3, 3.0, (10, 4)):
        gains = js.SlidingModeGains(c1=draw[0], c2=draw[1], z_u=0.3 * draw[2], phi_z=draw[3], k_i=k_i)
        poles = np.sort_complex(np.asarray(js.sliding_mode_poles(robot, 0.1, gains, seeking=k_i > 0.0)))
        coefficients = np.asarray(characteristic_polynomial(robot, 0.1, gains))
        roots = np.sort_complex(np.roots(coefficients if k_i > 0.0 else coefficients[:4]))
        np.testing.assert_allclose(roots, poles, rtol=1e-6, atol=1e-6 * np.abs(poles).max())
        assert bool(hurwitz_margin(robot, 0.1, gains) > 0.0) == bool(poles.real.max() < 0.0)
