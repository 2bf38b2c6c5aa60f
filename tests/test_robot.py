"""The robot: published sets, their climbing bounds, and one sentence per fault."""

from dataclasses import fields, replace

import jax
import numpy as np
import pytest

import jaxsphere as js

POSITIVE_SCALARS = ("shell_mass", "gimbal_mass", "pendulum_mass", "pendulum_length", "shell_radius")


def test_default_is_set_a():
    for leaf in fields(js.Robot):
        np.testing.assert_array_equal(getattr(js.Robot(), leaf.name), getattr(js.robots()["set_a"], leaf.name))


@pytest.mark.parametrize("name", ["set_a", "roboball_ii", "rotunbot"])
def test_published_robots_pass_their_own_check(name):
    assert js.check_robot(js.robot_named(name)) is not None
    assert set(js.robots()) == {"set_a", "roboball_ii", "rotunbot"}


@pytest.mark.parametrize(
    ("name", "degrees", "digits"),
    [("set_a", 18.7578, 5e-5), ("roboball_ii", 9.2, 0.05), ("rotunbot", 25.25, 5e-3)],  # half the last digit
)
def test_published_climbing_bounds(name, degrees, digits):
    assert np.rad2deg(js.climbing_bound(js.robot_named(name))) == pytest.approx(degrees, abs=digits)


def test_roboball_cannot_hold_ten_degrees(slope):
    assert not js.equilibrium.can_hold(js.robot_named("roboball_ii"), slope)
    assert js.equilibrium.can_hold(js.robot_named("set_a"), slope)


def test_unknown_robot_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"robot = 'setA'.*set_a, roboball_ii, rotunbot"):
        js.robot_named("setA")


@pytest.mark.parametrize("field", POSITIVE_SCALARS)
@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan, np.inf, -np.inf])
def test_scalar_fields_must_be_positive_and_finite(field, value):
    message = fault(replace(js.Robot(), **{field: value}))
    assert f"robot.{field} = {value:g}" in message
    assert "above 0" in message


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_gravity_may_vanish_but_not_be_negative(value):
    message = fault(replace(js.Robot(), gravity=value))
    assert f"robot.gravity = {value:g}" in message
    assert "at least 0" in message
    assert js.check_robot(replace(js.Robot(), gravity=0.0)).gravity == 0.0


@pytest.mark.parametrize("field", ["shell_inertia", "gimbal_inertia"])
@pytest.mark.parametrize("entry", [-0.01, np.nan, np.inf])
def test_moments_must_be_finite_and_not_negative(field, entry):
    message = fault(replace(js.Robot(), **{field: np.array([0.018, 0.018, entry])}))
    assert message.startswith(f"robot.{field} = [0.018, 0.018, {entry}]")
    assert "finite and" in message


def test_only_the_gimbal_may_have_no_inertia():
    assert "robot.shell_inertia = [0.0, 0.0, 0.0]" in fault(replace(js.Robot(), shell_inertia=np.zeros(3)))
    massless_gimbal = replace(js.Robot(), gimbal_inertia=np.zeros(3))
    assert js.check_robot(massless_gimbal) is massless_gimbal


@pytest.mark.parametrize("field", ["shell_inertia", "gimbal_inertia"])
def test_moments_of_no_rigid_body_are_refused(field):
    message = fault(replace(js.Robot(), **{field: np.array([0.01, 0.01, 0.021])}))
    assert message.startswith(f"robot.{field} = [0.01, 0.01, 0.021]")
    assert "triangle inequality" in message
    flat = replace(js.Robot(), **{field: np.array([0.01, 0.01, 0.02])})  # a flat disc: the limit is admissible
    assert js.check_robot(flat) is flat


@pytest.mark.parametrize("field", ["shell_inertia", "gimbal_inertia"])
@pytest.mark.parametrize("value", [0.018, np.ones(2), np.ones((3, 3))])
def test_moments_of_another_shape_are_refused(field, value):
    message = fault(replace(js.Robot(), **{field: value}))
    assert message.startswith(f"robot.{field} has shape {np.shape(value)}")
    assert "three principal moments" in message


@pytest.mark.parametrize("field", [*POSITIVE_SCALARS, "gravity"])
def test_batched_scalars_point_to_vmap(field):
    message = fault(replace(js.Robot(), **{field: np.ones(2)}))
    assert f"robot.{field} has shape (2,)" in message
    assert "vmap" in message


@pytest.mark.parametrize("length", [0.15, 0.16])
def test_pendulum_must_fit_into_the_shell(length):
    message = fault(replace(js.Robot(), pendulum_length=length))
    assert f"robot.pendulum_length = {length:g} m" in message
    assert "robot.shell_radius = 0.15 m" in message


def test_words_are_no_numbers_and_other_types_no_robots():
    assert "robot.shell_mass = 'heavy' is no number" in fault(replace(js.Robot(), shell_mass="heavy"))
    with pytest.raises(TypeError, match=r"robot = 3 is no Robot; type jaxsphere\.Robot"):
        js.check_robot(3)


def test_name_of_the_argument_is_used():
    with pytest.raises(ValueError, match=r"^plant\.shell_mass = -1"):
        js.check_robot(replace(js.Robot(), shell_mass=-1.0), "plant")


def test_traced_fields_are_passed_over():
    masses = jax.vmap(lambda mass: js.check_robot(replace(js.Robot(), shell_mass=mass)).shell_mass)(np.array([-1.0, 2.0]))
    np.testing.assert_array_equal(masses, [-1.0, 2.0])


def fault(robot: js.Robot) -> str:
    """Return the one sentence that the robot is refused with."""
    with pytest.raises(ValueError, match=r"robot\.") as caught:
        js.check_robot(robot)
    message = str(caught.value)
    assert "\n" not in message
    assert "; type " in message or "jax.vmap" in message
    return message


def test_moments_that_are_words_are_named():
    with pytest.raises(ValueError, match="shell_inertia"):
        js.check_robot(replace(js.Robot(), shell_inertia=["a", "b", "c"]))
