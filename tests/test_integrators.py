"""Measured order of every integrator, on a problem with a known solution and on the closed loop."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.simulation.integrators import METHODS, stepper

ORDERS = {"rk4": 4, "dopri5": 5, "semi_implicit_euler": 1}


def test_every_method_has_a_stated_order():
    assert set(ORDERS) == set(METHODS)


@pytest.mark.parametrize("method", METHODS)
def test_measured_order_on_a_driven_nonlinear_oscillator(method):
    finest = {4: 256, 5: 256, 1: 512}[ORDERS[method]]  # errors of 3e-12 and more, well above rounding
    errors = [oscillator_error(steps, method=method) for steps in (finest // 2, finest)]
    order = np.log2(errors[0] / errors[1])
    assert abs(order - ORDERS[method]) < 0.2  # the next term of the expansion bends it, a wrong coefficient breaks it


def test_rk4_keeps_its_order_on_the_smoothed_closed_loop(slope):
    run = partial(js.rest_to_rest, js.Robot(), slope, duration=2.0, smoothing=1.0, save_every=None)
    exact = run(dt=2.5e-3, method="dopri5").state[0]  # its error is 1e-3 of the smallest one below
    errors = [float(jnp.max(jnp.abs(run(dt=dt).state[0] - exact))) for dt in (4e-2, 2e-2, 1e-2)]
    assert abs(np.log2(errors[1] / errors[2]) - 4.0) < 0.2  # as above
    assert errors[2] < 1e-6


def test_information_is_that_of_the_start_of_the_step():
    for method in METHODS:
        _, info = stepper(method, (False, True))(lambda t, x: ((x[1], -x[0]), (t, x)), *started(1.5))
        assert info[0] == 1.5
        np.testing.assert_array_equal(info[1], [0.3, 0.7])


def test_unknown_method_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"method = 'euler' is not known; type one of rk4, dopri5, semi_implicit_euler"):
        stepper("euler", (False, True))


def started(time):
    """Time, state and step of a test."""
    return jnp.asarray(time), (jnp.asarray(0.3), jnp.asarray(0.7)), jnp.asarray(0.1)


@partial(jax.jit, static_argnames="method")
def oscillator_error(steps, method):
    """Error after 4 s of x'' = -x^3 + sin(t)^3 - sin(t), whose solution is x = sin(t): nonlinear, not autonomous."""
    step, dt = stepper(method, (False, True)), 4.0 / steps

    def field(time, state):
        x, v = state
        return (v, -(x**3) + jnp.sin(time) ** 3 - jnp.sin(time)), None

    def advance(index, state):
        return step(field, index * dt, state, dt)[0]

    x, v = jax.lax.fori_loop(0, steps, advance, (jnp.zeros(()), jnp.ones(())))
    return jnp.hypot(x - jnp.sin(4.0), v - jnp.cos(4.0))
