"""What raises the closed-loop bound: implicit derivatives against bisection, and gains tuned to climb."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from tuning import climbing

QUICK = js.Numerics(duration=60.0, dt=1e-2)
CLIMB, GAINS = js.PlanarTask(), js.SlidingModeGains()
NAMES = ("z_u", "phi_z", "pendulum_mass", "shell_radius", "travel")


def test_saddle_is_an_equilibrium_with_one_way_out():
    slope = 0.31
    task = replace(CLIMB, slope=slope)
    rest = climbing.saddle(task, GAINS)
    run = js.rest_to_rest(
        js.Robot(), slope, duration=0.1, dt=1e-3, initial_state=rest, travel=10.0 - float(rest[0]), throw=False
    )
    np.testing.assert_allclose(run.state[-1], rest, atol=1e-9)
    assert rest[2] == pytest.approx(np.pi - js.equilibrium_swing(js.Robot(), slope))
    pole, direction = climbing.unstable_direction(task, GAINS)
    nudge = 1e-6 * np.array([1.0, 2.0, -1.0, 0.5])
    nudged = rest + nudge
    left = js.rest_to_rest(
        js.Robot(), slope, duration=1.0, dt=1e-3, initial_state=nudged, travel=10.0 - float(nudged[0]), save_every=None
    ).state[-1]
    # Seen along the left eigenvector every nudge grows by exp(pole t).
    growth = np.dot(direction, np.asarray(left - rest)) / np.dot(direction, nudge)
    assert np.log(growth) == pytest.approx(pole, rel=1e-2)
    assert pole > 0.1


def test_small_swings_have_no_saddle():
    assert np.isnan(climbing.saddle(replace(CLIMB, slope=0.2), js.SlidingModeGains(z_u=0.1))).any()


def test_implicit_derivatives_equal_differences_of_bisections_past_the_saddle():
    found = climbing.climb_sensitivity(CLIMB, GAINS, QUICK, NAMES, tolerance=1e-9)
    assert found.mode == "past the saddle"
    assert found.margins[0] * found.margins[1] < 0.0
    differences = climbing.sensitivity_by_differences(CLIMB, GAINS, NAMES, QUICK, tolerance=1e-9)
    # Second-order terms of the differences, and the bracket over twice the step.
    np.testing.assert_allclose(found.derivative, differences, rtol=1e-4, atol=2e-6)
    assert found.derivative[NAMES.index("pendulum_mass")] > 0.1
    assert found.derivative[NAMES.index("z_u")] < -0.01


def test_implicit_derivatives_equal_differences_of_bisections_where_climbs_are_too_slow():
    slow, gains = replace(QUICK, duration=20.0), js.SlidingModeGains(z_u=0.25, c1=0.3)
    names = ("z_u", "phi_z", "pendulum_mass")
    found = climbing.climb_sensitivity(CLIMB, gains, slow, names, tolerance=1e-9)
    assert found.mode == "too slow"
    assert found.time == 20.0
    assert found.margins[0] * found.margins[1] <= 0.0
    differences = climbing.sensitivity_by_differences(CLIMB, gains, names, slow, tolerance=1e-9)
    np.testing.assert_allclose(found.derivative, differences, rtol=1e-3)


def test_scaling_multiplies_what_is_named():
    names, factors = ("c1", "torque_limit", "shell_inertia"), jnp.log(jnp.array([2.0, 3.0, 4.0]))
    task, gains = climbing.scaled(replace(CLIMB, torque_limit=2.0), GAINS, names, factors)
    assert gains.c1 == pytest.approx(2.0 * 0.5501)
    assert task.torque_limit == pytest.approx(6.0)
    np.testing.assert_allclose(task.robot.shell_inertia, 4.0 * 0.018)
    with pytest.raises(ValueError, match="name = 'weight'"):
        climbing.scaled(CLIMB, GAINS, ("weight",), jnp.zeros(1))


def test_faults_are_one_sentence():
    with pytest.raises(ValueError, match="leave them None"):
        climbing.climb_sensitivity(replace(CLIMB, control_period=1e-2))
    with pytest.raises(ValueError, match="smoothing = 0"):
        climbing.climb_sensitivity(replace(CLIMB, smoothing=0.0))
    with pytest.raises(ValueError, match="rounds = 0"):
        climbing.tune_to_climb(CLIMB, rounds=0)


def test_one_round_of_tuning_raises_the_bound_that_the_hard_sign_holds_too():
    climb = replace(CLIMB, torque_limit=5.0)
    found = climbing.tune_to_climb(climb, GAINS, QUICK, rounds=1, iterations=8, dt=2.4e-2, progress=False)
    assert len(found.bounds) == 2
    gap = found.static_bound - found.bounds[0]
    assert found.bounds[1] > found.bounds[0] + 0.2 * gap
    assert found.bounds[1] < found.static_bound
    hard = replace(climb, slope=found.bounds[1] - 0.1 * gap, smoothing=0.0, control_period=2e-3)
    ends = js.batch(lambda gains: js.outcome_run(hard, gains, replace(QUICK, dt=2e-3)), ragged=True)(
        jax.tree.map(lambda *pair: np.array(pair), found.gains, GAINS)
    ).status
    assert [int(code) == js.Status.OK for code in ends] == [True, False]
