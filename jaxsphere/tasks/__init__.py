"""The paper's experiments as one call each: a robot, a law and a rollout put together, checked on the host."""

from jaxsphere.tasks.climbing import climb_outcome, outcome_run, slope_search, steepest_slope
from jaxsphere.tasks.numerics import Numerics
from jaxsphere.tasks.planar import PlanarTask, require_holdable, rest_to_rest
from jaxsphere.tasks.release import static_bound_by_release
from jaxsphere.tasks.simulate import closed_loop_of, simulate
from jaxsphere.tasks.spatial import SpatialTask, track, track_line

__all__ = [
    "Numerics",
    "PlanarTask",
    "SpatialTask",
    "closed_loop_of",
    "simulate",
    "climb_outcome",
    "outcome_run",
    "require_holdable",
    "rest_to_rest",
    "slope_search",
    "static_bound_by_release",
    "steepest_slope",
    "track",
    "track_line",
]
