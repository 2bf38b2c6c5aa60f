"""Figures of merit on made-up motions whose numbers can be read off."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsphere.tasks.metrics import regulation

DT = 0.5


def measured(alpha, torque=None, travel=10.0, swing=None):
    """Metrics of a motion given by its samples, as a rollout feeds them."""
    count = len(alpha)
    torque = np.zeros(count) if torque is None else np.asarray(torque)
    swing = np.full(count, 0.5) if swing is None else np.asarray(swing)
    measure = regulation(jnp.asarray(travel), jnp.asarray(travel), jnp.asarray(0.5))

    def update(running, sample):
        index, a, s, tau = sample
        dt = jnp.where(index < count - 1, DT, 0.0)
        return measure.update(running, index * DT, (a, 0.0, s, 0.0), (tau,), dt), None

    samples = (np.arange(count), np.asarray(alpha, float), swing, torque)
    return measure.finish(jax.lax.scan(update, measure.initial, samples)[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_settling_counts_from_the_last_entry_into_the_band(sign):
    # In the band at 1 s, out of it at 1.5 s, back at 2.5 s and there to the end; the band is +-0.2 rad.
    alpha = sign * np.array([0.0, 5.0, 9.9, 10.5, 10.3, 10.1, 10.15, 9.85])
    found = measured(alpha, travel=sign * 10.0)
    assert found.settling_time == 2.5
    assert found.overshoot == pytest.approx(0.05, rel=1e-12)
    assert found.final_error == pytest.approx(-0.15 * sign, rel=1e-12)


def test_a_motion_that_leaves_the_band_at_the_end_has_not_settled():
    assert measured([0.0, 9.9, 10.0, 10.3]).settling_time == np.inf
    assert measured([0.0, 9.0, 9.7]).settling_time == np.inf
    assert measured([0.0, 9.0, 9.7]).overshoot == 0.0


def test_swing_torque_and_integrals():
    found = measured([0.0, 5.0, 10.0], torque=[1.0, -2.0, 0.5], swing=[0.5, 0.9, 0.2])
    assert (found.lowest_swing, found.highest_swing) == (0.2, 0.9)
    assert found.peak_swing == pytest.approx(0.4, rel=1e-12)
    assert found.peak_torque == 2.0
    assert found.effort == pytest.approx(DT * (1.0 + 4.0), rel=1e-12)
    assert found.chatter == pytest.approx(3.0 + 2.5, rel=1e-12)
    assert found.itae == pytest.approx(DT * (0.0 * 1.0 + DT * 0.5), rel=1e-12)
