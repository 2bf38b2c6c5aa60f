"""Batches in blocks of lanes are the batches that vmap makes."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.simulation.batch import blocks
from jaxsphere.simulation.search import Pausable


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
    found = js.batch(climb, block=block)(*lanes)
    assert jax.tree.structure(found) == jax.tree.structure(reference)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(reference), strict=True):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)  # other vector widths round differently


@pytest.mark.parametrize("count", [1, 2, 5, 6])
def test_lane_counts_that_do_not_divide_the_block(count):
    values = np.arange(2.0 * count).reshape(count, 2)
    found = js.batch(lambda pair, scale: {"sum": pair.sum() * scale}, block=4)(values, np.full(count, 3.0))
    np.testing.assert_array_equal(found["sum"], 3.0 * values.sum(axis=1))


def test_result_of_a_lane_does_not_depend_on_the_block(lanes):
    # Blocks of whole vectors (eight numbers at most) run the same instructions; a remainder may round differently.
    many = jax.tree.map(lambda leaf: np.tile(leaf, 3), lanes)
    first, second = (jax.tree.leaves(js.batch(climb, block=block)(*many)) for block in (8, 16))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [3, 8, 21])
def test_blocks_of_one_program_give_what_vmap_gives(lanes, reference, count):
    chosen = jax.tree.map(lambda leaf: np.resize(leaf, count), lanes)
    parts = blocks(climb, 8)(*chosen)
    assert len(parts) == -(-count // 8)
    found = jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *parts)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(reference), strict=True):
        np.testing.assert_allclose(ours, np.resize(theirs, (count, *theirs.shape[1:])), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("batched", [js.batch, lambda function: js.batch(function, block=8)])
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
from jaxsphere.simulation.batch import batch, use_all_cores
assert jax.device_count() == 2
values = np.arange(7.0)
result = js.batch(lambda x: (x * x, js.numerics.sincos(x)[0]), block=2)(values)
np.testing.assert_array_equal(result[0], values**2)
np.testing.assert_allclose(result[1], np.sin(values), atol=1e-15)
assert js.use_all_cores() == 2
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


def test_a_given_block_makes_a_lane_independent_of_its_number(lanes):
    many = jax.tree.map(lambda leaf: np.tile(leaf, 3), lanes)
    run = js.batch(climb, block=8)
    for one, other in zip(jax.tree.leaves(run(*lanes)), jax.tree.leaves(run(*many)), strict=True):
        np.testing.assert_array_equal(one, other[:7])


def final_error(slope, c1):
    """A number that depends smoothly on slope and gain."""
    run = js.rest_to_rest(js.Robot(), slope, js.SlidingModeGains(c1=c1), duration=0.2, dt=1e-2, save_every=None, throw=False)
    return run.metrics.final_error


SLOPES = np.array([0.05, 0.1, 0.15])


@pytest.mark.parametrize("batched", [lambda f: js.batch(f, block=2), lambda f: js.batch(f)], ids=["blocks", "one block"])
@pytest.mark.parametrize("captured", [False, True], ids=["argument", "closure"])
def test_transformations_go_through_a_batch(batched, captured):
    def mean(c1, over):
        if captured:
            return over(lambda slope: final_error(slope, c1))(SLOPES).mean()
        return over(final_error)(SLOPES, jnp.broadcast_to(c1, 3)).mean()

    value = jax.vmap
    expected = jax.grad(mean)(0.55, value)
    for derivative in (jax.grad(mean), jax.jacfwd(mean), jax.jit(jax.grad(mean), static_argnums=1)):
        assert derivative(0.55, batched) == pytest.approx(float(expected), rel=1e-9)
    means = [mean(c1, value) for c1 in (0.5, 0.6)]
    np.testing.assert_allclose(jax.vmap(lambda c1: mean(c1, batched))(jnp.array([0.5, 0.6])), means, rtol=1e-12)
    np.testing.assert_allclose(jax.lax.map(lambda c1: mean(c1, batched), jnp.array([0.5, 0.6])), means, rtol=1e-12)


def countdown(start):
    """Computation that takes as many steps as its number says, and finds the sum on the way."""
    return Pausable((start, 0.0 * start), lambda c: (c[0] - 1.0, c[1] + c[0]), lambda c: c[0] <= 0.0, lambda c: c[1])


def test_ragged_batches_compose_too():
    starts = jnp.array([1.0, 4.0, 2.0, 7.0, 3.0])
    expected = starts * (starts + 1.0) / 2.0
    run = js.batch(countdown, ragged=True, block=2)
    np.testing.assert_array_equal(run(starts), expected)
    np.testing.assert_array_equal(jax.jit(run)(starts), expected)
    np.testing.assert_array_equal(jax.lax.map(run, jnp.stack([starts, starts[::-1]])), [expected, expected[::-1]])
    tangent = jax.jvp(run, (starts,), (jnp.ones(5),))[1]
    np.testing.assert_array_equal(tangent, starts)


def test_empty_leaves_random_keys_and_single_instructions_are_lanes_too():
    found = js.batch(lambda x, none: (x + none.sum(), none), block=4)(np.arange(6.0), np.zeros((6, 0)))
    assert found[1].shape == (6, 0)
    keys = jax.random.split(jax.random.key(0), 5)
    np.testing.assert_array_equal(js.batch(jax.random.uniform)(keys), jax.vmap(jax.random.uniform)(keys))
    with jax.disable_jit():
        np.testing.assert_array_equal(js.batch(jnp.sin)(np.arange(3.0)), np.sin(np.arange(3.0)))
