"""What a lane reports that ended before its time: nothing that is not finite, and its last state in the metrics."""

from functools import partial

import numpy as np
import pytest

import jaxsphere as js

SLOPE, PAST = float(np.deg2rad(10.0)), 0.45
SHORT = partial(js.rest_to_rest, js.Robot(), duration=0.4, dt=4e-3, torque_limit=5.0, throw=False)


@pytest.fixture(scope="module")
def whirling():
    return SHORT(SLOPE, initial_state=np.array([0.0, 0.0, 0.5, 60.0]))


def test_metrics_include_the_last_state(whirling):
    assert whirling.status == js.Status.WHIRLING
    assert whirling.metrics.highest_swing == whirling.state[:, 2].max() > np.pi
    assert whirling.metrics.final_error == pytest.approx(float(whirling.state[-1, 0] - 10.0))


def test_a_lane_past_the_bound_spends_no_torque_and_is_not_on_target():
    found = SHORT(PAST)
    assert np.all(np.asarray(found.torque) == 0.0)
    assert (found.metrics.peak_torque, found.metrics.effort) == (0.0, 0.0)
    assert found.metrics.final_error == -10.0


def test_metrics_of_every_ended_lane_are_finite(whirling):
    for found in (SHORT(PAST), whirling):
        values = found.metrics._asdict()
        assert values.pop("settling_time") == np.inf
        assert {name: float(value) for name, value in values.items() if not np.isfinite(value)} == {}


def test_an_overflowing_lane_reports_no_nan():
    found = SHORT(SLOPE, initial_state=np.array([0.0, 0.0, 0.5, 1e200]))
    assert found.status == js.Status.NONFINITE
    for leaf in (found.torque, found.state, found.metrics.peak_torque, found.metrics.effort):
        assert np.isfinite(leaf).all()


def test_every_way_to_end_early_has_its_advice():
    every = set(js.Status) - {js.Status.OK}
    # A planar move that has not settled is a result; only the spatial robot has joints to lose, only the planar one whirls.
    assert set(js.PlanarTask().advice()) == every - {js.Status.NOT_SETTLED, js.Status.SINGULAR_JOINTS}
    assert set(js.SpatialTask().advice()) == every - {js.Status.WHIRLING}
