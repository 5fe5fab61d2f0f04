"""Identifiable directions of motions, and reduced identification, [Lee2019] §4.5.1.

The normalized covariance of an estimate has eigenvalues λ₁ ≤ … ≤ λ_n: variances along principal
directions, in squares of relative changes, whatever frames and units are. Directions of a variance
above a threshold keep their prior values; the others are found by least squares. That takes one
singular value decomposition of the whitened regressor A K (`geodrake.excitation.objective`):

    A K = U S Wᵀ,   λᵢ = 1/sᵢ²,   φ* = φ⁰ + K W₋ S₋⁻¹ U₋ᵀ (b − A φ⁰)

which has the base parameters of Eq. (4.5.60), and of all φ with those is the one nearest to φ⁰.

    found = log_identifiability(load_model("arm.urdf"), ["log.csv"])
    print(f"{found.count} of {found.possible} directions are identifiable")

Logs are prepared and reduced as for every fit, so that what is counted are filtered samples of
independent noise. The noise is what the model, refitted, leaves on held-out data: whatever else is
in there, an estimate has to live with it.
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
from geodrake.identification.logs.case import Case, open_case
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.hypothesis import first_hypothesis, reweight
from geodrake.identification.logs.log_fits import log_unknowns
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

_SAMPLES = 2000  # of which there is a regressor in memory at once
_ITERATIONS = 6  # refits until the weights of the joints stay
_NOTHING = 1e-9  # share of a direction, or parameters of a block, that are rounding
_HALF = 0.5  # share of a block above which it counts as identifiable


@dataclass(frozen=True, eq=False)
class IdentifiableParameters(Short):
    """Which combinations of p parameters are identifiable to within a threshold.

    Attributes:
        variances: (n_B,) λ, ascending; infinite where the data say nothing. 10⁻² means a relative
            deviation of about a tenth.
        directions: (p, n_B) columns K W: the changes of parameters, of length one in the metric
            G₀, that the variances are of.
        kept: Number r of directions with a variance of at most the threshold.
        threshold: ε_λ; λ_r where r was given.
    """

    variances: Array
    directions: Array
    kept: int
    threshold: float
    target: Target

    @property
    def base_directions(self) -> Array:
        """(n_B, n_B) v of [Lee2019] step a.3, columns, for `target.base`."""
        return np.asarray(self.target.base.matrix @ self.directions)

    @property
    def shares(self) -> Array:
        """(blocks, n_B) share of every body, payload and further parameter in each direction.

        Shares of a direction add up to one. They do not depend on frames and units.
        """
        whitened = np.linalg.solve(self.target.metric_root, self.directions) ** 2
        inertial = len(self.target.columns)
        bodies = whitened[:inertial].reshape(-1, PARAMETERS_PER_BODY, whitened.shape[1]).sum(1)
        return np.concatenate([bodies, whitened[inertial:]])

    @property
    def counts(self) -> Array:
        """(blocks,) identifiable parameters of every body, payload and effect: 0 to 10 or 1.

        They add up to `kept`, and need not be whole: part of one can be.
        """
        return np.asarray(self.shares[:, : self.kept].sum(axis=1))


@dataclass(frozen=True, eq=False)
class ReducedIdentification(Short):
    """Parameters found along the directions that data identify.

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
        measured: For each motion (N, m) efforts (N·m or N), or base wrenches (N·m and N), less
            those of bodies and effects that the target takes as known. None for what could be
            identified.

    Returns:
        (p, p) R with RᵀR = AᵀA of the whitened regressor; (p + 1, p + 1) of [A b] with
        measurements.
    """
    noise = instance(target, "target", Target).noise[:, None]
    given = (motions,) if isinstance(motions, Motion) else motions
    every = instances(given, "motions", Motion)
    outputs: Sequence[object] = [None] * len(every)
    if measured is not None:
        outputs = instances(measured, "measured", object)
    if len(outputs) != len(every) or not every:
        raise ArgumentError(
            f"There are {len(every)} motions, but measurements of {len(outputs)}.",
            advice="Pass one array of measurements for each motion.",
        )

    def whitened() -> Iterator[Array]:
        for motion, output in zip(every, outputs, strict=True):
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
    """Return the identifiable directions of data, [Lee2019] steps a.1 to a.4.

    Args:
        factor: `measurement_factor` of the data, with or without what was measured.
        threshold: ε_λ, largest variance of what counts as identifiable; 10⁻² is a deviation of
            a tenth.
        kept: Number of directions instead of the threshold, as in step b.4.
    """
    array, size = real_array(factor, "factor"), instance(target, "target", Target).size
    if array.shape not in ((size, size), (size + 1, size + 1)):
        raise ArgumentError(
            f"The factor has shape {array.shape}, but the target {size} parameters.",
            advice="Compute it with `measurement_factor` of the same target.",
        )
    return _decompose(target, array[:, :size], threshold, kept)[0]


def reduced_identification(
    target: Target, factor: ArrayLike, *, threshold: float = 1e-2, kept: int | None = None
) -> ReducedIdentification:
    """Return least squares along identifiable directions, with the prior elsewhere, step a.5.

    Args:
        factor: (p + 1, p + 1) `measurement_factor` with what was measured.
        threshold: ε_λ; infinite for least squares of all base parameters.
        kept: Number of directions instead of the threshold.
    """
    size = instance(target, "target", Target).size
    both = real_array(factor, "factor", (size + 1, size + 1))  # with what was measured
    found, U, singular = _decompose(target, both[:, :size], threshold, kept)
    r, seen = found.kept, _seen(singular)
    if r > seen:
        raise ArgumentError(
            f"{r} directions cannot be estimated: the data identify only {seen}.",
            advice="Keep fewer, lower the threshold, or move more joints.",
        )
    rest = both[:, size] - both[:, :size] @ target.prior
    step = found.directions[:, :r] @ ((U[:, :r].T @ rest) / singular[:r])
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
        count = _seen(singular)
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


def _seen(singular: Array) -> int:
    """Return how many singular values, descending, are more than rounding."""
    least = np.finfo(float).eps * singular.max(initial=0.0) * len(singular)
    return int(np.count_nonzero(singular > least))


@dataclass(frozen=True)
class IdentifiableBlock:
    """How much of a body, or of a parameter of an effect, is identifiable."""

    name: str  # of the body, or of the effect: "<parameter> of <effect>" if it has several
    where: tuple[str, ...]  # joints or body of the effect; () for a body
    # How many of its parameters are, 0 to 10 for a body and 0 to 1 for an effect, part of one too.
    count: float
    possible: float  # how many are from the best of motions
    # Of an effect: its value in the model, or that of a fit to the logs, and the deviation of an
    # estimate from these logs alone, infinite where they do not determine it.
    value: float = np.nan
    deviation: float = np.nan
    effect: str = ""
    parameter: str = ""

    @property
    def label(self) -> str:
        """Its name, and of an effect where it acts."""
        place = "/".join(self.where) or "the robot"
        return f"{self.name} of {place}" if self.effect else self.name

    @property
    def share(self) -> float:
        """Identifiable over possible; zero if nothing is possible."""
        return self.count / self.possible if self.possible > _NOTHING else 0.0

    @property
    def is_identifiable(self) -> bool:
        """Whether most of it is identifiable."""
        return self.share >= _HALF


@dataclass(frozen=True)
class ParameterCombination:
    """A base parameter."""

    words: str  # the combination, such as "Izz of column + Iyy of arm"
    value: float  # its value in the model, SI units
    # Deviation of an estimate from the logs alone; infinite where they do not determine it.
    deviation: float
    # The deviation over the size that such a parameter has, which is geometric: it depends neither
    # on frames nor on units.
    relative: float


@dataclass(frozen=True, eq=False)
class LogIdentifiability(Shown):
    """Identifiability of a model's parameters from logs."""

    model: RobotModel
    identifiable: IdentifiableParameters
    bodies: tuple[IdentifiableBlock, ...]
    effects: tuple[IdentifiableBlock, ...]
    combinations: tuple[ParameterCombination, ...]
    noise: Array  # (nv,) deviation that a filtered sample counts with, N·m or N
    floor: Array  # (nv,) estimated sensor noise after filtering, N·m or N
    floor_variances: Array  # (n_B,) variances if the sensor noise were all there is, ascending
    samples: NDArray[np.int_]  # (nv,) filtered samples of each joint
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many directions are identifiable."""
        return self.identifiable.kept

    @property
    def possible(self) -> int:
        """How many are from the best of motions."""
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
        """The base parameters whose relative deviation is above the threshold, worst first."""
        most = np.sqrt(self.identifiable.threshold)
        rest = [c for c in self.combinations if not c.relative <= most]
        return tuple(sorted(rest, key=lambda c: -c.relative))


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
        threshold: ε_λ, largest variance of what counts as identifiable; 10⁻² is a deviation of
            a tenth.
        noise: Deviation of a filtered effort: one, or one a joint, N·m or N. By default what the
            refitted model leaves on held-out data, counted by effective samples.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.
    """
    function(progress, "progress")
    wanted = with_effects(instance(model, "model", RobotModel).with_volume, effects)
    case = open_case(wanted, logs, candidates=False, bandwidth=bandwidth, blocks=blocks)
    progress("Fitting, for noise and sizes of effects")
    fitted, left = _fitted(case)
    target = make_target(fitted, noise=left if noise is None else noise)
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

    The noise is the RMS of what the refitted model leaves, as if every sample were independent.
    """
    dataset, model = case.dataset, case.model
    unknowns = log_unknowns(dataset, model)
    found = reweight(first_hypothesis(dataset, unknowns), iterations=_ITERATIONS)
    mse = np.maximum(found.held_out.mse, dataset.noise_floor**2)
    mse = np.maximum(mse, 1e-12 * dataset.effort_std**2)
    samples, has = dataset.samples.sum(0), dataset.has_rows
    noise = np.ones(len(mse))  # of joints without rows, where it weighs nothing
    noise[has] = np.sqrt((mse * samples)[has] / np.minimum(found.effective, samples)[has])
    x = found.cv.fit_all
    effects = []
    for known in model.effects:
        values = known.parameters
        if known.effect in unknowns.effects and not is_payload(known.effect):
            values = np.where(values, values, x[unknowns.span(known.effect)])
        effects.append(replace(known, parameters=values))
    return replace(model, effects=tuple(effects)), np.asarray(noise)


def _factor(case: Case, target: Target, noise: Array) -> Array:
    """Return the triangular factor (p, p) of the whitened regressor in the target's columns."""
    dataset = case.dataset
    columns = [target.columns, *(dataset.effect_columns(f.effect) for f in target.further)]
    wanted = np.concatenate(columns)
    rows = []
    for data, deviation in zip(dataset.data, noise, strict=True):
        local = data.local(wanted)
        stacked = data.factors.reshape(-1, data.factors.shape[2])
        here = np.zeros((len(stacked), len(wanted)))
        here[:, local >= 0] = stacked[:, local[local >= 0]]
        rows.append(here / deviation)
    return triangular_factor(rows)


def _blocks(
    found: IdentifiableParameters,
) -> tuple[tuple[IdentifiableBlock, ...], tuple[IdentifiableBlock, ...]]:
    """Return bodies, and parameters of effects."""
    target, bodies = found.target, found.target.bodies
    numbers = np.stack([found.counts, found.shares.sum(axis=1)], axis=1).tolist()
    parameters, of_effects = [], iter(numbers[len(target.columns) // PARAMETERS_PER_BODY :])
    for f, span in target.further_spans:
        rows = found.directions[span]
        each = zip(f.effect.parameters, f.parameters.tolist(), rows, of_effects, strict=False)
        for parameter, value, row, (count, possible) in each:
            several = f"{parameter.name} of {f.effect.name}"
            parameters.append(
                IdentifiableBlock(
                    several if len(rows) > 1 else f.effect.name,
                    f.effect.where,
                    count=count,
                    possible=possible,
                    value=value,
                    deviation=_deviation(row, found.variances),
                    effect=f.effect.name,
                    parameter=parameter.name,
                )
            )
    pairs = zip(bodies, numbers, strict=False)
    return tuple(IdentifiableBlock(name, (), *own) for name, own in pairs), tuple(parameters)


def _combinations(found: IdentifiableParameters) -> tuple[ParameterCombination, ...]:
    """Return base parameters with their deviations."""
    target, rows = found.target, found.base_directions
    sizes = np.linalg.norm(rows, axis=1)  # (H₀⁻¹)ᵢᵢ is what one unit of length allows
    values = target.base.values(target.prior)
    deviations = [_deviation(row, found.variances) for row in rows]
    return tuple(
        ParameterCombination(words, float(value), deviation, float(deviation / size))
        for words, value, deviation, size in zip(
            target.labels, values, deviations, sizes, strict=True
        )
    )


def _deviation(row: Array, variances: Array) -> float:
    """Return the deviation of row · w for independent w; infinite variances count if seen."""
    seen = np.abs(row) > _NOTHING * np.abs(row).max(initial=0.0)
    return float(np.sqrt(np.sum(row[seen] ** 2 * variances[seen])))
