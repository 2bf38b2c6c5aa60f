"""Where the centre of the sphere should be: reference trajectories on the slope.

A reference is a function time (s) -> `Reference` with position (m), velocity (m/s) and acceleration (m/s2), each a pair of
components (x, y) in O, x up-slope. `from_position` makes one of any differentiable function time -> (x, y).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

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

    def velocity(time: Array) -> tuple[Pair, Pair]:
        return jax.jvp(lambda t: tuple(jnp.asarray(x) for x in position(t)), (time,), (jnp.ones_like(time),))

    def reference(time: Array) -> Reference:
        time = jnp.asarray(time, jnp.result_type(float, time))
        (here, rate), (_, rate_rate) = jax.jvp(velocity, (time,), (jnp.ones_like(time),))
        return Reference(here, rate, rate_rate)

    return reference


def line(speed: Real, heading: Real = 0.25 * jnp.pi, start: Pair = (0.0, 0.0)) -> ReferenceFunction:
    """Straight line at constant speed; the default heading is the paper's y = x.

    Args:
        speed: v_f, m/s, along the line. heading: rad, from up-slope towards y. start: x, y, m.
    """
    sine, cosine = sincos(heading)
    velocity = speed * cosine, speed * sine

    def reference(time: Array) -> Reference:
        zero = jnp.zeros_like(time)
        position = start[0] + velocity[0] * time, start[1] + velocity[1] * time
        return Reference(position, (velocity[0] + zero, velocity[1] + zero), (zero, zero))

    return reference


def circle(radius: Real, speed: Real, center: Pair = (0.0, 0.0), start_angle: Real = 0.0) -> ReferenceFunction:
    """Circle at constant speed, counter-clockwise seen from above the slope for a positive speed.

    Args:
        radius: m. speed: m/s. center: x, y, m. start_angle: rad, where the circle starts, seen from its centre.
    """
    rate = speed / radius

    def reference(time: Array) -> Reference:
        sine, cosine = sincos(start_angle + rate * time)
        return Reference(
            (center[0] + radius * cosine, center[1] + radius * sine),
            (-speed * sine, speed * cosine),
            (-rate * speed * cosine, -rate * speed * sine),
        )

    return reference


def figure_eight(half_width: Real, period: Real, center: Pair = (0.0, 0.0)) -> ReferenceFunction:
    """Figure of eight that lies along x: x = w sin(s), y = w sin(s) cos(s), s = 2 pi t / period.

    Args:
        half_width: w, m. period: s. center: the crossing, where it starts, x, y, m.
    """
    rate = 2.0 * jnp.pi / period

    def reference(time: Array) -> Reference:
        sine, cosine = sincos(rate * time)
        sine_double, cosine_double = 2.0 * sine * cosine, cosine * cosine - sine * sine
        return Reference(
            (center[0] + half_width * sine, center[1] + 0.5 * half_width * sine_double),
            (half_width * rate * cosine, half_width * rate * cosine_double),
            (-half_width * rate**2 * sine, -2.0 * half_width * rate**2 * sine_double),
        )

    return reference
