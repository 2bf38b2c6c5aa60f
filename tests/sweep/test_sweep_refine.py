"""Sweeps from coarse to fine give what the dense sweep gives, from fewer lanes or trials, and go on where they were stopped."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.sweep.refine import Boundaries, Guesses

AXES = [js.axes.linear("x", 0.0, 1.0, 97), js.axes.linear("y", 0.0, 1.0, 130)]


def disc(x, y):
    """Three outcomes with curved boundaries."""
    away = jnp.hypot(x - 0.31, y - 0.47)
    return {"status": (away < 0.25).astype(int) + (away < 0.115), "away": away}


def root(x, y, guess):
    """Newton's steps from a guess to the root of z^3 = 1 + x + y."""
    goal = 1.0 + x + y
    start = (jnp.where(guess > 0.0, guess, 3.0), 0)
    value, steps = jax.lax.while_loop(
        lambda at: jnp.abs(at[0] ** 3 - goal) > 1e-10,
        lambda at: (at[0] - (at[0] ** 3 - goal) / (3.0 * at[0] ** 2), at[1] + 1),
        start,
    )
    return {"value": value, "steps": steps, "guess": guess}


def files(folder):
    """Path below a folder -> bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def stop_after(calls):
    """Progress callback that presses Ctrl-C."""
    seen = []

    def progress(done, total):
        seen.append(done)
        if len(seen) == calls:
            raise KeyboardInterrupt

    return progress


def test_boundaries_equal_the_dense_sweep_from_a_part_of_its_lanes():
    dense, found = js.sweep(disc, {}, AXES), js.sweep(disc, {}, AXES, refine=Boundaries(coarse=8))
    np.testing.assert_array_equal(found.status, dense.status)
    assert found.counts() == dense.counts()
    simulated = found.values["simulated"]
    assert 100 < simulated.sum() < simulated.size / 5
    np.testing.assert_array_equal(found.values["away"][simulated], dense.values["away"][simulated])
    assert np.all(np.isnan(found.values["away"][~simulated]))


def test_guesses_come_from_neighbours_and_save_steps():
    found = js.sweep(root, {}, AXES, refine=Guesses(first=3.0))
    alone = js.sweep(lambda x, y: root(x, y, 3.0), {}, AXES)
    np.testing.assert_allclose(found.values["value"], alone.values["value"], atol=1e-9)
    assert found.values["steps"].mean() < 0.5 * alone.values["steps"].mean()
    value, guess = found.values["value"], found.values["guess"]
    assert guess[16, 32] == 3.0
    np.testing.assert_allclose(guess[8, 40], (value[0, 32] + value[0, 48] + value[16, 32] + value[16, 48]) / 4.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("lane", "refine", "other"),
    [(disc, Boundaries(), Boundaries(coarse=4)), (root, Guesses(first=3.0), Guesses())],
    ids=["boundaries", "guesses"],
)
def test_a_stopped_refinement_goes_on_and_ends_with_the_same_bytes(tmp_path, lane, refine, other):
    js.sweep(lane, {}, AXES, refine=refine, store=tmp_path / "whole", chunk=520)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted after \d+ of at most 12610 lanes; resume the same sweep"):
        js.sweep(lane, {}, AXES, refine=refine, store=tmp_path / "store", chunk=520, progress=stop_after(3))
    assert len(list((tmp_path / "store" / "seals" / "journal").iterdir())) == 3
    first = tmp_path / "store" / "seals" / "journal" / "0"
    first.write_bytes(first.read_bytes()[:-1] + b"x")
    js.sweep(lane, {}, AXES, refine=refine, store=tmp_path / "store", chunk=520, resume=True)
    assert files(tmp_path / "store") == files(tmp_path / "whole")
    with pytest.raises(ValueError, match=r"is of another sweep \(it differs in .*refine"):
        js.sweep(lane, {}, AXES, refine=other, store=tmp_path / "store", resume=True)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"refine": 3}, r"refine = 3 is not admissible"),
        ({"refine": Boundaries(output="height")}, r"refine\.output = 'height' is no output; type one of away, status"),
        ({"refine": Boundaries(coarse=0)}, r"coarse = 0 is not admissible"),
        ({"refine": Boundaries(), "axes": [*AXES, js.axes.listed("z", [1.0])]}, r"refine works over two axes, and there are 3"),
        ({"refine": Guesses("away", "z", coarsest=12)}, r"coarsest = 12 is not admissible; type a power of two"),
        ({"refine": Guesses("away", "z", first=np.ones(3))}, r"first has the shape \(3,\); type one number or an array"),
    ],
)
def test_bad_refinements_are_one_sentence(options, named):
    with pytest.raises(ValueError, match=named):
        js.sweep(lambda x, y, z=0.0: disc(x, y), {}, **{"axes": AXES} | options)
