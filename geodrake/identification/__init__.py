"""Identification: fits of physical parameters to data, near a prior."""

from geodrake.identification.constraints import BodyConstraints
from geodrake.identification.fit import FitResult, solve_fit
from geodrake.identification.identify import REGULARIZERS, IdentificationResult, identify
from geodrake.identification.problem import FitProblem, LinearConstraints, whitened_factor
from geodrake.identification.program import FitProgram, build_fit
from geodrake.identification.regularizer import QuadraticRegularizer, Regularizer
from geodrake.identification.riemannian import Riemannian
from geodrake.identification.riemannian_fit import LocalMinima
from geodrake.identification.solvers import SOLVERS

__all__ = [
    "REGULARIZERS",
    "SOLVERS",
    "BodyConstraints",
    "FitProblem",
    "FitProgram",
    "FitResult",
    "IdentificationResult",
    "LinearConstraints",
    "LocalMinima",
    "QuadraticRegularizer",
    "Regularizer",
    "Riemannian",
    "build_fit",
    "identify",
    "solve_fit",
    "whitened_factor",
]
