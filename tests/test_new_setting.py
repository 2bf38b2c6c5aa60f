"""A new setting of the robot's world is one edit: a field of a task, used where the task builds its plant."""

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from experiments.cli.options import arguments, options
from jaxsphere.units import declared_units, quantity

SHORT = js.Numerics(dt=1e-2, duration=0.4, save_every=None)
GAINS = js.SlidingModeGains()


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class DraggedTask(js.PlanarTask):
    """A move against an air drag that grows with the rate of the sphere."""

    drag: float = quantity(0.0, "1/s", "deceleration of the sphere by its rate")

    def dynamics(self):
        """Plant with the drag."""
        plant = super().dynamics()

        def derivative(state, torque):
            rates = tuple(plant.derivative(state, torque))
            return (rates[0], rates[1] - self.drag * rates[0], *rates[2:])

        return plant._replace(derivative=derivative)


def final_angle(drag):
    return js.simulate(DraggedTask(drag=drag), GAINS, SHORT, throw=False).state[-1, 0]


def test_rollouts_batches_and_gradients_see_it():
    angles = np.asarray(js.batch(final_angle)(np.array([0.0, 0.5, 1.0])))
    plain = js.simulate(js.PlanarTask(), GAINS, SHORT, throw=False).state[-1, 0]
    assert angles[0] == pytest.approx(float(plain), rel=1e-12)
    assert np.all(np.diff(angles) < 0.0)
    slope = (final_angle(0.5 + 1e-4) - final_angle(0.5 - 1e-4)) / 2e-4
    assert jax.grad(final_angle)(0.5) == pytest.approx(float(slope), rel=1e-5)


def test_sweeps_name_it_with_its_unit():
    base = {"task": DraggedTask(), "gains": GAINS, "numerics": SHORT, "throw": False}
    found = js.sweep(js.simulate, base, js.axes.linear("task.drag", 0.0, 1.0, 3))
    assert found.coordinates["task.drag"].unit == "1/s"
    assert found.values["final_state"][:, 0] == pytest.approx([float(final_angle(x)) for x in (0.0, 0.5, 1.0)], rel=1e-9)


def test_climbs_and_objectives_see_it():
    # Table 3 is within 2 % of the travel after 6.36 s, and later against a drag.
    just = js.Numerics(duration=6.4, dt=1e-2)
    ends = [int(js.climb_outcome(DraggedTask(drag=drag), GAINS, just).status) for drag in (0.0, 0.5)]
    assert ends == [js.Status.OK, js.Status.NOT_SETTLED]
    calm, dragged = (
        tuning.RestToRest(task=DraggedTask(torque_limit=5.0), drag=drag, dt=2e-2, duration=1.0)(GAINS) for drag in (0.0, 0.5)
    )
    assert dragged > calm


def test_the_command_line_offers_it():
    kind = options("Options", DraggedTask, without=("robot", "plant", "disturbance", "convention"))
    assert arguments(kind(drag=0.25))["drag"] == 0.25
    assert declared_units(DraggedTask())["drag"] == "1/s"
    assert {leaf.name for leaf in dataclasses.fields(DraggedTask)} - {
        leaf.name for leaf in dataclasses.fields(js.PlanarTask)
    } == {"drag"}
    assert jnp.isfinite(final_angle(0.25))
