"""Stages of a search, hard limits at its end, and where an objective ceases to be finite."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning.objectives.terms import Series, first_not_finite

TABLE_3 = js.SlidingModeGains()
SHORT = tuning.RestToRest(duration=0.4, dt=2e-2)


class Staged(NamedTuple):
    """A bowl whose minimum moves and rises from stage to stage: c1 = 1, 2, 4."""

    stages: int = 3

    def stage(self, index):
        return lambda gains: jnp.log(gains.c1 / jnp.array([1.0, 2.0, 4.0])[index]) ** 2 + 1.0 + index

    def __call__(self, gains):
        return self.stage(2)(gains)


def quiet(objective, **settings):
    return tuning.tune(objective, TABLE_3, **{"progress": False, "frozen": ("c2", "z_u", "phi_z", "eta", "k")} | settings)


@pytest.mark.parametrize("optimiser", ["lbfgs", "adam"])
def test_every_stage_starts_from_the_best_of_the_last_and_forgets_its_value(optimiser):
    found = quiet(Staged(), optimiser=optimiser, iterations=90, learning_rate=0.3, chunk=40)
    assert found.gains.c1 == pytest.approx(4.0, rel=2e-2)
    # The last stage is the highest; what counts is its own best.
    assert found.objective == pytest.approx(3.0, abs=1e-3)
    assert found.objective == np.min(found.history["objective"][60:])
    assert found.bests[0] == found.objective
    assert found.initial_objective == pytest.approx(np.log(0.5501 / 4.0) ** 2 + 3.0)
    values = found.history["objective"][:, 0]
    assert values[30] == pytest.approx(np.log(2.0) ** 2 + 2.0, rel=5e-2)
    assert values[60] == pytest.approx(np.log(2.0) ** 2 + 3.0, rel=5e-2)


def test_an_annealed_objective_ends_with_its_last_stage():
    annealed = tuning.Annealed(SHORT, smoothing=(0.2, 0.05), stiffness=(1.0, 9.0))
    base = SHORT.weights
    heavy = base._replace(
        swing=9 * base.swing, overshoot=9 * base.overshoot, singularity=9 * base.singularity, stability=9 * base.stability
    )
    expected = replace(SHORT, smoothing=0.05, weights=heavy)(TABLE_3)
    np.testing.assert_allclose(annealed.stage(1).weights, heavy)
    assert annealed(TABLE_3) == pytest.approx(float(expected), rel=1e-12)
    assert annealed.stage(0)(TABLE_3) == pytest.approx(float(SHORT(TABLE_3)), rel=1e-12)
    assert jnp.sum(annealed.residuals(TABLE_3) ** 2) == pytest.approx(float(expected), rel=1e-12)


def test_limits_are_relative_and_decide_what_is_feasible():
    objective = replace(SHORT, duration=4.0, swing_limit=0.2)
    limits = objective.limits(TABLE_3)
    run = objective.rollout(TABLE_3)
    assert limits.soft["swing"] == pytest.approx(float(run.metrics.peak_swing) / 0.2 - 1.0)
    assert limits.soft["swing"] > 0.02
    assert not limits.feasible
    assert limits.sentence() == f"breaks swing by {float(limits.soft['swing']):.3g}"
    kept = limits._replace(soft={"swing": jnp.asarray(0.019)})
    assert kept.feasible
    assert kept.sentence() == "keeps every limit"
    assert objective.limits(replace(TABLE_3, z_u=0.99, c2=200.0)).hard["singularity"] > 0.0
    early = replace(objective, plant=js.Robot(pendulum_mass=0.4)).limits(TABLE_3)
    assert early.hard["ended_early"] >= 0.0


class Limited(NamedTuple):
    """A bowl with its minimum at c1 = 1, and a limit on c1 from below."""

    least: float

    def __call__(self, gains):
        return jnp.log(gains.c1) ** 2 + 1.0

    def limits(self, gains):
        return tuning.Limits({}, {"swing": self.least / gains.c1 - 1.0})


def test_the_best_feasible_start_wins():
    # No step is taken: the starts lie where they are drawn.
    settings = {"iterations": 1, "starts": 16, "bounds": {"c1": (0.3, 3.0)}}
    free, limited = quiet(Limited(0.0), **settings), quiet(Limited(1.8), **settings)
    assert abs(np.log(free.gains.c1)) == np.min(np.abs(np.log(free.answers["c1"])))
    assert limited.status == "finished"
    assert limited.gains.c1 == np.min(limited.answers["c1"][limited.answers["c1"] >= 1.8 / 1.02])
    np.testing.assert_array_equal(limited.feasible, limited.answers["c1"] >= 1.8 / 1.02)
    none = quiet(Limited(9.0), **settings)
    assert none.status == "infeasible"
    assert none.gains.c1 == free.gains.c1
    assert "all 16 starts ended infeasible: the best breaks swing by" in none.report()


def nan_after(time):
    def spoil(trajectory):
        return jnp.where(trajectory.time[-1] > time, jnp.nan, 0.0)

    return spoil


def test_the_first_quantity_that_is_not_finite_is_named():
    time, late, early = jnp.arange(3.0), jnp.array([0.0, 0.0, jnp.inf]), jnp.array([0.0, jnp.nan, 1.0])
    assert first_not_finite(Series(time, {"late": late, "early": early}, {})) == "lane 0, t = 1 s, early"
    assert first_not_finite(Series(time, {"late": late}, {"still": jnp.array([jnp.nan])}), lane=3) == "lane 3, t = 0 s, still"
    assert "all of its terms are finite" in first_not_finite(Series(time, {"fine": time}, {}))


def test_an_objective_that_is_not_finite_names_lane_time_and_quantity():
    spoilt = replace(SHORT, extra=(tuning.Term("comfort", nan_after(0.1)),))
    with pytest.raises(ValueError, match=r"objective = nan at initial_gains \(lane 0, t = 0.4 s, term comfort\), and it is"):
        tuning.tune(spoilt, TABLE_3, optimiser="lm", iterations=1, chunk=1, progress=False)
    scenarios, _ = tuning.sample(tuning.Uncertainty(swing=0.1), js.Robot(), 3, seed=0)
    scenarios = replace(scenarios, slope=scenarios.slope.at[1].set(jnp.nan))
    assert tuning.Robust(SHORT, scenarios).explain(TABLE_3).startswith("lane 1, t = 0 s, ")


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (tuning.Annealed(SHORT, smoothing=(0.1,)), "smoothing has 1 stages and stiffness 3; type as many"),
        (tuning.Annealed(SHORT, smoothing=(), stiffness=()), "at least one"),
        (tuning.Annealed(SHORT, smoothing=(0.2, 0.1, 0.0)), "smoothing = 0 is not admissible"),
        (tuning.Annealed(replace(SHORT, slope=0.5)), r"slope = 0.5 rad \(28.65 deg\) is past the climbing bound"),
        (replace(SHORT, weights=tuning.Weights(*[0.0] * 9)), "weights leaves the objective without terms"),
    ],
)
def test_faults_get_one_sentence_before_anything_is_compiled(objective, message):
    with pytest.raises(ValueError, match=message) as caught:
        tuning.tune(objective, TABLE_3, iterations=5, progress=False)
    assert "\n" not in str(caught.value)
