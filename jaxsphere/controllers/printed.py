"""The controllers as the paper prints them, to show what fails: (8) with +z_U, (47) and (48).

(47), (48)  five accelerations cannot be assigned by two torques, so (48) is not what (47) gives.
(53)        Phi is 2 x 5 and has no inverse; its pseudo-inverse, the smallest u, is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from jax import Array

from jaxsphere.controllers.sliding_mode import SlidingModeGains
from jaxsphere.models.spatial import CONVENTIONS as CONVENTIONS
from jaxsphere.models.spatial import Affine, SpatialState, State, frames
from jaxsphere.numerics import Real, sincos
from jaxsphere.numerics.linear_algebra import dot, solve_pair
from jaxsphere.robot import Robot


def sliding_mode_gains(gains: SlidingModeGains) -> SlidingModeGains:
    """Return the gains with which the corrected law of `sliding_mode` is the printed one: z = +z_U tanh(s1 / Phi_z)."""
    return replace(gains, z_u=-gains.z_u)


def assigned_accelerations(radius: Real, paper: SpatialState, demand: tuple[Real, Real]) -> tuple[Array, Array]:
    """Accelerations (theta'', phi'') that give the centre the demanded one, rad/s2: u = Phi^+ (v - Phi' v), Eq. (53).

    Differs from the paper: the pseudo-inverse of Phi stands for its inverse; u is zero on psi, beta1 and beta2.
    """
    (s_psi, c_psi), (s_theta, c_theta) = sincos(paper.precession), sincos(paper.lean)
    psi_rate, theta_rate, spin_rate = paper.precession_rate, paper.lean_rate, paper.spin_rate
    drift_x = psi_rate * radius * s_theta * spin_rate
    drift_y = psi_rate * radius * theta_rate - radius * c_theta * theta_rate * spin_rate
    along_x = c_psi * demand[0] + s_psi * demand[1] - drift_x
    along_y = c_psi * demand[1] - s_psi * demand[0] - drift_y
    return along_x / radius, -along_y / (radius * s_theta)


def ideal_derivative(robot: Robot, state: State, accelerations: State) -> tuple[Real, ...]:
    """Time derivative (C v, u) of 12 paper coordinates whose five accelerations u (rad/s2) are the input, Eq. (48)."""
    return (*frames.coordinate_rates(robot, state), *accelerations)


def pseudo_inverse_torque(terms: Affine, accelerations: Sequence[Real]) -> tuple[Array, Array]:
    """Torques G^+ (u - f2) that come nearest to the five accelerations u (rad/s2), N m, Eq. (47)."""
    missing = [wanted - drift for wanted, drift in zip(accelerations, terms.drift, strict=True)]
    cross_term = dot(terms.drive, terms.tilt)
    normal = (dot(terms.drive, terms.drive), cross_term), (cross_term, dot(terms.tilt, terms.tilt))
    return solve_pair(normal, (dot(terms.drive, missing), dot(terms.tilt, missing)))
