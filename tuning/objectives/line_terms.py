"""Terms of following lines, their weights, and the angle of the friction that rolling needs."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxsphere.models.spatial import contact
from jaxsphere.numerics import Real

# Ranges for Latin-hypercube starts of a robot like set A with a motor of 5 N m.
SPATIAL_BOUNDS = {
    "k1": (4.0, 100.0),
    "k2": (4.0, 30.0),
    "k3": (1.0, 12.0),
    "k4": (1.5, 10.0),
    "axis_damping": (0.1, 0.8),
    "k_p": (300.0, 2000.0),
    "k_d": (25.0, 120.0),
    "a_max": (0.5, 2.0),
}


class LineWeights(NamedTuple):
    """Weights of the terms of `FollowLine`; zero switches a term off."""

    distance: Real = 1.0
    late: Real = 10.0
    lean: Real = 6.0
    friction: Real = 0.1
    effort: Real = 0.0
    lost: Real = 1e4
    prior: Real = 0.1


class LineTerms(NamedTuple):
    """The unweighted terms, means over the lanes; every entry a scalar (as residuals: vectors whose squares sum to it)."""

    distance: Array  # cm^2: mean square of the distance from the reference
    late: Array  # cm^2: the same from settled_after on
    lean: Array  # mean of the lean's excess over lean_limit in degrees, squared up to 1, linear beyond
    friction: Array  # mean of the excess of the friction angle needed over friction_limit's in degrees, likewise
    effort: Array  # (N m)^2: mean of the sum of the squared torques
    lost: Array  # share of the duration after an early end
    prior: Array  # sum of the squared logarithms of the gains over those of `typical`; regularises


def friction_angle(forces: contact.Contact) -> Float[Array, ...]:
    """Return the angle (rad) between the force of the slope on the sphere and the normal.

    It is the arctangent of the friction coefficient. Past a quarter turn the sphere would leave the slope; there the
    coefficient is infinite, the angle stays smooth.
    """
    along, across = forces.friction
    square = along * along + across * across
    slipping = square > 0.0
    return jnp.where(slipping, jnp.arctan2(jnp.sqrt(jnp.where(slipping, square, 1.0)), forces.normal), 0.0)
