"""Gradients through a rollout: forward, reverse and central differences agree, and no gain is left out."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning

OBJECTIVE = tuning.RestToRest(duration=2.0, dt=8e-3)
NAMES = tuple(leaf.name for leaf in fields(js.SlidingModeGains))
CASES = {
    "table 3": (js.SlidingModeGains(), NAMES[:6]),
    "seeking": (js.SlidingModeGains(0.72, 3.3, 0.76, 9.0, 6.0, 10.0, 0.05), NAMES),
}


@pytest.fixture(params=CASES)
def case(request):
    """Gains and the names of those to differentiate with respect to."""
    return CASES[request.param]


evaluate = jax.jit(OBJECTIVE)
by_forward = jax.jit(jax.jacfwd(OBJECTIVE))
by_reverse = jax.jit(jax.grad(OBJECTIVE))


def test_forward_equals_reverse_equals_central_differences_and_none_vanishes(case):
    gains, names = case
    forward, reverse = by_forward(gains), by_reverse(gains)
    for name in names:
        ahead, back = float(getattr(forward, name)), float(getattr(reverse, name))
        assert ahead == pytest.approx(back, rel=1e-10), name  # the same sums in another order
        assert ahead == pytest.approx(richardson(gains, name), rel=1e-6), name
        assert abs(ahead) > 1e-4, name


def test_terms_reach_the_gradient_one_by_one():
    # Table 3 swings by more than 5 degrees, but by less than the default limit of 20.
    terms = replace(OBJECTIVE, swing_limit=np.deg2rad(5.0), duration=1.2).terms
    moving = ("itae", "swing", "torque", "chatter", "settling")  # the others are zero here or know no trajectory
    gradients = jax.jit(jax.jacfwd(terms))(js.SlidingModeGains())
    for term in moving:
        gradient = getattr(gradients, term)
        assert all(getattr(gradient, name) != 0.0 for name in ("c1", "c2", "z_u", "phi_z", "eta", "k")), term


def test_gradient_with_respect_to_robot_and_slope(slope):
    def value(robot, slope):
        return replace(OBJECTIVE, robot=robot, slope=slope)(js.SlidingModeGains())

    by_robot, by_slope = jax.jit(jax.grad(value, (0, 1)))(js.Robot(), slope)
    shape = jax.tree.structure(js.Robot())
    assert jax.tree.structure(by_robot) == shape
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((by_robot, by_slope)))
    for name in ("shell_mass", "gimbal_mass", "pendulum_mass", "pendulum_length", "shell_radius", "gravity"):
        assert abs(getattr(by_robot, name)) > 1e-4, name
    for name in ("shell_inertia", "gimbal_inertia"):
        np.testing.assert_array_equal(getattr(by_robot, name)[:2], 0.0)  # the plane knows the spin axis alone
        assert abs(getattr(by_robot, name)[2]) > 1e-4
    assert abs(by_slope) > 1e-4
    # The slope by differences: the same rule as for the gains, around 0.17 rad.
    step = 1e-4
    compiled = jax.jit(value)
    coarse, fine = ((compiled(js.Robot(), slope + h) - compiled(js.Robot(), slope - h)) / (2 * h) for h in (2 * step, step))
    assert by_slope == pytest.approx(float((4 * fine - coarse) / 3), rel=1e-6)


def test_gradient_of_a_lane_past_the_bound_is_finite_and_does_not_spoil_its_neighbour(slope):
    def value(slope):
        return replace(OBJECTIVE, slope=slope, duration=0.4)(js.SlidingModeGains())

    both = jax.jit(jax.vmap(jax.jacfwd(value)))(jnp.array([slope, 0.45]))
    assert np.isfinite(both).all()
    assert both[0] == pytest.approx(float(jax.jit(jax.jacfwd(value))(slope)), rel=1e-10)  # vectors round differently


def richardson(gains, name):
    """Derivative with respect to one gain from central differences at h and 2 h, error of order h^4.

    With h = 1e-4 of the gain the truncation is about 1e-16 and rounding 1e-16 / 1e-4 = 1e-12, of values of order one; a wider
    step lets samples cross the swing limit, where the second derivative jumps.
    """
    value = float(getattr(gains, name))

    def difference(step):
        up, down = (evaluate(replace(gains, **{name: value + sign * step})) for sign in (1.0, -1.0))
        return float(up - down) / (2.0 * step)

    step = 1e-4 * value
    return (4.0 * difference(step) - difference(2.0 * step)) / 3.0
