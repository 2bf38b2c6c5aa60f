"""Gains of the tracking controller, k1..k4 of (58) and those beyond the paper."""

from __future__ import annotations

from dataclasses import dataclass, fields

import jax

from jaxsphere.checks import require_scalar
from jaxsphere.numerics import Real
from jaxsphere.units import quantity


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class TrackingGains:
    """Gains of tracking; the defaults are for "axis_aligned", Table 4 is TABLE_4.

    With "axis_aligned" k1 and k2 act along the path, k3 and k4 across it; else k1 and k2 along x, k3 and k4 along y. k_p, k_d
    and a_max are used by it and by "pendulum_attitude".
    """

    k1: Real = quantity(16.0, "1/s2", "on the error along the path, or of x")
    k2: Real = quantity(9.0, "1/s", "on its rate")
    k3: Real = quantity(3.4, "1/s2", "on the error across the path, or of y")
    k4: Real = quantity(3.2, "1/s", "on its rate")
    k_p: Real = quantity(900.0, "1/s2", "of both joints")
    k_d: Real = quantity(60.0, "1/s", "of both joints")
    a_max: Real = quantity(1.3, "m/s2", "largest acceleration asked for")
    axis_damping: Real = quantity(0.38, "", "damping ratio of the spin axis's coning")


TABLE_4 = TrackingGains(k1=49.0, k2=14.0, k3=49.0, k4=14.0, a_max=1.0)


def check_gains(gains: TrackingGains, name: str = "gains") -> TrackingGains:
    """Check gains on the host and return them. Raises ValueError for a gain that is not one finite positive number."""
    if not isinstance(gains, TrackingGains):
        raise TypeError(f"{name} = {gains!r} are no TrackingGains; type jaxsphere.TrackingGains(k1=49.0, ...)")
    for leaf in fields(gains):
        require_scalar(f"{name}.{leaf.name}", getattr(gains, leaf.name), above=0.0)
    return gains
