"""Identification: fits of physical parameters to data, near a prior."""

from geodrake.identification.comparison import RegularizerComparison, compare_regularizers
from geodrake.identification.constraints import BodyConstraints
from geodrake.identification.fit import FitResult, solve_fit
from geodrake.identification.geodesic_least_squares import (
    GeodesicLeastSquaresResult,
    geodesic_least_squares,
)
from geodrake.identification.identify import REGULARIZERS, IdentificationResult, identify
from geodrake.identification.least_squares import (
    LeastSquaresResult,
    least_squares,
    physical_least_squares,
)
from geodrake.identification.local_minima import LocalMinima
from geodrake.identification.newton import newton_sweep, solve_newton
from geodrake.identification.point_mass import PointMasses
from geodrake.identification.point_mass_fit import PointMassEuclidean, PointMassFit, PointMassKL
from geodrake.identification.problem import FitProblem, LinearConstraints, whitened_factor
from geodrake.identification.program import FitProgram, build_fit
from geodrake.identification.regularizer import QuadraticRegularizer, Regularizer
from geodrake.identification.riemannian import Riemannian
from geodrake.identification.solvers import SOLVERS

__all__ = [
    "REGULARIZERS",
    "SOLVERS",
    "BodyConstraints",
    "FitProblem",
    "FitProgram",
    "FitResult",
    "GeodesicLeastSquaresResult",
    "IdentificationResult",
    "LeastSquaresResult",
    "LinearConstraints",
    "LocalMinima",
    "PointMassEuclidean",
    "PointMassFit",
    "PointMassKL",
    "PointMasses",
    "QuadraticRegularizer",
    "Regularizer",
    "RegularizerComparison",
    "Riemannian",
    "build_fit",
    "compare_regularizers",
    "geodesic_least_squares",
    "identify",
    "least_squares",
    "newton_sweep",
    "physical_least_squares",
    "solve_fit",
    "solve_newton",
    "whitened_factor",
]
