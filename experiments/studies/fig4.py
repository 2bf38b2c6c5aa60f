"""Fig. 4: rest to rest on 10 degrees. Table 3 with both signs of z, tuned gains, and a robot that is not the modelled one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments.plots import regulation, search
from experiments.records import Record

SLOPE = float(np.deg2rad(10.0))
TRAVEL = 10.0
TORQUE_LIMIT = 5.0
SEEKING = 0.03  # k_i, rad/s
PENDULUM_FACTORS = (0.9, 1.0, 1.1)

# How gains are scored, whatever they were tuned with: hard sign, 1 kHz zero-order hold, the motor's limit.
SCORING: dict[str, Any] = {"smoothing": 0.0, "control_period": 1e-3, "torque_limit": TORQUE_LIMIT}


def reproduce(record: Record, progress: bool = True) -> dict[str, Any]:
    """Run the experiment, save its pictures into `record` and return its numbers."""
    robot, table = js.Robot(), js.SlidingModeGains()
    run = partial(js.rest_to_rest, robot, SLOPE, travel=TRAVEL)
    corrected = run(table)
    printed = run(table, convention="printed", throw=False)
    objective = tuning.Annealed(tuning.RestToRest(robot, SLOPE, travel=TRAVEL, torque_limit=TORQUE_LIMIT))
    result = tuning.tune(objective, table, optimiser="lm", starts=8, bounds=tuning.BOUNDS, progress=progress)
    result.save(record.folder / "fig4_tuning.json")
    tuned = run(result.gains, torque_limit=TORQUE_LIMIT)
    scored = {"table_3": run(table, **SCORING), "tuned": run(result.gains, **SCORING)}
    mismatch = {"table_3": _mismatch(table), "tuned": _mismatch(result.gains)}
    mismatch["tuned_with_k_i"] = _mismatch(replace(result.gains, k_i=SEEKING))

    title = "Rest to rest on a 10° slope, smoothed sign (ε = 0.02 rad/s)"
    runs = [regulation.Run("Table 3", corrected, table), regulation.Run("tuned", tuned, result.gains)]
    record.picture("fig4", regulation.regulation_figure(title, runs, robot, SLOPE, TRAVEL, until=10.0))
    record.picture("fig4_sign", regulation.sign_figure(corrected, printed, until=6.0))
    record.picture("fig4_tuning", search.convergence_figure(result))
    record.picture("fig4_mismatch", _mismatch_figure(mismatch))
    return {
        "summary": _summary(scored, printed, mismatch),
        "climbing_bound_deg": jnp.rad2deg(js.climbing_bound(robot)),
        "equilibrium_swing_deg": jnp.rad2deg(js.equilibrium_swing(robot, SLOPE)),
        "zero_dynamics_poles": jnp.real(js.zero_dynamics_poles(robot, SLOPE)),
        "table_3": figures(corrected, table),
        "table_3_printed_sign": figures(printed, table),
        "tuned": figures(tuned, result.gains),
        "scored_with_hard_sign_1kHz_hold": {name: figures(trajectory) for name, trajectory in scored.items()},
        "tuned_gains": result.gains,
        "tuning": {"objective_before": result.initial_objective, "objective_after": result.objective},
        "pendulum_mass_mismatch": {name: _mismatch_numbers(trajectories) for name, trajectories in mismatch.items()},
    }


def figures(trajectory: js.Trajectory, gains: js.SlidingModeGains | None = None) -> dict[str, Any]:
    """Name the figures of merit of one rest-to-rest trajectory, and with `gains` what the linearisation says of them."""
    metrics = trajectory.metrics
    numbers = {
        "status": js.Status(int(trajectory.status)).name.lower(),
        "end_time_s": trajectory.end_time,
        "settling_time_s": metrics.settling_time,
        "overshoot": metrics.overshoot,
        "final_error_rad": metrics.final_error,
        "swing_range_deg": jnp.rad2deg(jnp.stack([metrics.lowest_swing, metrics.highest_swing])),
        "peak_swing_about_equilibrium_deg": jnp.rad2deg(metrics.peak_swing),
        "peak_torque_Nm": metrics.peak_torque,
        "torque_variation_Nm": metrics.chatter,
    }
    if gains is not None:
        poles = js.sliding_mode_poles(js.Robot(), SLOPE, gains)
        numbers["sliding_mode_poles"] = {"real": jnp.real(poles), "imaginary": jnp.imag(poles)}
        numbers["nonsingularity_margin"] = js.nonsingularity_margin(js.Robot(), gains)
    return numbers


def _summary(scored: dict[str, js.Trajectory], printed: js.Trajectory, mismatch: dict[str, js.Trajectory]) -> list[str]:
    rows = ["gains, hard sign, 1 kHz hold, 5 N m    2 % settling   peak swing about equilibrium   peak torque"]
    for name, trajectory in scored.items():
        numbers = trajectory.metrics
        rows.append(
            f"{name:<36}{float(numbers.settling_time):>12.2f} s{float(jnp.rad2deg(numbers.peak_swing)):>23.1f} deg"
            f"{float(numbers.peak_torque):>16.1f} N m"
        )
    rows.append(f"printed sign of z: {js.Status(int(printed.status)).name.lower()} after {float(printed.end_time):.2f} s")
    for name, lanes in mismatch.items():
        ends = ", ".join(
            f"x{factor:g}: {'settles' if status == js.Status.OK else js.Status(status).name.lower().replace('_', ' ')}"
            for factor, status in zip(PENDULUM_FACTORS, np.asarray(lanes.status).tolist(), strict=True)
        )
        rows.append(f"pendulum mass of the plant, {name}: {ends}")
    return rows


def _mismatch(gains: js.SlidingModeGains) -> js.Trajectory:
    def lane(factor: jax.Array) -> js.Trajectory:
        plant = js.Robot(pendulum_mass=js.Robot().pendulum_mass * factor)
        return js.rest_to_rest(js.Robot(), SLOPE, gains, TRAVEL, plant=plant, save_every=10, **SCORING)

    return jax.vmap(lane)(jnp.array(PENDULUM_FACTORS))


def _mismatch_numbers(trajectories: js.Trajectory) -> dict[str, Any]:
    lanes = [jax.tree.map(lambda leaf, i=i: leaf[i], trajectories) for i in range(len(PENDULUM_FACTORS))]
    return {f"pendulum_mass_x{factor:g}": figures(lane) for factor, lane in zip(PENDULUM_FACTORS, lanes, strict=True)}


def _mismatch_figure(mismatch: dict[str, js.Trajectory]) -> Any:
    labels, errors = [], []
    for name, words in (("tuned", "k_i = 0"), ("tuned_with_k_i", f"k_i = {SEEKING:g} rad/s")):
        for lane in (0, 2):
            labels.append(f"pendulum {100 * (PENDULUM_FACTORS[lane] - 1):+.0f} %, {words}")
            errors.append(np.asarray(mismatch[name].state[lane, :, 0]) - TRAVEL)
    title = "Tuned gains on a robot whose pendulum is not the modelled one"
    return regulation.error_figure(title, labels, np.asarray(mismatch["tuned"].time[0]), errors, 0.02 * TRAVEL)
