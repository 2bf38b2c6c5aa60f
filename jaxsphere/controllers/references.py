"""Where the centre of the sphere should be: reference trajectories on the slope.

A reference is a function time (s) -> `Reference` with position (m), velocity (m/s) and acceleration (m/s2), each a pair of
components (x, y) in O, x up-slope. `from_position` makes one of any differentiable function time -> (x, y). The ones made here
are pytrees, so that their speeds and sizes can be batched, differentiated and changed without compiling anew.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.tree_util import Partial

from jaxsphere.checks import is_concrete
from jaxsphere.numerics import Real, sincos

Pair = tuple[Real, Real]


class Reference(NamedTuple):
    """Desired motion of the centre at one instant, in O."""

    position: Pair  # x_d, y_d, m
    velocity: Pair  # m/s
    acceleration: Pair  # m/s2


ReferenceFunction = Callable[[Array], Reference]


def from_position(position: Callable[[Array], Pair]) -> ReferenceFunction:
    """Complete a twice differentiable `position` (s -> x, y in m) by its velocity and acceleration."""
    return Partial(partial(_differentiated, position))


def _differentiated(position: Callable[[Array], Pair], time: Array) -> Reference:
    def velocity(time: Array) -> tuple[Pair, Pair]:
        return jax.jvp(lambda t: tuple(jnp.asarray(x) for x in position(t)), (time,), (jnp.ones_like(time),))

    time = jnp.asarray(time, jnp.result_type(float, time))
    (here, rate), (_, rate_rate) = jax.jvp(velocity, (time,), (jnp.ones_like(time),))
    return Reference(here, rate, rate_rate)


def line(speed: Real, heading: Real = 0.25 * jnp.pi, start: Pair = (0.0, 0.0)) -> ReferenceFunction:
    """Straight line at constant speed; the default heading is the paper's y = x.

    Args:
        speed: v_f, m/s, along the line.
        heading: rad, from up-slope towards y.
        start: x, y, m.
    """
    return Partial(_line, speed, heading, start)


def _line(speed: Real, heading: Real, start: Pair, time: Array) -> Reference:
    sine, cosine = sincos(heading)
    velocity = speed * cosine, speed * sine
    zero = jnp.zeros_like(time)
    position = start[0] + velocity[0] * time, start[1] + velocity[1] * time
    return Reference(position, (velocity[0] + zero, velocity[1] + zero), (zero, zero))


def circle(radius: Real, speed: Real, center: Pair = (0.0, 0.0), start_angle: Real = 0.0) -> ReferenceFunction:
    """Circle at constant speed, counter-clockwise seen from above the slope for a positive speed.

    Args:
        radius: m.
        speed: m/s.
        center: x, y, m.
        start_angle: rad, where the circle starts, seen from its centre.
    """
    return Partial(_circle, radius, speed, center, start_angle)


def _circle(radius: Real, speed: Real, center: Pair, start_angle: Real, time: Array) -> Reference:
    rate = speed / radius
    sine, cosine = sincos(start_angle + rate * time)
    return Reference(
        (center[0] + radius * cosine, center[1] + radius * sine),
        (-speed * sine, speed * cosine),
        (-rate * speed * cosine, -rate * speed * sine),
    )


def figure_eight(half_width: Real, period: Real, center: Pair = (0.0, 0.0)) -> ReferenceFunction:
    """Figure of eight that lies along x: x = w sin(s), y = w sin(s) cos(s), s = 2 pi t / period.

    Args:
        half_width: w, m.
        period: s.
        center: the crossing, where it starts, x, y, m.
    """
    return Partial(_figure_eight, half_width, period, center)


def _figure_eight(half_width: Real, period: Real, center: Pair, time: Array) -> Reference:
    rate = 2.0 * jnp.pi / period
    sine, cosine = sincos(rate * time)
    sine_double, cosine_double = 2.0 * sine * cosine, cosine * cosine - sine * sine
    return Reference(
        (center[0] + half_width * sine, center[1] + 0.5 * half_width * sine_double),
        (half_width * rate * cosine, half_width * rate * cosine_double),
        (-half_width * rate**2 * sine, -2.0 * half_width * rate**2 * sine_double),
    )


def way_points(times: Array, points: Array) -> ReferenceFunction:
    """Smooth motion through points at given times: a cubic spline that starts and ends at rest and stays at the last point.

    Position and velocity are continuous, and between the ends so is the acceleration.

    Args:
        times: (n,), s, increasing.
        points: (n, 2), m.

    Raises:
        ValueError: fewer than two points, shapes that do not match, or times that do not increase.
    """
    times, points = jnp.asarray(times, float), jnp.asarray(points, float)
    count = times.size
    if times.ndim != 1 or count < 2 or points.shape != (count, 2):
        raise ValueError(f"times and points have shapes {times.shape} and {points.shape}; type n times and n points (x, y)")
    if is_concrete(times) and not np.all(np.diff(np.asarray(times)) > 0.0):
        raise ValueError(f"times = {np.asarray(times).tolist()} s do not increase; type increasing times")
    # The slopes at the points make the second derivative continuous: a tridiagonal system, zero slope at both ends.
    step = jnp.diff(times)
    chord = jnp.diff(points, axis=0) / step[:, None]
    system, right = jnp.eye(count), jnp.zeros((count, 2))
    inner = jnp.arange(1, count - 1)
    system = system.at[inner, inner - 1].set(step[1:]).at[inner, inner + 1].set(step[:-1])
    system = system.at[inner, inner].set(2.0 * (step[:-1] + step[1:]))
    right = right.at[inner].set(3.0 * (step[1:, None] * chord[:-1] + step[:-1, None] * chord[1:]))
    return Partial(_spline, times, points, jnp.linalg.solve(system, right))


def _spline(times: Array, points: Array, slopes: Array, time: Array) -> Reference:
    moving = (time >= times[0]) & (time < times[-1])
    clipped = jnp.clip(time, times[0], times[-1])
    index = jnp.clip(jnp.searchsorted(times, clipped, side="right") - 1, 0, times.size - 2)
    step = times[index + 1] - times[index]
    s = (clipped - times[index]) / step
    rise = points[index + 1] - points[index]
    before, after = step * slopes[index], step * slopes[index + 1]
    quadratic, cubic = 3.0 * rise - 2.0 * before - after, before + after - 2.0 * rise
    position = points[index] + s * (before + s * (quadratic + s * cubic))
    velocity = jnp.where(moving, (before + s * (2.0 * quadratic + 3.0 * s * cubic)) / step, 0.0)
    acceleration = jnp.where(moving, (2.0 * quadratic + 6.0 * s * cubic) / step**2, 0.0)
    return Reference(*((vector[0], vector[1]) for vector in (position, velocity, acceleration)))


def as_reference(reference: Callable[[Array], object]) -> ReferenceFunction:
    """Accept any function time -> (position, velocity, acceleration), each two numbers, as a reference.

    Raises:
        ValueError: it returns something else. Each new function that is no `jax.tree_util.Partial` compiles anew.
    """
    if not callable(reference):
        raise ValueError(f"reference = {reference!r} is no function; type a function of time, e.g. references.line(0.5)")
    function = reference if isinstance(reference, Partial) else Partial(reference)
    shapes = jax.eval_shape(lambda time: jax.tree.map(jnp.asarray, tuple(_pairs(function(time)))), jnp.zeros(()))
    if [leaf.shape for leaf in jax.tree.leaves(shapes)] != [()] * 6:
        raise ValueError("reference must return position, velocity and acceleration, two numbers each; type such a function")
    return Partial(_from_pairs, function)


def _pairs(value: object) -> list[Pair]:
    try:
        position, velocity, acceleration = value  # type: ignore[misc]
        return [(vector[0], vector[1]) for vector in (position, velocity, acceleration) if len(vector) == 2]
    except (TypeError, ValueError, IndexError):
        return []


def _from_pairs(function: Callable[[Array], object], time: Array) -> Reference:
    return Reference(*_pairs(function(time)))


@jax.jit
def _sampled(reference: ReferenceFunction, times: Array) -> Reference:
    return jax.vmap(reference)(times)


def check_reference(reference: ReferenceFunction, duration: float) -> None:
    """Look at a reference at 101 instants on the host. Raises ValueError if it is not finite; traced ones are passed over."""
    times = np.linspace(0.0, duration, 101)
    values = jax.tree.leaves(_sampled(reference, times))
    if is_concrete(values):
        finite = np.isfinite(np.stack(values)).all(axis=0)
        if not finite.all():
            first = times[np.argmin(finite)]
            raise ValueError(f"reference is not finite at {first:g} s; type a function that is finite from 0 to {duration:g} s")
