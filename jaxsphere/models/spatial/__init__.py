"""The spatial robot on a slope: frames and rolling, dynamics, energies and contact forces."""

from jaxsphere.models.spatial.dynamics import (
    CONVENTIONS,
    INPUT_COLUMNS,
    SINGULAR_LEAN,
    Affine,
    Lumped,
    Reduced,
    accelerations,
    affine,
    check_spatial_robot,
    derivative,
    derivative_components,
    is_singular,
    lump,
    mass_matrix,
    reduced,
    status,
)
from jaxsphere.models.spatial.frames import IS_VELOCITY, STATE_NAMES, STATE_UNITS, State

__all__ = [
    "CONVENTIONS",
    "INPUT_COLUMNS",
    "IS_VELOCITY",
    "STATE_NAMES",
    "STATE_UNITS",
    "Affine",
    "Lumped",
    "Reduced",
    "State",
    "SINGULAR_LEAN",
    "accelerations",
    "affine",
    "check_spatial_robot",
    "derivative",
    "derivative_components",
    "is_singular",
    "lump",
    "mass_matrix",
    "reduced",
    "status",
]
