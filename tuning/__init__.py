"""Gains by gradients through rollouts."""

from tuning.climbing import ClimbTuning, Sensitivity, climb_sensitivity, sensitivity_by_differences, tune_to_climb
from tuning.following import FollowLine
from tuning.health import audit_sign, check_gradient, lyapunov_exponent, stiff_and_sloppy
from tuning.objectives import BOUNDS, RestToRest, Term, Terms, Weights
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.pareto import Front, hypervolume, non_dominated, pareto_front
from tuning.result import TuningResult
from tuning.robust import Certificate, Robust, Scenarios, Uncertainty, certify, clopper_pearson, sample
from tuning.second_order import Quadratic, lbfgs, levenberg_marquardt, quadratic
from tuning.stability import hurwitz_margin
from tuning.starts import latin_hypercube
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
    "FROZEN",
    "FollowLine",
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
