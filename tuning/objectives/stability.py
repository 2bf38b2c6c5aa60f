"""Stability of the motion on s2 = 0 as a smooth number: Routh's array on the characteristic polynomial, no eigenvalues.

Linearised at rest on the target, with e = alpha - alpha_d, delta = phi - phi_0 and kappa = z_U / Phi_z,

    A e'' + D delta'' = G delta,    delta' = -c2 (delta + kappa s1 + k_i integral of s1),    s1 = c1 e + e',

where A = M11 - M12, D = M12 - M22, G = m_p g l cos(phi_0), all at phi_0. Without k_i the cubic is stable exactly when c1 < c2
and c2 kappa D < A (all gains positive).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

import jaxsphere as js
from jaxsphere.models import planar
from jaxsphere.numerics import Real


def characteristic_polynomial(robot: js.Robot, slope: Real, gains: js.SlidingModeGains) -> Array:
    """Coefficients (5,) of the quartic with k_i, highest power first; its last one is zero when k_i is."""
    lumped, swing = planar.lump(robot, slope), js.equilibrium_swing(robot, slope)
    zero = jnp.zeros_like(swing)
    m11, m12, m22 = planar.inertia(lumped, (zero, zero, swing, zero))
    a, d, g = m11 - m12, m12 - m22, lumped.pendulum_weight * jnp.cos(swing)
    kappa = gains.z_u / gains.phi_z
    # (kappa s + k_i) (s + c1), the transfer from e to the swing asked for, times s.
    p2, p1, p0 = kappa, kappa * gains.c1 + gains.k_i, gains.k_i * gains.c1
    c2 = gains.c2
    return jnp.stack([a - d * c2 * p2, c2 * (a - d * p1), c2 * (g * p2 - d * p0), c2 * g * p1, c2 * g * p0])


def routh_column(coefficients: Array) -> Array:
    """First column (n + 1,) of Routh's array of a polynomial (n + 1,), highest power first.

    Every root is in the left half plane exactly when all entries have the sign of the first. A zero entry is replaced by a
    tiny one, as usual.
    """
    size = coefficients.shape[0]
    rows = [list(coefficients[0::2]), list(coefficients[1::2])]
    rows[1] += [jnp.zeros_like(coefficients[0])] * (len(rows[0]) - len(rows[1]))
    for _ in range(size - 2):
        above, pivot = rows[-2], rows[-1]
        first = jnp.where(pivot[0] == 0.0, 1e-12, pivot[0])
        below = [above[i + 1] - above[0] * pivot[i + 1] / first for i in range(len(pivot) - 1)]
        rows.append([*below, jnp.zeros_like(first)])
    return jnp.stack([row[0] for row in rows])


def hurwitz_margins(robot: js.Robot, slope: Real, gains: js.SlidingModeGains) -> Array:
    """Signed distances (5,) from instability, all positive exactly when stable, dimensionless, smooth in the gains.

    Routh's column of the polynomial with its time scale taken out, after the sign of its first coefficient: the cubic of the
    paper's law while k_i = 0 (the last entry is then one), the quartic otherwise.
    """
    quartic = characteristic_polynomial(robot, slope, gains)
    seeking = jnp.asarray(gains.k_i) > 0.0
    within = jnp.where(seeking, quartic, jnp.ones(5))  # any polynomial that can be scaled, where it is not used
    return jnp.where(seeking, _scaled(within), jnp.append(_scaled(quartic[:4]), 1.0))


def hurwitz_margin(robot: js.Robot, slope: Real, gains: js.SlidingModeGains) -> Array:
    """Least of the `hurwitz_margins`: positive when the sliding motion is stable."""
    return jnp.min(hurwitz_margins(robot, slope, gains))


def _scaled(coefficients: Array) -> Array:
    degree = coefficients.shape[0] - 1
    leading = coefficients[0]
    scale = jnp.abs(coefficients[-1] / leading) ** (1.0 / degree)  # 1/s, the geometric mean of the poles
    monic = coefficients / (leading * scale ** jnp.arange(degree + 1))
    # A negative leading coefficient is past the singularity of the law.
    return jnp.concatenate([jnp.sign(leading)[None], routh_column(monic)[1:]])
