"""Batches in blocks of lanes are the batches that vmap makes."""

import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.simulation.lanes import over_lanes, same_bits


def climb(slope, gains):
    """One short rollout, saving its end only."""
    return js.rest_to_rest(js.Robot(), slope, gains, duration=0.2, dt=4e-3, save_every=None, throw=False)


@pytest.fixture(scope="module")
def lanes():
    """Seven lanes that differ in slope and in one gain, one of them past the bound."""
    c1 = np.linspace(0.4, 0.8, 7)
    others = [np.full(7, value) for value in (2.3272, 0.9626, 7.4822, 2.7688, 0.6769, 0.0)]
    return np.deg2rad(np.array([0.0, 4.0, 8.0, 25.0, 10.0, -6.0, 12.0])), js.SlidingModeGains(c1, *others)


@pytest.fixture(scope="module")
def reference(lanes):
    """The same lanes by vmap alone."""
    return jax.jit(jax.vmap(climb))(*lanes)


@pytest.mark.parametrize("block", [1, 3, 7, 512])
def test_blocks_give_what_vmap_gives(lanes, reference, block):
    found = over_lanes(climb, block)(*lanes)
    assert jax.tree.structure(found) == jax.tree.structure(reference)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(reference), strict=True):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)  # other vector widths round differently


@pytest.mark.parametrize("count", [1, 2, 5, 6])
def test_lane_counts_that_do_not_divide_the_block(count):
    values = np.arange(2.0 * count).reshape(count, 2)
    found = over_lanes(lambda pair, scale: {"sum": pair.sum() * scale}, block=4)(values, np.full(count, 3.0))
    np.testing.assert_array_equal(found["sum"], 3.0 * values.sum(axis=1))


def test_result_of_a_lane_does_not_depend_on_the_block(lanes):
    # Blocks of whole vectors (eight numbers at most) run the same instructions; a remainder may round differently.
    many = jax.tree.map(lambda leaf: np.tile(leaf, 3), lanes)
    first, second = (jax.tree.leaves(over_lanes(climb, block)(*many)) for block in (8, 16))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [3, 8, 21])
def test_blocks_of_one_program_give_what_vmap_gives(lanes, reference, count):
    chosen = jax.tree.map(lambda leaf: np.resize(leaf, count), lanes)
    blocks = same_bits(climb, 8)(*chosen)
    assert len(blocks) == -(-count // 8)
    found = jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *blocks)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(reference), strict=True):
        np.testing.assert_allclose(ours, np.resize(theirs, (count, *theirs.shape[1:])), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("batched", [over_lanes, lambda function: same_bits(function, 8)])
def test_no_lanes_and_unequal_axes_are_refused(batched):
    double = batched(lambda x, y: x + y)
    for arguments in ((np.zeros(0), np.zeros(0)), (np.zeros(3), np.zeros(4)), (np.zeros(3), 1.0), (1.0, 2.0)):
        with pytest.raises(ValueError, match=r"leading axes .* type one positive number of lanes for all"):
            double(*arguments)


def test_two_devices_share_the_lanes():
    program = """
import jax, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
import jaxsphere as js
from jaxsphere.simulation.lanes import over_lanes, use_all_cores
assert jax.device_count() == 2
values = np.arange(7.0)
result = over_lanes(lambda x: (x * x, js.numerics.sincos(x)[0]), block=2)(values)
np.testing.assert_array_equal(result[0], values**2)
np.testing.assert_allclose(result[1], np.sin(values), atol=1e-15)
assert use_all_cores() == 2
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
