"""Scenarios, aggregates, the certificate and its interval, delay and sensor bias."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxsphere as js
import tuning
from tuning.robust import scenarios as robust

MASS_LIKE = ("shell_mass", "gimbal_mass", "pendulum_mass", "shell_inertia", "gimbal_inertia")
WIDE = tuning.Uncertainty(
    relative=dict.fromkeys(MASS_LIKE, 0.2), slope=(0.1, 0.26), swing=0.1, delayed=0.5, known=False,
    sensor_bias=(0.01, 0.0, 0.02, 0.0),
)  # fmt: skip


@pytest.mark.parametrize(("failures", "count"), [(0, 2000), (3, 2000), (20, 20), (7, 31)])
@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_clopper_pearson_against_scipy(failures, count, confidence):
    expected = stats.binomtest(failures, count).proportion_ci(confidence, method="exact")
    np.testing.assert_allclose(tuning.clopper_pearson(failures, count, confidence), expected, rtol=1e-8, atol=1e-12)


def test_samples_fill_their_ranges_and_repeat_with_their_seed():
    drawn, excluded = tuning.sample(WIDE, js.Robot(), 400, seed=3)
    again, _ = tuning.sample(WIDE, js.Robot(), 400, seed=3)
    other, _ = tuning.sample(WIDE, js.Robot(), 400, seed=4)
    for one, two in zip(jax.tree.leaves(drawn), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.any(other.slope == drawn.slope)
    assert excluded > 0
    assert np.all(jax.vmap(js.climbing_bound)(drawn.plant) >= drawn.slope + WIDE.margin)
    for name in WIDE.relative:
        factor = np.asarray(getattr(drawn.plant, name)) / np.asarray(getattr(js.Robot(), name))
        assert 0.8 < factor.min() < 0.84
        assert 1.16 < factor.max() < 1.2
        np.testing.assert_array_equal(getattr(drawn.robot, name)[0], getattr(js.Robot(), name))  # unknown to the controller
    np.testing.assert_array_equal(drawn.plant.shell_radius, 0.15)
    assert 0.4 < np.mean(drawn.delayed) < 0.6
    assert np.abs(drawn.sensor_bias[:, 2]).max() == pytest.approx(0.02, rel=0.05)
    # About phi_0 of the robot that the controller believes in.
    swung = drawn.initial_state[:, 2] - jax.vmap(lambda slope: js.equilibrium_swing(js.Robot(), slope))(drawn.slope)
    assert 0.095 < np.abs(swung).max() <= 0.1
    known, _ = tuning.sample(replace(WIDE, known=True), js.Robot(), 5, seed=3)
    np.testing.assert_array_equal(known.robot.pendulum_mass, known.plant.pendulum_mass)


def one_of(objective, scenarios, index):
    """The objective of one scenario alone."""
    drawn = {name: getattr(scenarios, name) for name in robust.drawn_fields(scenarios)}
    return replace(objective, **jax.tree.map(lambda leaf: leaf[index], drawn))


def test_aggregates():
    values = jnp.array([3.0, 1.0, 10.0, 2.0])
    assert robust.aggregate(values, "mean") == 4.0
    assert robust.aggregate(values, "worst") == 10.0
    assert robust.aggregate(values, "cvar", 0.5) == 6.5
    assert robust.aggregate(values, "cvar", 0.99) == 10.0


def test_robust_objective_is_the_mean_over_its_scenarios_and_of_its_residuals():
    scenarios, _ = tuning.sample(WIDE, js.Robot(), 3, seed=0)
    base, gains = tuning.RestToRest(duration=0.4, dt=2e-2), js.SlidingModeGains(k_i=0.03)
    objective = tuning.Robust(base, scenarios)

    @jax.jit
    def both(gains):
        every = [replace(objective, aggregate=how, alpha=0.4) for how in robust.AGGREGATES]
        return [(one(gains), jnp.sum(one.residuals(gains) ** 2)) for one in every], objective.limits(gains)

    ((value, squares), *others), limits = both(gains)
    single = [
        one_of(base, scenarios, i)(gains) for i in range(3)
    ]  # fmt: skip
    assert value == pytest.approx(float(sum(single)) / 3.0, rel=1e-12)
    assert squares == pytest.approx(float(value), rel=1e-12)
    worst = sorted(map(float, single))
    for (one, sum_of_squares), expected in zip(others, ((worst[1] + worst[2]) / 2.0, worst[2]), strict=True):
        assert one == pytest.approx(expected, rel=1e-12)
        assert sum_of_squares == pytest.approx(expected, rel=1e-12)
    assert limits.soft == {}
    assert limits.hard["stability"] < 0.0


def test_a_late_command_acts_one_period_after_its_sample():
    settings = {"duration": 0.08, "dt": 2e-3, "control_period": 1e-2, "smoothing": 0.2}
    late = js.rest_to_rest(js.Robot(), 0.17, delayed=True, **settings)
    prompt = js.rest_to_rest(js.Robot(), 0.17, delayed=False, **settings)
    plain = js.rest_to_rest(js.Robot(), 0.17, **settings)
    np.testing.assert_allclose(prompt.state, plain.state, rtol=1e-12, atol=1e-14)  # two programs
    torque = np.asarray(late.torque[:, 0])
    np.testing.assert_allclose(torque[:10], torque[0], rtol=1e-12)  # the first command rules two periods
    asked = np.asarray(late.diagnostics.equivalent + late.diagnostics.switching)
    np.testing.assert_allclose(torque[10:40:5], asked[5:35:5], rtol=1e-9)
    with pytest.raises(ValueError, match="delayed needs a sampled controller"):
        js.rest_to_rest(js.Robot(), 0.17, delayed=True)


def test_a_sensor_bias_shifts_what_the_law_sees():
    bias = jnp.array([0.5, 0.0, 0.0, 0.0])
    biased = js.rest_to_rest(js.Robot(), 0.17, duration=0.4, dt=1e-2, sensor_bias=bias)
    nearer = js.rest_to_rest(js.Robot(), 0.17, travel=9.5, duration=0.4, dt=1e-2)
    np.testing.assert_allclose(biased.state, nearer.state, rtol=1e-9, atol=1e-12)


def test_certificate_counts_what_it_should():
    spread = tuning.Uncertainty(slope=(0.1, 0.26))
    settings = {"count": 24, "duration": 6.3, "dt": 5e-3, "control_period": 5e-3}
    found = tuning.certify(js.SlidingModeGains(), spread, **settings)
    scenarios, _ = tuning.sample(spread, js.Robot(), 24, seed=2000)
    settled = np.isfinite(found.settling_times)
    assert 0 < settled.sum() < 24
    assert found.failures == found.not_settled + found.ended_early == 24 - settled.sum()
    index = int(np.argmin(settled))
    task = {"duration": 6.3, "dt": 5e-3, "control_period": 5e-3, "torque_limit": 5.0, "smoothing": 0.0}
    alone = js.rest_to_rest(js.Robot(), scenarios.slope[index], throw=False, **task)
    assert alone.status != js.Status.OK
    assert found.low < found.rate < found.high
    assert f"{found.failures} of 24 samples failed" in found.sentence()
    strict = tuning.certify(js.SlidingModeGains(), spread, swing_limit=0.1, **settings)
    assert strict.over_limits == 24  # the equilibrium alone is steeper
    assert strict.failures == 24


def steep():
    """Three scenarios of which the middle one is past its bound."""
    scenarios, _ = tuning.sample(WIDE, js.Robot(), 3, seed=0)
    return tuning.Robust(tuning.RestToRest(), replace(scenarios, slope=scenarios.slope.at[1].set(0.5)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tuning.sample(tuning.Uncertainty(relative={"mass": 0.1}), js.Robot(), 2, 0), "relative = 'mass' is not known"),
        (lambda: tuning.sample(tuning.Uncertainty(slope=(0.5, 0.6)), js.Robot(), 2, 0), "leaves 0 of 8 drawn robots"),
        (lambda: tuning.sample(tuning.Uncertainty(slope=(0.2, 0.1)), js.Robot(), 2, 0), "is no range; type the lowest first"),
        (lambda: robust.aggregate(jnp.ones(2), "median"), "aggregate = 'median' is not known"),
        (lambda: steep().check(), "scenarios: 1 of 3 robots cannot hold their slope, the first is lane 1; type gentler slopes"),
        (lambda: tuning.clopper_pearson(5, 4), "failures = 5 is not between 0 and count = 4"),
    ],
)
def test_faults_get_one_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()
