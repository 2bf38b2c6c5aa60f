"""The sliding-mode law in closed loop: reaching, the band of the hard sign, the printed sign and a mismatched robot."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere import sliding_mode

TABLE_3 = js.SlidingModeGains()
TUNED = js.SlidingModeGains(0.72, 3.3, 0.76, 9.0, 6.0, 10.0)
SMOOTHING = 0.05
STARTS = np.array(
    [  # rest at phi_0, rest with the pendulum down, rolling away uphill, swinging hard
        [0.0, 0.0, 0.57, 0.0],
        [0.0, 0.0, 0.0, 0.0],
        [3.0, 6.0, -0.4, 1.0],
        [-2.0, -3.0, 1.0, -4.0],
    ]
)


@pytest.fixture(scope="module")
def smoothed(slope):
    """Rollouts of 4 s from every start, lanes first."""
    run = jax.vmap(lambda x: js.rest_to_rest(js.Robot(), slope, duration=4.0, dt=1e-3, smoothing=SMOOTHING, initial_state=x))
    found = run(STARTS)
    assert np.all(found.status <= js.Status.NOT_SETTLED)
    return found


def test_reaching_condition_holds_outside_the_boundary_layer(smoothed, slope):
    lumped, robot = js.planar.lump(js.Robot(), slope), js.Robot()

    def along(state, torque, target):
        def surface(state):
            z = sliding_mode.asked_swing(TABLE_3, TABLE_3.c1 * (state[0] - target) + state[1])
            return TABLE_3.c2 * (state[2] - js.equilibrium_swing(robot, slope) - z) + state[3]

        return jax.jvp(surface, (state,), (jnp.stack(js.planar.derivative(lumped, tuple(state), (torque,))),))

    per_step = jax.jit(jax.vmap(jax.vmap(along, (0, 0, None))))
    s2, rate = (np.asarray(x) for x in per_step(smoothed.state, smoothed.torque[..., 0], STARTS[:, 0] + 10.0))
    np.testing.assert_allclose(s2, smoothed.diagnostics.s2, rtol=1e-9, atol=1e-10)  # rounding of alpha of some 10 rad
    outside = np.abs(s2) > 3 * SMOOTHING
    assert outside[:, 0].all()
    assert not outside[:, -1].any()
    sign = np.tanh(3.0)  # what the smooth sign has reached at the edge of the layer
    bound = -TABLE_3.eta * sign * np.abs(s2) - TABLE_3.k * s2**2
    assert np.all((s2 * rate)[outside] <= bound[outside] + 1e-9)  # rounding of s2' of some 10 rad/s2


def test_lyapunov_function_falls_until_the_layer_and_stays_in_it(smoothed):
    value = np.asarray(smoothed.diagnostics.lyapunov)
    layer = 0.5 * SMOOTHING**2
    for lane in value:
        reached = int(np.argmax(lane < layer))
        assert reached > 100  # every start is well outside
        assert np.all(np.diff(lane[: reached + 1]) < 0.0)
        assert np.all(lane[reached:] < layer)


def test_time_to_the_surface_obeys_the_reaching_law(smoothed):
    # s2' <= -eta tanh(3) - k |s2| until 3 epsilon, so |s2(0)| / (eta tanh 3) bounds the time.
    s2 = np.abs(np.asarray(smoothed.diagnostics.s2))
    reached = np.argmax(s2 < 3 * SMOOTHING, axis=1) * 1e-3
    assert np.all(reached <= s2[:, 0] / (TABLE_3.eta * np.tanh(3.0)) + 1e-3)


@pytest.mark.parametrize("method", ["rk4", "semi_implicit_euler"])
def test_band_of_the_hard_sign_shrinks_with_the_step(slope, method):
    bands = []
    for dt in (8e-3, 4e-3, 2e-3):
        found = js.rest_to_rest(js.Robot(), slope, duration=2.0, dt=dt, smoothing=0.0, method=method)
        s2, settled = np.abs(np.asarray(found.diagnostics.s2)), np.asarray(found.time) > 0.8
        assert s2[0] > 1.0
        bands.append(np.max(s2[settled]))
    # Within one step s2 moves by at most 2 eta dt: across the surface and the drift of a step's end.
    assert np.all(np.array(bands) <= 2.0 * TABLE_3.eta * np.array([8e-3, 4e-3, 2e-3]))
    assert bands[1] < 0.7 * bands[0]  # half of it, with room for the phase of the switching
    assert bands[2] < 0.7 * bands[1]


def test_printed_sign_rolls_away_downhill(slope):
    found = js.rest_to_rest(js.Robot(), slope, duration=12.0, dt=4e-3, convention="printed", throw=False)
    assert found.status == js.Status.DIVERGED
    assert found.end_time == pytest.approx(10.33, abs=0.02)  # a few steps of 4 ms and one more digit than is published
    assert found.state[-1, 0] == pytest.approx(-1000.0, abs=2.0)  # it rolls 0.8 rad in a step
    later = np.asarray(found.state[250:, 0])  # after the first second, in which the motor's reaction still lifts it
    assert np.all(np.diff(later) <= 0.0)
    assert later[0] < 0.0


def test_corrected_sign_reaches_the_target_where_the_printed_one_runs_away(slope):
    found = js.rest_to_rest(js.Robot(), slope, duration=12.0, dt=4e-3)
    assert found.status == js.Status.OK
    assert found.state[-1, 0] == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize("scale", [0.9, 1.1])
class TestPendulumOfAnotherMass:
    """The plant's pendulum weighs `scale` times the modelled one; the motor gives 5 N m."""

    def test_table_3_runs_away(self, slope, scale):
        found = self.run(slope, TABLE_3, scale)
        assert found.status in (js.Status.NOT_SETTLED, js.Status.DIVERGED)
        assert abs(found.metrics.final_error) > 100.0  # ten times the travel

    def test_fast_switching_stops_short(self, slope, scale):
        for k, tolerance in ((10.0, 0.25), (300.0, 0.1)):  # the estimate is the limit of a large k, seen 17 % and 6 %
            gains = replace(TUNED, k=k)
            found = self.run(slope, gains, scale)
            assert found.status == js.Status.NOT_SETTLED
            error = js.equilibrium_swing(pendulum_scaled(scale), slope) - js.equilibrium_swing(js.Robot(), slope)
            estimate = -gains.phi_z / gains.c1 * np.arctanh(error / gains.z_u)
            assert found.metrics.final_error == pytest.approx(estimate, rel=tolerance)
            assert abs(found.metrics.final_error) > 0.4

    @pytest.mark.parametrize("k_i", [0.03, 0.06])
    def test_equilibrium_seeking_settles_on_the_target(self, slope, scale, k_i):
        found = self.run(slope, replace(TUNED, k_i=k_i), scale)
        assert found.status == js.Status.OK
        assert found.metrics.settling_time < 8.0  # seen: 3.9 to 7.5 s
        assert abs(found.metrics.final_error) < 0.01 * 10.0
        # At rest the pendulum hangs at the phi_0 of the true robot, which the law was never told.
        true, modelled = (float(js.equilibrium_swing(which, slope)) for which in (pendulum_scaled(scale), js.Robot()))
        assert found.state[-1, 2] == pytest.approx(true, abs=0.05 * abs(true - modelled))  # the last 5 % still settle

    @staticmethod
    def run(slope, gains, scale):
        return js.rest_to_rest(
            js.Robot(), slope, gains, duration=20.0, dt=4e-3, torque_limit=5.0, plant=pendulum_scaled(scale), throw=False
        )


def pendulum_scaled(scale):
    """Set A with a heavier or lighter pendulum."""
    return replace(js.Robot(), pendulum_mass=scale * 2.05)
