"""Sine and cosine by polynomials, and the fence around values that are computed once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxsphere.numerics import evaluate_once, sincos

# Largest angle and absolute error that the docstring of sincos promises.
PROMISES = {np.float64: (1e5, 3e-16), np.float32: (1e3, 2e-7)}


@pytest.mark.parametrize("dtype", PROMISES)
def test_error_stays_below_the_promised_bound(dtype, rng):
    reach, bound = PROMISES[dtype]
    quarters = np.arange(-int(reach / 1.6), int(reach / 1.6)) * (np.pi / 4)  # where the reduction cancels or switches
    angle = np.concatenate([rng.uniform(-reach, reach, 200_000), rng.uniform(-4, 4, 50_000), quarters]).astype(dtype)
    sine, cosine = jax.jit(sincos)(angle)
    assert sine.dtype == cosine.dtype == dtype
    exact = angle.astype(np.longdouble)  # the reference needs digits to spare for a bound of one rounding
    assert np.max(np.abs(np.asarray(sine, np.longdouble) - np.sin(exact))) < bound
    assert np.max(np.abs(np.asarray(cosine, np.longdouble) - np.cos(exact))) < bound


@settings(deadline=None, max_examples=200, derandomize=True)
@given(st.floats(-1e5, 1e5))
def test_error_bound_holds_for_adversarial_angles(angle):
    sine, cosine = sincos(angle)
    assert abs(float(sine) - np.sin(angle)) < 4e-16  # the bound 3e-16 plus half a rounding of the reference itself
    assert abs(float(cosine) - np.cos(angle)) < 4e-16


def test_exact_at_zero_and_odd_and_even():
    angle = np.linspace(0.0, 7.0, 1001)
    sine, cosine = sincos(angle)
    mirrored_sine, mirrored_cosine = sincos(-angle)
    np.testing.assert_array_equal(mirrored_sine, -sine)
    np.testing.assert_array_equal(mirrored_cosine, cosine)
    assert (float(sine[0]), float(cosine[0])) == (0.0, 1.0)


def test_integers_and_shapes_are_taken():
    sine, cosine = sincos(np.arange(6).reshape(2, 3))
    assert sine.shape == cosine.shape == (2, 3)
    assert sine.dtype == jnp.float64


def test_derivatives_of_every_order_are_those_of_sine_and_cosine(rng):
    angle, rate = rng.uniform(-10, 10, 64), rng.normal(size=64)
    values, rates = jax.jvp(sincos, (angle,), (rate,))
    # One rounding of each factor: the derivative is a product of a value good to 3e-16 and the rate.
    np.testing.assert_allclose(rates[0], np.cos(angle) * rate, atol=1e-14)
    np.testing.assert_allclose(rates[1], -np.sin(angle) * rate, atol=1e-14)
    np.testing.assert_array_equal(values, sincos(angle))
    third = jax.vmap(jax.grad(jax.grad(jax.grad(lambda x: sincos(x)[0]))))(angle)
    np.testing.assert_allclose(third, -np.cos(angle), atol=1e-14)
    reverse = jax.vmap(jax.grad(lambda x: sincos(x)[0] * sincos(x)[1]))(angle)
    np.testing.assert_allclose(reverse, np.cos(2 * angle), atol=1e-14)


def test_evaluate_once_is_the_identity_with_unit_derivative(rng):
    value = rng.normal(size=100) * 10.0 ** rng.integers(-200, 200, 100)
    np.testing.assert_array_equal(evaluate_once(value), value)
    np.testing.assert_array_equal(jax.vmap(jax.grad(evaluate_once))(value), np.ones(100))
    assert evaluate_once(jnp.float32(3.0)).dtype == jnp.float32


def test_evaluate_once_turns_what_is_not_finite_into_nan():
    assert np.all(np.isnan(evaluate_once(np.array([np.inf, -np.inf, np.nan]))))
