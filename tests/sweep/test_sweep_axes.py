"""Axes give every lane its values from its number alone."""

import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.sweep import axes as ax
from jaxsphere.sweep import draws


def along(axis):
    """Leaf -> values in every position of one axis."""
    return ax.values_at([axis], np.arange(axis.length))


def test_grids_hold_both_ends_and_even_steps():
    np.testing.assert_allclose(along(js.axes.linear("x", -1.0, 2.0, 7))["x"], np.linspace(-1.0, 2.0, 7), atol=1e-15)
    found = along(js.axes.logarithmic("x", 0.3, 0.7, 5))["x"]
    assert (found[0], found[-1]) == (0.3, 0.7)
    np.testing.assert_allclose(found[1:] / found[:-1], (0.7 / 0.3) ** 0.25, rtol=1e-14)
    np.testing.assert_array_equal(along(js.axes.linear("x", 3.0, 4.0, 1))["x"], [3.0])
    np.testing.assert_array_equal(along(js.axes.listed("x", [3, 1, 2]))["x"], [3.0, 1.0, 2.0])


def test_the_last_axis_of_a_product_varies_fastest_and_zipped_axes_go_together():
    pair = js.axes.zipped(js.axes.listed("b", [1, 2, 3]), js.axes.listed("c", [10, 20, 30]), name="pair")
    axes = js.axes.product(js.axes.listed("a", [5, 6]), pair)
    found = ax.values_at(axes, np.arange(6))
    np.testing.assert_array_equal(found["a"], [5, 5, 5, 6, 6, 6])
    np.testing.assert_array_equal(found["b"], [1, 2, 3, 1, 2, 3])
    np.testing.assert_array_equal(found["c"], [10, 20, 30, 10, 20, 30])
    assert [axis.name for axis in axes] == ["a", "pair"]
    assert js.axes.zipped(js.axes.listed("b", [1]), js.axes.listed("c", [2])).name == "b & c"


def test_units_come_with_the_name_and_degrees_reach_the_lane_as_radians():
    (column,) = js.axes.linear("robot.shell_inertia.2", 0.01, 0.02, 3).columns
    assert column.unit == "kg m2"
    slope = js.axes.linear("slope", 0.0, 180.0, 3, unit="deg")
    np.testing.assert_array_equal(along(slope)["slope"], [0.0, 90.0, 180.0])
    np.testing.assert_array_equal(ax.arguments_at([slope], np.arange(3))["slope"], [0.0, np.pi / 2, np.pi])
    with pytest.raises(ValueError, match=r"unit = 'deg' does not fit axis 'robot.pendulum_mass'; leave it out for kg"):
        js.axes.listed("robot.pendulum_mass", [1.0], unit="deg")


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 100, 1000])
def test_a_latin_hypercube_has_one_sample_in_every_cell(count):
    axis = js.axes.latin_hypercube({"a": (2.0, 4.0), "b": (-1.0, 0.0)}, count, seed=5)
    found = along(axis)
    for leaf, low, width in (("a", 2.0, 2.0), ("b", -1.0, 1.0)):
        cells = np.floor((found[leaf] - low) / width * count).astype(int)
        np.testing.assert_array_equal(np.sort(cells), np.arange(count))
    logarithms = np.log(along(js.axes.latin_hypercube({"a": (0.01, 100.0)}, count, log=True))["a"])
    cells = np.floor((logarithms - np.log(0.01)) / np.log(1e4) * count).astype(int)
    np.testing.assert_array_equal(np.sort(cells), np.arange(count))


def test_samples_look_random_and_differ_by_leaf_and_seed():
    one, two, other = (
        along(js.axes.latin_hypercube({leaf: (0.0, 1.0)}, 1000, seed))[leaf] for leaf, seed in (("a", 0), ("b", 0), ("a", 1))
    )
    order = np.arange(1000.0)
    for x, y in ((one, two), (one, other), (one, order), (one[:-1], one[1:])):
        assert abs(np.corrcoef(x, y)[0, 1]) < 0.1
    place = (one * 1000) % 1.0  # within the cell
    assert abs(place.mean() - 0.5) < 0.05


@pytest.mark.parametrize("count", [1, 2, 5, 1023, 1024, 1025, 60000])
def test_the_shuffle_is_a_permutation(count):
    found = draws.permutation(3, "leaf", np.arange(count), count)
    np.testing.assert_array_equal(np.sort(found), np.arange(count))


def test_every_small_permutation_occurs():
    orders = {tuple(draws.permutation(seed, "leaf", np.arange(3), 3)) for seed in range(200)}
    assert len(orders) == 6


def test_draws_belong_to_the_lane_and_have_the_right_distribution():
    axes = [
        js.axes.listed("a", [0.0, 1.0]),
        js.axes.zipped(
            js.axes.uniform({"u": (2.0, 4.0), "v": (2.0, 4.0)}, 4000, seed=7), js.axes.normal({"n": (1.0, 0.5)}, 4000, seed=7)
        ),
    ]
    all_lanes = ax.values_at(axes, np.arange(8000))
    some = np.array([17, 7999, 4000, 3])
    for leaf, few in ax.values_at(axes, some).items():
        np.testing.assert_array_equal(few, all_lanes[leaf][some])
    u, v, n = all_lanes["u"], all_lanes["v"], all_lanes["n"]
    assert len(np.unique(u)) == 8000  # other lanes, other draws, also along "a"
    assert (u.min() >= 2.0, u.max() < 4.0) == (True, True)
    np.testing.assert_allclose([u.mean(), u.std(), n.mean(), n.std()], [3.0, 3.0**-0.5, 1.0, 0.5], atol=0.02)
    assert abs(np.corrcoef(u, v)[0, 1]) < 0.05
    assert abs(np.corrcoef(u, n)[0, 1]) < 0.05


def test_lanes_beyond_thirty_two_bits_have_values_of_their_own():
    axes = [js.axes.latin_hypercube({"a": (0.0, 1.0)}, 10**9), js.axes.uniform({"u": (0.0, 1.0)}, 10**6)]
    assert ax.lane_count(axes) == 10**15
    lanes = np.array([5, 5 + 2**32, 10**15 - 1])
    found = ax.values_at(axes, lanes)
    assert len(np.unique(found["u"])) == 3
    assert np.all((found["a"] > 0.0) & (found["a"] < 1.0))
