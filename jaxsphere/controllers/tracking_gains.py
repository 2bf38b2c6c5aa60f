"""Gains of the tracking laws."""

from __future__ import annotations

from dataclasses import dataclass, fields

import jax

from jaxsphere.checks import require_scalar
from jaxsphere.numerics import Real


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class TrackingGains:
    """Gains of tracking; the defaults are for "axis_aligned", Table 4 is TABLE_4.

    k1, k3 (1/s2): on the errors. k2, k4 (1/s): on their rates. With "axis_aligned" k1 and k2 act along the path, k3 and k4
    across it; else k1 and k2 along x, k3 and k4 along y. axis_damping: damping ratio of the coning, "axis_aligned" only.
    k_p (1/s2) and k_d (1/s) of both joints and a_max (m/s2), the largest demand: these two and "pendulum_attitude".
    """

    k1: Real = 16.0
    k2: Real = 9.0
    k3: Real = 3.4
    k4: Real = 3.2
    k_p: Real = 900.0
    k_d: Real = 60.0
    a_max: Real = 1.3
    axis_damping: Real = 0.38


TABLE_4 = TrackingGains(k1=49.0, k2=14.0, k3=49.0, k4=14.0, a_max=1.0)


def check_gains(gains: TrackingGains, name: str = "gains") -> TrackingGains:
    """Check gains on the host and return them. Raises ValueError for a gain that is not one finite positive number."""
    if not isinstance(gains, TrackingGains):
        raise TypeError(f"{name} = {gains!r} are no TrackingGains; type jaxsphere.TrackingGains(k1=49.0, ...)")
    for leaf in fields(gains):
        require_scalar(f"{name}.{leaf.name}", getattr(gains, leaf.name), above=0.0)
    return gains
