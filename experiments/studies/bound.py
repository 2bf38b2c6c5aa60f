"""How steep: (4) by simulation, the closed-loop bound of Table 3, maps of it, what raises it, gains tuned to climb."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments.plots import climbing as plots
from experiments.records import Record
from experiments.studies import climbing_axes as axes
from experiments.studies import climbing_map as maps
from tuning import climbing

TORQUE_LIMIT = 5.0
# Rollouts that only decide between settling and failing; the step is at most what the smoothed sign allows.
QUICK = js.Numerics(duration=60.0, dt=1e-2)
# How gains are scored, whatever they were tuned with.
SCORING = js.PlanarTask(smoothing=0.0, control_period=1e-3, torque_limit=TORQUE_LIMIT)
SHARE = 0.99
ROBOTS = 1024


def reproduce(record: Record, progress: bool = True) -> dict[str, Any]:
    """Run the experiment, save its pictures into `record` and return its numbers."""
    record.picture("bound_static", plots.static_figure(js.robots()))
    released = _release(record)
    table = _table_3()
    scan = _scan()
    bounds = _bound_map(record, progress)
    outcomes = _outcome_maps(record)
    raised = _sensitivities(record)
    tuned = _tuned(record, progress)
    parts = {"static_by_release": released, "table_3": table, "monotone": scan, "map": bounds, "outcomes": outcomes}
    parts |= {"sensitivity": raised, "tuned_to_climb": tuned}
    return {"summary": [row for part in parts.values() for row in part.pop("summary")], **parts}


def random_robots(count: int, seed: int = 0) -> js.Robot:
    """Robots with masses over two decades, radii from 5 cm to 1 m, thin shells and gravity from the Moon's to the Earth's."""
    rng = np.random.default_rng(seed)
    masses = 10.0 ** rng.uniform(-1.0, 1.0, (3, count))
    radius = 10.0 ** rng.uniform(np.log10(0.05), 0.0, count)
    drawn = {
        "shell_mass": masses[0],
        "gimbal_mass": masses[1],
        "pendulum_mass": masses[2],
        "shell_inertia": np.repeat((2.0 / 3.0 * masses[0] * radius**2)[:, None], 3, axis=1),
        "gimbal_inertia": np.repeat((0.1 * masses[1] * radius**2)[:, None], 3, axis=1),
        "pendulum_length": radius * rng.uniform(0.1, 0.95, count),
        "shell_radius": radius,
        "gravity": rng.uniform(1.6, 9.9, count),
        "pendulum_inertia": np.zeros((count, 3)),
    }
    return js.Robot(**{name: jnp.asarray(values) for name, values in drawn.items()})  # type: ignore[arg-type]


def _release(record: Record) -> dict[str, Any]:
    robots = random_robots(ROBOTS)
    found = js.batch(js.static_bound_by_release)(robots)
    bound = np.asarray(jax.vmap(js.climbing_bound)(robots))
    record.picture("bound_release", plots.release_figure(bound, np.asarray(found.value)))
    worst = float(np.max(np.abs(found.value - bound)))
    rollouts = int(np.sum(found.rollouts))
    return {
        "robots": ROBOTS,
        "rollouts": rollouts,
        "largest_difference_rad": worst,
        "summary": [f"(4) by releasing {ROBOTS} random robots, {rollouts} rollouts: largest difference {worst:.1e} rad"],
    }


def _table_3() -> dict[str, Any]:
    """gamma* of Table 3 over the full 60 s, at 1 ms and at half that; a coarser one only says where to look."""
    guess = float(js.steepest_slope(js.PlanarTask(), None, QUICK, tolerance=1e-9).value)
    found = {
        dt: js.steepest_slope(js.PlanarTask(), None, replace(QUICK, dt=dt), tolerance=1e-9, guess=guess, early=False)
        for dt in (1e-3, 5e-4)
    }
    degrees = {dt: float(np.rad2deg(bound.value)) for dt, bound in found.items()}
    static = float(np.rad2deg(js.climbing_bound(js.Robot())))
    moved = abs(degrees[1e-3] - degrees[5e-4])
    return {
        "bound_deg": degrees[1e-3],
        "bracket_deg": np.rad2deg(found[1e-3].upper - found[1e-3].lower),
        "bound_at_half_the_step_deg": degrees[5e-4],
        "share_of_static_bound": degrees[1e-3] / static,
        "just_above": js.Status(int(found[1e-3].status)).name.lower(),
        "summary": [
            f"closed-loop bound of Table 3: {degrees[1e-3]:.6f} deg, {100.0 * degrees[1e-3] / static:.2f} % of "
            f"{static:.4f} deg; half the step moves it by {moved:.0e} deg"
        ],
    }


def random_gains(count: int, seed: int = 0) -> js.SlidingModeGains:
    """Gains evenly spread in their logarithms over `tuning.BOUNDS`."""
    rng = np.random.default_rng(seed)
    drawn = {name: np.exp(rng.uniform(np.log(low), np.log(high), count)) for name, (low, high) in tuning.BOUNDS.items()}
    return js.SlidingModeGains(**{name: jnp.asarray(values) for name, values in drawn.items()}, k_i=jnp.zeros(count))


def _scan(slopes: int = 150, sets: int = 64) -> dict[str, Any]:
    """Count how often outcomes change between settling and failing from the flat to (4); once is what bisection assumes."""
    bound = float(js.climbing_bound(js.Robot()))
    gains = random_gains(sets)
    gains = jax.tree.map(lambda table, drawn: np.concatenate([[table], drawn]), js.SlidingModeGains(), gains)
    lanes = jax.tree.map(lambda leaf: np.repeat(leaf, slopes), gains)
    slope = np.tile(np.linspace(0.0, bound, slopes), sets + 1)
    fine = replace(QUICK, dt=5e-3)
    run = js.batch(lambda gains, slope: js.outcome_run(js.PlanarTask(slope=slope), gains, fine), ragged=True)
    settled = (np.asarray(run(lanes, slope).status) == js.Status.OK).reshape(sets + 1, slopes)
    changes = np.sum(settled[:, 1:] != settled[:, :-1], axis=1)
    odd = np.flatnonzero(changes > 1)
    return {
        "slopes": slopes,
        "changes_of_table_3": int(changes[0]),
        "changes_of_random_gains": changes[1:],
        "summary": [
            f"outcome from flat to (4) at {slopes} slopes: Table 3 changes {changes[0]} time, {len(odd)} of {sets} random "
            "sets of gains more than once (not monotone)"
        ],
    }


def _bound_map(record: Record, progress: bool, size: int = 64, sample: int = 64) -> dict[str, Any]:
    x, y = axes.axis("z_u", size), axes.axis("pendulum_mass", size)
    setting = axes.Setting(numerics=replace(QUICK, dt=axes.stable_step(axes.Setting()), dtype="float32"))
    found = maps.bound_map(setting, x, y, progress=progress)
    title = "Steepest slope that the closed loop climbs: Table 3 but for z_U and the pendulum's mass"
    record.picture("bound_map", plots.bound_figure(found, title, (0.9626, 2.05, "Table 3, set A")))
    confirmed, asked = maps.confirm(setting, found, sample)
    return {
        "size": size,
        "rollouts": found.rollouts,
        "simulated_seconds": found.seconds,
        "largest_deg": np.rad2deg(np.nanmax(found.value)),
        "ends_confirmed": confirmed,
        "ends_asked": asked,
        "summary": [
            f"map of {size} x {size} bounds to 1e-3 rad: {found.rollouts} rollouts, {found.rollouts / size**2:.1f} each; "
            f"{confirmed} of {asked} ends of brackets confirmed by 60 s at 1 ms in float64"
        ],
    }


def _outcome_maps(record: Record, size: int = 144) -> dict[str, Any]:
    x, y = axes.axis("torque_limit", size), axes.axis("slope", size)
    setting = axes.Setting(numerics=replace(QUICK, dt=axes.stable_step(axes.Setting()), dtype="float32"))
    refined = maps.outcome_map(setting, x, y)
    dense = maps.outcome_map(setting, x, y, coarse=None)
    record.picture(
        "bound_outcomes", plots.outcome_figure(refined, "How climbs with Table 3 end on slopes, by the motor's limit")
    )
    different = int(np.sum(refined.outcome != dense.outcome))
    rollouts = int(refined.simulated.sum())
    return {
        "size": size,
        "rollouts_refined": rollouts,
        "rollouts_dense": size**2,
        "different_nodes": different,
        "summary": [
            f"outcomes of {size} x {size} climbs: {rollouts} simulated where neighbours disagree against {size**2} "
            f"({size**2 / rollouts:.0f} times fewer), {different} nodes differ from simulating all"
        ],
    }


def _sensitivities(record: Record) -> dict[str, Any]:
    task, gains = js.PlanarTask(), js.SlidingModeGains()
    found = climbing.climb_sensitivity(task, gains, QUICK, tolerance=1e-9)
    differences = climbing.sensitivity_by_differences(task, gains, found.names, QUICK, tolerance=1e-8)
    none = jnp.zeros(len(found.names))
    static = jax.jacfwd(lambda logarithms: js.climbing_bound(climbing.scaled(task, gains, found.names, logarithms)[0].robot))(
        none
    )
    record.picture("bound_sensitivity", plots.sensitivity_figure(found, differences, np.asarray(static)))
    worst = float(np.max(np.abs(found.derivative - differences)) / np.max(np.abs(differences)))
    per_cent = dict(zip(found.names, 0.01 * np.rad2deg(found.derivative), strict=True))
    best = sorted(per_cent, key=lambda name: -abs(per_cent[name]))[:3]
    return {
        "degrees_per_per_cent": per_cent,
        "by_differences": dict(zip(found.names, 0.01 * np.rad2deg(differences), strict=True)),
        "of_static_bound": dict(zip(found.names, 0.01 * np.rad2deg(static), strict=True)),
        "largest_difference_of_largest": worst,
        "summary": [
            "what raises it, degrees for +1 %: "
            + ", ".join(f"{plots.WORDS[name]} {per_cent[name]:+.4f}" for name in (*best, "z_u", "c1", "phi_z"))
            + f"; implicit and differenced derivatives agree to {worst:.0e}"
        ],
    }


def _tuned(record: Record, progress: bool) -> dict[str, Any]:
    found = climbing.tune_to_climb(
        js.PlanarTask(torque_limit=TORQUE_LIMIT), None, QUICK, rounds=3, iterations=25, dt=1.6e-2, progress=progress
    )
    minute = js.Numerics(duration=60.0)
    scored = js.steepest_slope(SCORING, found.gains, minute, tolerance=2e-5, guess=found.bounds[-1], early=False)
    slope = SHARE * found.static_bound
    # Odd: every other sample of a chattering torque has the same sign.
    sampled = replace(minute, save_every=5)
    runs = {
        name: js.simulate(replace(SCORING, slope=slope), gains, sampled, throw=False)
        for name, gains in (("tuned to climb", found.gains), ("Table 3", js.SlidingModeGains()))
    }
    title = f"Hard sign, 1 kHz hold, 5 N m on {np.rad2deg(slope):.3f}°, 99 % of the static bound"
    record.picture("bound_climb", plots.climb_figure(title, list(runs.items()), js.Robot(), slope, 10.0))
    record.picture("bound_tuning", plots.tuning_figure(found.bounds, found.static_bound))
    best = runs["tuned to climb"]
    ends = {name: js.Status(int(run.status)).name.lower() for name, run in runs.items()}
    share = float(scored.value) / found.static_bound
    settling = float(best.metrics.settling_time)
    return {
        "gains": found.gains,
        "bounds_deg": np.rad2deg(found.bounds),
        "bound_with_hard_sign_1kHz_5Nm_deg": np.rad2deg(scored.value),
        "share_of_static_bound": share,
        "at_99_per_cent": {
            "slope_deg": np.rad2deg(slope),
            "status": ends["tuned to climb"],
            "settling_time_s": settling,
            "peak_torque_Nm": best.metrics.peak_torque,
            "table_3": ends["Table 3"],
        },
        "summary": [
            f"gains tuned to climb: {float(np.rad2deg(scored.value)):.4f} deg, {100.0 * share:.3f} % of the static bound, with "
            "the hard sign, 1 kHz hold, 5 N m",
            f"at 99 %, {float(np.rad2deg(slope)):.3f} deg: {ends['tuned to climb']}, settled after {settling:.1f} s (Table 3: "
            f"{ends['Table 3'].replace('_', ' ')})",
        ],
    }
