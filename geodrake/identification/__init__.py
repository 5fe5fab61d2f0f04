"""Identification: fits of physical parameters to data, close to a prior."""

from geodrake.identification.comparison import RegularizerComparison, compare_regularizers
from geodrake.identification.conic_fit import solve_fit
from geodrake.identification.geodesic_least_squares import geodesic_least_squares
from geodrake.identification.identify import REGULARIZERS, IdentificationResult, identify
from geodrake.identification.least_squares import least_squares
from geodrake.identification.models import (
    IdentificationSettings,
    identify_model,
)
from geodrake.identification.point_mass import PointMasses, PointMassEuclidean, PointMassKL
from geodrake.identification.problem import BodyConstraints, FitProblem
from geodrake.identification.regularizer import Regularizer
from geodrake.identification.riemannian import Riemannian

__all__ = [
    "REGULARIZERS",
    "BodyConstraints",
    "FitProblem",
    "IdentificationResult",
    "IdentificationSettings",
    "PointMassEuclidean",
    "PointMassKL",
    "PointMasses",
    "Regularizer",
    "RegularizerComparison",
    "Riemannian",
    "compare_regularizers",
    "geodesic_least_squares",
    "identify",
    "identify_model",
    "least_squares",
    "solve_fit",
]
