"""The non-dominated filter, the hypervolume and a small front."""

import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning import pareto


def test_non_dominated_filter():
    points = np.array([[1.0, 4.0], [2.0, 2.0], [2.0, 3.0], [4.0, 1.0], [4.0, 1.0], [5.0, 5.0], [0.0, np.inf], [np.nan, 0.0]])
    np.testing.assert_array_equal(pareto.non_dominated(points), [True, True, False, True, True, False, False, False])


def test_hypervolume_of_boxes_and_against_sampling(rng):
    assert pareto.hypervolume(np.array([[1.0, 4.0], [2.0, 2.0]]), np.array([5.0, 5.0])) == 4.0 + 9.0 - 3.0
    assert pareto.hypervolume(np.array([[6.0, 0.0]]), np.array([5.0, 5.0])) == 0.0
    points = rng.uniform(size=(12, 3))
    samples = rng.uniform(size=(200_000, 3))
    share = np.mean(np.any(np.all(points[None] <= samples[:, None], axis=-1), axis=1))
    assert pareto.hypervolume(points, np.ones(3)) == pytest.approx(share, abs=0.005)  # 4.5 standard errors


def test_a_small_front_trades_one_figure_for_another():
    objective = tuning.RestToRest(travel=1.0, duration=6.0, dt=2e-2)
    front = tuning.pareto_front(objective, js.SlidingModeGains(), points=6, iterations=3, swing=(0.02, 0.3))
    assert np.all(pareto.non_dominated(front.figures))
    assert np.all(np.diff(front.figures[:, 0]) >= 0.0)
    assert front.gains.c1.shape == (len(front.figures),)
    assert front.rollouts == 18
    assert front.plain_rollouts == 18 * (tuning.levenberg_marquardt().plain_rollouts(6) + 1)  # and one to score each
    assert front.tried == 18
    first = js.SlidingModeGains(*(float(leaf[0]) for leaf in vars(front.gains).values()))
    np.testing.assert_allclose(pareto.figures(objective, first), front.figures[0], rtol=1e-6)


def test_faults_get_one_sentence():
    with pytest.raises(ValueError, match=r"swing = \(0\.3, 0\.1\) is no range; type two increasing"):
        tuning.pareto_front(tuning.RestToRest(), js.SlidingModeGains(), swing=(0.3, 0.1))
