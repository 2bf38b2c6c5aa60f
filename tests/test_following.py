"""Following lines as an objective: its terms recomputed, residuals and streamed sum, gradients, early ends, the search."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
import tuning
from jaxsphere.models.spatial import contact
from jaxsphere.models.spatial.contact import Contact

EVERY = tuning.LineWeights(*(0.5 + i for i in range(len(tuning.LineWeights._fields))))
# Limits low enough that every term but `lost` is at work.
SHORT = tuning.FollowLine(
    speeds=(0.3, 0.6),
    duration=0.96,
    dt=8e-3,
    save_every=3,
    settled_after=0.25,
    weights=EVERY,
    lean_limit=0.05,
    friction_limit=0.05,
)
GAINS = js.TrackingGains(k1=60.0, k_p=700.0, a_max=1.5)
# Compiling takes longer than running.
FAST = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


def compiled(function):
    """Compile in a hurry."""
    return jax.jit(function, compiler_options=FAST)


@pytest.fixture(scope="module")
def evaluated():
    """(gains, slope, plant) -> objective and terms of the short task, compiled once."""

    def at(gains, slope, plant):
        there = replace(SHORT, slope=slope, plant=plant)
        return there(gains), there.terms(gains)

    run = compiled(at)
    return lambda gains, slope, plant=js.Robot(): run(gains, slope, plant)


CHOSEN = tuning.parametrise(GAINS, transforms={name: tuning.bounded(*ends) for name, ends in tuning.SPATIAL_BOUNDS.items()})


@pytest.fixture(scope="module")
def expanded():
    """Free vector (8,) -> `Quadratic` of the residuals, compiled once."""

    def at(vector):
        return tuning.quadratic(lambda free: SHORT.residuals(CHOSEN.to_gains(free)), vector)

    return compiled(at)


def test_terms_equal_those_of_the_saved_rollouts(evaluated, slope):
    terms = evaluated(GAINS, slope)[1]
    expected = {name: [] for name in tuning.LineTerms._fields[:5]}
    for speed in SHORT.speeds:
        found = js.track_line(
            js.Robot(), slope, GAINS, speed, duration=0.96, dt=8e-3, control_period=8e-3, torque_limit=5.0, diagnostics=True
        )
        looks = np.arange(0, 120, 3)
        time, state, torque = (np.asarray(x)[looks] for x in (found.time, found.state, found.torque))
        square = 1e4 * np.sum((state[:, :2] - speed * np.sqrt(0.5) * time[:, None]) ** 2, axis=1)
        lean = np.maximum(np.rad2deg(np.abs(state[:, 3] - 0.5 * np.pi) - 0.05), 0.0)
        steeper = np.arctan(np.asarray(found.diagnostics.contact.friction_coefficient)[looks]) - np.arctan(0.05)
        slip = np.maximum(np.rad2deg(steeper), 0.0)
        expected["distance"].append(square.mean())
        expected["late"].append(square[time >= 0.25].mean())
        expected["lean"].append(np.mean(2.0 * (np.sqrt(1.0 + lean**2) - 1.0)))
        expected["friction"].append(np.mean(2.0 * (np.sqrt(1.0 + slip**2) - 1.0)))
        expected["effort"].append(np.mean(np.sum(torque**2, axis=1)))
    for name, values in expected.items():
        assert np.mean(values) > 0.0
        assert getattr(terms, name) == pytest.approx(np.mean(values), rel=1e-9), name  # another program
    assert terms.lost == 0.0
    assert terms.prior == pytest.approx(np.log(60 / 16) ** 2 + np.log(7 / 9) ** 2 + np.log(1.5 / 1.3) ** 2)


@pytest.mark.parametrize("slope", [0.17, 0.4], ids=["follows", "past the bound"])
def test_objective_is_the_weighted_sum_of_its_terms(evaluated, slope):
    value, terms = evaluated(GAINS, slope)
    expected = sum(w * float(t) for w, t in zip(EVERY, terms, strict=True))
    assert value == pytest.approx(expected, rel=1e-9)  # the first sums inside the rollout, the second over what it saved
    assert terms.lost == pytest.approx(0.0 if slope == 0.17 else 1.0)


def test_a_lane_that_ends_early_keeps_its_error_and_pays_for_the_rest(evaluated):
    wild = js.TrackingGains(k1=199.6, k2=9.8, k3=1.5, k4=17.7, k_p=1833.2, k_d=30.2, a_max=2.65, axis_damping=0.373)
    value, terms = evaluated(wild, 0.3)
    expected = sum(w * float(t) for w, t in zip(EVERY, terms, strict=True))
    assert value == pytest.approx(expected, rel=1e-6)  # wild gains blow rounding up
    task = {"duration": 0.96, "dt": 8e-3, "control_period": 8e-3, "save_every": 3, "throw": False}
    time = np.arange(0, 120, 3) * 8e-3
    lost, distance = [], []
    for speed, early in zip(SHORT.speeds, (False, True), strict=True):
        found = js.track_line(js.Robot(), 0.3, wild, speed, **task)
        end = float(found.end_time)
        assert (int(found.status) not in (js.Status.OK, js.Status.NOT_SETTLED)) == (0.2 < end < 0.8) == early
        error = np.asarray(found.state)[:-1, :2] - speed * np.sqrt(0.5) * np.minimum(time, end)[:, None]
        lost.append(np.mean(time > end - 4e-3))
        distance.append(1e4 * np.mean(np.sum(error**2, axis=1)))
    assert terms.lost == pytest.approx(np.mean(lost))
    assert terms.distance == pytest.approx(np.mean(distance), rel=1e-6)


def test_squared_residuals_sum_to_the_objective_and_gradient_and_differences_agree(evaluated, expanded, slope):
    vector = CHOSEN.to_vector(GAINS)
    seen = expanded(vector)
    assert seen.value == pytest.approx(float(evaluated(GAINS, slope)[0]), rel=1e-9)
    forward = np.asarray(seen.gradient)
    ends = [
        [evaluated(CHOSEN.to_gains(vector + sign * step), slope)[0] for sign in (1, -1)] for step in 1e-5 * np.eye(len(vector))
    ]
    differences = [float(up - down) / 2e-5 for up, down in ends]
    np.testing.assert_allclose(forward, differences, rtol=1e-4, atol=1e-5 * np.abs(forward).max())
    assert np.all(forward != 0.0)


def test_friction_angle_is_the_arctangent_of_the_coefficient_and_smooth_beyond(slope):
    found = SHORT.rollout(GAINS, 0.6)
    for state, torque in zip(found.state[:-1:5], found.torque[:-1:5], strict=True):
        forces = contact.contact(js.Robot(), slope, tuple(state), tuple(torque))
        assert np.tan(tuning.friction_angle(forces)) == pytest.approx(float(forces.friction_coefficient), rel=1e-12)

    def angle(normal):
        return tuning.friction_angle(Contact(normal, (jnp.asarray(3.0), jnp.asarray(4.0)), jnp.zeros(())))

    assert angle(jnp.asarray(0.0)) == pytest.approx(0.5 * np.pi)
    assert jax.grad(angle)(0.0) == pytest.approx(-0.2)
    assert angle(jnp.asarray(-5.0)) == pytest.approx(0.75 * np.pi)  # the sphere would leave the slope
    still = jax.grad(lambda force: tuning.friction_angle(Contact(jnp.ones(()), (force, force), jnp.zeros(()))))
    assert still(0.0) == 0.0


def test_the_plants_friction_and_motion_are_the_true_robots(evaluated, slope):
    value, terms = evaluated(GAINS, slope, replace(js.Robot(), pendulum_mass=2.5))
    assert value == pytest.approx(sum(w * float(t) for w, t in zip(EVERY, terms, strict=True)), rel=1e-9)
    for name in ("distance", "friction"):
        assert abs(float(getattr(terms, name)) / float(getattr(evaluated(GAINS, slope)[1], name)) - 1.0) > 1e-3


def test_own_term_adds_its_weighted_mean_square_over_the_speeds():
    peak = tuning.Term("peak spin", lambda trajectory: jnp.max(jnp.abs(trajectory.state[:, 9])), weight=0.25)
    objective = replace(SHORT, weights=tuning.LineWeights(*(0.0,) * 6, 1.0), extra=(peak,))
    peaks = [float(jnp.max(jnp.abs(SHORT.rollout(GAINS, speed).state[:, 9]))) for speed in SHORT.speeds]
    prior = float(jnp.sum(objective._prior(GAINS) ** 2))
    assert compiled(objective)(GAINS) == pytest.approx(prior + 0.25 * np.mean(np.square(peaks)), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speeds": ()}, r"speeds = \(\) leaves nothing to follow; type at least one speed"),
        ({"speeds": (0.3, np.nan)}, "speeds = nan m/s is not admissible"),
        ({"starts": (0.3, 0.1)}, r"starts = \(0\.3, 0\.1\) are no positions; type pairs"),
        ({"settled_after": 0.96}, r"settled_after = 0\.96 s is not admissible; type a number at least 0 and below 0\.96"),
        ({"save_every": 7}, "save_every = 7 must be None or a whole number that divides the 120 steps"),
        ({"save_every": 0}, "save_every = 0 is not admissible"),
        ({"friction_limit": -0.1}, r"friction_limit = -0\.1 is not admissible"),
        ({"lean_limit": 90.0}, "lean_limit = 90 rad is not admissible"),
        ({"largest_residual_gradient": 0.0}, r"largest_residual_gradient = 0\.0 is not admissible"),
        ({"weights": tuning.LineWeights(lean=-1.0)}, r"weights\.lean = -1 is not admissible"),
        ({"weights": tuning.LineWeights(*(0.0,) * 7)}, r"type a positive one, e\.g\. tuning\.LineWeights\(distance=1\.0\)"),
        ({"extra": (tuning.Term("path", lambda trajectory: trajectory.state[:, 0]),)}, "term 'path' returns shape"),
    ],
)  # fmt: skip
def test_faults_get_one_sentence(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SHORT, **change)(GAINS)


def test_what_is_not_finite_is_named_with_lane_and_time():
    broken = replace(SHORT, friction_limit=np.nan)
    assert broken.explain(GAINS) == "lane 0, t = 0 s, friction at 0.3 m/s from (0.3, 0.1) m"
    far = replace(SHORT, starts=((np.inf, 0.0),))
    assert far.explain(GAINS) == "lane 0, t = 0 s, distance at 0.3 m/s from (inf, 0.0) m"
    assert "all of its terms are finite" in SHORT.explain(GAINS)


# Every capability of the planar objective, on lines that last 20 steps.
BRIEF = replace(SHORT, duration=0.16, save_every=2, settled_after=0.08, hard_limits=True)


def test_scenarios_stages_limits_and_figures_of_lines():
    spread = tuning.Uncertainty(relative={"pendulum_mass": 0.2}, slope=(0.05, 0.2), known=False, delayed=0.5)
    scenarios, _ = tuning.sample(spread, BRIEF.task, 2, seed=0)
    assert len(set(np.asarray(scenarios.plant.pendulum_mass).tolist())) == 2
    robust = tuning.Robust(BRIEF, scenarios)
    annealed = tuning.Annealed(robust, smoothing=(1.0, 1.0), stiffness=(1.0, 3.0))

    @compiled
    def evaluate(gains):
        def alone(slope, plant, delayed):
            return replace(BRIEF, slope=slope, plant=plant, delayed=delayed).terms(gains)

        each = jax.vmap(alone)(scenarios.slope, scenarios.plant, scenarios.delayed)
        return robust(gains), each, BRIEF.limits(gains), BRIEF.figures(gains)

    value, each, limits, figures = evaluate(GAINS)
    each = [jax.tree.map(lambda leaf, i=i: leaf[i], each) for i in (0, 1)]
    first, second = (sum(w * float(t) for w, t in zip(EVERY, terms, strict=True)) for terms in each)
    assert first != second
    assert value == pytest.approx(0.5 * (first + second), rel=1e-9)
    stiff = EVERY._replace(lean=3 * EVERY.lean, friction=3 * EVERY.friction, lost=3 * EVERY.lost)
    np.testing.assert_allclose(annealed.stage(1).objective.weights, stiff)
    np.testing.assert_allclose(annealed.stage(0).objective.weights, EVERY)
    assert annealed.largest_residual_gradient == 3.0
    runs = [BRIEF.rollout(GAINS, speed) for speed in BRIEF.speeds]
    lean = max(float(run.metrics.peak_lean) for run in runs) / 0.05 - 1.0
    assert limits.soft["lean"] == pytest.approx(lean, rel=1e-9)
    assert limits.hard["ended_early"] == pytest.approx(0.0, abs=1e-12)
    assert bool(limits.feasible) == (lean <= 0.02 and float(limits.soft["friction"]) <= 0.02)
    assert 0.0 < figures[1] < 1.0
    assert np.all(np.isfinite(figures))
    soft = replace(BRIEF, hard_limits=False)
    assert soft.limits(GAINS).feasible


def test_growth_along_lines_is_that_of_a_nudged_rollout():
    slow = replace(BRIEF, speeds=(0.3,), weights=tuning.LineWeights())
    exponent = compiled(lambda gains: tuning.lyapunov_exponent(slow, gains))(GAINS)
    rest = jnp.stack(slow.lane(0.3).start()[0])
    ends = [
        js.simulate(replace(slow.lane(0.3), initial_state=rest + nudge), GAINS, slow.numerics, throw=False).state[-1]
        for nudge in (5e-7, -5e-7)
    ]
    growth = float(jnp.linalg.norm(ends[0] - ends[1])) / 1e-6
    assert exponent == pytest.approx(np.log(growth) / 0.16 - np.log(2.0) / 0.16, abs=0.05)


class Telltale(tuning.FollowLine):
    """Its best k1 and k2 tell the limit of the lean and the weight of the effort that it was given."""

    def residuals(self, gains):
        return jnp.stack([gains.k1 - 100.0 * self.lean_limit, gains.k2 - 30.0 - 4.0 * jnp.log10(self.weights.effort)])

    def figures(self, gains):
        return jnp.stack([gains.k1, 1.0 / gains.k1, jnp.ones(())])


def test_a_front_of_lines_weighs_lean_against_effort():
    settings = {"points": 8, "iterations": 40, "rounds": 0, "swing": (0.2, 0.8), "effort": (1e-4, 1.0)}
    front = tuning.pareto_front(Telltale(largest_residual_gradient=np.inf), js.TrackingGains(), **settings)
    ends, counts = np.unique(np.round(np.asarray(front.gains.k1), 4), return_counts=True)
    np.testing.assert_array_equal(np.floor(8 * np.log(ends[counts >= 10] / 20.0) / np.log(4.0)), np.arange(8))


def test_a_certificate_of_lines_counts_those_that_are_not_followed():
    settings = {"count": 3, "duration": 0.16, "dt": 8e-3, "control_period": 8e-3}
    slopes = tuning.Uncertainty(slope=(0.05, 0.2))
    lost = tuning.certify(GAINS, slopes, js.SpatialTask(settled_after=0.0, start_position=(0.3, 0.1)), **settings)
    assert lost.not_settled == lost.failures == 3
    assert np.all(np.isinf(lost.settling_times))
    with pytest.raises(ValueError, match="swing and sensor_bias vary in a PlanarTask only"):
        tuning.certify(GAINS, replace(slopes, swing=0.1), js.SpatialTask())
