"""The non-dominated filter, the hypervolume and a small front."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning.robust import pareto


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
    front = tuning.pareto_front(objective, js.SlidingModeGains(), points=6, iterations=3, rounds=2, swing=(0.02, 0.3))
    assert np.all(pareto.non_dominated(front.figures))
    assert np.all(np.diff(front.figures[:, 0]) >= 0.0)
    assert front.gains.c1.shape == (len(front.figures),)
    assert front.rollouts == 18
    assert front.tried == 18 + 2 * 30
    assert front.plain_rollouts == 18 * tuning.levenberg_marquardt().plain_rollouts(6) + front.tried  # each is scored
    first = js.SlidingModeGains(*(float(leaf[0]) for leaf in vars(front.gains).values()))
    np.testing.assert_allclose(objective.figures(first), front.figures[0], rtol=1e-6)


class Telltale(tuning.RestToRest):
    """Its best c1 and c2 tell the swing limit and the weight of the torque that it was given."""

    def residuals(self, gains):
        return jnp.stack([gains.c1 - 2.0 * self.swing_limit, gains.c2 - 5.5 - jnp.log10(self.weights.torque)])


def test_weightings_fill_both_ranges_evenly_in_the_logarithm(monkeypatch):
    monkeypatch.setattr(Telltale, "figures", lambda _, gains: jnp.stack([gains.c1, -gains.c1, jnp.ones(())]))
    start = js.SlidingModeGains(c1=0.6, c2=3.0)
    front = tuning.pareto_front(Telltale(), start, points=8, iterations=40, rounds=0, swing=(0.15, 0.6), effort=(1e-4, 0.1))
    # Where a weighting ends, it stays for many iterations.
    ends = [np.unique(np.round(np.asarray(leaf), 6), return_counts=True) for leaf in (front.gains.c1, front.gains.c2)]
    swings, decades = (values[counts >= 10] for values, counts in ends)
    np.testing.assert_array_equal(np.floor(8 * np.log(0.5 * swings / 0.15) / np.log(4.0)), np.arange(8))
    np.testing.assert_array_equal(np.floor(8 * (decades - 5.5 + 4.0) / 3.0), np.arange(8))


def test_rounds_fill_in_the_front_and_reach_beyond_its_edge(monkeypatch):
    monkeypatch.setattr(Telltale, "figures", lambda _, gains: jnp.stack([gains.c1, 1.0 / gains.c1, gains.c2]))
    settings = {"points": 8, "iterations": 2, "swing": (0.15, 0.6), "effort": (1e-4, 0.1)}
    fronts = [tuning.pareto_front(Telltale(), js.SlidingModeGains(c1=0.6, c2=3.0), rounds=n, **settings) for n in (0, 3)]
    volumes = [pareto.hypervolume(front.figures, np.array([2.0, 6.0, 9.0])) for front in fronts]
    assert volumes[1] > 1.02 * volumes[0]
    assert len(fronts[1].figures) > 2 * len(fronts[0].figures)
    assert fronts[1].figures[:, 2].min() < fronts[0].figures[:, 2].min()
    assert np.all(pareto.non_dominated(fronts[1].figures))


def test_figures_are_scored_with_the_hard_sign_and_infinite_unless_settled():
    task, gains = tuning.RestToRest(), js.SlidingModeGains()
    found = js.rest_to_rest(
        js.Robot(), task.task.slope, gains, 10.0, 8.0, 1e-3, 0.0, 5.0, control_period=1e-3, save_every=None, throw=False
    )
    assert found.status == js.Status.OK
    expected = [found.metrics.settling_time, found.metrics.peak_swing, found.metrics.effort]
    np.testing.assert_allclose(task.figures(gains), expected, rtol=1e-9)
    assert np.all(np.isinf(task.figures(js.SlidingModeGains(c1=0.1))))


def test_faults_get_one_sentence():
    with pytest.raises(ValueError, match=r"swing = \(0\.3, 0\.1\) is no range; type two increasing"):
        tuning.pareto_front(tuning.RestToRest(), js.SlidingModeGains(), swing=(0.3, 0.1))
