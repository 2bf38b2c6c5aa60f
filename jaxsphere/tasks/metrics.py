"""Figures of merit of regulation and of tracking, updated at every step of a rollout, whatever the rollout saves."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxsphere.models.planar import PlanarState
from jaxsphere.models.spatial import cosine_of_lean
from jaxsphere.numerics import Real, safe_sqrt
from jaxsphere.simulation.closed_loop import Measure, State

SETTLING_BAND = 0.02  # of the travel


class RegulationMetrics(NamedTuple):
    """How a move from rest to rest went; every entry a scalar per lane."""

    settling_time: Array  # s, from when on |e| <= 2 % of the travel; infinite if it never stays there
    overshoot: Array  # of the travel, beyond the target
    final_error: Array  # e at the end, rad
    peak_swing: Array  # largest |phi - phi_0|, rad
    lowest_swing: Array  # rad
    highest_swing: Array  # rad
    peak_torque: Array  # N m
    effort: Array  # integral of tau^2, (N m)^2 s
    chatter: Array  # total variation of the torque, N m
    itae: Array  # integral of t |e| / travel, s^2

    UNITS = {  # noqa: RUF012
        **{"settling_time": "s", "final_error": "rad", "peak_swing": "rad", "lowest_swing": "rad", "highest_swing": "rad"},
        **{"peak_torque": "N m", "effort": "(N m)2 s", "chatter": "N m", "itae": "s2"},
    }


class _Running(NamedTuple):
    so_far: RegulationMetrics
    last_torque: Array


def regulation(target: Array, travel: Array, equilibrium: Array) -> Measure:
    """Measure of a move by `travel` (rad) to `target` (rad) for states (alpha, alpha', phi, phi')."""
    zero = jnp.zeros_like(target)
    nothing = RegulationMetrics(zero + jnp.inf, zero, zero, zero, zero + jnp.inf, zero - jnp.inf, zero, zero, zero, zero)

    def update(running: _Running, time: Array, state: State, torque: State, dt: Array) -> _Running:
        now, (tau,) = PlanarState(*state), torque
        last, error = running.so_far, now.alpha - target
        outside = jnp.abs(error) > SETTLING_BAND * jnp.abs(travel)
        variation = jnp.where(time > 0.0, jnp.abs(tau - running.last_torque), 0.0)
        after = RegulationMetrics(
            settling_time=jnp.where(outside, jnp.inf, jnp.minimum(last.settling_time, time)),
            overshoot=jnp.maximum(last.overshoot, error / travel),
            final_error=error,
            peak_swing=jnp.maximum(last.peak_swing, jnp.abs(now.swing - equilibrium)),
            lowest_swing=jnp.minimum(last.lowest_swing, now.swing),
            highest_swing=jnp.maximum(last.highest_swing, now.swing),
            peak_torque=jnp.maximum(last.peak_torque, jnp.abs(tau)),
            effort=last.effort + dt * tau * tau,
            chatter=last.chatter + variation,
            itae=last.itae + dt * time * jnp.abs(error / travel),
        )
        return _Running(after, tau)

    return Measure(_Running(nothing, zero), update, lambda running: running.so_far)


class TrackingMetrics(NamedTuple):
    """How well a reference was followed; every entry a scalar per lane."""

    rms_error: Array  # root mean square distance from the reference, m
    late_error: Array  # largest distance after the time allowed for settling, m
    final_error: Array  # m
    peak_torque: Array  # largest of any torque, N m
    effort: Array  # integral of the sum of the squared torques, (N m)^2 s
    peak_lean: Array  # largest |theta - pi/2|, rad

    UNITS = {  # noqa: RUF012
        **{"rms_error": "m", "late_error": "m", "final_error": "m"},
        **{"peak_torque": "N m", "effort": "(N m)2 s", "peak_lean": "rad"},
    }


def tracking(reference: Callable[[Array], tuple[Real, Real]], settled_after: Array) -> Measure:
    """Measure of following `reference` (time -> x, y in m) for spatial states; errors after `settled_after` (s) are late."""
    zero = jnp.zeros_like(settled_after)

    def update(running: TrackingMetrics, time: Array, state: State, torque: State, dt: Array) -> TrackingMetrics:
        wanted, (x, y, *_) = reference(time), state
        square = (x - wanted[0]) ** 2 + (y - wanted[1]) ** 2
        distance = safe_sqrt(square)
        late = jnp.where(time >= settled_after, distance, 0.0)
        largest = jnp.max(jnp.abs(jnp.stack(torque)), axis=0)
        return TrackingMetrics(
            rms_error=running.rms_error + dt * square,
            late_error=jnp.maximum(running.late_error, late),
            final_error=distance,
            peak_torque=jnp.maximum(running.peak_torque, largest),
            effort=running.effort + dt * sum((u * u for u in torque[1:]), torque[0] * torque[0]),
            peak_lean=jnp.maximum(running.peak_lean, jnp.abs(cosine_of_lean(state))),
        )

    def finish(running: TrackingMetrics) -> TrackingMetrics:
        return running._replace(peak_lean=jnp.arcsin(jnp.minimum(running.peak_lean, 1.0)))

    return Measure(TrackingMetrics(*(zero,) * 6), update, finish)
