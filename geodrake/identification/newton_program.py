"""What Newton's method iterates on: a fit on triangular factors, without units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Coordinates, Rows, Scalars
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

_SVEC = SYMMETRIC_BASIS.reshape(10, 16)
IDENTITY = _SVEC @ np.eye(4).ravel()
"""Coordinates svec(I) of the 4×4 identity; shape (10,)."""

_BARRIER = 1e-10
"""Weight of a barrier, relative to the curvature of the block's quadratic prior."""
_LEAST = 1e-11
"""Least weight of a barrier, relative to the misfit at the prior."""
_UNDETERMINED = 1e-11
_FIXING = 1e-5


def smat(coordinates: Array) -> Array:
    """Symmetric matrices (..., 4, 4) of orthonormal coordinates (..., 10)."""
    return (coordinates @ _SVEC).reshape(*coordinates.shape[:-1], 4, 4)


def svec(matrices: Array) -> Array:
    """Orthonormal coordinates (..., 10) of symmetric matrices (..., 4, 4)."""
    return matrices.reshape(*matrices.shape[:-2], 16) @ _SVEC.T


@dataclass(frozen=True, eq=False)
class NewtonProgram:
    """A fit in the coordinates z of `Coordinates`, split into data and prior.

    Minimizes ‖M z − d‖² + w (‖C z‖² + Σ_i γ_i (tr S_i − log|S_i|) + Σ_k γ_k (s_k − log s_k)) with
    S_i = B_i + smat(z_i) ≻ 0, s = G z − h ≥ 0 and E z = e ([Lee2019] Eqs. (3.5.45), (3.5.46)). The
    γ_k of an inequality is 0, but for positive scalars over their priors. A block whose prior is
    quadratic has a γ_i next to nothing, as the barrier that keeps it physical.

    Attributes:
        coordinates: Map to the parameters of the problem.
        data: (p, p + 1) triangle [M | d]; what d has beyond it is `floor`.
        prior: (k, p) root C of the quadratic prior.
        fixing: (j, p) weak rows that fix directions which neither data nor prior determine.
        blocks: (n, 10) indices of the inertia blocks in z.
        begin: (n, 4, 4) matrices B.
        gamma: (n,) weights γ.
        least: (n,) least w γ of a barrier, whatever w, so that rounding does not drown it.
        strength: Size of the prior, to which weights w are relative.
        targets: (m,) weights γ_k of the inequalities.
        inequalities: G (m, p) and h (m,), with rows of unit length but those of positive scalars.
        equalities: E (l, p) and e (l,), with independent rows of unit length.
        floor: Least squared residual of any parameters, also unphysical ones.
    """

    coordinates: Coordinates
    data: Array
    prior: Array
    fixing: Array
    blocks: NDArray[np.intp]
    begin: Array
    gamma: Array
    least: Array
    strength: float
    targets: Array
    inequalities: Rows
    equalities: Rows
    floor: float

    @classmethod
    def of(cls, problem: FitProblem) -> NewtonProgram:
        """The program of a problem whose every block has an entropic or a quadratic prior.

        Raises:
            ArgumentError: A block has none.
        """
        coordinates = Coordinates.of(problem)
        p = problem.size
        triangle = triangular_factor([np.column_stack(coordinates.data())])
        prior = coordinates.prior_root()
        blocks = np.reshape(
            [np.arange(start, start + 10) for start in problem.inertia_blocks], (-1, 10)
        ).astype(np.intp)
        scalars = coordinates.scalars(problem.entropic_scalars)
        inequalities, equalities = coordinates.rows()
        gamma, strength = _weights(problem, prior, blocks)
        known = np.append(blocks.ravel(), scalars.columns)
        barrier = np.array([start not in problem.entropic for start in problem.inertia_blocks])
        margins = np.where(barrier, problem.margin, 0.0)[:, None, None]
        program = cls(
            coordinates=coordinates,
            data=triangle[:p],
            prior=prior,
            fixing=_undetermined(np.vstack([triangle[:p, :p], prior]), known),
            blocks=blocks,
            begin=coordinates.starts - margins * coordinates.references,
            gamma=gamma,
            least=np.zeros(len(gamma)),
            strength=max(strength, scalars.weights.max(initial=0.0)),
            targets=np.append(scalars.weights, np.zeros(len(inequalities[1]))),
            inequalities=_with_scalars(inequalities, scalars),
            equalities=equalities,
            floor=float(triangle[p, p] ** 2) if len(triangle) > p else 0.0,
        )
        least = _LEAST * program.excess(program.middle())
        return replace(program, least=np.where(barrier, least, 0.0))

    def middle(self) -> Array:
        """Coordinates (p,) where every S is the identity."""
        z = np.zeros(self.size)
        z[self.blocks] = IDENTITY - svec(self.begin)
        return z

    @property
    def size(self) -> int:
        """Number p of coordinates."""
        return self.data.shape[1] - 1

    def excess(self, z: Array) -> float:
        """Squared residual of z (p,) beyond `floor`."""
        return float(np.square(self.data @ np.append(z, -1.0)).sum())

    def matrices(self, z: Array) -> Array:
        """S_i of every block, (n, 4, 4), at z (p,)."""
        return self.begin + smat(z[self.blocks])

    def lifted(self, z: Array, least: float) -> Array:
        """Coordinates z (p,) with no eigenvalue of S, and no entropic scalar, below a least one.

        Args:
            z: (p,) coordinates.
            least: Least eigenvalue of every S; none are lifted if it is not positive.
        """
        if least <= 0:
            return z
        scalars = self.coordinates.scalars(self.coordinates.problem.entropic_scalars)
        z = z.copy()
        z[scalars.columns] += np.maximum(least - scalars.ratios(z), 0.0) / scalars.slope
        values, vectors = np.linalg.eigh(self.matrices(z))
        matrices = vectors * np.maximum(values, least)[:, None, :] @ np.swapaxes(vectors, 1, 2)
        low = values[:, 0] < least
        z[self.blocks[low]] = svec(matrices - self.begin)[low]
        return z

    def weighted(self, weight: float) -> WeightedProgram:
        """The program with the prior's weight w in its factor."""
        p = self.size
        extra = np.vstack([np.sqrt(weight) * self.prior, self.fixing])
        triangle = self.data
        if len(extra):
            rows = np.column_stack([extra, np.zeros(len(extra))])
            triangle = triangular_factor([triangle, rows])[:p]
        return WeightedProgram(
            program=self,
            weight=weight,
            factor=np.asfortranarray(np.sqrt(2.0) * np.triu(triangle[:, :p])),
            target=np.sqrt(2.0) * triangle[:, p],
            gamma=np.maximum(weight * self.gamma, self.least),
            targets=weight * self.targets,
        )


@dataclass(frozen=True, eq=False)
class WeightedProgram:
    """A `NewtonProgram` with one weight.

        ½‖F z − f‖² + Σ_i γ_i (tr S_i − log|S_i|) + Σ_k γ_k (s_k − log s_k)

    Attributes:
        program: The program.
        weight: The weight w.
        factor: (p, p) upper triangular F, in Fortran's order.
        target: (p,) f.
        gamma: (n,) weights w γ_i, or those of barriers.
        targets: (m,) weights w γ_k of the inequalities.
    """

    program: NewtonProgram
    weight: float
    factor: Array
    target: Array
    gamma: Array
    targets: Array

    @property
    def least_weight(self) -> float:
        """The smallest weight of an entropic prior or barrier; inf if there is none."""
        return float(np.append(self.gamma, self.targets[self.targets > 0]).min(initial=np.inf))

    @property
    def total_weight(self) -> float:
        """All these weights together."""
        return float(self.gamma.sum() + self.targets.sum())

    def slope(self, z: Array) -> Array:
        """Gradient (p,) of the cost without its logarithms at z (p,)."""
        gradient = self.factor.T @ (self.factor @ z - self.target)
        gradient[self.program.blocks] += self.gamma[:, None] * IDENTITY
        return gradient + self.program.inequalities[0].T @ self.targets

    def cost(self, z: Array) -> float:
        """Cost at z (p,), counted from a perfect fit at the prior."""
        S = self.program.matrices(z)
        logs = np.linalg.slogdet(S)[1]
        divergences = np.trace(S, axis1=1, axis2=2) - logs - 4.0
        errors = self.factor @ z - self.target
        G, h = self.program.inequalities
        weighty = self.targets > 0
        slack = G[weighty] @ z - h[weighty]
        scalars = self.targets[weighty] @ (slack - np.log(slack) - 1.0)
        return float(0.5 * errors @ errors + self.gamma @ divergences + scalars)


def _weights(problem: FitProblem, prior: Array, blocks: NDArray[np.intp]) -> tuple[Array, float]:
    """Weights γ (n,) of entropic priors and barriers, and the size of the whole prior."""
    curvatures = np.square(prior).sum(0)[blocks].mean(1)
    entropic = np.array([problem.entropic.get(k, (None, 0.0))[1] for k in problem.inertia_blocks])
    free = np.array(problem.inertia_blocks, int)[(entropic == 0) & (curvatures == 0)].tolist()
    if free:
        raise ArgumentError(
            "Newton's method needs an entropic or quadratic prior for every inertia block; those "
            f"at columns {free} have none.",
            advice="Give them one, or use the solver clarabel.",
            columns=free,
        )
    gamma = np.where(entropic > 0, entropic, _BARRIER * curvatures)
    strengths = np.where(entropic > 0, entropic, curvatures)
    return gamma, float(strengths.max(initial=0.0)) or 1.0


def _with_scalars(inequalities: Rows, scalars: Scalars) -> Rows:
    """The inequalities after those of positive scalars over their priors."""
    rows = np.zeros((len(scalars.columns), inequalities[0].shape[1]))
    rows[np.arange(len(rows)), scalars.columns] = scalars.slope
    return np.vstack([rows, inequalities[0]]), np.append(-scalars.begin, inequalities[1])


def _undetermined(rows: Array, known: NDArray[np.intp]) -> Array:
    """Weak rows for the directions of scalars that no row determines.

    Every block and every entropic scalar (`known`) has its curvature, so only others can be
    without.
    """
    scalars = np.setdiff1d(np.arange(rows.shape[1]), known)
    if not len(scalars):
        return np.zeros((0, rows.shape[1]))
    factor = triangular_factor([rows[:, scalars]])
    _, sizes, directions = np.linalg.svd(factor)
    unknown = directions[sizes <= _UNDETERMINED * max(sizes[0], 1e-300)]
    fixing = np.zeros((len(unknown), rows.shape[1]))
    fixing[:, scalars] = _FIXING * unknown
    return fixing
