"""Gains by gradients through rollouts."""

from tuning.certificate import Certificate, certify, clopper_pearson
from tuning.climbing import ClimbTuning, Sensitivity, climb_sensitivity, sensitivity_by_differences, tune_to_climb
from tuning.following import SPATIAL_BOUNDS, FollowLine, LineTerms, LineWeights, friction_angle
from tuning.health import audit_sign, check_gradient, lyapunov_exponent, stiff_and_sloppy
from tuning.limits import Limits
from tuning.objectives import BOUNDS, SEEKING_BOUNDS, RestToRest, Terms, Weights
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.pareto import Front, hypervolume, non_dominated, pareto_front
from tuning.result import TuningResult
from tuning.robust import Robust, Scenarios, Uncertainty, sample
from tuning.second_order import LeastSquares, Quadratic, lbfgs, levenberg_marquardt, linearise, quadratic
from tuning.stability import hurwitz_margin
from tuning.stages import Annealed
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
    "ClimbTuning",
    "Sensitivity",
    "climb_sensitivity",
    "sensitivity_by_differences",
    "tune_to_climb",
    "Robust",
    "Scenarios",
    "Uncertainty",
    "certify",
    "clopper_pearson",
    "sample",
    "BOUNDS",
    "SEEKING_BOUNDS",
    "FROZEN",
    "SPATIAL_BOUNDS",
    "FollowLine",
    "LineTerms",
    "LineWeights",
    "friction_angle",
    "POSITIVE",
    "UNIT",
    "LeastSquares",
    "Optimiser",
    "Parametrisation",
    "Quadratic",
    "RestToRest",
    "Term",
    "Terms",
    "Transform",
    "TuningResult",
    "Weights",
    "Annealed",
    "Limits",
    "adam",
    "bounded",
    "cosine_decay",
    "hurwitz_margin",
    "latin_hypercube",
    "lbfgs",
    "levenberg_marquardt",
    "linearise",
    "parametrise",
    "quadratic",
    "tune",
    "value_and_gradient",
]
