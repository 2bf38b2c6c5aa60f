"""The tuner and its parts: Adam, the parametrisation, descent, bookkeeping, interruption, files and faults."""

import json
import re
from dataclasses import fields

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning

TABLE_3 = js.SlidingModeGains()


def bowl(gains):
    """Objective with its minimum 0.25 at c1 = 1, c2 = 3, z_u = 0.5."""
    return jnp.log(gains.c1) ** 2 + (gains.c2 - 3.0) ** 2 + 4.0 * (gains.z_u - 0.5) ** 2 + 0.25


def quiet(objective=bowl, gains=TABLE_3, **settings):
    """Tune without a progress bar."""
    return tuning.tune(objective, gains, **{"iterations": 20, "progress": False} | settings)


def test_first_steps_of_adam_by_hand():
    optimiser = tuning.adam(0.1, beta1=0.9, beta2=0.99, epsilon=0.0)
    vector = jnp.array([1.0, -2.0])
    state = optimiser.init(vector)
    vector, state = optimiser.update(jnp.array([3.0, -0.5]), state, vector)
    np.testing.assert_allclose(vector, [0.9, -1.9], rtol=1e-14)  # the first step is the rate against the sign
    vector, state = optimiser.update(jnp.array([-1.0, -0.5]), state, vector)
    mean = (0.9 * 0.1 * 3.0 - 0.1 * 1.0) / (1.0 - 0.81)
    square = (0.99 * 0.01 * 9.0 + 0.01 * 1.0) / (1.0 - 0.9801)
    np.testing.assert_allclose(vector, [0.9 - 0.1 * mean / np.sqrt(square), -1.8], rtol=1e-13)
    assert state.count == 2


def test_adam_clips_the_norm_of_the_gradient():
    optimiser = tuning.adam(0.1, clip=2.0)
    vector = jnp.zeros(2)
    _, state = optimiser.update(jnp.array([30.0, 40.0]), optimiser.init(vector), vector)
    np.testing.assert_allclose(state.mean, 0.1 * np.array([1.2, 1.6]), rtol=1e-14)
    _, below = optimiser.update(jnp.array([0.3, 0.4]), optimiser.init(vector), vector)
    np.testing.assert_allclose(below.mean, 0.1 * np.array([0.3, 0.4]), rtol=1e-14)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_adam_rejects_a_gradient_that_is_not_finite(bad):
    optimiser, vector = tuning.adam(0.1), jnp.array([1.0, 2.0])
    moved, state = optimiser.update(jnp.array([0.5, 0.5]), optimiser.init(vector), vector)
    kept, same = optimiser.update(jnp.array([0.5, bad]), state, moved)
    np.testing.assert_array_equal(kept, moved)
    for new, old in zip(same, state, strict=True):
        np.testing.assert_array_equal(new, old)


def test_adam_descends_the_rosenbrock_valley():
    def rosenbrock(x):
        return (1.0 - x[0]) ** 2 + 100.0 * (x[1] - x[0] ** 2) ** 2

    optimiser = tuning.adam(tuning.cosine_decay(0.05, 3000), clip=1e3)
    start = jnp.array([-1.2, 1.0])

    def step(carry, _):
        return optimiser.update(jax.grad(rosenbrock)(carry[0]), carry[1], carry[0]), None

    (end, _), _ = jax.lax.scan(step, (start, optimiser.init(start)), None, length=3000)
    np.testing.assert_allclose(end, [1.0, 1.0], atol=0.02)  # the rate is 2.5e-3 at the end; the valley is flat along it


def test_cosine_decay_from_start_to_floor():
    rate = tuning.cosine_decay(0.2, 100, floor=0.1)
    np.testing.assert_allclose([rate(0), rate(50), rate(100), rate(500)], [0.2, 0.11, 0.02, 0.02], rtol=1e-12)


def test_parametrisation_round_trip_and_bounds(rng):
    gains = js.SlidingModeGains(0.3, 7.0, 0.91, 4.0, 2.0, 0.01, 0.02)
    chosen = tuning.parametrise(gains)
    assert chosen.names == ("c1", "c2", "z_u", "phi_z", "eta", "k")
    back = chosen.to_gains(chosen.to_vector(gains))
    for leaf in fields(gains):
        assert getattr(back, leaf.name) == pytest.approx(getattr(gains, leaf.name), rel=1e-14)  # exp(log x)
    for vector in rng.normal(0.0, 10.0, (50, 6)):
        js.sliding_mode.check_gains(chosen.to_gains(jnp.asarray(vector)))  # every vector is admissible
        assert chosen.to_gains(jnp.asarray(vector)).k_i == 0.02


def test_parametrisation_keeps_and_frees_what_it_is_told():
    frozen = tuning.parametrise(TABLE_3, frozen=("k", "c2"))
    assert frozen.names == ("c1", "z_u", "phi_z", "eta")
    seeking = tuning.parametrise(js.SlidingModeGains(k_i=0.03), transforms={"k_i": tuning.POSITIVE})
    assert seeking.names[-1] == "k_i"
    assert seeking.to_gains(jnp.zeros(7)).k_i == 1.0


@pytest.mark.parametrize("gradient", ["forward", "reverse"])
def test_tuning_finds_the_minimum_and_keeps_the_frozen_gain(gradient):
    found = quiet(iterations=200, chunk=50, frozen=("c2",), gradient=gradient)
    assert found.status == "finished"
    assert found.gains.c2 == TABLE_3.c2
    assert found.gains.eta == pytest.approx(TABLE_3.eta, rel=1e-14)  # free, without a gradient: exp(log x)
    assert found.gains.c1 == pytest.approx(1.0, abs=1e-3)  # Adam at its floor rate of 5e-3
    assert found.gains.z_u == pytest.approx(0.5, abs=1e-3)
    assert found.objective == pytest.approx(0.25 + (TABLE_3.c2 - 3.0) ** 2, abs=1e-5)  # quadratic in the above
    assert found.objective == float(bowl(found.gains))
    assert found.initial_objective == pytest.approx(float(bowl(TABLE_3)), rel=1e-14)
    assert found.names == ("c1", "z_u", "phi_z", "eta", "k")
    assert found.evaluations == 200


def test_tuning_a_rollout_improves_every_start_and_repeats_itself():
    objective = tuning.RestToRest(duration=0.8, dt=2e-2, weights=tuning.Weights(prior=0.0))
    settings = {"objective": objective, "starts": 3, "iterations": 15, "chunk": 5, "spread": 0.2}
    first = quiet(**settings)
    history = first.history["objective"]
    assert history.shape == first.history["gradient_norm"].shape == (15, 3)
    assert np.all(np.min(history, axis=0) < history[0])
    assert first.objective == np.min(history) < first.initial_objective == history[0, 0]
    assert first.objective == pytest.approx(float(objective(first.gains)), rel=1e-9)  # batched against single
    assert first.evaluations == 45


def test_starts_are_drawn_from_the_seed():
    first, second, other = (quiet(starts=4, iterations=10, seed=seed) for seed in (0, 0, 1))
    history = first.history["objective"]
    np.testing.assert_array_equal(history, second.history["objective"])
    assert first.gains.c1 == second.gains.c1
    np.testing.assert_array_equal(other.history["objective"][:, 0], history[:, 0])  # the first is not drawn
    assert np.all(other.history["objective"][0, 1:] != history[0, 1:])


def test_result_survives_the_file(tmp_path):
    found = quiet(starts=2)
    found.history["objective"][3, 1] = np.nan
    path = found.save(tmp_path / "new folder" / "tuned.json")
    assert [entry.name for entry in path.parent.iterdir()] == ["tuned.json"]
    loaded = tuning.TuningResult.load(path)
    for leaf in fields(found):
        if "gains" in leaf.name:
            assert vars(getattr(loaded, leaf.name)) == vars(getattr(found, leaf.name))
        else:
            np.testing.assert_equal(getattr(loaded, leaf.name), getattr(found, leaf.name))
    assert loaded.report() == found.report()


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"gains_type": "Other", "format": 1}', "\x00"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=rf"{re.escape(str(path))} is no tuning result of this version; type"):
        tuning.TuningResult.load(path)


def test_another_format_is_refused(tmp_path):
    path = quiet().save(tmp_path / "tuned.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 1}))
    with pytest.raises(ValueError, match="no tuning result of this version"):
        tuning.TuningResult.load(path)


def test_report_names_gains_objective_and_starts():
    report = quiet(starts=2, frozen=("k",)).report()
    assert re.search(r"^c1 +0\.5501 +\d+\.\d{4}$", report, re.MULTILINE)
    assert re.search(r"^k +0\.6769 +0\.6769  frozen$", report, re.MULTILINE)
    assert "finished: 40 rollouts with gradient" in report


def test_interrupt_keeps_the_best_so_far(monkeypatch):
    whole = quiet(iterations=30, chunk=10)
    interrupt_at(monkeypatch, chunk=2)
    found = quiet(iterations=30, chunk=10)
    assert found.status == "interrupted"
    assert found.evaluations == 10
    np.testing.assert_array_equal(found.history["objective"], whole.history["objective"][:10])
    assert found.objective == np.min(found.history["objective"])
    assert found.objective == pytest.approx(float(bowl(found.gains)), rel=1e-14)


def test_interrupt_before_anything_is_known_passes_on(monkeypatch):
    interrupt_at(monkeypatch, chunk=1)
    with pytest.raises(KeyboardInterrupt):
        quiet()


def interrupt_at(monkeypatch, chunk):
    """Press Ctrl-C as the given chunk begins."""
    batched = js.batch

    def batch(function, **settings):
        run, calls = batched(function, **settings), iter(range(1, chunk + 1))

        def interrupted(*arguments):
            if next(calls) == chunk:
                raise KeyboardInterrupt
            return run(*arguments)

        return interrupted

    monkeypatch.setattr(js, "batch", batch)


BAD = {
    "vector": ({"objective": lambda g: jnp.stack([g.c1, g.c2])}, r"objective returns shape \(2,\); return one scalar"),
    "nan": (
        {"objective": lambda g: jnp.nan * g.c1},
        r"objective = nan at initial_gains, and it is finite at 0 of 1 starts; type",
    ),
    "slope": (
        {"objective": lambda g: jnp.sqrt(jax.lax.stop_gradient(g.c1) - 0.5501) + jnp.sqrt(g.c1 - 0.5501)},
        r"the gradient at initial_gains is not finite though the objective is; type another",
    ),
    "stages": (
        {"objective": tuning.Annealed(tuning.RestToRest()), "iterations": 2},
        "iterations = 2 does not reach the last of 3",
    ),
    "all frozen": ({"frozen": ("c1", "c2", "z_u", "phi_z", "eta", "k")}, r"frozen leaves nothing to tune; leave at least one"),
    "unknown name": ({"frozen": ("c3",)}, r"frozen or transforms name 'c3', which is no gain; type some of c1, c2"),
    "no transform": ({"gains": js.Robot()}, r"no transform is known for shell_mass.*transforms="),
    "outside": ({"gains": js.SlidingModeGains(z_u=1.5)}, r"initial gain z_u = 1\.5 is outside its range; type an admissible"),
    "negative": ({"gains": js.SlidingModeGains(k=-1.0)}, r"initial gain k = -1\.0 is outside its range"),
    "gradient": ({"gradient": "backward"}, r"gradient = 'backward' is not known; type one of forward, reverse"),
    "iterations": ({"iterations": 0}, r"iterations = 0 is not admissible"),
    "starts": ({"starts": -1}, r"starts = -1 is not admissible"),
    "chunk": ({"chunk": 0}, r"chunk = 0 is not admissible"),
    "rate": ({"learning_rate": np.nan}, r"learning_rate = nan is not admissible"),
    "spread": ({"spread": -0.1}, r"spread = -0\.1 is not admissible"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_get_one_sentence(case):
    settings, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        quiet(**settings)
    assert "\n" not in str(caught.value)


def test_result_does_not_depend_on_the_chunk_and_its_best_is_in_the_history():
    coarse, fine = quiet(iterations=15, chunk=10), quiet(iterations=15, chunk=5)
    assert coarse.objective == fine.objective == coarse.history["objective"].min()


@pytest.mark.parametrize("content", ['"text"', "3", "null"])
def test_json_that_is_no_object_is_refused(tmp_path, content):
    path = tmp_path / "result.json"
    path.write_text(content)
    with pytest.raises(ValueError, match="no tuning result"):
        tuning.TuningResult.load(path)


def test_history_that_is_no_table_is_refused(tmp_path):
    path = quiet().save(tmp_path / "result.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"history": [1, 2]}))
    with pytest.raises(ValueError, match="no tuning result"):
        tuning.TuningResult.load(path)


@pytest.mark.parametrize("name", ["iterations", "starts", "chunk"])
def test_a_count_is_a_whole_number(name):
    with pytest.raises(ValueError, match=f"{name} = 2.5"):
        quiet(**{name: 2.5})
