"""Decoupled sliding-mode control of the planar robot: equations (6)-(16).

    e     alpha - alpha_d           error of the sphere angle, rad
    s1    c1 e + alpha'             sliding surface of the sphere angle, rad/s
    z     -z_U tanh(s1 / Phi_z)     swing asked of the pendulum on top of phi_0, rad
    s2    c2 (phi - phi_0 - z - zeta) + phi'       sliding surface of the swing, rad/s
    u     u_eq + u_sw               motor torque, N m
    zeta  correction of phi_0 that the equilibrium-seeking gain k_i accumulates, rad; 0 in the paper

Differs from the paper:
    (8)   is printed with +z_U. The sphere accelerates up-slope when the pendulum swings up-slope, so with s1 < 0 a positive
          z is needed; the printed sign is positive feedback and the robot rolls away. `printed` keeps it.
    (15)  has sgn(s2); tanh(s2 / epsilon) is used for a smoothing width epsilon > 0, the hard sign for epsilon = 0.
    (7)   trusts phi_0 of a known robot. `k_i` > 0 adds zeta, zeta' = -k_i tanh(s1 / 1 rad/s), which settles on the target
          with a robot that is not the modelled one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_scalar
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import can_hold, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot
from jaxsphere.status import ControllerOutput, Status, code
from jaxsphere.units import quantity

# The correction zeta stops here (rad). Uncertain masses of +-20 % move phi_0 of set A by about 0.1 rad at 10 degrees.
CORRECTION_LIMIT = 0.35


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SlidingModeGains:
    """Gains of the decoupled sliding-mode controller; the defaults are Table 3."""

    c1: Real = quantity(0.5501, "1/s", "slope of the sphere's sliding surface")
    c2: Real = quantity(2.3272, "1/s", "slope of the pendulum's sliding surface")
    z_u: Real = quantity(0.9626, "rad", "largest swing asked for beyond equilibrium, between 0 and 1")
    phi_z: Real = quantity(7.4822, "rad/s", "width over which it is reached")
    eta: Real = quantity(2.7688, "rad/s2", "switching gain")
    k: Real = quantity(0.6769, "1/s", "proportional reaching gain")
    k_i: Real = quantity(0.0, "rad/s", "equilibrium-seeking gain; 0 is the paper's law")


class Signals(NamedTuple):
    """Everything the controller computes on the way to its torque; also the diagnostics of a rollout."""

    s1: Array  # rad/s
    s2: Array  # rad/s
    z: Array  # rad
    equivalent: Array  # u_eq, N m
    switching: Array  # u_sw, N m
    lyapunov: Array  # V = s2^2 / 2, rad2/s2
    decoupling: Array  # b2 - alpha(.) c2 b1, the divisor of (12) and (15), 1/(kg m2)
    correction_rate: Array  # zeta', rad/s


def check_gains(gains: SlidingModeGains, name: str = "gains") -> SlidingModeGains:
    """Check gains on the host and return them. Raises ValueError for a gain that is not admissible."""
    if not isinstance(gains, SlidingModeGains):
        raise TypeError(f"{name} = {gains!r} are no SlidingModeGains; type jaxsphere.SlidingModeGains(c1=0.55, ...)")
    for leaf in fields(SlidingModeGains):
        below = 1.0 if leaf.name == "z_u" else float("inf")
        value = getattr(gains, leaf.name)
        require_scalar(f"{name}.{leaf.name}", value, above=0.0, below=below, or_equal=leaf.name == "k_i")
    return gains


def first_surface(gains: SlidingModeGains, error: Array, rate: Array) -> Array:
    """Sliding surface of the sphere angle, s1 = c1 e + alpha', rad/s, Eq. (6)."""
    return gains.c1 * error + rate


def asked_swing(gains: SlidingModeGains, s1: Array) -> Array:
    """Intermediate variable z (rad) that couples the surfaces: the swing asked for beyond phi_0, Eq. (8).

    Differs from the paper: z = -z_U tanh(s1 / Phi_z).
    """
    return -gains.z_u * jnp.tanh(s1 / gains.phi_z)


def asked_swing_slope(gains: SlidingModeGains, s1: Array) -> Array:
    """Slope dz/ds1 of the swing asked for, s: z' = slope s1', called alpha(s1, Phi_z, z_U) in Eq. (10).

    Differs from the paper: negative, like z.
    """
    saturation = jnp.tanh(s1 / gains.phi_z)
    return -gains.z_u / gains.phi_z * (1.0 - saturation * saturation)


def second_surface(gains: SlidingModeGains, deviation: Array, rate: Array) -> Array:
    """Sliding surface of the swing, s2 = c2 (phi - phi_0 - z - zeta) + phi', rad/s, Eq. (7).

    Args:
        gains: the gains.
        deviation: phi - phi_0 - z - zeta, rad.
        rate: phi', rad/s.
    """
    return gains.c2 * deviation + rate


def reaching_rate(gains: SlidingModeGains, s2: Array, smoothing: Real) -> Array:
    """Rate at which the law drives s2 to zero, eta sgn(s2) + k s2, rad/s2, the numerator of Eq. (15).

    Differs from the paper: sgn is tanh(s2 / smoothing) while `smoothing` (rad/s) is positive.
    """
    soft = jnp.asarray(smoothing) > 0.0
    sign = jnp.where(soft, jnp.tanh(s2 / jnp.where(soft, smoothing, 1.0)), jnp.sign(s2))
    return gains.eta * sign + gains.k * s2


def lyapunov(s2: Array) -> Array:
    """Lyapunov function of the reaching phase, V = s2^2 / 2, rad2/s2, the one of Eq. (14)."""
    return 0.5 * s2 * s2


def lyapunov_rate(gains: SlidingModeGains, s2: Array, smoothing: Real) -> Array:
    """Rate V' = s2 s2' <= -eta |s2| - k s2^2 of V = s2^2 / 2 under the law, rad2/s3, Eq. (16); equal with the hard sign."""
    return -s2 * reaching_rate(gains, s2, smoothing)


def signals(
    lumped: planar.Lumped,
    equilibrium: Array,
    gains: SlidingModeGains,
    state: planar.State,
    correction: Array,
    target: Real,
    smoothing: Real,
) -> Signals:
    """Evaluate the law at one state: surfaces, s2' = drift + decoupling u of (11), and u_eq from s2' = 0, Eq. (12).

    Args:
        lumped: the robot that the controller believes in.
        equilibrium: its phi_0, rad.
        gains: the gains.
        state: alpha, alpha', phi, phi'.
        correction: zeta, rad.
        target: alpha_d, rad.
        smoothing: epsilon, rad/s.
    """
    now = planar.PlanarState(*state)
    form = planar.canonical_form(lumped, state)
    s1 = first_surface(gains, now.alpha - target, now.alpha_rate)
    z = asked_swing(gains, s1)
    z_slope = asked_swing_slope(gains, s1)
    s2 = second_surface(gains, now.swing - equilibrium - z - correction, now.swing_rate)
    correction_rate = _correction_rate(gains, s1, correction)
    s1_drift = gains.c1 * now.alpha_rate + form.f1
    drift = gains.c2 * (now.swing_rate - z_slope * s1_drift - correction_rate) + form.f2
    decoupling = form.b2 - z_slope * gains.c2 * form.b1
    inverse = 1.0 / decoupling
    return Signals(
        s1=s1,
        s2=s2,
        z=z,
        equivalent=-drift * inverse,
        switching=-reaching_rate(gains, s2, smoothing) * inverse,
        lyapunov=lyapunov(s2),
        decoupling=decoupling,
        correction_rate=correction_rate,
    )


def _correction_rate(gains: SlidingModeGains, s1: Array, correction: Array) -> Array:
    rate = -gains.k_i * jnp.tanh(s1)
    outward = (jnp.abs(correction) >= CORRECTION_LIMIT) & (rate * correction > 0.0)
    return jnp.where(outward, 0.0, rate)


def law(
    robot: Robot,
    slope: Real,
    gains: SlidingModeGains,
    target: Real,
    smoothing: Real,
) -> Callable[[Array, planar.State, tuple[Array, ...]], ControllerOutput]:
    """Build the control law (time, state, memory) -> ControllerOutput with torque u = u_eq + u_sw, Eq. (13).

    Its memory is one state, zeta (rad). The status is SINGULAR_DECOUPLING from where the divisor of (12) is not positive:
    it is positive at rest, so it has crossed zero then. On a slope past the bound (4) it is INFEASIBLE_LEAN.

    Args:
        robot: the robot that the controller believes in.
        slope: rad.
        gains: the gains.
        target: alpha_d, rad.
        smoothing: width epsilon of the switching term, rad/s, 0 for the hard sign.
    """
    lumped = planar.lump(robot, slope)
    equilibrium = equilibrium_swing(robot, slope)
    holdable = can_hold(robot, slope)

    def control(time: Array, state: planar.State, memory: tuple[Array, ...]) -> ControllerOutput:
        del time
        (correction,) = memory
        now = signals(lumped, equilibrium, gains, state, correction, target, smoothing)
        status = jnp.where(now.decoupling > 0.0, code(Status.OK), code(Status.SINGULAR_DECOUPLING))
        status = jnp.where(holdable, status, code(Status.INFEASIBLE_LEAN))
        return ControllerOutput((now.equivalent + now.switching,), (now.correction_rate,), status)

    return control


def nonsingularity_margin(robot: Robot, gains: SlidingModeGains) -> Real:
    """How far (12) is from dividing by zero in any state: positive is safe, more is safer, dimensionless.

    The divisor stays positive for every state when (z_U c2 / Phi_z) (m_p r l - M22) < M11 - m_p r l. The margin is one minus
    the ratio of the two sides. It holds for the corrected sign of z, and is necessary too while m_p r l > M22.
    """
    lumped = planar.lump(robot, 0.0)
    steepest = gains.z_u * gains.c2 / gains.phi_z
    return 1.0 - steepest * (lumped.coupling - lumped.pendulum_inertia) / (lumped.rolling_inertia - lumped.coupling)


def sliding_mode_poles(robot: Robot, slope: Real, gains: SlidingModeGains, *, seeking: bool = False) -> Array:
    """Poles (1/s, complex, (3,)) of the motion on s2 = 0, linearised at rest on the target.

    Theorem 1 of the paper shows that s2 reaches zero; that alpha and phi then settle needs these poles in the left half
    plane. With `seeking` the correction zeta is included, and there are four.
    """
    lumped = planar.lump(robot, slope)
    equilibrium = equilibrium_swing(robot, slope)
    gains = gains if seeking else replace(gains, k_i=0.0)

    def on_surface(reduced: Array) -> Array:
        alpha, alpha_rate, swing, correction = reduced
        z = asked_swing(gains, first_surface(gains, alpha, alpha_rate))
        swing_rate = -gains.c2 * (swing - equilibrium - z - correction)
        state = planar.PlanarState(alpha, alpha_rate, swing, swing_rate)
        now = signals(lumped, equilibrium, gains, state, correction, 0.0, 1.0)
        rates = planar.derivative(lumped, state, (now.equivalent,))
        return jnp.stack([alpha_rate, rates.alpha_rate, swing_rate, now.correction_rate])

    rest = jnp.zeros(4).at[2].set(equilibrium)
    size = 4 if seeking else 3
    return jnp.linalg.eigvals(jax.jacfwd(on_surface)(rest)[:size, :size])
