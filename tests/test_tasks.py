"""`rest_to_rest`: the numbers of Fig. 4, batching over every leaf, dtypes, and one sentence per bad argument."""

import sys
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js

# Short and coarse, without saved states: one compiled program serves most tests below.
SHORT = partial(js.rest_to_rest, duration=0.4, dt=1e-2, save_every=None, throw=False)


@pytest.fixture(scope="module")
def figure_4(slope):
    """Table 3 on 10 degrees over 10 rad, RK4 at 1 ms."""
    return js.rest_to_rest(js.Robot(), slope, duration=12.0, dt=1e-3)


def test_numbers_of_the_papers_case(figure_4, slope):
    found = figure_4.metrics
    assert figure_4.status == js.Status.OK
    assert found.settling_time == pytest.approx(6.36, abs=5e-3)  # half the last digit here and below
    assert np.rad2deg(found.lowest_swing) == pytest.approx(21.2, abs=0.05)
    assert np.rad2deg(found.highest_swing) == pytest.approx(52.0, abs=0.05)
    assert np.rad2deg(found.peak_swing) == pytest.approx(19.3, abs=0.05)
    assert found.overshoot == 0.0
    assert figure_4.state[-1, 0] == pytest.approx(10.0, abs=0.01)  # exp(-0.67 s^-1 * 12 s) of 10 rad is 3 mrad
    assert np.rad2deg(figure_4.state[-1, 2]) == pytest.approx(32.68, abs=0.1)


def test_swing_makes_one_oscillation(figure_4, slope):
    deviation = np.asarray(figure_4.state[:, 2]) - float(js.equilibrium_swing(js.Robot(), slope))
    clear = deviation[np.abs(deviation) > np.deg2rad(2.0)]  # a tenth of the first peak; what is below has died out
    assert np.sum(np.diff(np.sign(clear)) != 0) == 1
    assert clear[0] > 0.0


def test_trajectory_has_the_documented_shapes(figure_4):
    assert figure_4.time.shape == (12001,)
    assert figure_4.state.shape == (12001, 4)
    assert figure_4.torque.shape == (12001, 1)
    assert figure_4.memory.shape == (12001, 1)
    assert {leaf.shape for leaf in jax.tree.leaves(figure_4.metrics)} == {()}
    assert {leaf.shape for leaf in jax.tree.leaves(figure_4.diagnostics)} == {(12001,)}
    assert (figure_4.time[0], figure_4.end_time) == (0.0, pytest.approx(12.0, rel=1e-12))
    signals = figure_4.diagnostics
    np.testing.assert_allclose(signals.equivalent + signals.switching, figure_4.torque[:, 0], rtol=1e-10)  # rounding


def test_metrics_of_12_s_are_those_of_a_downhill_move_mirrored(slope):
    up, down = (js.rest_to_rest(js.Robot(), s, travel=t, duration=8.0, dt=4e-3) for s, t in ((slope, 10.0), (-slope, -10.0)))
    np.testing.assert_allclose(down.state, -up.state, atol=1e-12)  # the same operations up to sign and rounding
    for name in ("settling_time", "overshoot", "peak_swing", "peak_torque", "effort", "chatter", "itae"):
        assert getattr(down.metrics, name) == pytest.approx(float(getattr(up.metrics, name)), rel=1e-10, abs=1e-12)
    assert down.metrics.highest_swing == pytest.approx(-float(up.metrics.lowest_swing), rel=1e-12)


BASE = {
    "robot": js.Robot(pendulum_inertia=np.array([0.001, 0.001, 0.001])),
    "slope": float(np.deg2rad(10.0)),
    "gains": js.SlidingModeGains(k_i=0.03),
    "travel": 10.0,
    "smoothing": 1.0,
    "torque_limit": 1.0,
    "initial_state": np.array([0.5, 0.1, 0.4, -0.2]),
    "plant": js.Robot(pendulum_inertia=np.array([0.001, 0.001, 0.001])),
}


@pytest.mark.parametrize("name", BASE)
def test_batches_over_every_argument_and_each_of_its_leaves(name):
    # Lane 0 is the base case; in each further lane one leaf of the argument is 2 % larger.
    leaves, structure = jax.tree.flatten(BASE[name])
    scales = np.ones((1 + len(leaves), len(leaves))) + 0.02 * np.eye(1 + len(leaves), len(leaves), -1)
    lanes = [np.multiply.outer(scales[:, i], leaf) for i, leaf in enumerate(leaves)]
    batch = jax.vmap(lambda value: SHORT(**BASE | {name: value}))(jax.tree.unflatten(structure, lanes))
    for i in range(len(scales)):
        single = SHORT(**BASE | {name: jax.tree.unflatten(structure, [lane[i] for lane in lanes])})
        np.testing.assert_allclose(batch.state[i], single.state, rtol=1e-11, atol=1e-12)  # vectors round differently
        assert batch.status[i] == single.status
    states = np.asarray(batch.state)
    moved = np.abs(states[1:] - states[0]).max(axis=(1, 2))
    assert np.all(moved > 1e-7)  # every leaf arrives in the physics


def test_jit_of_a_whole_call_gives_the_same(slope):
    inside = jax.jit(lambda robot, slope, gains: SHORT(robot, slope, gains))(js.Robot(), slope, js.SlidingModeGains())
    outside = SHORT(js.Robot(), slope)
    np.testing.assert_allclose(inside.state, outside.state, rtol=1e-12)  # the same program, inlined


def test_changed_numbers_do_not_compile_anew(slope):
    SHORT(js.Robot(), slope, torque_limit=5.0)
    compiled = sys.modules[js.simulate.__module__]._compiled
    traces = compiled._cache_size()
    for gains in (js.SlidingModeGains(c1=0.7), js.SlidingModeGains(c1=1, k_i=0.1), js.SlidingModeGains(eta=np.float32(3.0))):
        SHORT(js.Robot(), slope, gains, torque_limit=5.0)
    SHORT(replace(js.Robot(), shell_mass=2, gravity=np.float64(1.6)), 0.1, travel=-3, smoothing=0.0, torque_limit=2)
    SHORT(js.robot_named("rotunbot"), jnp.asarray(0.2), js.SlidingModeGains(z_u=jnp.asarray(0.4)), torque_limit=80.0)
    assert compiled._cache_size() == traces
    SHORT(js.Robot(), slope, torque_limit=5.0, convention="printed")
    assert compiled._cache_size() == traces + 1  # so that the count above does count


def test_single_precision_is_an_option(slope):
    single = js.rest_to_rest(js.Robot(), slope, duration=8.0, dt=4e-3, dtype=jnp.float32)
    floats = [leaf for leaf in jax.tree.leaves(single) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert len(floats) == len(jax.tree.leaves(single)) - 1  # all but the status
    assert {leaf.dtype for leaf in floats} == {np.dtype(np.float32)}
    double = js.rest_to_rest(js.Robot(), slope, duration=8.0, dt=4e-3)
    # 2000 steps that round 10 rad to 1e-6 rad each, at random: 5e-5 rad; a factor of ten for safety.
    np.testing.assert_allclose(single.state, double.state, atol=5e-4)


def test_plant_of_its_own_is_the_one_that_moves(slope):
    heavy = replace(js.Robot(), shell_mass=2.4)
    same = SHORT(js.Robot(), slope, plant=js.Robot())
    np.testing.assert_array_equal(same.state, SHORT(js.Robot(), slope).state)
    other = SHORT(js.Robot(), slope, plant=heavy)
    # It starts at the modelled robot's equilibrium and sags: the true one needs more swing.
    assert other.state[0, 0] < same.state[0, 0] - 1e-3
    assert js.equilibrium_swing(heavy, slope) > js.equilibrium_swing(js.Robot(), slope)


def test_target_counts_from_the_start(slope):
    here, there = (SHORT(js.Robot(), slope, initial_state=np.array([start, 0.0, 0.5, 0.0])) for start in (0.0, 7.0))
    np.testing.assert_allclose(there.state[0] - here.state[0], [7.0, 0.0, 0.0, 0.0], atol=1e-13)  # rounding of 7 rad
    assert there.metrics.final_error == pytest.approx(float(here.metrics.final_error), abs=1e-13)


BAD = {
    "slope past the bound": (
        {"slope": np.deg2rad(25.0), "throw": True},
        r"slope = 0\.4363 rad \(25\.00 deg\) is past the climbing",
    ),
    "slope in degrees": ({"slope": 10.0}, r"slope = 10 rad is not admissible; type radians"),
    "slope not a number": ({"slope": np.nan}, r"slope = nan rad is not admissible"),
    "slope of lanes": ({"slope": np.zeros(3)}, r"slope has shape \(3,\); .*jax\.vmap"),
    "no travel": ({"travel": 0.0}, r"travel = 0 rad is no move"),
    "infinite travel": ({"travel": np.inf}, r"travel = inf rad is not admissible"),
    "gain": ({"gains": js.SlidingModeGains(c2=-1.0)}, r"gains\.c2 = -1 is not admissible; type a finite number above 0"),
    "z_u": ({"gains": js.SlidingModeGains(z_u=1.2)}, r"gains\.z_u = 1\.2 .* above 0 and below 1"),
    "dt zero": ({"dt": 0.0}, r"dt = 0 s is not admissible"),
    "dt negative": ({"dt": -1e-3}, r"dt = -0\.001 s is not admissible"),
    "dt above the duration": ({"dt": 1.0}, r"dt = 1 s exceeds duration = 0\.4 s"),
    "duration": ({"duration": -1.0}, r"duration = -1 s is not admissible"),
    "uneven duration": ({"dt": 0.03}, r"duration = 0\.4 s is no whole multiple of dt = 0\.03 s; type e\.g\. 0\.39"),
    "save_every": ({"save_every": 7}, r"save_every = 7 must be None or a whole number that divides the 40 steps"),
    "save_every zero": ({"save_every": 0}, r"save_every = 0 must be None or"),
    "state too short": ({"initial_state": np.zeros(3)}, r"initial_state has shape \(3,\); type 4 numbers: alpha"),
    "state not finite": ({"initial_state": np.array([0, 0, np.nan, 0])}, r"initial_state = \[.*nan.*\] is not finite"),
    "torque limit": ({"torque_limit": 0.0}, r"torque_limit = 0 N m is not admissible"),
    "smoothing": ({"smoothing": -0.1}, r"smoothing = -0\.1 rad/s is not admissible"),
    "control period": ({"control_period": 0.015}, r"control_period = 0\.015 s is no whole multiple of dt = 0\.01 s"),
    "convention": ({"convention": "paper"}, r"convention = 'paper' is not known; type one of corrected, printed"),
    "method": ({"method": "rk5"}, r"method = 'rk5' is not known; type one of rk4, dopri5, semi_implicit_euler"),
    "robot": ({"robot": replace(js.Robot(), shell_mass=-1.0)}, r"robot\.shell_mass = -1 is not admissible"),
    "plant": ({"plant": replace(js.Robot(), pendulum_length=0.2)}, r"plant\.pendulum_length = 0\.2 m does not fit"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_get_one_sentence(case, slope):
    change, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        SHORT(**{"robot": js.Robot(), "slope": slope} | change)
    assert "\n" not in str(caught.value)
    assert "; type" in str(caught.value) or "must be" in str(caught.value)


def test_traced_time_grid_is_refused(slope):
    for name in ("duration", "dt"):
        with pytest.raises(ValueError, match=rf"{name} is traced; type a plain number"):
            jax.jit(lambda value, name=name: SHORT(js.Robot(), slope, **{name: value}).state)(0.01)


def test_early_end_raises_with_the_trajectory_so_far(slope):
    start = np.array([0.0, 0.0, 0.5, 60.0])
    with pytest.raises(js.RolloutError, match=r"ended at 0\.\d+ s with status whirling: .*throw=False") as caught:
        SHORT(js.Robot(), slope, initial_state=start, throw=True)
    assert "\n" not in str(caught.value)
    assert caught.value.trajectory.status == js.Status.WHIRLING
    quiet = SHORT(js.Robot(), slope, initial_state=start)
    np.testing.assert_array_equal(caught.value.trajectory.state, quiet.state)
    traced = jax.vmap(lambda x: js.rest_to_rest(js.Robot(), slope, initial_state=x, duration=0.4, dt=1e-2).status)(start[None])
    assert traced[0] == js.Status.WHIRLING  # a batch never raises


def test_a_facade_traces_with_the_robot_and_the_slope_as_plain_numbers():
    def end(c1):
        return js.rest_to_rest(js.Robot(), 0.17, js.SlidingModeGains(c1=c1), duration=0.1, dt=1e-2).end_time

    assert jax.jit(end)(0.5) == pytest.approx(0.1)
