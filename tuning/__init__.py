"""Gains by gradients through rollouts."""

from tuning.following import SPATIAL_BOUNDS, FollowLine, LineTerms, LineWeights, friction_angle
from tuning.health import audit_sign, check_gradient, lyapunov_exponent, stiff_and_sloppy
from tuning.objectives import BOUNDS, RestToRest, Terms, Weights
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.pareto import Front, hypervolume, non_dominated, pareto_front
from tuning.result import TuningResult
from tuning.robust import Certificate, Robust, Scenarios, Uncertainty, certify, clopper_pearson, sample
from tuning.second_order import Quadratic, lbfgs, levenberg_marquardt, quadratic
from tuning.stability import hurwitz_margin
from tuning.starts import latin_hypercube
from tuning.terms import Term
from tuning.transforms import FROZEN, POSITIVE, UNIT, Parametrisation, Transform, bounded, parametrise
from tuning.tuner import tune, value_and_gradient

__all__ = [
    "Front",
    "hypervolume",
    "non_dominated",
    "pareto_front",
    "audit_sign",
    "check_gradient",
    "lyapunov_exponent",
    "stiff_and_sloppy",
    "Certificate",
    "Robust",
    "Scenarios",
    "Uncertainty",
    "certify",
    "clopper_pearson",
    "sample",
    "BOUNDS",
    "FROZEN",
    "SPATIAL_BOUNDS",
    "FollowLine",
    "LineTerms",
    "LineWeights",
    "friction_angle",
    "POSITIVE",
    "UNIT",
    "Optimiser",
    "Parametrisation",
    "Quadratic",
    "RestToRest",
    "Term",
    "Terms",
    "Transform",
    "TuningResult",
    "Weights",
    "adam",
    "bounded",
    "cosine_decay",
    "hurwitz_margin",
    "latin_hypercube",
    "lbfgs",
    "levenberg_marquardt",
    "parametrise",
    "quadratic",
    "tune",
    "value_and_gradient",
]
