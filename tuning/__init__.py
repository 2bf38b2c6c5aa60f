"""Gains by gradients through rollouts."""

from tuning.objectives import FollowLine, RestToRest, Terms, Weights
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.transforms import FROZEN, POSITIVE, UNIT, Parametrisation, Transform, parametrise
from tuning.tuner import TuningResult, tune, value_and_gradient

__all__ = [
    "FROZEN",
    "FollowLine",
    "POSITIVE",
    "UNIT",
    "Optimiser",
    "Parametrisation",
    "RestToRest",
    "Terms",
    "Transform",
    "TuningResult",
    "Weights",
    "adam",
    "cosine_decay",
    "parametrise",
    "tune",
    "value_and_gradient",
]
