"""Numerical primitives that decide how fast a rollout runs; no physics."""

from jaxsphere.numerics.fences import Real, evaluate_once, safe_sqrt
from jaxsphere.numerics.sincos import sincos

__all__ = ["Real", "evaluate_once", "safe_sqrt", "sincos"]
