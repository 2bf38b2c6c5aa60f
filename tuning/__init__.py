"""Gains by gradients through rollouts."""

from tuning.climbing import ClimbTuning, Sensitivity, climb_sensitivity, sensitivity_by_differences, tune_to_climb
from tuning.diagnostics.health import audit_sign, check_gradient, lyapunov_exponent
from tuning.diagnostics.sensitivity import stiff_and_sloppy
from tuning.objectives.following import FollowLine
from tuning.objectives.limits import Limits
from tuning.objectives.line_terms import SPATIAL_BOUNDS, LineTerms, LineWeights, friction_angle
from tuning.objectives.objective import Members, Objective
from tuning.objectives.regulation import BOUNDS, SEEKING_BOUNDS, RestToRest, Terms, Weights
from tuning.objectives.stability import hurwitz_margin
from tuning.objectives.stages import Annealed
from tuning.objectives.terms import Term
from tuning.optimisers.adam import adam, cosine_decay
from tuning.optimisers.lbfgs import lbfgs
from tuning.optimisers.levenberg_marquardt import LeastSquares, Quadratic, levenberg_marquardt, linearise, quadratic
from tuning.optimisers.optimiser import Optimiser
from tuning.result import TuningResult
from tuning.robust.certificate import Certificate, certify, clopper_pearson
from tuning.robust.pareto import Front, hypervolume, non_dominated, pareto_front
from tuning.robust.scenarios import Robust, Scenarios, Uncertainty, sample
from tuning.search import tune
from tuning.starts import latin_hypercube
from tuning.transforms import FROZEN, POSITIVE, UNIT, Parametrisation, Transform, bounded, parametrise, value_and_gradient

__all__ = [
    "tune", "TuningResult",
    "RestToRest", "FollowLine", "Robust", "Annealed", "Objective", "Members", "Term", "Limits",
    "Weights", "Terms", "LineWeights", "LineTerms", "friction_angle", "hurwitz_margin",
    "BOUNDS", "SEEKING_BOUNDS", "SPATIAL_BOUNDS", "FROZEN", "POSITIVE", "UNIT",
    "Parametrisation", "Transform", "bounded", "latin_hypercube", "parametrise", "value_and_gradient",
    "Optimiser", "adam", "cosine_decay", "lbfgs", "levenberg_marquardt", "LeastSquares", "Quadratic", "linearise", "quadratic",
    "Uncertainty", "Scenarios", "sample", "Certificate", "certify", "clopper_pearson",
    "Front", "hypervolume", "non_dominated", "pareto_front",
    "audit_sign", "check_gradient", "lyapunov_exponent", "stiff_and_sloppy",
    "ClimbTuning", "Sensitivity", "climb_sensitivity", "sensitivity_by_differences", "tune_to_climb",
]  # fmt: skip
