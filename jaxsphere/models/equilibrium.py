"""Standing on the slope: equations (2)-(4), the two equilibria and how stable they are.

On a slope gamma the pendulum must hold the weight of the whole robot: (m + m_i + m_p) r sin(gamma) = m_p l sin(phi_0). Below
the bound (4) there are two such swings, phi_0 and pi - phi_0; at the bound they merge and vanish in a saddle-node
bifurcation, and beyond it the pendulum whirls. (The paper calls it a bifurcation of stable nodes.)
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.models import planar
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, total_mass


class Equilibria(NamedTuple):
    """Both equilibrium swings (rad) and whether they exist; where they do not, both are at the merging point."""

    lower: Array  # phi_0, pendulum below the horizontal
    upper: Array  # pi - phi_0 (or -pi - phi_0 on a falling slope)
    exists: Array  # bool


def swing_sine(robot: Robot, slope: Real) -> Real:
    """Sine of the equilibrium swing that balances the weight of the robot, Eq. (2); above 1 no swing does."""
    lumped = planar.lump(robot, slope)
    return lumped.slope_torque / lumped.pendulum_weight


def equilibrium_swing(robot: Robot, slope: Real) -> Array:
    """Equilibrium swing phi_0 in rad, from the vertical, Eq. (3).

    Past the bound (4) no equilibrium exists; the result is then the nearest lean, +-pi/2, with a zero gradient, and never
    NaN. `can_hold` tells the two cases apart.
    """
    sine = swing_sine(robot, slope)
    exists = jnp.abs(sine) < 1.0
    return jnp.where(exists, jnp.arcsin(jnp.where(exists, sine, 0.0)), 0.5 * jnp.pi * jnp.sign(sine))


def climbing_bound(robot: Robot) -> Array:
    """Steepest slope, rad, that the pendulum can hold statically, Eq. (4); pi/2 where every slope can be held."""
    sine = robot.pendulum_mass * robot.pendulum_length / (total_mass(robot) * robot.shell_radius)
    bounded = sine < 1.0
    return jnp.where(bounded, jnp.arcsin(jnp.where(bounded, sine, 0.0)), 0.5 * jnp.pi)


def can_hold(robot: Robot, slope: Real) -> Array:
    """Tell (bool) whether the slope (rad) is within the bound (4)."""
    return jnp.abs(swing_sine(robot, slope)) <= 1.0


def highest_step(robot: Robot, slope: Real = 0.0) -> Array:
    """Height (m, normal to the slope) of the highest step that the robot can roll onto quasi-statically; 0 past the bound (4).

    The view of Halme, Schoenberg and Wang (1996), from moments. The radius to the edge of a step of height h is at an angle
    beta = slope + arccos(1 - h / r) from the vertical, so that the centre of the sphere is r sin(beta) behind the edge. The
    shell lifts off the ground when the pendulum, swung to the horizontal, outweighs the rest:

        m_p g (l - r sin beta) >= (m + m_i) g r sin beta,    that is    sin(beta) <= m_p l / ((m + m_i + m_p) r),

    so that the bound (4) limits beta, whatever the masses: h = r (1 - cos(bound - slope)). A slope is a step of no height, with
    the contact point for its edge. Lifting off is the hardest moment: beta falls while the robot rolls over the edge. Nothing
    slips here, and nothing is gained from speed.

    Args:
        robot: the robot.
        slope: of the ground before and after the step, rad, positive up-slope.
    """
    left = jnp.maximum(climbing_bound(robot) - slope, 0.0)
    return robot.shell_radius * (1.0 - jnp.cos(left))


def equilibria(robot: Robot, slope: Real) -> Equilibria:
    """Return both equilibrium swings of the robot held on the slope; they merge at the bound (4), a saddle-node."""
    lower = equilibrium_swing(robot, slope)
    side = jnp.where(lower < 0.0, -1.0, 1.0)
    return Equilibria(lower, side * jnp.pi - lower, can_hold(robot, slope))


def zero_dynamics_poles(robot: Robot, slope: Real, swing: Real | None = None) -> Array:
    """Poles (1/s, complex, (2,)) of the swing when the torque holds the sphere angle fixed.

    With alpha'' = 0 the motion left is (M12 - M22) phi'' = N2 - N1. A pole in the right half plane means that the sphere
    angle is a non-minimum-phase output: no controller that prescribes alpha exactly is internally stable.

    Args:
        robot: the robot.
        slope: rad.
        swing: equilibrium to linearise at, rad; phi_0 of (3) by default.
    """
    lumped = planar.lump(robot, slope)
    if swing is None:
        swing = equilibrium_swing(robot, slope)

    def swing_acceleration(angle: Array, rate: Array) -> Array:
        state = (jnp.zeros_like(angle), jnp.zeros_like(angle), angle, rate)
        _, m12, m22 = planar.inertia(lumped, state)
        n1, n2 = planar.bias(lumped, state)
        return (n2 - n1) / (m12 - m22)

    stiffness, damping = jax.jacfwd(swing_acceleration, (0, 1))(jnp.asarray(swing), jnp.zeros_like(swing))
    root = jnp.sqrt((0.25 * damping**2 + stiffness).astype(jnp.result_type(stiffness, jnp.complex64)))
    return jnp.stack([0.5 * damping - root, 0.5 * damping + root])
