"""What is identifiable from given motions, and identification of that alone, [Lee2019] §4.5.1.

The normalized covariance of an estimate has eigenvalues λ₁ ≤ … ≤ λ_n: variances along principal
directions, in squares of relative changes, whatever frames and units are. Directions of a variance
above a threshold keep their prior values; the others are found by least squares. That takes one
singular value decomposition of the whitened regressor A K (`geodrake.excitation.normalization`):

    A K = U S Wᵀ,   λᵢ = 1/sᵢ²,   φ* = φ⁰ + K W₋ S₋⁻¹ U₋ᵀ (b − A φ⁰)

which has the base parameters of Eq. (4.5.60), and of all φ with those is the one nearest to φ⁰.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.normalization import normalizing_map
from geodrake.excitation.target import Target
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.motion import Motion
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

_SAMPLES = 2000  # of which there is a regressor in memory at once


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
    """All that motions, and what was measured in them, say: one triangular matrix.

    Args:
        motions: Motions, (N, ·) each.
        measured: For each motion (N, m) efforts (N·m or N), or base wrenches (N·m and N), less
            those of bodies and effects that the target takes as known. None for what could be
            identified.

    Returns:
        (p, p) R with RᵀR = AᵀA of the whitened regressor; (p + 1, p + 1) of [A b] with
        measurements.

    Raises:
        ArgumentError: Shapes do not fit together, or a value is not finite.
    """
    instance(target, "target", Target)
    given = (motions,) if isinstance(motions, Motion) else motions
    every = instances(given, "motions", Motion)
    outputs: list[Array | None] = [None] * len(every)
    if measured is not None:
        outputs = [real_array(b, "measured") for b in instances(measured, "measured", object)]
    if len(outputs) != len(every) or not every:
        raise ArgumentError(
            f"There are {len(every)} motions and measurements of {len(outputs)} of them.",
            advice="Pass one array of measurements a motion.",
        )
    return triangular_factor(_blocks(target, every, outputs))


def _blocks(
    target: Target, motions: Sequence[Motion], outputs: Sequence[Array | None]
) -> Iterator[Array]:
    """Whitened rows, some samples at a time."""
    for motion, output in zip(motions, outputs, strict=True):
        if output is not None and output.shape != (len(motion), len(target.noise)):
            raise ArgumentError(
                f"The measurements have the shape {output.shape}; the motion needs "
                f"{(len(motion), len(target.noise))}."
            )
        for start in range(0, len(motion), _SAMPLES):
            part = slice(start, start + _SAMPLES)
            rows = target.measure(motion[part]).regressor
            if output is not None:
                rows = np.concatenate([rows, output[part, :, None]], axis=2)
            yield (rows / target.noise[:, None]).reshape(-1, rows.shape[2])


def identifiable_parameters(
    target: Target, factor: ArrayLike, *, threshold: float = 1e-2, kept: int | None = None
) -> IdentifiableParameters:
    """What is identifiable from data, [Lee2019] steps a.1 to a.4.

    Args:
        target: What is unknown; its nominal parameters are the prior.
        factor: `measurement_factor` of the data, with or without what was measured.
        threshold: ε_λ, largest variance of what counts as identifiable; 10⁻² is a deviation of
            a tenth.
        kept: Number of directions instead of the threshold, as in step b.4.

    Raises:
        ArgumentError: The factor does not fit, or nothing is kept.
    """
    A = _regressor_factor(target, factor)
    return _decompose(target, A, threshold, kept)[0]


def reduced_identification(
    target: Target, factor: ArrayLike, *, threshold: float = 1e-2, kept: int | None = None
) -> ReducedIdentification:
    """Least squares along what data identify, and the prior elsewhere, [Lee2019] step a.5.

    Args:
        target: What is unknown; its nominal parameters are the prior.
        factor: (p + 1, p + 1) `measurement_factor` with what was measured.
        threshold: ε_λ; infinite for least squares of all base parameters.
        kept: Number of directions instead of the threshold.

    Raises:
        ArgumentError: The factor does not fit, nothing is kept, or more than the data see.
    """
    both, size = real_array(factor, "factor"), instance(target, "target", Target).size
    if both.shape != (size + 1, size + 1):
        raise ArgumentError(
            f"The factor has the shape {both.shape}; with measurements it is "
            f"{(size + 1, size + 1)}.",
            advice="Pass what was measured to `measurement_factor`.",
        )
    found, U, singular = _decompose(target, both[:, :size], threshold, kept)
    r, seen = found.kept, _seen(singular)
    if r > seen:
        raise ArgumentError(
            f"{r} directions cannot be found: the data say something of {seen} alone.",
            advice="Keep fewer, lower the threshold, or move more joints.",
        )
    rest = both[:, size] - both[:, :size] @ target.prior
    step = found.directions[:, :r] @ ((U[:, :r].T @ rest) / singular[:r])
    parameters = target.prior + step
    return ReducedIdentification(parameters, target.base.values(parameters), found)


def _regressor_factor(target: Target, factor: ArrayLike) -> Array:
    """Rows of a factor without the column of measurements."""
    array, size = real_array(factor, "factor"), instance(target, "target", Target).size
    if array.shape not in ((size, size), (size + 1, size + 1)):
        raise ArgumentError(
            f"The factor has the shape {array.shape}; the target has {size} parameters.",
            advice="Take it from `measurement_factor` of the same target.",
        )
    return array[:, :size]


def _decompose(
    target: Target, A: Array, threshold: float, kept: int | None
) -> tuple[IdentifiableParameters, Array, Array]:
    """The identifiable parameters, and U and S of A K, most certain direction first."""
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
            f"A threshold of {threshold:g} keeps nothing: the most certain direction has a "
            f"variance of {variances[0]:.3g}."
            if kept is None
            else f"{kept} directions cannot be kept; there are {len(variances)}.",
            advice="Raise the threshold, move more, or measure more precisely.",
            variances=variances,
        )
    limit = threshold if kept is None else float(variances[count - 1])
    found = IdentifiableParameters(variances, K @ Wt.T, count, limit, target)
    return found, U, singular


def _seen(singular: Array) -> int:
    """How many singular values, descending, are more than rounding."""
    least = np.finfo(float).eps * singular.max(initial=0.0) * len(singular)
    return int(np.count_nonzero(singular > least))
