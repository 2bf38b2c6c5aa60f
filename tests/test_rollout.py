"""The rollout itself: statuses per lane, what is saved, metrics, limits, holds, and the compiled step."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.tasks.metrics import RegulationMetrics

DT, DURATION = 4e-3, 8.0
RUN = partial(js.rest_to_rest, js.Robot(), duration=DURATION, dt=DT, throw=False)
TABLE_3 = js.SlidingModeGains()
SINGULAR = js.SlidingModeGains(c2=60.0, z_u=0.9, phi_z=1.0)
TEN = float(np.deg2rad(10.0))
REST = (0.0, 0.0, float(js.equilibrium_swing(js.Robot(), TEN)), 0.0)

# name -> slope, gains, initial state, torque limit, status
LANES = {
    "climbs": (TEN, TABLE_3, REST, 5.0, js.Status.OK),
    "too steep": (float(np.deg2rad(25.0)), TABLE_3, REST, 5.0, js.Status.INFEASIBLE_LEAN),
    "swings over the top": (TEN, TABLE_3, (0.0, 0.0, 0.5, 60.0), 5.0, js.Status.WHIRLING),
    "rolls away": (TEN, TABLE_3, (0.0, -300.0, 0.5, 0.0), 0.2, js.Status.DIVERGED),
    "divides by zero": (TEN, SINGULAR, (0.0, 10.0 * SINGULAR.c1, TEN, 0.0), 5.0, js.Status.SINGULAR_DECOUPLING),
    "too slow": (TEN, replace(TABLE_3, c1=0.2), REST, 5.0, js.Status.NOT_SETTLED),
    "overflows": (TEN, TABLE_3, (0.0, 0.0, 0.5, 1e200), 5.0, js.Status.NONFINITE),
}


def run(slope, gains, start, limit):
    """One lane."""
    return RUN(slope, gains, initial_state=jnp.stack(start) if isinstance(start, tuple) else start, torque_limit=limit)


@pytest.fixture(scope="module")
def batch():
    """All lanes at once."""
    arguments = [(slope, gains, np.array(start), limit) for slope, gains, start, limit, _ in LANES.values()]
    return jax.jit(jax.vmap(run))(*jax.tree.map(lambda *leaves: np.stack(leaves).astype(float), *arguments))


@pytest.fixture(scope="module")
def dense():
    """The climbing lane with every step saved and a torque limit that bites."""
    return RUN(TEN, TABLE_3, torque_limit=1.5)


def test_each_lane_ends_in_its_own_way(batch):
    assert [js.Status(int(code)) for code in batch.status] == [lane[-1] for lane in LANES.values()]


@pytest.mark.parametrize("name", LANES)
def test_a_lane_is_not_disturbed_by_its_neighbours(batch, name):
    lane = jax.tree.map(lambda leaf: np.asarray(leaf[list(LANES).index(name)]), batch)
    slope, gains, start, limit, _ = LANES[name]
    alone = RUN(slope, gains, initial_state=np.array(start), torque_limit=limit)
    np.testing.assert_allclose(lane.state, alone.state, rtol=1e-12, atol=1e-12)  # vectors may round differently
    assert np.isfinite(lane.state).all()
    assert lane.end_time == pytest.approx(float(alone.end_time), abs=1e-12)


@pytest.mark.parametrize("name", [name for name, lane in LANES.items() if lane[-1] > js.Status.NOT_SETTLED])
def test_an_ended_lane_keeps_its_last_state(batch, name):
    lane = jax.tree.map(lambda leaf: np.asarray(leaf[list(LANES).index(name)]), batch)
    last = round(float(lane.end_time) / DT)
    assert last < DURATION / DT
    np.testing.assert_array_equal(lane.state[last:], np.broadcast_to(lane.state[last], lane.state[last:].shape))
    np.testing.assert_array_equal(lane.torque[last + 1 :], 0.0)
    assert np.all(np.any(np.diff(lane.state[: last + 1], axis=0) != 0.0, axis=1))
    assert lane.metrics.settling_time == np.inf


def test_finite_lanes_have_finite_torques_and_signals(batch):
    for name, code in zip(LANES, batch.status, strict=True):
        if code == js.Status.NONFINITE:
            continue
        lane = jax.tree.map(lambda leaf, i=list(LANES).index(name): np.asarray(leaf[i]), batch)
        for leaf in jax.tree.leaves((lane.torque, lane.memory, lane.diagnostics, lane.end_time)):
            assert np.isfinite(leaf).all()


def test_gradients_of_ended_lanes_are_finite(slope):
    def final(scale, start, slope):
        gains = jax.tree.map(lambda gain: gain * scale, TABLE_3)
        ended = js.rest_to_rest(
            js.Robot(), slope, gains, duration=0.4, dt=1e-2, initial_state=start, save_every=None, throw=False
        )
        return jnp.sum(ended.state)

    names = ("climbs", "too steep", "swings over the top")
    starts, slopes = np.array([LANES[name][2] for name in names]), np.array([LANES[name][0] for name in names])
    gradient = jax.jit(jax.vmap(jax.grad(final, (0, 1, 2)), (None, 0, 0)))(1.0, starts, slopes)
    assert all(np.isfinite(leaf).all() for leaf in gradient)
    assert gradient[0][0] != 0.0
    np.testing.assert_array_equal(gradient[1][1], np.ones(4))  # nothing moves: the end is the start


@pytest.mark.parametrize("save_every", [1, 4, 250, 2000])
def test_saved_states_are_those_of_the_dense_run(dense, save_every):
    thin = RUN(TEN, TABLE_3, torque_limit=1.5, save_every=save_every)
    for name in ("time", "state", "torque", "memory"):
        # The loop is cut into other blocks, so XLA may contract other products.
        np.testing.assert_allclose(getattr(thin, name), getattr(dense, name)[::save_every], rtol=1e-12, atol=1e-13)
    same_numbers(thin, dense)


def test_saving_nothing_keeps_the_end_and_the_metrics(dense):
    bare = RUN(TEN, TABLE_3, torque_limit=1.5, save_every=None)
    assert bare.state.shape == (1, 4)
    assert bare.diagnostics is None
    for name in ("time", "state", "torque", "memory"):
        np.testing.assert_allclose(getattr(bare, name)[0], getattr(dense, name)[-1], rtol=1e-12, atol=1e-13)
    same_numbers(bare, dense)


def same_numbers(one, other):
    """Assert that two trajectories report the same status, end and metrics."""
    assert (one.status, one.end_time) == (other.status, other.end_time)
    for name in RegulationMetrics._fields:
        assert getattr(one.metrics, name) == pytest.approx(float(getattr(other.metrics, name)), rel=1e-11, abs=1e-13), name


@pytest.mark.parametrize("name", ["climbs", "too slow"])
def test_metrics_equal_those_of_the_saved_trajectory(batch, name):
    lane = jax.tree.map(lambda leaf: np.asarray(leaf[list(LANES).index(name)]), batch)
    slope, _, start, _, _ = LANES[name]
    time, error, swing, torque = lane.time, lane.state[:, 0] - start[0] - 10.0, lane.state[:, 2], lane.torque[:, 0]
    outside = np.flatnonzero(np.abs(error) > 0.2)
    expected = RegulationMetrics(
        settling_time=time[outside[-1] + 1] if outside[-1] + 1 < len(time) else np.inf,
        overshoot=max(0.0, np.max(error / 10.0)),
        final_error=error[-1],
        peak_swing=np.max(np.abs(swing - float(js.equilibrium_swing(js.Robot(), slope)))),
        lowest_swing=np.min(swing),
        highest_swing=np.max(swing),
        peak_torque=np.max(np.abs(torque)),
        effort=DT * np.sum(torque[:-1] ** 2),
        chatter=np.sum(np.abs(np.diff(torque))),
        itae=DT * np.sum((time * np.abs(error) / 10.0)[:-1]),
    )
    for field in RegulationMetrics._fields:
        # Sums of 2000 terms in another order.
        assert getattr(lane.metrics, field) == pytest.approx(getattr(expected, field), rel=1e-11, abs=1e-12), field


def test_torque_limit_bites_and_is_kept(dense):
    torque = np.abs(np.asarray(dense.torque))
    assert np.max(torque) == 1.5
    assert np.sum(torque == 1.5) > 20
    assert np.max(np.abs(RUN(TEN, TABLE_3).torque)) > 1.9  # what the law would have asked for
    assert dense.metrics.peak_torque == 1.5


@pytest.mark.parametrize("every", [1, 5])
def test_hold_keeps_the_command_between_samples(every):
    held = RUN(TEN, TABLE_3, initial_state=np.array(REST), torque_limit=5.0, control_period=every * DT)
    torque = np.asarray(held.torque[:-1, 0]).reshape(-1, every)
    np.testing.assert_array_equal(torque, np.broadcast_to(torque[:, :1], torque.shape))
    samples = torque[:, 0]
    assert np.all(np.diff(samples[: len(samples) // 2]) != 0.0)  # it samples anew at every period
    # At the samples the torque is the law's, evaluated at the state of that instant.
    law = held.diagnostics.equivalent + held.diagnostics.switching
    np.testing.assert_allclose(samples, np.asarray(law)[:-1:every], rtol=1e-9, atol=1e-12)  # torques of 2 N m that cancel
    assert held.status == js.Status.OK


def test_a_fine_hold_approaches_continuous_control_at_first_order():
    ends = [RUN(TEN, TABLE_3, smoothing=1.0, control_period=period).state for period in (None, 4 * DT, 2 * DT)]
    coarse, fine = (np.max(np.abs(end - ends[0])) for end in ends[1:])
    assert 1.7 < coarse / fine < 2.3  # the delay of half a period dominates


def test_memory_is_integrated_with_the_plant_and_is_no_part_of_its_state():
    gains = replace(TABLE_3, k_i=0.05)
    found = RUN(TEN, gains, plant=replace(js.Robot(), pendulum_mass=2.1))
    assert found.state.shape[1] == 4
    rate = np.asarray(found.diagnostics.correction_rate)
    integral = DT * np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2)])
    np.testing.assert_allclose(found.memory[:, 0], integral, atol=1e-6)  # the trapezoidal rule's dt^2 k_i
    assert abs(found.memory[-1, 0]) > 1e-3


def test_a_plain_plant_and_law_roll_out_too():
    # x' = -x + u with u = 2 - m and m' = x: none of the robot's names, one state, one memory.
    plant = js.Plant(lambda x, u: (-x[0] + u[0],), lambda x: jnp.int32(js.Status.OK), (True,))

    def law(time, x, memory):
        return js.ControllerOutput((2.0 - memory[0],), (x[0],), jnp.int32(js.Status.OK))

    found = js.rollout(plant, law, (jnp.ones(()),), (jnp.zeros(()),), dt=jnp.asarray(0.01), steps=200)
    assert found.metrics is None
    # x'' = -x' - x: x = exp(-t/2) (cos wt + b sin wt), x'(0) = 1.
    frequency = np.sqrt(0.75)
    exact = np.exp(-found.time / 2) * (np.cos(frequency * found.time) + 1.5 / frequency * np.sin(frequency * found.time))
    np.testing.assert_allclose(found.state[:, 0], exact, atol=1e-9)  # dt^4
