"""L-BFGS and Levenberg-Marquardt on textbook problems, batches of starts, steps that are not finite; Latin hypercubes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from tuning import checkpoint


def descend(rule, evaluate, start, steps):
    """Iterate (init, update) from `start`; returns the trial points, (steps + 1, n)."""

    def step(carry, _):
        vector, state = carry
        moved = rule.update(evaluate(vector), state, vector)
        return moved, moved[0]

    _, trials = jax.lax.scan(step, (start, rule.init(start)), None, length=steps)
    return jnp.concatenate([start[None], trials])


def rosenbrock(x):
    return jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def powell(x):
    a, b, c, d = x
    return jnp.stack([a + 10.0 * b, jnp.sqrt(5.0) * (c - d), (b - 2.0 * c) ** 2, jnp.sqrt(10.0) * (a - d) ** 2])


def beale(x):
    return jnp.stack([y - x[0] * (1.0 - x[1] ** power) for power, y in ((1, 1.5), (2, 2.25), (3, 2.625))])


def of_squares(residuals):
    return jax.value_and_grad(lambda x: jnp.sum(residuals(x) ** 2))


def test_linear_least_squares_take_levenberg_marquardt_one_step(rng):
    matrix, right = jnp.asarray(rng.normal(size=(7, 3))), jnp.asarray(rng.normal(size=7))
    rule = tuning.levenberg_marquardt(damping=1e-12, longest=1e3)
    trials = descend(rule, lambda x: tuning.linearise(lambda y: matrix @ y - right, x), jnp.zeros(3), 1)
    np.testing.assert_allclose(trials[1], np.linalg.lstsq(matrix, right)[0], rtol=1e-9)


def test_quadratic_holds_value_gradient_and_gauss_newton_hessian():
    x = jnp.array([-1.2, 1.0])
    seen = tuning.quadratic(rosenbrock, x)
    jacobian = np.array([[24.0, 10.0], [-1.0, 0.0]])
    np.testing.assert_allclose(seen.value, 24.2, rtol=1e-14)
    np.testing.assert_allclose(seen.gradient, [-215.6, -88.0], rtol=1e-14)
    np.testing.assert_allclose(seen.hessian, 2.0 * jacobian.T @ jacobian, rtol=1e-14)


@pytest.mark.parametrize(
    ("residuals", "start", "least"),
    [
        (rosenbrock, [-1.2, 1.0], [1.0, 1.0]),
        (powell, [3.0, -1.0, 0.0, 1.0], [0.0] * 4),
        (beale, [1.0, 1.0], [3.0, 0.5]),
    ],
    ids=["rosenbrock", "powell", "beale"],
)
def test_textbook_problems(residuals, start, least):
    start = jnp.array(start)
    marquardt = descend(tuning.levenberg_marquardt(longest=10.0), lambda x: tuning.linearise(residuals, x), start, 60)
    bfgs = descend(tuning.lbfgs(longest=10.0), of_squares(residuals), start, 120)
    # Powell's Jacobian is singular at the solution: the square root of the objective's accuracy is all there is.
    tolerance = 2e-2 if residuals is powell else 1e-6
    np.testing.assert_allclose(marquardt[-1], least, atol=tolerance)
    np.testing.assert_allclose(bfgs[-1], least, atol=tolerance)


def updates_until(value, residuals, start, **settings):
    trials = descend(tuning.levenberg_marquardt(longest=10.0, **settings), lambda x: tuning.linearise(residuals, x), start, 60)
    values = jax.vmap(lambda x: jnp.sum(residuals(x) ** 2))(trials)
    assert np.all(np.diff(values) <= 0.0)
    return int(np.argmax(np.asarray(values) <= value))


@pytest.mark.parametrize(
    ("residuals", "start"),
    [(rosenbrock, [-1.2, 1.0]), (powell, [3.0, -1.0, 0.0, 1.0]), (beale, [1.0, 1.0])],
    ids=["rosenbrock", "powell", "beale"],
)
def test_several_steps_on_one_jacobian_save_jacobians(residuals, start):
    start = jnp.array(start)
    one, three = (updates_until(1e-6, residuals, start, rounds=rounds) for rounds in (1, 3))
    assert 0 < three <= 0.6 * one


def test_one_secant_step_by_hand():
    # r = x^3 - 8 from x = 1: without damping the step is 7 / 3; r there is larger, so it is refused, but it teaches the
    # secant slope: (r(10/3) - r(1)) / (7/3), and the next step from x = 1 is along that.
    rule = tuning.levenberg_marquardt(damping=1e-12, longest=1e3, rounds=2, factors=(1.0,))
    moved, _ = rule.update(tuning.linearise(lambda x: x**3 - 8.0, jnp.ones(1)), rule.init(jnp.ones(1)), jnp.ones(1))
    secant = ((10.0 / 3.0) ** 3 - 1.0) / (7.0 / 3.0)
    np.testing.assert_allclose(moved, [1.0 + 7.0 / secant], rtol=1e-9)


def test_point_whose_derivatives_are_not_finite_is_left_for_a_shorter_way():
    rule = tuning.levenberg_marquardt()
    start = jnp.array([-1.2, 1.0])
    first, state = rule.update(tuning.linearise(rosenbrock, start), rule.init(start), start)
    assert not np.array_equal(first, start)
    seen = tuning.linearise(rosenbrock, first)
    back, state = rule.update(seen._replace(jacobian=seen.jacobian.at[0, 1].set(jnp.nan)), state, first)
    np.testing.assert_array_equal(back, start)
    again, _ = rule.update(tuning.linearise(rosenbrock, back), state, back)
    assert 0.0 < np.linalg.norm(again - start) < np.linalg.norm(first - start)


def test_rollouts_of_an_update_are_counted():
    assert tuning.levenberg_marquardt(rounds=3, factors=(0.5, 2.0)).plain_rollouts(6) == 1 + 6 + 3 * 2
    assert tuning.lbfgs().plain_rollouts(6) == tuning.adam().plain_rollouts(6) == 7
    calls = []

    def counted(x):
        jax.debug.callback(lambda _: calls.append(0), x[0])
        return rosenbrock(x)

    rule, start = tuning.levenberg_marquardt(rounds=3, factors=(0.5, 2.0)), jnp.array([-1.2, 1.0])
    seen = tuning.linearise(rosenbrock, start)._replace(elsewhere=counted)
    jax.block_until_ready(rule.update(seen, rule.init(start), start))
    jax.effects_barrier()
    assert len(calls) == rule.trials


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rounds": 0}, "rounds = 0 is not admissible; type a whole number of at least 1"),
        ({"factors": (1.0, 0.5)}, r"factors = \(1\.0, 0\.5\) are no multiples of the damping; type positive increasing ones"),
        ({"factors": ()}, r"factors = \(\) are no multiples"),
    ],
)
def test_faulty_settings_get_one_sentence(settings, message):
    with pytest.raises(ValueError, match=message):
        tuning.levenberg_marquardt(**settings)


def test_lbfgs_solves_a_quadratic_in_about_as_many_steps_as_unknowns(rng):
    root = rng.normal(size=(5, 5))
    matrix, right = jnp.asarray(root @ root.T + np.eye(5)), jnp.asarray(rng.normal(size=5))
    evaluate = jax.value_and_grad(lambda x: 0.5 * x @ matrix @ x - right @ x)
    trials = descend(tuning.lbfgs(longest=1e3), evaluate, jnp.zeros(5), 40)
    np.testing.assert_allclose(trials[-1], np.linalg.solve(matrix, right), rtol=1e-6)


def test_starts_are_batched_and_do_not_disturb_each_other():
    rule = tuning.levenberg_marquardt(longest=10.0)
    starts = jnp.array([[-1.2, 1.0], [0.0, 0.0], [jnp.nan, 1.0]])
    together = jax.vmap(lambda start: descend(rule, lambda x: tuning.linearise(rosenbrock, x), start, 40))(starts)
    alone = descend(rule, lambda x: tuning.linearise(rosenbrock, x), starts[0], 40)
    np.testing.assert_allclose(together[0], alone, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(together[:2, -1], 1.0, atol=1e-6)


def test_a_step_is_no_longer_than_longest():
    rule = tuning.levenberg_marquardt(damping=1e-9, longest=0.5, rounds=1, factors=(1.0,))
    seen = tuning.linearise(lambda x: x - jnp.array([20.0, -2.0]), jnp.zeros(2))
    after, _ = rule.update(seen, rule.init(jnp.zeros(2)), jnp.zeros(2))
    np.testing.assert_allclose(after, [0.5, -0.05], rtol=1e-6)


def test_slopes_steeper_than_the_cap_are_scaled_down_and_the_value_is_not():
    def chaotic(x):
        return jnp.stack([x[0] + 1.0, 1e6 * x[1] + 0.1, 2.0 * x[1] - 1.0])

    x = jnp.zeros(2)
    seen = tuning.quadratic(chaotic, x, largest_residual_gradient=3.0)
    size = np.sqrt(2.01 / 3.0)
    jacobian = np.array([[1.0, 0.0], [0.0, 3.0 * size], [0.0, 2.0]])
    assert seen.value == pytest.approx(2.01)
    np.testing.assert_allclose(seen.gradient, 2.0 * jacobian.T @ [1.0, 0.1, -1.0], rtol=1e-12)
    np.testing.assert_allclose(seen.hessian, 2.0 * jacobian.T @ jacobian, rtol=1e-12)
    uncapped = tuning.quadratic(chaotic, x, largest_residual_gradient=1e9)
    for one, other in zip(uncapped, tuning.quadratic(chaotic, x), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["lm", "lbfgs"])
def test_a_trial_that_is_not_finite_is_rejected_and_the_search_goes_on(name):
    def walled(x):
        return jnp.where(x[0] > 0.5, jnp.nan, 1.0) * jnp.stack([x[0] - 0.4, 3.0 * (x[1] - 2.0)])

    if name == "lm":
        trials = descend(tuning.levenberg_marquardt(longest=10.0), lambda x: tuning.linearise(walled, x), jnp.zeros(2), 40)
    else:
        far = of_squares(walled)
        trials = descend(tuning.lbfgs(longest=10.0), far, jnp.array([-20.0, 0.0]), 80)
    assert np.isfinite(trials).all()
    np.testing.assert_allclose(trials[-1], [0.4, 2.0], atol=1e-4)


def test_latin_hypercube_has_one_point_in_every_cell(key):
    points = np.asarray(tuning.latin_hypercube(key, 16, 3))
    assert points.shape == (16, 3)
    for column in points.T:
        np.testing.assert_array_equal(np.sort(np.floor(16 * column)), np.arange(16))
    assert len({tuple(np.argsort(column)) for column in points.T}) == 3


def test_tuning_within_bounds_by_every_optimiser():
    target = js.SlidingModeGains(c1=1.0, c2=3.0, z_u=0.5, phi_z=5.0, eta=40.0, k=1.0)
    names = ("c1", "c2", "z_u", "phi_z", "eta", "k")

    class Bowl:
        def residuals(self, gains):
            return jnp.stack([jnp.log(getattr(gains, name) / getattr(target, name)) for name in names])

        def __call__(self, gains):
            return jnp.sum(self.residuals(gains) ** 2) + 0.0

    bounds = {name: (0.1 * getattr(target, name), 3.0 * getattr(target, name)) for name in names} | {
        "z_u": (0.1, 0.98),
        "eta": (0.5, 20.0),
    }
    for optimiser, iterations in (("adam", 150), ("lbfgs", 80), ("lm", 60)):
        settings = {"optimiser": optimiser, "iterations": iterations, "starts": 4, "bounds": bounds, "progress": False}
        found = tuning.tune(Bowl(), js.SlidingModeGains(), **settings)
        assert found.optimiser == optimiser
        assert found.near_best() == 1.0
        assert found.answers["c2"].shape == (4,)
        assert found.answers["c2"][np.argmin(found.bests)] == found.gains.c2
        assert found.gains.c2 == pytest.approx(3.0, rel=0.05)
        assert 18.0 < found.gains.eta < 20.001  # its bound, where the optimum is beyond


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"optimiser": "newton"}, "optimiser = 'newton' is not known; type one of adam, lbfgs, lm"),
        ({"optimiser": "lm"}, "optimiser = 'lm' needs residuals, which this objective has not"),
        ({"bounds": {"c1": (2.0, 1.0)}}, r"bounds \(2\.0, 1\.0\) hold no positive gain"),
        ({"bounds": {"c1": (1.0, 2.0)}}, r"initial gain c1 = 0\.5501 is outside its range"),
        ({"resume": True}, "resume = True needs a file"),
    ],
)
def test_faults_get_one_sentence(settings, message):
    with pytest.raises(ValueError, match=message):
        tuning.tune(lambda gains: gains.c1**2, js.SlidingModeGains(), progress=False, **settings)


def problem(**settings):
    return (
        {"objective": tuning.RestToRest(duration=0.4, dt=2e-2), "initial_gains": js.SlidingModeGains(), "starts": 2}
        | {
            "optimiser": "lm",
            "iterations": 8,
            "chunk": 2,
            "progress": False,
        }
        | settings
    )


def test_interrupted_search_resumes_where_it_stopped(tmp_path, monkeypatch):
    path = tmp_path / "new" / "tuning.npz"
    whole = tuning.tune(**problem())
    save, calls = checkpoint.save, []

    def interrupted(*arguments):
        calls.append(save(*arguments))
        if len(calls) == 2:
            raise KeyboardInterrupt
        return calls[-1]

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "save", interrupted)
        half = tuning.tune(**problem(checkpoint=path))
    assert half.status == "interrupted"
    assert [entry.name for entry in path.parent.iterdir()] == ["tuning.npz"]
    rest = tuning.tune(**problem(checkpoint=path, resume=True))
    assert rest.status == "finished"
    np.testing.assert_array_equal(rest.history["objective"], whole.history["objective"])
    assert rest.objective == whole.objective
    again = tuning.tune(**problem(checkpoint=path, resume=True))
    assert again.objective == whole.objective


def test_checkpoints_of_other_problems_and_other_files_are_refused(tmp_path):
    path = tmp_path / "tuning.npz"
    with pytest.raises(ValueError, match=r"does not exist; type resume=False"):
        tuning.tune(**problem(checkpoint=path, resume=True))
    tuning.tune(**problem(checkpoint=path, iterations=2))
    for change, key in (({"seed": 1}, "seed"), ({"objective": tuning.RestToRest(duration=0.4, dt=1e-2)}, "objective")):
        with pytest.raises(ValueError, match=rf"is of another problem \(it differs in {key}\); type another file"):
            tuning.tune(**problem(checkpoint=path, iterations=2, resume=True) | change)
    path.write_text("no checkpoint")
    with pytest.raises(ValueError, match="is no checkpoint; type a file that"):
        tuning.tune(**problem(checkpoint=path, resume=True))


def valley(middle):
    return lambda gains: jnp.log(gains.c1 / middle) ** 2 + (gains.c2 - 2.0) ** 2 + 1.0


RATE = {"objective": valley(1.0), "initial_gains": js.SlidingModeGains(), "optimiser": tuning.adam(0.1), "iterations": 3}


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"objective": valley(1.5)}, "objective"),  # the same function with another captured number
        ({"transforms": {"c1": tuning.bounded(0.1, 9.0)}}, "transforms"),
        ({"optimiser": tuning.adam(0.5)}, "optimiser"),
        ({"optimiser": "lbfgs", "iterations": 6}, "optimiser"),
        ({"gradient": "reverse"}, "gradient"),
        ({"initial_gains": js.SlidingModeGains(c1=0.9)}, "initial_gains"),
        ({"optimiser": "adam"}, "iterations, optimiser"),
    ],
)
def test_a_search_that_differs_in_anything_is_not_resumed(tmp_path, change, key):
    settings = RATE | {"checkpoint": tmp_path / "tuning.npz", "progress": False}
    tuning.tune(**settings)
    with pytest.raises(ValueError, match=rf"of another problem \(it differs in {key}\)") as caught:
        tuning.tune(**settings | change, resume=True)
    assert "\n" not in str(caught.value)


def test_the_same_problem_made_anew_is_resumed_for_more_iterations(tmp_path):
    settings = RATE | {"progress": False, "chunk": 2}
    whole = tuning.tune(**settings | {"iterations": 7})
    tuning.tune(**settings, checkpoint=tmp_path / "tuning.npz")  # ends within a chunk
    again = {"objective": valley(1.0), "optimiser": tuning.adam(0.1), "iterations": 7}
    rest = tuning.tune(**settings | again, checkpoint=tmp_path / "tuning.npz", resume=True)
    np.testing.assert_array_equal(rest.history["objective"], whole.history["objective"])
    assert rest.gains.c1 == whole.gains.c1
    scheduled = settings | {"optimiser": "adam", "checkpoint": tmp_path / "scheduled.npz"}
    tuning.tune(**scheduled)
    with pytest.raises(ValueError, match="differs in iterations, optimiser"):
        tuning.tune(**scheduled | {"iterations": 7}, resume=True)


def test_a_stored_best_is_evaluated_before_it_is_trusted(tmp_path):
    path = tmp_path / "tuning.npz"
    found = tuning.tune(**RATE, checkpoint=path, progress=False)
    with np.load(path) as file:
        content = dict(file)
    (best,) = (name for name, leaf in content.items() if leaf.shape == (1,) and leaf[0] == found.objective)
    np.savez(path, **content | {best: 0.5 * content[best]})
    with pytest.raises(ValueError, match=r"says that its best objectives are .* but there they are .*; type resume=False"):
        tuning.tune(**RATE, checkpoint=path, resume=True, progress=False)
