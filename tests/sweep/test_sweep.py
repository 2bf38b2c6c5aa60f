"""A sweep gives what vmap gives, in named axes, and says in one sentence what it cannot do."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sweep_cases

import jaxsphere as js
from jaxsphere.sweep import axes as ax


@pytest.fixture(scope="module")
def climbs():
    """Sweep of real closed loops over every kind of axis."""
    return sweep_cases.climbs()


def test_values_are_those_of_vmap(climbs):
    lanes = np.arange(climbs.lanes)
    values = ax.arguments_at(climbs.axes, lanes)
    base = sweep_cases.BASE

    def lane(slope, c1, travel, mass, inertia, swing, rate):
        robot = dataclasses.replace(js.Robot(), pendulum_mass=mass, shell_inertia=jnp.array([0.018, 0.018, inertia]))
        state = jnp.array([0.0, 0.0, swing, rate])
        settings = {name: base[name] for name in ("duration", "dt", "method", "save_every")}
        return js.rest_to_rest(robot, slope, js.SlidingModeGains(c1=c1), travel, initial_state=state, **settings)

    expected = jax.jit(jax.vmap(lane))(*values.values())
    assert climbs.shape == (11, 2, 12, 5)
    np.testing.assert_array_equal(climbs.status.ravel(), expected.status)
    outputs = expected.metrics._asdict() | {"end_time": expected.end_time, "final_state": expected.state[:, -1]}
    assert set(climbs.values) == set(outputs) | {"status"}
    for name, array in outputs.items():
        found = climbs.values[name]
        assert found.shape[:4] == climbs.shape
        np.testing.assert_allclose(found.reshape(array.shape), array, rtol=1e-9, atol=1e-11)


def test_statuses_add_up_to_the_lanes(climbs):
    counts = climbs.counts()
    assert sum(counts.values()) == climbs.lanes == 1320
    assert counts[js.Status.INFEASIBLE_LEAN] == np.sum(climbs.status == js.Status.INFEASIBLE_LEAN) > 100
    # Past the bound of its own robot, every lane and only those.
    steep = climbs.coordinates["slope"].values[:, None] > np.rad2deg(
        [float(js.climbing_bound(js.Robot(pendulum_mass=mass))) for mass in climbs.coordinates["robot.pendulum_mass"].values]
    )
    expected = np.broadcast_to(steep[:, None, :, None], climbs.shape)
    np.testing.assert_array_equal(climbs.status == js.Status.INFEASIBLE_LEAN, expected)


def test_coordinates_carry_dimensions_and_units(climbs):
    assert climbs.dimensions == ("slope", "move", "sample", "draw")
    slope = climbs.coordinates["slope"]
    assert (slope.dimensions, slope.unit) == (("slope",), "deg")
    np.testing.assert_allclose(slope.values, np.linspace(-5.0, 22.0, 11), atol=1e-14)
    assert climbs.coordinates["gains.c1"].dimensions == ("move",)
    assert climbs.coordinates["initial_state.2"].values.shape == climbs.shape


def counted(calls):
    """A lane function that counts how often it is traced."""

    def lane(x, scale=1.0):
        calls.append(1)
        return js.rollout(
            js.Plant(lambda x, u: (u[0] - x[0],), lambda x: jnp.int32(0), (False,)),
            lambda time, x, memory: js.ControllerOutput((scale * x[0],), (), jnp.int32(0)),
            (x,),
            dt=jnp.asarray(0.1),
            steps=10,
            save_every=None,
        )

    return lane


def test_a_sweep_traces_and_compiles_once_whatever_the_number_of_chunks():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, seconds, **_: compiled.append(name) if name.endswith("backend_compile_duration") else None
    )
    for count in (512, 1800):
        calls = []
        compiled.clear()
        found = js.sweep(counted(calls), {}, js.axes.linear("x", 0.0, 1.0, count), chunk=512)
        assert len(calls) == 1
        assert len(compiled) == 1
        assert len(found.shards.chunks) == -(-count // 512)
        np.testing.assert_allclose(found.values["final_state"][:, 0], np.linspace(0.0, 1.0, count), atol=1e-12)


class Pair(NamedTuple):
    """Two numbers of a lane."""

    first: float
    second: float


def test_any_pytree_of_numbers_may_go_in_and_out():
    base = {"table": {"rows": [np.arange(3.0), Pair(1.0, 2.0)]}, "word": "twice", "also": (True, None)}

    def lane(table, word, also, extra):
        row, pair = table["rows"]
        assert word == "twice"
        return {"row": 2.0 * row, "deep": [pair, {"extra": extra}], "whole": 3, "yes": extra > 0.0}

    axes = [
        js.axes.listed("table.rows.0.1", [5, 6]),
        js.axes.listed("table.rows.1.second", [7, 8, 9]),
        js.axes.listed("extra", [0]),
    ]
    found = js.sweep(lane, base, axes)
    assert {name: array.shape for name, array in found.values.items()} == {
        "deep.0.first": (2, 3, 1),
        "deep.0.second": (2, 3, 1),
        "deep.1.extra": (2, 3, 1),
        "row": (2, 3, 1, 3),
        "whole": (2, 3, 1),
        "yes": (2, 3, 1),
    }
    np.testing.assert_array_equal(found.values["row"][1, 0, 0], [0.0, 12.0, 4.0])
    np.testing.assert_array_equal(found.values["deep.0.second"][0, :, 0], [7.0, 8.0, 9.0])
    assert found.values["yes"].dtype == bool
    np.testing.assert_array_equal(base["table"]["rows"][0], [0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match=r"returns no status; let it return"):
        found.counts()
    with pytest.raises(KeyError, match=r"'rows' is no output; type one of deep"):
        found.values["rows"]


def test_single_precision_reaches_axes_base_and_a_dtype_argument():
    def lane(x, array, dtype):
        assert (x.dtype, array.dtype, jnp.dtype(dtype)) == (jnp.float32,) * 3
        return x * array

    found = js.sweep(lane, {"array": np.ones(2)}, js.axes.linear("x", 0.0, 1.0, 5), dtype=jnp.float32)
    assert found.values["value"].dtype == np.float32
    single = sweep_cases.swings(dtype=jnp.float32)
    assert single.values["final_state"].dtype == np.float32
    double = sweep_cases.swings()
    kept = (single.status == 0) & (double.status == 0)
    np.testing.assert_allclose(single.values["final_state"][kept], double.values["final_state"][kept], atol=1e-4)


def test_xarray_gets_dimensions_coordinates_and_units(climbs):
    data = climbs.to_xarray()
    assert dict(data.sizes) == {**dict(zip(climbs.dimensions, climbs.shape, strict=True)), "final_state_0": 4}
    assert data["slope"].attrs["units"] == "deg"
    assert data["peak_torque"].attrs["units"] == "N m"
    np.testing.assert_array_equal(data["final_error"].sel(slope=-5.0).values, climbs.values["final_error"][0])
    assert data["gains.c1"].dims == ("move",)


@dataclasses.dataclass
class Cart:
    """A thing with declared units."""

    mass: float = dataclasses.field(default=1.0, metadata={"unit": "kg"})
    sides: tuple = dataclasses.field(default=(1.0, 2.0), metadata={"unit": "m"})


class Rolled(NamedTuple):
    """Outputs with declared units."""

    UNITS = {"way": "m"}  # noqa: RUF012
    way: float
    count: float


def test_units_are_those_that_the_classes_of_arguments_and_outputs_declare():
    axes = [js.axes.listed("cart.mass", [1.0]), js.axes.listed("cart.sides.1", [2.0, 3.0])]
    base = {"cart": Cart()}
    found = js.sweep(lambda cart: {"a": Rolled(cart.mass, cart.sides[1])}, base, axes)
    assert [column.unit for column in found.columns] == ["kg", "m"]
    assert found.units == {"a.way": "m", "a.count": ""}
    with pytest.raises(ValueError, match=r"unit = 'rad' does not fit axis 'cart\.mass'; leave it out for kg"):
        js.sweep(lambda cart: cart.mass, base, js.axes.listed("cart.mass", [1.0], unit="rad"))


def test_only_the_outputs_that_are_named_are_kept():
    lane = lambda x: {"status": 0, "a": x, "b": 2.0 * x}  # noqa: E731
    assert list(js.sweep(lane, {}, X, outputs=["b"]).values) == ["b", "status"]
    with pytest.raises(ValueError, match=r"output = 'c' is not known; type one of a, b, status|type one of status"):
        js.sweep(lane, {}, X, outputs=["c"])


ROBOT = {"robot": js.Robot(), "slope": 0.1, "gains": None, "duration": 0.1, "dt": 0.01, "save_every": None}
SLOPES = js.axes.linear("slope", 0.0, 0.3, 3)
FAULTS = {
    "unknown field": (
        lambda: climb(js.axes.listed("robot.mass", [1])),
        r"axis 'robot\.mass' leads to no number; type one of robot\.s",
    ),
    "unknown argument": (
        lambda: climb(js.axes.listed("slop", [1])),
        r"'slop' is unknown to the lane function; type one of robot, sl",
    ),
    "unknown root": (lambda: climb(js.axes.listed("robots.gravity", [1])), r"'robots' is unknown to the lane function"),
    "part of nothing": (lambda: climb(js.axes.listed("gains.c1", [1])), r"gains = None has no parts, give it a value first"),
    "index too large": (
        lambda: climb(js.axes.listed("robot.shell_inertia.3", [1])),
        r"type one of robot\.shell_inertia\.0, robot",
    ),
    "no leaf": (lambda: climb(js.axes.listed("robot", [1])), r"axis 'robot' is not one number; type one of robot\.shell_mass"),
    "word": (lambda: climb(js.axes.listed("method", [1]), method="rk4"), r"axis 'method' is not one number; name a number"),
    "static number": (lambda: climb(js.axes.listed("duration", [1.0])), r"duration is traced; type a plain number"),
    "bad base": (lambda: climb(SLOPES, robot=js.Robot(gravity=-1.0)), r"robot\.gravity = -1 is not admissible"),
    "missing argument": (lambda: js.sweep(js.rest_to_rest, {}, SLOPES), r"the lane function needs 'robot'; give it in base"),
    "unequal zip": (
        lambda: js.axes.zipped(SLOPES, js.axes.listed("gains.c1", [1, 2])),
        r"zipped axes must be equally long, but 'slope' has 3, 'gains\.c1' has 2; type axes of one length",
    ),
    "unequal zip of one name": (
        lambda: js.axes.zipped(js.axes.uniform({"a": (0, 1)}, 5), js.axes.normal({"b": (0, 1)}, 4)),
        r"'draw' has 5, 'draw' has 4",
    ),
    "unknown status": (lambda: js.sweep(lambda x: {"status": 42}, {}, X).counts(), r"status = 42 is none of jaxsphere\.Status"),
    "status of several": (
        lambda: js.sweep(lambda x: {"status": np.arange(2)}, {}, X),
        r"let it return one js\.Status, or rename it",
    ),
    "empty zip": (lambda: js.axes.zipped(), r"zipped axes must be equally long, but there are none"),
    "strings": (
        lambda: js.sweep(lambda x: {"name": "ok"}, {}, X),
        r"returns name = 'ok', which is no number; let it return numbers",
    ),
    "nothing": (lambda: js.sweep(lambda x: None, {}, X), r"returns None, which holds no number"),
    "no axes": (lambda: js.sweep(lambda x: x, {}, []), r"axes = \(\) give no lanes; type at least one"),
    "no values": (lambda: js.axes.listed("slope", []), r"axis 'slope' has no values and gives zero lanes"),
    "zero lanes": (lambda: js.axes.linear("slope", 0.0, 1.0, 0), r"count of axis 'slope' = 0 is not admissible"),
    "zero samples": (lambda: js.axes.latin_hypercube({"a": (0, 1)}, 0), r"count of axis 'sample' = 0 is not admissible"),
    "no leaves": (lambda: js.axes.uniform({}, 5), r"axis 'draw' varies no leaf; type e\.g\."),
    "turned range": (lambda: js.axes.uniform({"a": (1, 0)}, 5), r"axis 'a' has the range \(1, 0\); type the lower end first"),
    "negative logarithm": (lambda: js.axes.logarithmic("a", -1, 1, 5), r"is logarithmic from -1 to 1; type positive ends"),
    "negative deviation": (lambda: js.axes.normal({"a": (0, -1)}, 5), r"has the standard deviation -1; type one of at least 0"),
    "not finite": (lambda: js.axes.listed("a", [1.0, np.nan]), r"axis 'a' has the values \[1\.0, nan\]; type a list of finite"),
    "words": (lambda: js.axes.listed("a", ["b"]), r"axis 'a' has the values \['b'\]; type numbers"),
    "unknown unit": (
        lambda: js.axes.linear("slope", 0, 18, 7, unit="degrees"),
        r"unit = 'degrees' of axis 'slope' is not admissible; type unit='deg'",
    ),
    "unit of another kind": (lambda: js.axes.listed("slope", [1], unit="m"), r"unit = 'm' does not fit axis 'slope'"),
    "seed": (lambda: js.axes.uniform({"a": (0, 1)}, 5, seed=-1), r"seed = -1 of axis 'draw' is not admissible"),
    "leaf twice": (lambda: js.axes.product(SLOPES, SLOPES), r"leaf 'slope' comes twice among the axes; vary it along one"),
    "axis twice": (
        lambda: js.axes.product(js.axes.uniform({"a": (0, 1)}, 5), js.axes.uniform({"b": (0, 1)}, 5)),
        r"axis 'draw' comes twice among the axes; type name=",
    ),
    "chunk": (lambda: js.sweep(lambda x: x, {}, X, chunk=0), r"chunk = 0 is not admissible; type a whole number"),
    "dtype": (
        lambda: js.sweep(lambda x: x, {}, X, dtype=jnp.int32),
        r"dtype = 'int32' is not known; type one of float64, float32",
    ),
}
X = js.axes.listed("x", [1.0, 2.0])


def climb(axis, **base):
    """Sweep of a short climb over one axis."""
    return js.sweep(js.rest_to_rest, ROBOT | base, axis)


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_input_is_one_sentence(fault):
    run, named = FAULTS[fault]
    with pytest.raises(ValueError, match=named) as caught:
        run()
    assert "\n" not in str(caught.value)


def test_what_is_no_function_no_mapping_and_no_axis_is_named():
    for run, named in (
        (lambda: js.sweep(3, {}, X), r"lane = 3 is no function"),
        (lambda: js.sweep(lambda x: x, [1], X), r"base = \[1\] is no mapping"),
        (lambda: js.sweep(lambda x: x, {}, ["slope"]), r"axis = 'slope' is no axis"),
    ):
        with pytest.raises(TypeError, match=named):
            run()
