"""Settings and results of model identification, as frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.arguments import integer, number, one_of
from geodrake.boundary.showing import Short, Shown
from geodrake.errors import ArgumentError
from geodrake.identification.identify import REGULARIZERS, IdentificationResult
from geodrake.identification.logs.log_fits import GammaScore
from geodrake.identification.logs.model_errors import Comparison, ErrorTable
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True, eq=False)
class BodyChange(Short):
    """A body before and after a fit."""

    name: str
    mass: tuple[float, float]  # masses before and after, kg
    com: Array  # (2, 3) centres of mass before and after in the body's frame, m
    mass_deviation: float  # standard deviation of the mass, kg
    com_deviation: Array  # (3,) standard deviations of the centre of mass, m
    at_boundary: bool  # whether the body is at the boundary of physical consistency
    # Geometric distance from before to after, in the metric before: 0.1 is about 10 % of mass or
    # lengths.
    distance: float


@dataclass(frozen=True, eq=False)
class Alternative(Short):
    """Result of another regularizer at the same training residual."""

    regularizer: str
    gamma: float  # weight at which it has that residual
    residual: float  # weighted squared residual of the training data
    errors: ErrorTable  # held out
    phi: Array  # (nb, 10) inertial parameters
    at_boundary: tuple[str, ...]  # names of the bodies at the boundary of physical consistency


@dataclass(frozen=True, eq=False)
class ModelIdentification(Shown):
    """An identified model."""

    model: RobotModel  # the fitted model, with its information matrix
    prior: RobotModel  # the model before the fit
    regularizer: str  # name of the regularizer
    gamma: float  # weight of the regularizer against effective samples
    sweep: tuple[GammaScore, ...]  # candidates for γ; empty if γ or a residual bound was given
    before: ErrorTable  # errors of the prior model
    after: ErrorTable  # held-out errors of the fit
    bodies: tuple[BodyChange, ...]  # changes of all bodies, followed by payloads
    result: IdentificationResult  # the solution: residual, divergence, solver
    comparison: Comparison  # held-out predictions, for reports
    alternatives: tuple[Alternative, ...]  # all regularizers at the same residual, if requested
    notes: tuple[str, ...]  # on the preparation of the logs, and on the fit

    @property
    def at_boundary(self) -> tuple[str, ...]:
        """Names of the bodies at the boundary of physical consistency."""
        return tuple(body.name for body in self.bodies if body.at_boundary)


_LARGEST_RATIO = 1e6  # largest meaningful ratio of residuals


@dataclass(frozen=True, kw_only=True)
class IdentificationSettings(Short):
    """Settings of an identification; without gamma and residual_ratio, γ is chosen by a sweep."""

    regularizer: str = "entropic"  # a name in `geodrake.identification.REGULARIZERS`
    gamma: float | None = None  # weight γ > 0 of the regularizer against effective samples
    # Allowed RMS of the training residual, relative to the least of any parameters; above 1, at
    # most a million. Excludes gamma.
    residual_ratio: float | None = None
    total_mass: float | None = None  # of all moving bodies and payloads, kg, if known
    compare: bool = False  # whether to also solve with all regularizers at the same residual
    # Bandwidth of the filter, Hz; by default that of the model's fit to the same logs, or chosen
    # from the data.
    bandwidth: float | None = None
    blocks: int | None = None  # number of blocks of every log for validation
    # Whether joints that hardly move in any log are held; see
    # `geodrake.model.logged_joints.holding_resting`. With a total mass, which includes all bodies,
    # none is held.
    hold_resting: bool = True

    def __post_init__(self) -> None:
        """Raise for invalid settings."""
        one_of(self.regularizer, "regularizer", REGULARIZERS)
        for name, words in (("gamma", "gamma"), ("total_mass", "The total mass, in kg,")):
            if (given := getattr(self, name)) is not None:
                number(given, words, lower=0.0, strict=True)
        if self.bandwidth is not None:
            number(self.bandwidth, "bandwidth")
        if self.blocks is not None:
            integer(self.blocks, "blocks")
        if self.gamma is not None and self.residual_ratio is not None:
            raise ArgumentError(
                "Both γ and a residual bound are given.", advice="Give one of them."
            )
        ratio = self.residual_ratio
        if ratio is not None and not 1.0 < number(ratio, "The residual bound") <= _LARGEST_RATIO:
            raise ArgumentError(
                f"The residual bound {ratio:g} is relative to the smallest RMS residual of "
                f"any parameters, so it must be above 1, and at most {_LARGEST_RATIO:g}.",
                advice="Use 1.01 to allow one percent more.",
            )
