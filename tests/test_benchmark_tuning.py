"""The comparison of optimisers and of fronts: what is counted, and against what."""

import jax.numpy as jnp
import numpy as np
import pytest

import tuning
from experiments.benchmarks import pareto as benchmark_pareto
from experiments.benchmarks import tuning as benchmark_tuning
from tuning.robust import pareto


class Bowl:
    """As much of an objective as the optimisers need, without a rollout."""

    def residuals(self, gains):
        return jnp.log(jnp.stack([gains.c1, gains.c2, gains.z_u, gains.phi_z, gains.eta, gains.k]))

    def __call__(self, gains):
        return jnp.sum(self.residuals(gains) ** 2)


def trace(objective, cost, with_gradient=1):
    count = np.arange(1, len(objective) + 1)
    return benchmark_tuning.Trace(np.array(objective), count * with_gradient, count * cost, 1.0)


def test_trace_until_skips_what_is_not_finite():
    found = trace([np.nan, 9.0, 3.0, 2.0], cost=7)
    assert found.until(3.0) == (3.0, 21.0)
    assert found.until(1.0) == (np.inf, np.inf)


def test_peer_is_compared_at_the_value_it_ended_at(capsys):
    table = {"jaxsphere lm": trace([4.0, 2.0, 1.0], cost=7), "scipy one": trace([4.0] * 39 + [2.0], cost=1)}
    numbers = benchmark_tuning.against_peers(table)["scipy one"]
    assert numbers["value"] == pytest.approx(2.0 * 1.001)
    assert numbers["rollouts"] == 40.0
    assert numbers["jaxsphere lm"] == {"rollouts": 2.0, "as_plain": 14.0}
    out = capsys.readouterr().out
    assert "1/20.0" in out
    assert "1/2.9" in out


def test_median_over_starts_counts_those_that_never_arrive(capsys):
    traces = {"jaxsphere lm": [trace([2.0, 1.0], 7), trace([1.0], 7), trace([5.0], 7), trace([5.0], 7)]}
    found = benchmark_tuning.until_one_percent(traces)["jaxsphere lm"]
    assert found["arrived"] == 2
    assert found["rollouts"] == np.inf
    assert found["from_table_3"] == [2.0, 14.0]
    assert "never" in capsys.readouterr().out


def test_rollouts_of_every_optimiser_are_counted(monkeypatch):
    monkeypatch.setattr(benchmark_tuning, "STARTS", 2)
    monkeypatch.setattr(benchmark_tuning, "ITERATIONS", {"lm": 2, "lbfgs": 2})
    found = benchmark_tuning.ours(Bowl())
    rule = tuning.levenberg_marquardt()
    lm, bfgs = found["jaxsphere lm"][1], found["jaxsphere lbfgs"][1]
    np.testing.assert_array_equal(lm.rollouts, [1, 2 + rule.trials])
    np.testing.assert_array_equal(lm.plain, [7, 14 + rule.trials])
    np.testing.assert_array_equal(bfgs.plain, [7, 14])
    pytest.importorskip("scipy")
    peers = benchmark_tuning.scipys(Bowl(), 125)
    assert len(peers) == 3
    for name, runs in peers.items():
        assert len(runs) == 2
        for one in runs:
            np.testing.assert_array_equal(one.plain, np.arange(1, len(one.objective) + 1))
        if "evolution" not in name:
            np.testing.assert_allclose([one.objective[0] for one in runs], [lm_.objective[0] for lm_ in found["jaxsphere lm"]])
    assert [len(one.objective) for one in peers["scipy differential evolution"]] == [120, 120]


def test_memory_of_the_gradient_is_printed_for_both_modes(capsys, monkeypatch):
    monkeypatch.setattr(benchmark_tuning, "HORIZONS", (1, 8))
    sizes = benchmark_tuning.gradient_memory(tuning.RestToRest(duration=3.2, dt=2e-2))
    assert sizes["forward"][1] < 1.5 * sizes["forward"][0]
    assert sizes["reverse"][1] > 1.5 * sizes["reverse"][0]
    assert str(sizes["reverse"][1]) in capsys.readouterr().out


def test_survivors_are_the_first_ranks_and_the_loneliest_of_the_last():
    values = np.array([[0.0, 4.0], [1.0, 2.9], [2.0, 2.0], [2.1, 1.9], [4.0, 0.0], [5.0, 5.0], [np.inf, np.inf]])
    assert sorted(benchmark_pareto.survivors(values, 6)) == [0, 1, 2, 3, 4, 5]
    assert sorted(benchmark_pareto.survivors(values, 3)) == [0, 1, 4]
    assert len(benchmark_pareto.survivors(values, 7)) == 7


def test_generalised_differential_evolution_finds_a_known_front():
    def score(vectors):  # the front is x = 0 but for the first two entries: a part of a sphere
        x = np.abs(vectors) / (0.5 * np.pi)
        far = 1.0 + np.sum(x[:, 2:] ** 2, axis=1)
        a, b = 0.5 * np.pi * x[:, 0], 0.5 * np.pi * x[:, 1]
        return far[:, None] * np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=1)

    points = benchmark_pareto.generalised(tuning.RestToRest(), 2400, score=score)
    assert len(points) == 2400
    volume = pareto.hypervolume(points[pareto.non_dominated(points)], np.ones(3))
    assert volume > 0.8 * (1.0 - np.pi / 6.0)
    first = benchmark_pareto.generalised(tuning.RestToRest(), 60, score=score)
    assert pareto.hypervolume(first, np.ones(3)) < 0.1 * volume
