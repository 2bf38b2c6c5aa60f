"""The paper's experiments as one call each: a robot, a law and a rollout put together, checked on the host."""

from jaxsphere.tasks.regulation import require_holdable, rest_to_rest
from jaxsphere.tasks.tracking import track, track_line

__all__ = ["require_holdable", "rest_to_rest", "track", "track_line"]
