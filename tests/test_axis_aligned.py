"""The default law: its poles, its momentum, a fleet of random starts, a circle, and gradients over the whole horizon."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from experiments.studies import axis_aligned as study
from jaxsphere import linear, references
from jaxsphere.controllers import axis_aligned, spin_axis
from jaxsphere.models import spatial

ROBOT, SLOPE = js.Robot(), float(np.deg2rad(10.0))
GAINS = js.TrackingGains()
SPEEDS = (0.2, 0.5, 1.0)
TUNED = ("k1", "k2", "k3", "k4", "axis_damping")
# Compiling takes longer than running.
FAST = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


def test_gains_across_the_path_place_the_poles(rng):
    """The sideways model is written out again; with the gains its poles are those of (59) and a damped coning pair."""
    for _ in range(20):
        per_error, per_demand, rolling = rng.uniform(-2.0, 2.0), rng.uniform(-0.3, 0.3), rng.uniform(0.7, 8.0)
        radius, gains = 0.15, replace(GAINS, k3=rng.uniform(1.0, 9.0), k4=rng.uniform(2.0, 6.0))
        f = axis_aligned.sideways_gains(gains, radius, rolling, per_error, per_demand)
        demand = -np.array([f.error, f.error_rate, f.heading, f.lean])  # of e, e', p, q
        tilting = np.array([-rolling * per_error, 1.0 / radius, -rolling, 0.0]) - rolling * per_demand * demand
        matrix = np.stack([[0.0, 1.0, 0.0, 0.0], demand, [0.0, 0.0, 0.0, rolling], tilting])
        fastest = np.hypot(axis_aligned.FASTEST * rolling, axis_aligned.SLOWEST)
        slower = (1.0 + (np.sqrt(gains.k3) / fastest) ** 4) ** -0.25
        damping = gains.axis_damping * rolling**2 / (rolling**2 + axis_aligned.SLOW_ROLL**2)
        wanted = np.polymul([1.0, gains.k4 * slower, gains.k3 * slower**2], [1.0, 2.0 * damping * rolling, rolling**2])
        np.testing.assert_allclose(np.poly(matrix), wanted, rtol=1e-9, atol=1e-9)


def test_only_gravity_changes_the_momentum_about_the_contact_point(rng):
    """About the contact point, which moves with the centre: L' = sum of r x m g - v x (m_p l d'), whatever the torques."""
    robot = js.Robot(shell_inertia=np.array([0.02, 0.02, 0.027]), gimbal_inertia=np.array([0.003, 0.0021, 0.0011]))
    lumped, masses = spatial.lump(robot, SLOPE), (5.1, 2.05)
    gravity = -9.81 * np.array([np.sin(SLOPE), 0.0, np.cos(SLOPE)])

    @jax.jit
    def of(state, torque):
        rate = spatial.derivative(robot, SLOPE, state, torque)
        return jax.jvp(lambda x: spin_axis.posture_of(lumped, tuple(x)), (state,), (rate,))

    for _ in range(5):
        state = rng.normal(size=12) * np.array([*(0.5,) * 2, 2.0, 0.5, 2.0, *(0.7,) * 2, *(2.0,) * 5])
        state[3] += 0.5 * np.pi
        posture, rate = jax.tree.map(np.asarray, of(state, rng.normal(size=2)))
        d, d_rate, v = np.array(posture.direction), np.array(rate.direction), np.array(posture.velocity)
        moment = np.cross([0.0, 0.0, 0.15], masses[0] * gravity) + np.cross(0.12 * d, masses[1] * gravity)
        np.testing.assert_allclose(rate.momentum, moment - np.cross(v, masses[1] * 0.12 * d_rate), rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def compass():
    """Speeds (lanes,) and the loops of rolling at them on three slopes to twelve headings."""
    grid = np.meshgrid([0.1, 0.2, 0.5, 1.0, 1.2], np.deg2rad([0.0, 10.0, 14.0]), np.deg2rad(np.arange(0.0, 360.0, 30.0)))
    lanes = [axis.ravel() for axis in grid]
    found = jax.jit(study.rolling, compiler_options=FAST)(jax.tree.map(float, GAINS), *lanes)
    return lanes[0], jax.tree.map(np.asarray, found)


def test_rolling_is_stable_at_every_speed_heading_and_slope(compass):
    speeds, found = compass
    poles = study.sorted_poles(found.closed_loop)
    assert np.abs(poles[:, 0]).max() < 1e-9, "the vertical spin, which no torque reaches"
    rest = poles[:, 1:].real.max(axis=-1)
    assert rest.max() < -0.15
    # The slowest pair across the path and the coning are in proportion to the speed, until the joints are slower.
    assert rest[speeds >= 0.5].max() < -1.0


def test_linearise_tells_what_no_torque_reaches(compass):
    # 10 degrees, 0.5 m/s, a heading of 30 degrees.
    sloped = jax.tree.map(lambda leaf: leaf[85], compass[1])
    assert linear.unreachable_poles(sloped).shape == (1,)
    np.testing.assert_allclose(linear.unreachable_poles(sloped), 0.0, atol=1e-9)
    assert float(linear.return_difference(sloped)) > 0.5
    with pytest.raises(ValueError, match="straight line"):
        js.linearise(js.SpatialTask(reference=references.circle(1.0, 0.5)))


def test_linearise_finds_the_coning_of_the_other_law():
    def of(speed):
        return js.linearise(js.SpatialTask(reference=references.line(speed), realisation="pendulum_attitude"))

    poles = np.asarray(js.poles(jax.jit(of, compiler_options=FAST)(0.2)))
    unstable = poles[(poles.real > 0.1) & (poles.imag > 0.0)]
    np.testing.assert_allclose(unstable, [2.088 + 25.787j], atol=1e-3)
    # The coning, at the rate of rolling v / r, is hardly damped at all.
    coning = poles[np.argmin(np.abs(poles - 1j * 0.2 / 0.15))]
    assert abs(coning.real) < 0.02


def test_linearise_of_the_plane_holds_the_sliding_mode_poles():
    gains = js.SlidingModeGains()
    found = np.asarray(js.poles(js.linearise(js.PlanarTask(), gains)))
    for pole in np.asarray(js.sliding_mode_poles(ROBOT, SLOPE, gains)):
        assert np.min(np.abs(found - pole)) < 1e-6 * max(1.0, abs(pole))


@pytest.fixture(scope="module")
def followed():
    """Sixty random starts, Table 4's start at three speeds, and a circle, for 20 s with a 1 kHz hold."""
    parts = (
        study.fleet(60, seed=4),
        study.lines(np.array(SPEEDS), 0.25 * np.pi, SLOPE, 0.3, 0.1),
        study.Cases(*(np.array([x]) for x in (0.0, 0.5, 0.0, SLOPE, 0.0, 0.0))),
    )
    return study.follow(study.Cases(*(np.concatenate(columns) for columns in zip(*parts, strict=True))))


def test_a_fleet_of_random_starts_converges(followed):
    assert np.all(followed.status == js.Status.OK)
    for worst, limits in zip(followed.worst, ((0.2, 1.5, 20.0), (0.01, 0.15, 2.0), (0.001, 0.05, 1.0)), strict=True):
        assert np.all(100.0 * np.quantile(worst[:60], (0.5, 0.9, 0.99)) <= limits)
    assert np.median(followed.lean) < np.deg2rad(20.0)


def test_table_4s_start_is_followed_at_three_speeds(followed):
    after_5_s, after_10_s, _ = (100.0 * worst[60:63] for worst in followed.worst)
    assert np.all(after_5_s <= (1.1, 0.03, 0.45))
    assert np.all(after_10_s <= (0.08, 0.001, 0.001))
    assert np.all(followed.lean[60:63] < np.deg2rad(20.0))
    assert np.all(followed.saturated[60:63] == 0.0)
    assert np.all(followed.deviation[60:63] < 0.02)


def test_a_circle_is_followed_without_leaning_over(followed):
    assert 100.0 * followed.worst[0][63] < 0.45
    assert followed.lean[63] < np.deg2rad(25.0)


def test_gradients_over_the_whole_horizon_agree():
    """Mean square error over 20 s and the last state by k1 ... k4 and the axis damping, at three speeds."""
    numerics = js.Numerics(dt=8e-3, save_every=25)

    def run(chosen, speed):
        gains = replace(GAINS, **dict(zip(TUNED, chosen, strict=True)))
        task = js.SpatialTask(reference=references.line(speed), start_position=(0.3, 0.1))
        trajectory = js.simulate(task, gains, numerics, throw=False)
        return 1e4 * trajectory.metrics.rms_error**2, trajectory.state[-1]

    def cost(chosen, speed):
        return run(chosen, speed)[0]

    chosen, speeds = jnp.array([getattr(GAINS, name) for name in TUNED]), jnp.array(SPEEDS)
    lanes = jax.vmap(run, in_axes=(None, 0))
    forward, of_state = jax.jit(jax.jacfwd(lanes), compiler_options=FAST)(chosen, speeds)
    reverse = jax.jit(jax.vmap(jax.grad(cost), in_axes=(None, 0)), compiler_options=FAST)(chosen, speeds)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * np.abs(forward).max())
    value = jax.jit(lanes, compiler_options=FAST)
    for i, step in enumerate(1e-4 * np.asarray(chosen)):
        ends = [np.asarray(value(chosen.at[i].add(sign * step), speeds)[0]) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(forward[:, i], (ends[0] - ends[1]) / (2.0 * step), rtol=1e-5)
    assert np.abs(forward).min() > 1e-3
    # An unstable loop would let this grow with the horizon, without bound.
    assert np.all(np.linalg.norm(np.asarray(of_state) * np.asarray(chosen), axis=(1, 2)) < 10.0)
