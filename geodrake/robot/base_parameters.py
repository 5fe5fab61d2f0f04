"""Base parameters: the identifiable combinations of inertial parameters.

The columns of a regressor are linearly dependent for every motion, because joints constrain bodies:

    Y(q, v, v̇) = Y_B(q, v, v̇) B,   φ_B = B φ                 [Lee2019] Eqs. (4.2.14), (4.2.15)

with fewer rows in B than columns. B is unique up to a factor S B. Here it is the identity in the
columns of independent parameters, so Y_B consists of those columns of Y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from scipy.linalg import qr, solve_triangular

from geodrake.boundary.arguments import instances, integer, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.parameters import PARAMETER_NAMES
from geodrake.manifolds import PhysicalInertia
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.reduction import triangular_factor
from geodrake.robot.regressor import checked_tree, inverse_dynamics_regressor

Indices = NDArray[np.intp]

_ROUNDING = 1e-17  # least tolerance of singular values
_OWN_SHARE = 1e-1  # relative residual of an independent column after projection on earlier ones
_KINDS = (np.array([0]), np.arange(1, 4), np.arange(4, PARAMETERS_PER_BODY))  # m, h, I
_PREFERENCE = (*range(4, PARAMETERS_PER_BODY), 1, 2, 3, 0)  # of independent columns: I, h, m


@dataclass(frozen=True, eq=False)
class BaseParameters(Short):
    """Combinations of p parameters that determine a regressor's efforts.

    Attributes:
        matrix: (n_B, p) B, with φ_B = B φ; the identity in the columns `independent`.
        independent: (n_B,) independent columns, which name the combinations.
        singular_values: (p,) singular values of the scaled regressor.
        tolerance: Relative tolerance of singular values in the rank.
    """

    matrix: Array
    independent: Indices
    singular_values: Array
    tolerance: float

    @property
    def rank(self) -> int:
        """Return the number n_B of base parameters."""
        return len(self.independent)

    @property
    def unseen(self) -> tuple[int, ...]:
        """Return the indices of parameters without any influence."""
        return tuple(np.flatnonzero(~self.matrix.any(axis=0)).tolist())

    def regressor(self, regressor: ArrayLike) -> Array:
        """Return the independent columns Y_B (..., n_B) of a regressor Y (..., p)."""
        regressor = real_array(regressor, "regressor", ("...", self.matrix.shape[1]))
        return regressor[..., self.independent]

    def values(self, phi: ArrayLike) -> Array:
        """Return φ_B = B φ (n_B,) for parameters φ, (p,) or (nb, 10)."""
        flat = real_array(phi, "phi").ravel()
        return np.asarray(self.matrix @ real_array(flat, "phi", (self.matrix.shape[1],)))

    def metric(self, prior: ArrayLike, *, extra: ArrayLike | None = None) -> Array:
        """Return H₀ (n_B, n_B) at a prior; see `pushforward_metric`."""
        return pushforward_metric(self.matrix, prior, extra=extra)

    def labels(self, bodies: Sequence[str], *, extra: Sequence[str] = ()) -> tuple[str, ...]:
        """Return each combination in words, such as "Izz of column + Iyy of arm + 0.09 m of arm".

        Coefficients are in SI units, with three digits.

        Args:
            extra: Names of the parameters after those of the bodies.
        """
        bodies, extra = instances(bodies, "bodies", str), instances(extra, "extra", str)
        names = [f"{name} of {body}" for body in bodies for name in PARAMETER_NAMES] + [*extra]
        if len(names) != self.matrix.shape[1]:
            raise ArgumentError(
                f"{len(bodies)} bodies and {len(extra)} further names are {len(names)} "
                f"parameters, but the matrix has {self.matrix.shape[1]} columns."
            )
        return tuple(_sum(row, names) for row in self.matrix)


def base_parameters(
    regressor: ArrayLike, *, extra: int = 0, tolerance: float = 1e-9
) -> BaseParameters:
    """Return base parameters for the motions of a regressor.

    For fully exciting motions these are the robot's own (`structural_base_parameters`). Columns are
    scaled before singular values are compared, so the result does not depend on units.

    Args:
        regressor: (..., p) regressor, or its (p, p) triangular factor without the measurements; ten
            columns per body, then the further ones.
        extra: Number of further columns, such as those of friction; each is scaled separately.
        tolerance: Relative tolerance of singular values. Rounding reaches about 1e-14; a larger
            tolerance excludes combinations that the motion hardly excites.
    """
    rows = real_array(regressor, "regressor", ("...", "m", "p"))
    number(tolerance, "tolerance", lower=_ROUNDING, upper=1.0, strict=True)
    if not rows.size:
        raise ArgumentError(
            f"Base parameters need a nonempty regressor; its shape is {rows.shape}."
        )
    p = rows.shape[-1]
    integer(extra, "extra")
    if not 0 <= extra <= p or (p - extra) % PARAMETERS_PER_BODY:
        raise ArgumentError(
            f"The regressor has {p} columns, which are not ten for each body and {extra} "
            "further ones.",
            advice="Set `extra` to the number of columns of other parameters.",
        )
    bodies = (p - extra) // PARAMETERS_PER_BODY
    factor = triangular_factor([rows.reshape(-1, p)])
    scale = _scales(factor, bodies)
    scaled = factor / scale
    singular = np.linalg.svd(scaled, compute_uv=False)
    rank = int(np.count_nonzero(singular > tolerance * singular[0]))
    independent = _independent(scaled, rank, bodies, tolerance)
    Q, R = np.linalg.qr(scaled[:, independent])
    weights = solve_triangular(R, Q.T @ scaled) if rank else np.zeros((0, p))
    spread = np.linalg.cond(R) if rank else 1.0
    weights[np.abs(weights) < 100.0 * spread * np.finfo(float).eps] = 0.0
    weights[:, independent] = np.eye(rank)
    matrix = weights * scale / scale[independent, None]
    return BaseParameters(matrix, independent, np.asarray(singular, float), tolerance)


def structural_base_parameters(plant: MultibodyPlant | KinematicTree) -> BaseParameters:
    """Return the base parameters of a robot, from the efforts of random motions."""
    tree = checked_tree(plant)
    random, nv = np.random.default_rng(0), tree.num_velocities
    count = 3 * PARAMETERS_PER_BODY * len(tree.bodies) // max(nv, 1) + 10
    sizes = (tree.num_positions, nv, nv)
    q, v, vd = (random.uniform(-np.pi, np.pi, (count, size)) for size in sizes)
    return base_parameters(inverse_dynamics_regressor(tree, tree.inside(q), v, vd))


def pushforward_metric(
    matrix: ArrayLike, prior: ArrayLike, *, extra: ArrayLike | None = None
) -> Array:
    """Return the metric H₀ = (B G₀⁻¹ Bᵀ)⁻¹ on base parameters, [Lee2019] Eq. (4.3.35).

    G₀ is the pullback metric g(φ⁰) of (B.1.7) of each body. The length of dφ_B is that of the
    shortest dφ with B dφ = dφ_B, independent of frames, units and B.

    Args:
        matrix: (n_B, p) B.
        prior: (nb, 10) physical prior.
        extra: (p − 10 nb,) metric of each further parameter, 1/(2 x²) for a positive one of size x.
    """
    B = real_array(matrix, "matrix", ("n", "p"))
    prior = real_array(prior, "prior", ("nb", PARAMETERS_PER_BODY))
    weights = np.zeros(0) if extra is None else np.atleast_1d(real_array(extra, "extra"))
    if not len(B) or weights.ndim > 1 or B.shape[1:] != (prior.size + len(weights),):
        raise ArgumentError(
            f"B has shape {B.shape}, but a prior of shape {prior.shape} and {len(weights)} "
            f"further parameters need {prior.size + len(weights)} columns."
        )
    wrong = np.flatnonzero(~PhysicalInertia().contains(prior)).tolist()
    if wrong or not np.all(weights > 0):
        raise ArgumentError(
            f"The prior of bodies {wrong} is not physical, or a further metric is not positive.",
            advice="The metric needs physically valid parameters.",
        )
    # H₀⁻¹ = W Wᵀ with W = B G₀^(-½); g⁻¹ is twice the inverse of the Hessian. A QR factorization of
    # W keeps digits that the product would lose.
    inverse = 2.0 * PhysicalInertia().inverse_metric_times(
        prior[:, None], np.eye(PARAMETERS_PER_BODY)
    )
    blocks = B[:, : prior.size].reshape(len(B), *prior.shape)
    W = np.einsum("nbi,bij->nbj", blocks, np.linalg.cholesky(inverse)).reshape(len(B), -1)
    R = np.linalg.qr(np.hstack([W, B[:, prior.size :] / np.sqrt(weights)]).T, mode="r")
    pivots, sizes = np.abs(np.diagonal(R)), np.linalg.norm(R, axis=0)
    if len(pivots) < len(B) or np.any(pivots <= 1e-12 * sizes):
        raise ArgumentError(
            "Rows of B are linearly dependent, so there is no metric on B φ.",
            advice="Take B from `base_parameters`.",
        )
    root = solve_triangular(R, np.eye(len(B)), trans="T")
    return root.T @ root


def _scales(factor: Array, bodies: int) -> Array:
    """Return the scale (p,) of each column's kind: masses, first moments, or inertias.

    The scales have units with a_h² ~ a_m a_I. If one kind has no influence but rounding errors, the
    other two yield its scale.
    """
    norms = np.linalg.norm(factor, axis=0)
    split = bodies * PARAMETERS_PER_BODY
    blocks = norms[:split].reshape(bodies, PARAMETERS_PER_BODY)
    m, h, moment = (blocks[:, kind].max(initial=0.0) for kind in _KINDS)
    sizes = (
        max(m, h * h / moment if moment else 0.0),
        max(h, np.sqrt(m * moment)),
        max(moment, h * h / m if m else 0.0),
    )
    scales = np.empty_like(blocks)
    for kind, size in zip(_KINDS, sizes, strict=True):
        scales[:, kind] = size
    all_scales = np.concatenate([scales.ravel(), norms[split:]])
    return np.where(all_scales > 0, all_scales, 1.0)


def _independent(scaled: Array, rank: int, bodies: int, tolerance: float) -> Indices:
    """Return (rank,) independent columns, preferring bodies close to the base, and I before m.

    Columns that nearly depend on earlier ones would lose digits and are skipped. If columns are
    missing at the end, a pivoted QR factorization adds them.
    """
    split = bodies * PARAMETERS_PER_BODY
    order = np.arange(split).reshape(-1, PARAMETERS_PER_BODY)[:, _PREFERENCE].ravel()
    order = np.concatenate([order, np.arange(split, scaled.shape[1])])
    least = np.maximum(
        np.sqrt(len(scaled)) * tolerance, _OWN_SHARE * np.linalg.norm(scaled, axis=0)
    )
    basis = np.zeros((len(scaled), rank))
    kept: list[int] = []
    for column in order:
        residual = _outside(basis, scaled[:, column])
        size = np.linalg.norm(residual)
        if size > least[column] and len(kept) < rank:
            basis[:, len(kept)] = residual / size
            kept.append(int(column))
    if len(kept) < rank:
        kept += qr(_outside(basis, scaled), mode="r", pivoting=True)[1][: rank - len(kept)].tolist()
    return np.array(sorted(kept), np.intp)


def _outside(basis: Array, columns: Array) -> Array:
    """Return the part of columns orthogonal to a basis; a second pass removes rounding errors."""
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def _sum(row: Array, names: Sequence[str]) -> str:
    """Return a row of coefficients as a sum, the parameter with the coefficient one first."""
    columns = np.flatnonzero(row)
    first = int(np.argmin(np.abs(row[columns] - 1.0)))
    text = ""
    for column in [columns[first], *np.delete(columns, first)]:
        size = f"{abs(row[column]):.3g}"
        term = names[column] if size == "1" else f"{size} {names[column]}"
        sign = " - " if row[column] < 0 else " + "
        text += (sign if text else sign.strip(" +")) + term
    return text
