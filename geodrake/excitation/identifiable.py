"""Identifiable directions of motions, and reduced identification, [Lee2019] §4.5.1.

The normalized covariance of an estimate has eigenvalues λ₁ ≤ … ≤ λ_n: variances of relative changes
along principal directions, independent of frames and units. Directions with a variance above a
threshold keep their prior values; the others are estimated by least squares, from one singular
value decomposition of the whitened regressor A K (`geodrake.excitation.objective`):

    A K = U S Wᵀ,   λᵢ = 1/sᵢ²,   φ* = φ⁰ + K W₋ S₋⁻¹ U₋ᵀ (b − A φ⁰)

Its base parameters are those of Eq. (4.5.60); among all φ with these, φ* is closest to φ⁰.

    found = log_identifiability(load_model("arm.urdf"), ["log.csv"])
    print(f"{found.count} of {found.possible} directions are identifiable")

Logs are filtered and reduced as for every fit, so samples have independent noise. The noise is the
held-out residual of the refitted model, which includes all unmodelled error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import (
    function,
    instance,
    instances,
    integer,
    number,
    real_array,
)
from geodrake.boundary.showing import Short, Shown
from geodrake.effects import Effect
from geodrake.errors import ArgumentError
from geodrake.excitation.objective import normalizing_map
from geodrake.excitation.target import Target, make_target
from geodrake.identification.logs.case import Case, prepare_case
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.hypothesis import first_hypothesis, reweight
from geodrake.identification.logs.log_fits import log_unknowns
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

_SAMPLES = 2000  # whose regressor is in memory at once
_ITERATIONS = 6  # refits until the weights of the joints converge
_NEGLIGIBLE = 1e-9  # share of a direction, or parameters of a block, attributed to rounding
_HALF = 0.5  # share of a block from which it counts as identifiable


@dataclass(frozen=True, eq=False)
class IdentifiableParameters(Short):
    """Combinations of p parameters that are identifiable within a threshold.

    Attributes:
        variances: (n_B,) λ, ascending; infinite where the data carry no information. 10⁻² means a
            relative deviation of about a tenth.
        directions: (p, n_B) columns K W: the parameter changes, of unit length in the metric G₀,
            that have these variances.
        kept: Number r of directions with a variance of at most the threshold.
        threshold: ε_λ; λ_r if r was given.
    """

    variances: Array
    directions: Array
    kept: int
    threshold: float
    target: Target

    @property
    def base_directions(self) -> Array:
        """(n_B, n_B) columns v of [Lee2019] step a.3, for `target.base`."""
        return np.asarray(self.target.base.matrix @ self.directions)

    @property
    def shares(self) -> Array:
        """(blocks, n_B) share of every body, payload and further parameter in each direction.

        The shares of a direction sum to one and do not depend on frames and units.
        """
        whitened = np.linalg.solve(self.target.metric_root, self.directions) ** 2
        inertial = len(self.target.columns)
        bodies = whitened[:inertial].reshape(-1, PARAMETERS_PER_BODY, whitened.shape[1]).sum(1)
        return np.concatenate([bodies, whitened[inertial:]])

    @property
    def counts(self) -> Array:
        """(blocks,) number of identifiable parameters of every body, payload and effect.

        At most 10, or 1 for an effect's parameter. They sum to `kept` and need not be integers.
        """
        return np.asarray(self.shares[:, : self.kept].sum(axis=1))


@dataclass(frozen=True, eq=False)
class ReducedIdentification(Short):
    """Parameters estimated along the identifiable directions.

    Attributes:
        parameters: (p,) φ*: bodies, payloads, further effects, in the target's order.
        base_parameters: (n_B,) φ_B* = B φ*.
    """

    parameters: Array
    base_parameters: Array
    identifiable: IdentifiableParameters

    @property
    def phi(self) -> Array:
        """(blocks, 10) inertial parameters, bodies and then payloads; they may be unphysical."""
        inertial = len(self.identifiable.target.columns)
        return self.parameters[:inertial].reshape(-1, PARAMETERS_PER_BODY)


def measurement_factor(
    target: Target, motions: Motion | Sequence[Motion], measured: Sequence[ArrayLike] | None = None
) -> Array:
    """Return the information of motions and measurements as one triangular matrix.

    Args:
        motions: Motions, (N, ·) each.
        measured: For each motion, efforts (N, m) in N·m or N, or base wrenches in N·m and N, minus
            those of bodies and effects that the target takes as known. Omit them to analyse
            identifiability only.

    Returns:
        (p, p) R with RᵀR = AᵀA of the whitened regressor; with measurements (p + 1, p + 1), of
        [A b].
    """
    noise = instance(target, "target", Target).noise[:, None]
    inputs = (motions,) if isinstance(motions, Motion) else motions
    inputs = instances(inputs, "motions", Motion)
    outputs: Sequence[object] = [None] * len(inputs)
    if measured is not None:
        outputs = instances(measured, "measured", object)
    if len(outputs) != len(inputs) or not inputs:
        raise ArgumentError(
            f"There are {len(inputs)} motions, but measurements of {len(outputs)}.",
            advice="Pass one array of measurements for each motion.",
        )

    def whitened() -> Iterator[Array]:
        for motion, output in zip(inputs, outputs, strict=True):
            shape = len(motion), len(noise)
            b = np.zeros((*shape, 0))
            if output is not None:
                b = real_array(output, "measured", shape)[:, :, None]
            for start in range(0, len(motion), _SAMPLES):
                part = slice(start, start + _SAMPLES)
                rows = np.concatenate([target.measure(motion[part]).regressor, b[part]], axis=2)
                yield (rows / noise).reshape(-1, rows.shape[2])

    return triangular_factor(whitened())


def identifiable_parameters(
    target: Target, factor: ArrayLike, *, threshold: float = 1e-2, kept: int | None = None
) -> IdentifiableParameters:
    """Return the directions that data identify, [Lee2019] steps a.1 to a.4.

    Args:
        factor: `measurement_factor` of the data, with or without measurements.
        threshold: ε_λ, largest variance of an identifiable direction; 10⁻² is a deviation of a
            tenth.
        kept: Number of directions instead of the threshold, as in step b.4.
    """
    array, size = real_array(factor, "factor"), instance(target, "target", Target).size
    if array.shape not in ((size, size), (size + 1, size + 1)):
        raise ArgumentError(
            f"The factor has shape {array.shape}, but the target has {size} parameters.",
            advice="Compute it with `measurement_factor` of the same target.",
        )
    return _decompose(target, array[:, :size], threshold, kept)[0]


def reduced_identification(
    target: Target, factor: ArrayLike, *, threshold: float = 1e-2, kept: int | None = None
) -> ReducedIdentification:
    """Return the least-squares estimate along identifiable directions, the prior elsewhere (a.5).

    Args:
        factor: (p + 1, p + 1) `measurement_factor` with measurements.
        threshold: ε_λ; infinite for least squares of all base parameters.
        kept: Number of directions instead of the threshold.
    """
    size = instance(target, "target", Target).size
    augmented = real_array(factor, "factor", (size + 1, size + 1))
    found, U, singular = _decompose(target, augmented[:, :size], threshold, kept)
    r, rank = found.kept, _rank(singular)
    if r > rank:
        raise ArgumentError(
            f"{r} directions cannot be estimated: the data identify only {rank}.",
            advice="Keep fewer, lower the threshold, or move more joints.",
        )
    residual = augmented[:, size] - augmented[:, :size] @ target.prior
    step = found.directions[:, :r] @ ((U[:, :r].T @ residual) / singular[:r])
    parameters = target.prior + step
    return ReducedIdentification(parameters, target.base.values(parameters), found)


def _decompose(
    target: Target, A: Array, threshold: float, kept: int | None
) -> tuple[IdentifiableParameters, Array, Array]:
    """Return the identifiable parameters, and U and S of A K, most certain direction first."""
    number(threshold, "threshold", lower=0.0, finite=False)
    if kept is not None:
        integer(kept, "kept")
    K = normalizing_map("geometric", target.base.matrix, target.prior, target.metric_root)
    U, singular, Wt = np.linalg.svd(A @ K, full_matrices=False)
    with np.errstate(divide="ignore", over="ignore"):
        variances = singular**-2.0
    count = int(np.count_nonzero(variances <= threshold)) if kept is None else kept
    if np.isinf(threshold) and kept is None:
        count = _rank(singular)
    if not 1 <= count <= len(variances) or not singular[0] > 0:
        raise ArgumentError(
            f"No direction is within the threshold of {threshold:g}: the most certain one "
            f"has variance {variances[0]:.3g}."
            if kept is None
            else f"{kept} directions cannot be kept; there are {len(variances)}.",
            advice="Raise the threshold, move more, or measure more precisely.",
            variances=variances,
        )
    limit = threshold if kept is None else float(variances[count - 1])
    found = IdentifiableParameters(variances, K @ Wt.T, count, limit, target)
    return found, U, singular


def _rank(singular: Array) -> int:
    """Return the number of singular values, in descending order, above rounding."""
    least = np.finfo(float).eps * singular.max(initial=0.0) * len(singular)
    return int(np.count_nonzero(singular > least))


@dataclass(frozen=True)
class IdentifiableBlock:
    """The identifiable part of a body, or of a parameter of an effect."""

    name: str  # body, effect, or "<parameter> of <effect>" if the effect has several parameters
    where: tuple[str, ...]  # joints or body of the effect; () for a body
    # Identifiable parameters, 0 to 10 for a body and 0 to 1 for an effect, not always an integer.
    count: float
    possible: float  # identifiable parameters with ideal motions
    # For an effect, the value in the model or of a fit to the logs, and the standard deviation of
    # an estimate from these logs alone, infinite where they do not determine it.
    value: float = np.nan
    deviation: float = np.nan
    effect: str = ""
    parameter: str = ""

    @property
    def label(self) -> str:
        """The name, and the place of an effect."""
        place = "/".join(self.where) or "the robot"
        return f"{self.name} of {place}" if self.effect else self.name

    @property
    def share(self) -> float:
        """The ratio of `count` and `possible`; zero if nothing is possible."""
        return self.count / self.possible if self.possible > _NEGLIGIBLE else 0.0

    @property
    def is_identifiable(self) -> bool:
        """Whether at least half of it is identifiable."""
        return self.share >= _HALF


@dataclass(frozen=True)
class ParameterCombination:
    """A base parameter and its uncertainty."""

    words: str  # the combination, such as "Izz of column + Iyy of arm"
    value: float  # in the model, SI units
    # Deviation of an estimate from the logs alone; infinite where they do not determine it.
    deviation: float
    # The deviation relative to a geometric scale, independent of frames and units.
    relative: float


@dataclass(frozen=True, eq=False)
class LogIdentifiability(Shown):
    """Identifiability of a model's parameters from logs."""

    model: RobotModel
    identifiable: IdentifiableParameters
    bodies: tuple[IdentifiableBlock, ...]
    effects: tuple[IdentifiableBlock, ...]
    combinations: tuple[ParameterCombination, ...]
    noise: Array  # (nv,) standard deviation of a filtered sample, N·m or N
    floor: Array  # (nv,) estimated sensor noise after filtering, N·m or N
    floor_variances: Array  # (n_B,) variances with sensor noise only, ascending
    samples: NDArray[np.int_]  # (nv,) filtered samples of each joint
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of identifiable directions."""
        return self.identifiable.kept

    @property
    def possible(self) -> int:
        """Number of directions that are identifiable with ideal motions."""
        return len(self.identifiable.variances)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the rows of `identifiable.shares`: bodies, payloads, parameters of effects."""
        carriers = (f.effect.where[0] for f in self.identifiable.target.payloads)
        return (
            *(body.name for body in self.bodies),
            *(f"payload of {name}" for name in carriers),
            *(entry.label for entry in self.effects),
        )

    @property
    def count_at_floor(self) -> int:
        """Number of identifiable directions if only sensor noise remained."""
        return int(np.count_nonzero(self.floor_variances <= self.identifiable.threshold))

    @property
    def unidentifiable(self) -> tuple[ParameterCombination, ...]:
        """Base parameters with a relative deviation above the threshold, worst first."""
        limit = np.sqrt(self.identifiable.threshold)
        uncertain = [c for c in self.combinations if not c.relative <= limit]
        return tuple(sorted(uncertain, key=lambda c: -c.relative))


def log_identifiability(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    effects: Sequence[Effect] = (),
    threshold: float = 1e-2,
    noise: ArrayLike | None = None,
    bandwidth: float | None = None,
    blocks: int | None = None,
    progress: Callable[[str], None] = lambda words: None,
) -> LogIdentifiability:
    """Return the identifiability of a model's inertias and effects from logs.

    Args:
        threshold: ε_λ, largest variance of an identifiable direction; 10⁻² is a deviation of a
            tenth.
        noise: Standard deviation of a filtered effort, one or one per joint, N·m or N; by default
            the held-out residual of the refitted model, scaled by effective sample size.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Number of blocks into which every log is split for validation.
    """
    function(progress, "progress")
    extended = with_effects(instance(model, "model", RobotModel).with_volume, effects)
    case = prepare_case(extended, logs, candidates=False, bandwidth=bandwidth, blocks=blocks)
    progress("Fitting, for noise and sizes of effects")
    fitted, residual_noise = _fitted(case)
    target = make_target(fitted, noise=residual_noise if noise is None else noise)
    progress("Decomposing")
    factor = _factor(case, target, target.noise)
    found = identifiable_parameters(target, factor, threshold=threshold)
    floor = np.maximum(case.dataset.noise_floor, 1e-6 * case.dataset.effort_std)
    ideal = identifiable_parameters(target, _factor(case, target, floor), kept=len(found.variances))
    bodies, parameters = _blocks(found)
    return LogIdentifiability(
        model=fitted,
        identifiable=found,
        bodies=bodies,
        effects=parameters,
        combinations=_combinations(found),
        noise=target.noise,
        floor=case.dataset.noise_floor,
        floor_variances=ideal.variances,
        samples=case.dataset.samples.sum(0),
        notes=case.notes,
    )


def _fitted(case: Case) -> tuple[RobotModel, Array]:
    """Return the model with effects of unknown size fitted, and the noise (nv,) of a sample.

    The noise is the RMS residual of the refitted model, scaled as if samples were independent.
    """
    dataset, model = case.dataset, case.model
    unknowns = log_unknowns(dataset, model)
    found = reweight(first_hypothesis(dataset, unknowns), iterations=_ITERATIONS)
    mse = np.maximum(found.held_out.mse, dataset.noise_floor**2)
    mse = np.maximum(mse, 1e-12 * dataset.effort_std**2)
    samples, has = dataset.samples.sum(0), dataset.has_rows
    noise = np.ones(len(mse))  # irrelevant for joints without rows
    noise[has] = np.sqrt((mse * samples)[has] / np.minimum(found.effective, samples)[has])
    x = found.cv.fit_all
    effects = []
    for f in model.effects:
        values = f.parameters
        if f.effect in unknowns.effects and not is_payload(f.effect):
            values = np.where(values, values, x[unknowns.span(f.effect)])
        effects.append(replace(f, parameters=values))
    return replace(model, effects=tuple(effects)), np.asarray(noise)


def _factor(case: Case, target: Target, noise: Array) -> Array:
    """Return the triangular factor (p, p) of the whitened regressor in the target's columns."""
    dataset = case.dataset
    columns = [target.columns, *(dataset.effect_columns(f.effect) for f in target.further)]
    indices = np.concatenate(columns)
    rows = []
    for data, deviation in zip(dataset.data, noise, strict=True):
        local = data.local(indices)
        stacked = data.factors.reshape(-1, data.factors.shape[2])
        regressor = np.zeros((len(stacked), len(indices)))
        regressor[:, local >= 0] = stacked[:, local[local >= 0]]
        rows.append(regressor / deviation)
    return triangular_factor(rows)


def _blocks(
    found: IdentifiableParameters,
) -> tuple[tuple[IdentifiableBlock, ...], tuple[IdentifiableBlock, ...]]:
    """Return the blocks of bodies, and of parameters of effects."""
    target, bodies = found.target, found.target.bodies
    counts = np.stack([found.counts, found.shares.sum(axis=1)], axis=1).tolist()
    parameters, effect_counts = [], iter(counts[len(target.columns) // PARAMETERS_PER_BODY :])
    for f, span in target.further_spans:
        rows = found.directions[span]
        entries = zip(f.effect.parameters, f.parameters.tolist(), rows, effect_counts, strict=False)
        for parameter, value, row, (count, possible) in entries:
            full_name = f"{parameter.name} of {f.effect.name}"
            parameters.append(
                IdentifiableBlock(
                    full_name if len(rows) > 1 else f.effect.name,
                    f.effect.where,
                    count=count,
                    possible=possible,
                    value=value,
                    deviation=_deviation(row, found.variances),
                    effect=f.effect.name,
                    parameter=parameter.name,
                )
            )
    pairs = zip(bodies, counts, strict=False)
    return tuple(IdentifiableBlock(name, (), *both) for name, both in pairs), tuple(parameters)


def _combinations(found: IdentifiableParameters) -> tuple[ParameterCombination, ...]:
    """Return the base parameters with their deviations."""
    target, rows = found.target, found.base_directions
    sizes = np.linalg.norm(rows, axis=1)  # (H₀⁻¹)ᵢᵢ^½, the change per unit of length
    values = target.base.values(target.prior)
    deviations = [_deviation(row, found.variances) for row in rows]
    return tuple(
        ParameterCombination(words, float(value), deviation, float(deviation / size))
        for words, value, deviation, size in zip(
            target.labels, values, deviations, sizes, strict=True
        )
    )


def _deviation(row: Array, variances: Array) -> float:
    """Return the standard deviation of row · w for independent w, ignoring negligible entries."""
    relevant = np.abs(row) > _NEGLIGIBLE * np.abs(row).max(initial=0.0)
    return float(np.sqrt(np.sum(row[relevant] ** 2 * variances[relevant])))
