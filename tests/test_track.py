"""Tracking as one call: references of all kinds, statuses, batches, gradients and what a user types wrong."""

import dataclasses
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere import references

ROBOT, SLOPE = js.Robot(), float(np.deg2rad(10.0))
QUICK = {"duration": 0.4, "dt": 4e-3, "save_every": 10}
quick = partial(js.track_line, ROBOT, SLOPE, **QUICK)


def parabola(time):
    """A user's own reference: arrays in place of pairs."""
    return jnp.array([0.1 * time**2, 0.0]), jnp.array([0.2 * time, 0.0]), jnp.array([0.2, 0.0])


def test_line_of_table_4_is_followed_by_the_sampled_robot():
    run = js.track_line(ROBOT, SLOPE, speed=0.5, control_period=1e-3, save_every=20)
    assert int(run.status) == js.Status.OK
    wanted = 0.5 * np.sqrt(0.5) * np.asarray(run.time)[:, None] * np.ones(2)
    distance = np.hypot(*(np.asarray(run.state[:, :2]) - wanted).T)
    late = distance[np.asarray(run.time) >= 5.0].max()
    # Samples every 20 ms may miss the running maximum, never exceed it.
    assert late <= float(run.metrics.late_error) < 0.0003
    assert float(run.metrics.final_error) == pytest.approx(distance[-1])
    assert float(run.metrics.peak_torque) <= 5.0


def test_metrics_are_those_of_the_dense_trajectory():
    run = quick(dt=1e-3, save_every=1, settled_after=0.2, throw=False)
    wanted = 0.5 * np.sqrt(0.5) * np.asarray(run.time)[:, None] * np.ones(2)
    distance = np.hypot(*(np.asarray(run.state[:, :2]) - wanted).T)
    # The running mean is a left Riemann sum.
    assert float(run.metrics.rms_error) == pytest.approx(np.sqrt(np.mean(distance[:-1] ** 2)), rel=1e-12)
    assert float(run.metrics.late_error) == pytest.approx(distance[np.asarray(run.time) >= 0.2].max(), rel=1e-12)
    torque = np.asarray(run.torque)
    assert float(run.metrics.peak_torque) == pytest.approx(np.abs(torque).max(), rel=1e-12)
    assert float(run.metrics.effort) == pytest.approx(1e-3 * np.sum(torque[:-1] ** 2), rel=1e-12)
    assert float(run.metrics.peak_lean) == pytest.approx(np.abs(np.asarray(run.state)[:, 3] - np.pi / 2).max(), rel=1e-12)


def test_diagnostics_say_whether_rolling_is_credible():
    run = quick(diagnostics=True)
    needed = run.diagnostics.contact
    assert needed.normal.shape == run.time.shape
    # Five kilograms on ten degrees, accelerated by less than 1 m/s2 once the pendulum has jumped to its first lean.
    weight = 5.1 * 9.81 * np.cos(SLOPE)
    np.testing.assert_allclose(needed.normal[1:], weight, rtol=0.25)
    np.testing.assert_allclose(
        needed.friction_coefficient, np.hypot(*np.asarray(needed.friction)) / np.asarray(needed.normal), rtol=1e-12
    )
    assert np.all(np.asarray(run.diagnostics.signals.lean.margin) > 0.0)


def test_changed_numbers_do_not_compile_anew():
    quick()
    compiled = sys.modules[js.simulate.__module__]._compiled
    before = compiled._cache_size()
    quick(js.TrackingGains(k1=30.0, k_p=700.0, a_max=0.8), speed=0.3)
    js.track_line(dataclasses.replace(ROBOT, shell_mass=1.3), 0.1, speed=0.2, start=(0.1, 0.0), heading=0.5, **QUICK)
    assert compiled._cache_size() == before


def test_a_batch_over_gains_and_speeds_is_its_lanes():
    def lane(k1, speed):
        run = quick(dataclasses.replace(js.TrackingGains(), k1=k1), speed=speed)
        return run.state[-1], run.status

    k1, speed = jnp.array([30.0, 49.0, 60.0]), jnp.array([0.2, 0.5, 0.7])
    states, statuses = jax.jit(jax.vmap(lane))(k1, speed)
    for index in range(3):
        alone, status = lane(k1[index], speed[index])
        # The batch sums in another order: rounding, grown over 0.4 s by the inner loop.
        np.testing.assert_allclose(states[index], alone, rtol=1e-9, atol=1e-9)
        assert int(statuses[index]) == int(status)


def test_speed_of_a_reference_is_differentiable():
    def last(speed):
        return quick(speed=speed).state[-1, 0]

    slope = jax.jacfwd(last)(0.5)
    ends = float(last(0.5 + 1e-4) - last(0.5 - 1e-4)) / 2e-4
    assert abs(ends) > 1e-3
    assert float(slope) == pytest.approx(ends, rel=1e-5)


def test_a_robot_that_lies_on_its_side_is_simulated():
    lying = quick(initial_state=np.zeros(12), throw=False)
    assert int(lying.status) != js.Status.NONFINITE
    assert np.all(np.isfinite(lying.state))
    assert np.all(np.isfinite(lying.attitude))
    np.testing.assert_allclose(lying.attitude[0], [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(lying.attitude, axis=1), 1.0, rtol=1e-12)


def test_a_function_of_the_user_is_a_reference():
    run = js.track(ROBOT, SLOPE, parabola, duration=2.0, dt=4e-3)
    # It starts on the path, at rest, demanding 0.2 m/s2, a fifth of what the robot can give.
    assert float(run.metrics.late_error) == 0.0
    assert float(run.metrics.rms_error) < 0.02


def test_way_points_are_passed_and_rest_at_both_ends():
    times, points = np.array([0.0, 3.0, 5.0, 9.0]), np.array([[0.0, 0.0], [0.5, 0.2], [0.5, 0.7], [0.0, 1.0]])
    path = references.way_points(times, points)
    for time, point in zip(times, points, strict=True):
        np.testing.assert_allclose(path(jnp.asarray(time)).position, point, atol=1e-12)
    for time in (0.0, 9.0, 12.0):
        np.testing.assert_allclose(path(jnp.asarray(time)).velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(path(jnp.asarray(12.0)).position, points[-1], atol=1e-12)
    for time in (3.0, 5.0):
        before, after = path(jnp.asarray(time - 1e-9)), path(jnp.asarray(time + 1e-9))
        np.testing.assert_allclose(before.velocity, after.velocity, atol=1e-8)
        np.testing.assert_allclose(before.acceleration, after.acceleration, atol=1e-7)
    again = references.from_position(lambda time: path(time).position)
    for time in (0.7, 4.0, 8.9):
        np.testing.assert_allclose(path(jnp.asarray(time)).acceleration, again(jnp.asarray(time)).acceleration, atol=1e-10)


def test_what_the_robot_cannot_do_is_a_status_in_a_batch_and_a_sentence_alone():
    # Behind and below the line, so that the first demand points up-slope.
    law = {"gains": js.TABLE_4, "realisation": "pendulum_attitude"}
    options = law | {"start": (-0.3, -0.1), "duration": 1.0, "dt": 4e-3, "settled_after": 0.9}

    def status(slope, speed):
        return js.track_line(ROBOT, slope, speed=speed, save_every=None, **options).status

    slopes, speeds = jnp.deg2rad(jnp.array([10.0, 18.0, 19.0])), jnp.array([5.0, 0.1, 0.1])
    codes = [js.Status(int(code)) for code in jax.vmap(status)(slopes, speeds)]
    # 5 m/s after a second needs five times a_max; near the bound no lean gives the first demand; past it none holds.
    assert codes == [js.Status.NOT_SETTLED, js.Status.INFEASIBLE_LEAN, js.Status.INFEASIBLE_LEAN]
    with pytest.raises(js.RolloutError, match="lower the speed"):
        js.track_line(ROBOT, SLOPE, speed=5.0, **options)
    with pytest.raises(js.RolloutError, match="infeasible_lean"):
        js.track_line(ROBOT, float(slopes[1]), speed=0.1, **options)


def test_an_eight_beyond_the_motor_is_not_settled_and_finite():
    options = {"duration": 8.0, "dt": 4e-3, "control_period": 4e-3, "save_every": 50, "throw": False}
    options |= {"gains": js.TABLE_4, "realisation": "pendulum_attitude"}
    run = js.track(ROBOT, SLOPE, references.figure_eight(1.0, 10.0), **options)
    assert int(run.status) == js.Status.NOT_SETTLED
    assert np.all(np.isfinite(run.state))


FAULTS = [
    (lambda: quick(initial_state=np.zeros(10)), r"shape \(10,\)"),
    (lambda: quick(js.TrackingGains(k3=-1.0)), r"gains\.k3 = -1"),
    (lambda: quick(speed=np.nan), r"speed = nan"),
    (lambda: quick(realisation="perfect"), r"pendulum_attitude"),
    (lambda: quick(torque_limit=0.0), r"torque_limit = 0"),
    (lambda: quick(control_period=5e-3), r"control_period = 0.005 s is no whole multiple"),
    (lambda: js.track_line(ROBOT, 10.0, **QUICK), r"radians"),
    (lambda: js.track(ROBOT, SLOPE, lambda time: (time, time), **QUICK), r"two numbers each"),
    (lambda: js.track(ROBOT, SLOPE, lambda time: (jnp.ones(3),) * 3, **QUICK), r"two numbers each"),
    (lambda: js.track(ROBOT, SLOPE, lambda time: (jnp.array([1 / (time - 0.2), 0.0]),) * 3, **QUICK), r"not finite at 0.2 s"),
    (lambda: js.track(ROBOT, SLOPE, 3.0, **QUICK), r"no function"),
    (lambda: references.way_points([0.0, 1.0, 1.0], np.zeros((3, 2))), r"increasing"),
    (lambda: references.way_points([0.0, 1.0], np.zeros((3, 2))), r"shapes"),
    (
        lambda: js.track_line(dataclasses.replace(ROBOT, shell_inertia=np.array([0.018, 0.019, 0.018])), SLOPE, **QUICK),
        r"symmetric about its spin axis",
    ),
]


@pytest.mark.parametrize(("call", "words"), FAULTS, ids=[words for _, words in FAULTS])
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
