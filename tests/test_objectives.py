"""The terms of the objective, recomputed from the rollout."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxsphere as js
import tuning

GAINS = js.SlidingModeGains(c1=0.7, eta=4.0)
OBJECTIVE = tuning.RestToRest(duration=1.2, dt=8e-3, swing_limit=float(np.deg2rad(5.0)))


def test_terms_equal_those_of_the_saved_rollout():
    terms = jax.jit(OBJECTIVE.terms)(GAINS)
    found = OBJECTIVE.rollout(GAINS)
    time, alpha, swing = np.asarray(found.time), np.asarray(found.state[:, 0]), np.asarray(found.state[:, 2])
    deviation = np.abs(swing - float(js.equilibrium_swing(js.Robot(), OBJECTIVE.slope)))
    excess = np.rad2deg(np.maximum(deviation - OBJECTIVE.swing_limit, 0.0))
    step = GAINS.eta / np.asarray(found.diagnostics.decoupling)
    expected = tuning.Terms(
        tracking=8e-3 * np.sum(time * np.abs(alpha - 10.0) / 10.0),
        swing=8e-3 * np.sum(excess**2),
        torque=8e-3 * np.sum(np.asarray(found.torque) ** 2),
        chatter=np.mean(step**2),
    )
    for name in terms._fields:
        assert getattr(expected, name) > 0.0
        assert getattr(terms, name) == pytest.approx(getattr(expected, name), rel=1e-10), name  # sums in another order


def test_objective_is_the_weighted_sum_of_its_terms():
    objective = replace(OBJECTIVE, weights=tuning.Weights(2.0, 3.0, 5.0, 7.0))
    terms, value = jax.jit(lambda gains: (objective.terms(gains), objective(gains)))(GAINS)
    expected = sum(w * float(t) for w, t in zip(objective.weights, terms, strict=True))
    assert value == pytest.approx(expected, rel=1e-14)  # the same sum


def test_swing_within_its_limit_costs_nothing():
    assert replace(OBJECTIVE, swing_limit=1.0).terms(GAINS).swing == 0.0
