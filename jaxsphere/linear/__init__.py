"""Linear tools: a closed loop about its steady motion, its poles, what no torque reaches, and its margin."""

from jaxsphere.linear.linearise import Linearisation, linearise, poles, return_difference, unreachable_poles

__all__ = ["Linearisation", "linearise", "poles", "return_difference", "unreachable_poles"]
