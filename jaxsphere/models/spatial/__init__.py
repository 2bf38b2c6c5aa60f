"""The spatial robot on a slope: frames and rolling, dynamics, energies and contact forces."""

from jaxsphere.models.spatial.attitude import (
    IS_VELOCITY,
    GimbalState,
    cosine_of_lean,
    lean_from_upright,
    of_state,
    paper_state,
    paper_states,
)
from jaxsphere.models.spatial.dynamics import (
    Affine,
    Reduced,
    affine,
    derivative_components,
    reduced,
)
from jaxsphere.models.spatial.frames import SpatialState, State
from jaxsphere.models.spatial.lumped import Lumped, check_spatial_robot, lump
from jaxsphere.models.spatial.paper import CONVENTIONS, derivative, mass_matrix

__all__ = [
    "CONVENTIONS",
    "IS_VELOCITY",
    "Affine",
    "GimbalState",
    "Lumped",
    "Reduced",
    "SpatialState",
    "State",
    "affine",
    "check_spatial_robot",
    "cosine_of_lean",
    "derivative",
    "derivative_components",
    "lean_from_upright",
    "lump",
    "mass_matrix",
    "of_state",
    "paper_state",
    "paper_states",
    "reduced",
]
