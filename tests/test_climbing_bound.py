"""How steep a closed loop climbs: fates, bisection, the bound (4) by release, and steps."""

import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from experiments.studies.bound import random_gains, random_robots
from jaxsphere.simulation.search import Pausable, Trial, largest_success, run
from jaxsphere.status import Status

# Bisected over the full 60 s at 1 ms and at 0.5 ms, deg.
TABLE_3 = 18.118901
QUICK = js.Numerics(duration=60.0, dt=1e-2)
CLIMB, GAINS = js.PlanarTask(), js.SlidingModeGains()


def staircase(fails_from, takes):
    """Trial that fails from `fails_from` on, after a number of segments that grows with the value."""

    def advance(value, count):
        late = count >= jnp.floor(takes * value)
        return count + 1, late, jnp.where(value >= fails_from, jnp.int32(Status.DIVERGED), jnp.int32(Status.OK))

    return Trial(lambda value: jnp.zeros((), jnp.int32), advance)


def search(fails_from, guess=None, high=8.0, tolerance=1e-3):
    """Bracket of the staircase."""
    step = None if guess is None else jnp.asarray(tolerance)
    guess = None if guess is None else jnp.asarray(guess)
    ends = (jnp.asarray(0.0), jnp.asarray(high))
    return run(largest_success(staircase(fails_from, 3.0), *ends, jnp.asarray(tolerance), guess, step))


@pytest.mark.parametrize("guess", [None, 0.0, 2.9, 3.0, 3.0001, 7.9, 100.0])
def test_search_brackets_the_change_from_any_guess(guess):
    found = search(3.0, guess)
    assert found.lower < 3.0 <= found.upper
    assert found.upper - found.lower <= 1e-3
    assert found.value == 0.5 * (found.lower + found.upper)
    assert int(found.status) == Status.DIVERGED


def test_a_good_guess_needs_two_trials():
    # It looks half a bracket on each side, as `slope_search` asks it to.
    found = search(3.0, 3.0 - 0.5e-3)
    assert int(found.trials) == 2
    assert int(search(3.0).trials) >= 12  # log2(8 / 1e-3) = 13


def test_nothing_found_where_the_lowest_value_fails_and_the_end_where_none_does():
    nothing = search(0.0)
    assert np.isnan(nothing.value)
    assert np.isnan(nothing.lower)
    everything = search(100.0)
    assert everything.upper == 8.0
    assert everything.lower >= 8.0 - 1e-3
    assert int(everything.status) == Status.OK


def test_a_tolerance_below_the_last_digit_ends_too():
    found = search(3.0, tolerance=1e-30)
    assert found.lower < 3.0 <= found.upper
    assert found.upper - found.lower < 1e-15


def test_queue_gives_every_lane_what_it_gets_alone(rng):
    at = rng.uniform(0.0, 9.0, 21)
    make = lambda fails: largest_success(staircase(fails, 5.0), jnp.asarray(0.0), jnp.asarray(8.0), jnp.asarray(1e-2))  # noqa: E731
    alone = jax.vmap(lambda fails: run(make(fails)))(at)
    for slots in (5, 64):
        queued = js.batch(make, block=slots, ragged=True)(at)
        for ours, theirs in zip(queued, alone, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_queues_of_any_length_share_one_program_and_two_devices():
    program = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
import jaxsphere as js
from jaxsphere.simulation.search import Pausable
traces = []
def count_down(start, scale):
    traces.append(1)
    first = (start, jnp.zeros_like(start))
    return Pausable(first, lambda c: (c[0] - 1, c[1] + 1), lambda c: c[0] <= 0, lambda c: scale * c[1])
run = js.batch(count_down, block=3, ragged=True, capacity=16)
for lanes in (1, 2, 5, 11, 16):
    start = np.arange(1.0, lanes + 1.0)[::-1].copy()
    np.testing.assert_array_equal(run(start, np.full(lanes, 2.0)), 2.0 * start)
    traced = traced if lanes > 1 else len(traces)
assert len(traces) == traced
np.testing.assert_array_equal(run(np.ones(17), np.ones(17)), np.ones(17))
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_queue_refuses_unequal_axes():
    with pytest.raises(ValueError, match=r"leading axes"):
        js.batch(lambda a, b: Pausable(a + b, lambda c: c, lambda c: True, lambda c: c), ragged=True)(np.zeros(3), np.zeros(4))


def test_bound_of_table_3():
    found = js.steepest_slope(CLIMB, GAINS, QUICK, tolerance=1e-6)
    assert np.rad2deg(found.value) == pytest.approx(TABLE_3, abs=1e-4)
    assert int(found.status) == Status.DIVERGED
    # The rollout that everybody else uses agrees on both sides.
    for slope, status in ((found.lower - 1e-6, Status.OK), (found.upper + 1e-6, Status.DIVERGED)):
        run = js.rest_to_rest(js.Robot(), slope, duration=60.0, dt=5e-3, save_every=None, throw=False)
        assert int(run.status) == status


def test_early_decisions_are_those_of_the_full_minute():
    count = 24
    limit = np.exp(np.random.default_rng(5).uniform(np.log(1.0), np.log(8.0), count))

    def bound(early):
        def search(gains, limit):
            task, numerics = replace(CLIMB, torque_limit=limit), replace(QUICK, dt=5e-3)
            return js.slope_search(task, gains, numerics, tolerance=1e-3, early=early)

        return js.batch(search, ragged=True)(random_gains(count, 7), limit)

    short, full = bound(True), bound(False)
    np.testing.assert_array_equal(short.value, full.value)
    np.testing.assert_array_equal(short.status, full.status)
    assert short.seconds.sum() < 0.9 * full.seconds.sum()


def test_float32_finds_the_same_bound():
    single = js.steepest_slope(CLIMB, GAINS, replace(QUICK, dtype="float32"), tolerance=1e-4)
    assert single.value.dtype == jnp.float32
    assert np.rad2deg(single.value) == pytest.approx(TABLE_3, abs=np.rad2deg(1e-4))


def test_the_motor_cannot_hold_more_than_its_limit():
    limits = np.array([0.6, 1.2, 1.8])
    found = js.batch(
        lambda limit: js.slope_search(replace(CLIMB, torque_limit=limit), GAINS, QUICK, tolerance=1e-4), ragged=True
    )(limits)
    robot = js.Robot()
    weight = (robot.shell_mass + robot.gimbal_mass + robot.pendulum_mass) * robot.gravity * robot.shell_radius
    held = np.arcsin(limits / weight)
    assert np.all(found.lower <= held)
    np.testing.assert_allclose(found.value, held, rtol=0.02)  # within a minute there must be some torque to spare


def test_outcomes_name_what_happened():
    run_on = js.batch(lambda slope: js.outcome_run(replace(CLIMB, slope=slope), GAINS, QUICK), ragged=True)
    ends = run_on(np.deg2rad([10.0, 18.3, 19.0])).status
    assert [Status(int(code)) for code in ends] == [Status.OK, Status.DIVERGED, Status.INFEASIBLE_LEAN]
    # Table 3 is within 2 % of the travel after 6.36 s.
    for duration, status in ((6.3, Status.NOT_SETTLED), (6.4, Status.OK)):
        assert int(js.climb_outcome(CLIMB, GAINS, replace(QUICK, duration=duration)).status) == status


def test_a_sampled_hard_sign_and_a_push_enter_the_fate():
    pushed = [
        js.steepest_slope(replace(CLIMB, disturbance=jnp.array([0.0, push, 0.0, 0.0])), GAINS, QUICK, tolerance=1e-4).value
        for push in (-1.5, 1.5)
    ]
    assert pushed[0] < np.deg2rad(TABLE_3) - 1e-3
    assert pushed[0] < pushed[1]
    held = js.steepest_slope(replace(CLIMB, smoothing=0.0, control_period=1e-2), GAINS, QUICK, tolerance=1e-4)
    assert np.rad2deg(held.value) == pytest.approx(TABLE_3, abs=0.1)


def test_a_heavier_plant_pendulum_than_modelled_is_not_the_model():
    plant = replace(js.Robot(), pendulum_mass=2.05 * 1.1)
    assert not js.steepest_slope(replace(CLIMB, plant=plant), GAINS, QUICK, tolerance=1e-3).value > 0.3


def test_released_robots_whirl_from_the_bound_on():
    robots = random_robots(64, 3)
    found = js.batch(js.static_bound_by_release)(robots)
    bound = jax.vmap(js.climbing_bound)(robots)
    np.testing.assert_allclose(found.value, bound, atol=2e-5)
    assert np.all(found.upper - found.lower <= 1e-5)
    assert np.all(np.asarray(found.status) == Status.WHIRLING)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"travel": 0.0}, "travel = 0 rad is no move"),
        ({"torque_limit": -1.0}, "torque_limit = -1"),
        ({"smoothing": -0.1}, "smoothing = -0.1"),
        ({"disturbance": jnp.zeros(3)}, "disturbance has shape"),
        ({"dt": 0.7}, "duration = 60 s is no whole multiple"),
        ({"control_period": 3e-3, "dt": 2e-3}, "control_period"),
        ({"gains": js.SlidingModeGains(c2=-1.0)}, "gains.c2 = -1"),
    ],
)
def test_bad_climbs_are_one_sentence(fault, words):
    numerics = js.Numerics(duration=60.0, dt=fault.pop("dt", 1e-3))
    gains = fault.pop("gains", GAINS)
    with pytest.raises(ValueError, match=words):
        js.steepest_slope(replace(CLIMB, **fault), gains, numerics)


def test_bad_searches_are_one_sentence():
    with pytest.raises(ValueError, match="tolerance = 0 rad"):
        js.steepest_slope(CLIMB, GAINS, QUICK, tolerance=0.0)
    with pytest.raises(ValueError, match="slope = 90 rad"):
        js.climb_outcome(replace(CLIMB, slope=90.0))
    with pytest.raises(TypeError, match="is no PlanarTask"):
        js.steepest_slope(js.Robot())


def test_changed_numbers_do_not_compile_anew():
    program = sys.modules[js.steepest_slope.__module__]._search
    js.steepest_slope(CLIMB, GAINS, QUICK, tolerance=1e-2)
    before = program._cache_size()
    js.steepest_slope(replace(CLIMB, travel=9.0), js.SlidingModeGains(c1=0.6), QUICK, tolerance=2e-2)
    assert program._cache_size() == before


@pytest.mark.parametrize("slope", [-0.1, 0.0, 0.15])
def test_highest_step_balances_the_moments_about_its_edge(robot, slope):
    height = js.equilibrium.highest_step(robot, slope)
    radius = robot.shell_radius
    # Coordinates along and normal to the slope, the contact at the origin, the edge ahead of it at the shell.
    centre = np.array([0.0, radius])
    edge = np.array([np.sqrt(radius**2 - (radius - height) ** 2), height])
    down = np.array([-np.sin(slope), -np.cos(slope)])
    horizontal = np.array([np.cos(slope), -np.sin(slope)])
    bob = centre + robot.pendulum_length * horizontal

    def moment(place, mass):
        arm, force = place - edge, mass * robot.gravity * down
        return arm[0] * force[1] - arm[1] * force[0]

    total = moment(centre, robot.shell_mass + robot.gimbal_mass) + moment(bob, robot.pendulum_mass)
    scale = robot.pendulum_mass * robot.gravity * radius
    assert float(total) / scale == pytest.approx(0.0, abs=1e-12)
    assert js.equilibrium.highest_step(robot, js.climbing_bound(robot) + 0.01) == 0.0
