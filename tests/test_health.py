"""Gradient health: verdicts, the Lyapunov exponent against the poles, the audit of the sign, stiff and sloppy directions."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning.diagnostics import health

GAINS = js.SlidingModeGains()
SHORT = tuning.RestToRest(duration=1.2, dt=2e-2)


def test_a_smooth_short_task_is_trusted():
    found = tuning.check_gradient(SHORT, GAINS, horizons=(0.4, 0.8, 1.2))
    np.testing.assert_allclose(found.reverse, found.forward, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.differences, found.forward, rtol=1e-4, atol=1e-6)
    assert np.all(found.norms > 0.0)
    assert found.norms[-1] == pytest.approx(np.linalg.norm(found.forward), rel=1e-9)
    if found.growth <= 1.0 and found.lyapunov <= 1.0:
        assert found.verdict.startswith("trust")


class Lying(tuning.RestToRest):
    """Its derivatives, forward and reverse alike, leave out a part of it."""

    def __call__(self, gains):
        return super().__call__(gains) + jax.lax.stop_gradient(gains.c1 * gains.c2)


def test_a_gradient_that_differences_contradict_is_not_trusted():
    found = tuning.check_gradient(Lying(duration=0.2, dt=2e-2), GAINS, horizons=(0.1, 0.2))
    np.testing.assert_allclose(found.reverse, found.forward, rtol=1e-8, atol=1e-10)
    assert found.disagreement > 1e-2
    assert found.verdict.startswith("clip")


@pytest.mark.parametrize(
    ("numbers", "word"),
    [((1e-2, 0.0, -1.0), "clip"), ((np.nan, 0.0, -1.0), "clip"), ((1e-8, 3.0, -1.0), "shorten"), ((1e-8, 0.0, 2.0), "shorten"),
     ((1e-8, 0.1, -0.3), "trust")],
)  # fmt: skip
def test_verdicts(numbers, word):
    sentence = health._verdict(*numbers, duration=8.0)
    assert sentence.startswith(f"{word}: ")
    assert "\n" not in sentence


def test_lyapunov_exponent_is_the_slowest_pole_near_the_target():
    near = js.equilibrium_swing(js.Robot(), SHORT.task.slope)
    resting = replace(
        SHORT, travel=1e-3, duration=24.0, dt=1e-2, smoothing=1.0, initial_state=jnp.array([0.0, 0.0, float(near), 0.0])
    )
    poles = np.asarray(js.sliding_mode_poles(js.Robot(), SHORT.task.slope, GAINS))
    exponent = float(jax.jit(lambda gains: tuning.lyapunov_exponent(resting, gains))(GAINS))
    assert exponent == pytest.approx(poles.real.max(), abs=0.1)  # a finite time leaves log(constant) / 24 s


def test_audit_tends_to_the_hard_sign_and_hides_its_chatter():
    found = tuning.audit_sign(replace(SHORT, duration=3.0), GAINS, widths=(0.2, 0.02))
    np.testing.assert_array_equal(found.smoothing, [0.2, 0.02, 0.0])
    assert found.chatter[-1] > 10.0 * found.chatter[0]
    assert abs(found.itae[1] - found.itae[2]) < abs(found.itae[0] - found.itae[2])
    assert found.gap == pytest.approx(abs(found.itae[-1] / found.itae[0] - 1.0))


def test_stiff_and_sloppy_directions_of_a_known_quadratic():
    class Known:
        def residuals(self, gains):
            return jnp.stack([10.0 * jnp.log(gains.c1 / gains.c2), 0.1 * jnp.log(gains.c1 * gains.c2), jnp.log(gains.k)])

    found = tuning.stiff_and_sloppy(Known(), GAINS, ("c1", "c2", "k"))
    np.testing.assert_allclose(found.eigenvalues, [400.0, 2.0, 0.04], rtol=1e-10)
    np.testing.assert_allclose(np.abs(found.vectors[0]), [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-12)
    sentence = found.sentence()
    assert "c1 / c2" in sentence or "c2 / c1" in sentence
    assert "1.0e+04 times as stiff" in sentence
    # Along c1 c2 the objective is 0.02 d^2: it has risen by 0.01 at d = sqrt(0.5).
    assert f"by a factor of {np.exp(np.sqrt(0.5)):.3g} before" in sentence


@pytest.mark.parametrize("factor", [4, 16])
def test_memory_of_a_forward_gradient_is_flat_in_the_horizon(factor):
    def temporary(duration):
        objective = replace(SHORT, duration=duration)
        forward = tuning.value_and_gradient(objective, tuning.parametrise(GAINS))
        compiled = jax.jit(forward).lower(jnp.zeros(6)).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    once = temporary(0.8)
    assert 0 < once < 1e6
    assert temporary(0.8 * factor) < 1.1 * once + 64 * 40 * factor**0.5  # the loop is cut into blocks of root length


def test_a_saved_trajectory_does_need_memory_in_the_horizon():
    term = tuning.Term("peak", lambda trajectory: jnp.max(trajectory.state[:, 1]))

    def temporary(duration):
        objective = replace(SHORT, duration=duration, extra=(term,))
        forward = tuning.value_and_gradient(objective, tuning.parametrise(GAINS))
        return jax.jit(forward).lower(jnp.zeros(6)).compile().memory_analysis().temp_size_in_bytes

    assert temporary(12.8) > 4.0 * temporary(0.8)
