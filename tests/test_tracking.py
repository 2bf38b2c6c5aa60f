"""Tracking: the outer loop, the five realisations, and the robot that follows a line here and in MuJoCo."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import mujoco_robot
import numpy as np
import pytest
from scipy.linalg import expm

import jaxsphere as js
from jaxsphere.controllers import lean, references, tracking
from jaxsphere.models import spatial
from jaxsphere.models.spatial import frames
from jaxsphere.models.spatial.paper import paper_affine
from jaxsphere.simulation.rollout import rollout
from jaxsphere.tasks.spatial import ideal_plant, spatial_plant

ROBOT, SLOPE = js.Robot(), np.deg2rad(10.0)
UNEQUAL = dataclasses.replace(
    js.Robot(), shell_inertia=np.array([0.02, 0.02, 0.027]), gimbal_inertia=np.array([0.003, 0.0021, 0.0011])
)
GAINS = tracking.TABLE_4
PATHS = {
    "line": lambda speed: references.line(speed),
    "circle": lambda speed: references.circle(1.0, speed),
    "figure_eight": lambda period: references.figure_eight(1.0, period),
}


@partial(jax.jit, static_argnames=("path", "realisation", "steps", "save_every"))
def track(gains, path, number, start, heading, steps, realisation="pendulum_attitude", save_every=100, hold=1, slope=SLOPE):
    reference = PATHS[path](number)
    ideal = realisation == "ideal"
    trajectory = rollout(
        ideal_plant(ROBOT) if ideal else spatial_plant(ROBOT, slope),
        tracking.law(ROBOT, slope, gains, reference, realisation),
        tracking.resting_state(ROBOT, slope, (start[0], start[1]), heading),
        dt=jnp.asarray(1e-3),
        steps=steps,
        save_every=save_every,
        hold=None if ideal else hold,
        torque_limit=None if ideal else jnp.asarray(5.0),
    )
    wanted = jax.vmap(lambda time: jnp.stack(reference(time).position))(trajectory.time)
    return trajectory, trajectory.state[:, :2] - wanted


def draw(rng, count):
    state = rng.normal(size=(count, 12)) * np.array([*(0.5,) * 2, *(1.5,) * 3, *(0.5,) * 2, *(2.0,) * 5])
    state[:, 3] = rng.uniform(0.4, 2.7, count)
    return state


@pytest.mark.parametrize("path", PATHS)
def test_references_are_consistent(path):
    reference = PATHS[path](1.7)
    again = references.from_position(lambda time: reference(time).position)
    for time in (0.0, 0.3, 4.0):
        here, there = reference(jnp.asarray(time)), again(time)
        np.testing.assert_allclose(here.velocity, there.velocity, rtol=0, atol=1e-13)
        np.testing.assert_allclose(here.acceleration, there.acceleration, rtol=0, atol=1e-13)
    assert np.hypot(*reference(jnp.asarray(4.0)).velocity) > 0.1
    if path != "figure_eight":
        assert np.hypot(*reference(jnp.asarray(4.0)).velocity) == pytest.approx(1.7)


def test_lean_at_rest_is_the_equilibrium_swing():
    for slope in (-0.2, 0.0, 0.1745, 0.3):
        x, y, z = lean.balancing_lean(spatial.lump(ROBOT, slope), (jnp.zeros(()), jnp.zeros(()))).direction
        assert y == 0.0
        assert z < 0.0
        assert np.arctan2(x, -z) + slope == pytest.approx(float(js.equilibrium_swing(ROBOT, slope)), abs=1e-12)


@pytest.mark.parametrize("acceleration", [-0.8, 0.3, 0.7])
def test_lean_held_in_space_accelerates_the_robot_as_demanded(acceleration):
    """Upright with the heading up-slope, torques that keep the swing fixed give the demanded acceleration."""
    x, _, z = lean.balancing_lean(spatial.lump(UNEQUAL, SLOPE), (jnp.asarray(acceleration), jnp.zeros(()))).direction
    swing = np.arctan2(x, -z) + SLOPE
    free, pushed = (np.asarray(js.planar.acceleration(UNEQUAL, SLOPE, [0.0, 0.0, swing, 0.0], torque)) for torque in (0.0, 1.0))
    torque = -free[1] / (pushed[1] - free[1])
    rolling = free[0] + torque * (pushed[0] - free[0])
    assert UNEQUAL.shell_radius * rolling == pytest.approx(acceleration, rel=1e-10)


def test_an_infeasible_demand_has_a_negative_margin_and_a_finite_lean():
    lumped = spatial.lump(ROBOT, SLOPE)
    infeasible = lean.balancing_lean(lumped, (jnp.asarray(5.0), jnp.asarray(1.0)))
    assert infeasible.margin < 0.0
    assert float(jnp.linalg.norm(jnp.stack(infeasible.direction))) == pytest.approx(1.0)
    assert lean.balancing_lean(lumped, (jnp.asarray(0.5), jnp.asarray(0.5))).margin > 0.0
    gradient = jax.grad(lambda a: lean.balancing_lean(lumped, (a, 0.0 * a)).direction[2])
    assert np.isfinite(gradient(5.0))
    assert np.isfinite(jax.grad(lambda a: lean.limit((a, a), 1.0)[0])(0.0))
    np.testing.assert_allclose(lean.limit((jnp.asarray(30.0), jnp.asarray(40.0)), 2.0), (1.2, 1.6), rtol=1e-12)


def test_joints_reach_the_lean_and_hold_it():
    rng = np.random.default_rng(1)
    for state in draw(rng, 10):
        direction = tuple(v / np.sqrt(3) for v in rng.choice([-1.0, 1.0], 3))
        joints = lean.joints_to(state, direction)
        assert max(abs(float(e)) for e in joints.error) <= np.pi
        there = state.copy()
        there[5:7] += np.array(joints.error)
        np.testing.assert_allclose(frames.pendulum_direction(there), direction, rtol=0, atol=1e-12)
        along = np.zeros(12)
        along[2:4], along[5:7] = state[7:9], state[10:12] + np.array(lean.joints_to(there, direction).rate)
        drift = jax.jvp(lambda s: jnp.stack(frames.pendulum_direction(s)), (jnp.asarray(there),), (jnp.asarray(along),))[1]
        np.testing.assert_allclose(drift, 0.0, atol=1e-12)


def test_realisations_do_what_their_equations_say():
    lumped = spatial.lump(UNEQUAL, SLOPE)
    reference = references.line(0.5)(jnp.asarray(0.2))
    for state in draw(np.random.default_rng(2), 10):
        components = tuple(jnp.asarray(state))
        now = {name: tracking.signals(lumped, GAINS, reference, components, name) for name in tracking.REALISATIONS}
        gimbal = spatial.of_state(components)
        terms = paper_affine(components, gimbal, spatial.affine(lumped, gimbal))
        terms = [np.array(column) for column in terms]
        columns = np.stack(terms[1:], axis=1)
        outcome = {n: terms[0] + columns @ np.array(s.torque) for n, s in now.items() if n != "ideal"}
        outcome["ideal"] = np.array(now["ideal"].torque)
        for name in ("ideal", "exact"):
            second = frames.coordinate_accelerations(UNEQUAL, components, tuple(outcome[name]))
            np.testing.assert_allclose(second[:2], now[name].demand, rtol=1e-8, atol=1e-8)
        nearest = np.linalg.pinv(columns) @ (outcome["ideal"] - terms[0])
        np.testing.assert_allclose(now["pseudo_inverse"].torque, nearest, rtol=1e-7, atol=1e-7)
        decoupling = np.asarray(tracking.decoupling_matrix(UNEQUAL, components))
        wanted = np.array(now["ideal"].demand) - np.array(frames.coordinate_accelerations(UNEQUAL, components, (0.0,) * 5)[:2])
        np.testing.assert_allclose(outcome["ideal"], np.linalg.pinv(decoupling) @ wanted, rtol=1e-9, atol=1e-9)
        determinant = tracking.decoupling_determinant(UNEQUAL, SLOPE, components)
        assert determinant == pytest.approx(np.linalg.det(decoupling @ columns), rel=1e-8)
        for name in tracking.BY_ATTITUDE:
            joints = now[name].joints
            servo = 900.0 * np.array(joints.error) + 60.0 * np.array(joints.rate)
            np.testing.assert_allclose(outcome[name][3:], servo, rtol=1e-8, atol=1e-8)
        assert float(jnp.hypot(*now["pendulum_attitude"].limited)) < 1.0 + 1e-12


@pytest.mark.parametrize("robot", [ROBOT, UNEQUAL, js.robot_named("roboball_ii")], ids=["set_a", "unequal", "roboball_ii"])
def test_upright_the_torques_are_solvable(robot):
    lumped = spatial.lump(robot, 0.1)
    state = tuple(jnp.asarray([0.0] * 3 + [0.5 * np.pi] + [0.0] * 8))
    for name in ("exact", "pendulum_attitude"):
        now = tracking.signals(lumped, GAINS, references.line(0.1)(jnp.zeros(())), state, name)
        assert now.determinant > 0.0


@pytest.mark.parametrize("gains", [GAINS, tracking.TrackingGains(k1=50.0, k2=2.0, k3=6.0, k4=5.0)], ids=["table_4", "unequal"])
def test_ideal_obeys_the_error_dynamics(gains):
    trajectory, error = track(gains, "line", 0.1, (0.1, 0.03), 0.25 * np.pi, 2000, "ideal")
    assert int(trajectory.status) == js.Status.OK
    for axis, (k, damping, start) in enumerate(((gains.k1, gains.k2, 0.1), (gains.k3, gains.k4, 0.03))):
        step = expm(np.array([[0.0, 1.0], [-k, -damping]]) * 0.1)
        expected = [np.array([start, -0.1 * np.sqrt(0.5)])]
        for _ in trajectory.time[1:]:
            expected.append(step @ expected[-1])
        np.testing.assert_allclose(error[:, axis], np.array(expected)[:, 0], rtol=0, atol=1e-9)


def test_error_poles():
    np.testing.assert_allclose(tracking.error_poles(GAINS), -7.0, atol=1e-6)
    poles = tracking.error_poles(tracking.TrackingGains(k1=50.0, k2=2.0, k3=6.0, k4=5.0))
    np.testing.assert_allclose(np.sort_complex(poles), [-3.0, -2.0, -1.0 - 7.0j, -1.0 + 7.0j], atol=1e-12)


def test_pendulum_attitude_tracks_the_line():
    for speed in (0.2, 0.5, 1.0):
        trajectory, error = track(GAINS, "line", speed, (0.3, 0.1), 0.25 * np.pi, 20000)
        assert int(trajectory.status) == js.Status.OK
        late = np.hypot(*np.asarray(error)[trajectory.time >= 5.0].T)
        assert late.max() < 0.015
        assert np.max(np.abs(trajectory.torque)) <= 5.0


@pytest.mark.parametrize(
    ("path", "number", "start", "heading"), [("circle", 0.5, (1.0, 0.0), 0.5), ("figure_eight", 15.0, (0.0, 0.0), 0.25)]
)
def test_pendulum_attitude_tracks_curves(path, number, start, heading):
    trajectory, error = track(GAINS, path, number, start, heading * np.pi, 20000)
    assert int(trajectory.status) == js.Status.OK
    assert np.hypot(*np.asarray(error)[trajectory.time >= 5.0].T).max() < 0.01


def test_the_papers_realisations_fail_on_the_robot():
    exact, _ = track(GAINS, "line", 0.5, (0.3, 0.1), 0.25 * np.pi, 1000, "exact", 10)
    assert int(exact.status) == js.Status.SINGULAR_DECOUPLING
    assert 0.0 < float(exact.end_time) < 0.1
    nearest, error = track(GAINS, "line", 0.5, (0.3, 0.1), 0.25 * np.pi, 10000, "pseudo_inverse")
    assert int(nearest.status) != js.Status.OK or np.hypot(*error[-1]) > 1.0


def test_the_centre_is_a_non_minimum_phase_output():
    poles = np.asarray(tracking.zero_dynamics_poles(ROBOT, SLOPE))
    planar = np.asarray(js.zero_dynamics_poles(ROBOT, SLOPE))
    for pole in planar:
        assert np.min(np.abs(poles - pole)) < 1e-8 * np.abs(pole)
    assert poles.real.max() == pytest.approx(26.81, abs=0.01)


def test_gradients_of_a_tracking_cost_agree():
    @jax.jit
    def cost(gains):
        _, error = track(gains, "line", 0.1, (0.02, 0.01), 0.25 * np.pi, 300, "pendulum_attitude", 10)
        return 1e3 * jnp.mean(error**2)

    gains = jax.tree.map(np.float64, GAINS)
    forward, reverse = jax.jit(jax.jacfwd(cost))(gains), jax.jit(jax.grad(cost))(gains)
    for name in ("k1", "k2", "k3", "k4"):
        slope = float(getattr(forward, name))
        assert slope == pytest.approx(float(getattr(reverse, name)), rel=1e-8)
        assert abs(slope) > 1e-6
        ends = [cost(dataclasses.replace(gains, **{name: getattr(gains, name) + step})) for step in (1e-3, -1e-3)]
        assert slope == pytest.approx(float(ends[0] - ends[1]) / 2e-3, rel=1e-4)


def test_what_cannot_work_is_told():
    trajectory, _ = track(GAINS, "line", 0.5, (0.3, 0.1), 0.25 * np.pi, 100, slope=np.deg2rad(19.0))
    assert int(trajectory.status) == js.Status.INFEASIBLE_LEAN
    assert np.all(np.isfinite(trajectory.state))
    with pytest.raises(ValueError, match=r"gains\.k2"):
        tracking.check_gains(tracking.TrackingGains(k2=-1.0))
    with pytest.raises(TypeError, match="TrackingGains"):
        tracking.check_gains(js.SlidingModeGains())
    with pytest.raises(ValueError, match="pendulum_attitude"):
        tracking.law(ROBOT, SLOPE, GAINS, references.line(0.5), realisation="best")


@pytest.mark.parametrize(
    ("gains", "realisation", "speed", "worst"),
    [
        (tracking.TrackingGains(), "axis_aligned", 0.2, 0.003),
        (tracking.TrackingGains(), "axis_aligned", 0.5, 0.0001),
        (tracking.TrackingGains(), "axis_aligned", 1.0, 0.0001),
        (GAINS, "pendulum_attitude", 0.5, 0.015),
    ],
)
def test_the_line_is_tracked_in_mujoco(gains, realisation, speed, worst):
    control = tracking.law(ROBOT, SLOPE, gains, references.line(speed), realisation)
    command = jax.jit(lambda time, state: jnp.stack(control(time, tuple(state), ()).torque))
    start = np.stack(tracking.resting_state(ROBOT, SLOPE, (0.3, 0.1)))

    def sampled(time, state):
        return np.clip(command(time, state), -5.0, 5.0)

    states = mujoco_robot.simulate(ROBOT, SLOPE, start, sampled, duration=15.0, dt=2e-4, hold=1e-3, save=0.1)
    time = np.linspace(0.0, 15.0, len(states))
    error = states[:, :2] - speed * time[:, None] * np.sqrt(0.5)
    assert np.hypot(*error[time >= 10.0].T).max() < worst
    assert np.hypot(*error[time >= 5.0].T).max() < 0.015
