"""The sliding-mode law as the paper prints it, to show what fails: (8) with +z_U."""

from __future__ import annotations

from dataclasses import replace

from jaxsphere.controllers.sliding_mode import SlidingModeGains

CONVENTIONS = ("corrected", "printed")


def sliding_mode_gains(gains: SlidingModeGains) -> SlidingModeGains:
    """Return the gains with which the corrected law of `sliding_mode` is the printed one: z = +z_U tanh(s1 / Phi_z)."""
    return replace(gains, z_u=-gains.z_u)
