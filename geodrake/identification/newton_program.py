"""What Newton's method iterates on: a fit on triangular factors, without units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.coordinates import IDENTITY, Coordinates, Rows, Scalars, smat, svec
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array, is_physical
from geodrake.robot.reduction import triangular_factor

_BARRIER, _LEAST = 1e-10, 1e-11
"""Weight of a barrier, of the curvature of its block's quadratic prior, and of the misfit there."""
_UNDETERMINED, _FIXING = 1e-11, 1e-5
_INSIDE = (0.0, 1e-13, 1e-11, 1e-9)
"""Shares of the way to the prior, where every P(φ⁰)⁻¹ P(φ) is the identity, to be tried in turn."""


@dataclass(frozen=True, eq=False)
class NewtonProgram:
    """A fit in the coordinates z of `Coordinates`, split into data and prior.

    Minimizes ‖M z − d‖² + w (‖C z‖² + Σ_i γ_i (tr S_i − log|S_i|) + Σ_k γ_k (s_k − log s_k)) with
    S_i = B_i + smat(z_i) ≻ 0, s = G z − h ≥ 0 and E z = e ([Lee2019] Eqs. (3.5.45), (3.5.46)). The
    γ_k of an inequality is 0, but for positive scalars over their priors. A block whose prior is
    quadratic has a γ_i next to nothing, as the barrier that keeps it physical.
    """

    coordinates: Coordinates
    data: Array  # (p, p + 1) triangle [M | d]; what d has beyond it is `floor`
    prior: Array  # (k, p) root C of the quadratic prior
    fixing: Array  # (j, p) weak rows that fix directions which neither data nor prior determine
    blocks: NDArray[np.intp]  # (n, 10) indices of the inertia blocks in z
    begin: Array  # (n, 4, 4) matrices B
    gammas: Array  # (n,) weights γ_i
    barrier: NDArray[np.bool_]  # (n,) which of them are of barriers
    strength: float  # size of the prior, to which weights w are relative
    scalars: Scalars  # positive scalars over their priors, with their weights γ_k
    # G (m, p) and h (m,), with rows of unit length but those of the positive scalars, which come
    # first.
    inequalities: Rows
    equalities: Rows  # E (l, p) and e (l,), with independent rows of unit length
    floor: float  # least squared residual of any parameters, also unphysical ones
    weight: float = 1.0  # weight w of the prior

    @classmethod
    def of(cls, problem: FitProblem) -> Self:
        """Return the program of a problem with a prior, entropic or quadratic, for every block."""
        coordinates, p = Coordinates.of(problem), problem.size
        triangle = triangular_factor([coordinates.data()])
        prior, starts = coordinates.prior_root(), np.array(problem.inertia_blocks, np.intp)
        blocks = starts[:, None] + np.arange(10)
        curvatures = np.square(prior).sum(0)[blocks].mean(1)
        entropic = np.array([problem.entropic.get(k, (None, 0.0))[1] for k in starts.tolist()])
        barrier = entropic == 0
        if free := starts[barrier & (curvatures == 0)].tolist():
            raise ArgumentError(
                "Newton's method needs an entropic or quadratic prior for every inertia block; "
                f"those at columns {free} have none.",
                advice="Give them one, or use the solver clarabel.",
                columns=free,
            )
        scalars = coordinates.scalars(problem.entropic_scalars)
        (G, h), equalities = coordinates.rows()
        positive = np.eye(p)[scalars.columns] * scalars.slope[:, None]
        others = np.setdiff1d(np.arange(p), np.append(blocks.ravel(), scalars.columns))
        margins = np.where(barrier, problem.margin, 0.0)[:, None, None]
        strengths = np.append(np.where(barrier, curvatures, entropic), scalars.weights)
        return cls(
            coordinates=coordinates,
            data=triangle[:p],
            prior=prior,
            fixing=_undetermined(np.vstack([triangle[:p, :p], prior]), others),
            blocks=blocks,
            begin=coordinates.starts - margins * coordinates.references,
            gammas=np.where(barrier, _BARRIER * curvatures, entropic),
            barrier=barrier,
            strength=float(strengths.max(initial=0.0)) or 1.0,
            scalars=scalars,
            inequalities=(np.vstack([positive, G]), np.append(-scalars.begin, h)),
            equalities=equalities,
            floor=float(triangle[p, p] ** 2),
        )

    def weighted(self, weight: float) -> Self:
        """Return the program with another weight w of the prior; inf leaves the data out."""
        if np.isinf(weight):
            return replace(self, data=0.0 * self.data, floor=0.0, weight=1.0)
        return replace(self, weight=weight)

    @cached_property
    def middle(self) -> Array:
        """Coordinates (p,) where every S is the identity."""
        z = np.zeros(self.data.shape[1] - 1)
        z[self.blocks] = IDENTITY - svec(self.begin)
        return z

    def excess(self, z: Array) -> float:
        """Return the squared residual of z (p,) beyond `floor`."""
        return float(np.square(self.data @ np.append(z, -1.0)).sum())

    def matrices(self, z: Array) -> Array:
        """Return S_i of every block, (n, 4, 4), at z (p,)."""
        return self.begin + smat(z[self.blocks])

    def parameters(self, z: Array) -> Array:
        """Return parameters (p,) at z (p,), physical and within bounds despite rounding."""
        problem = self.coordinates.problem
        for share in _INSIDE:  # rounding alone can leave a tiny γ's bodies at the boundary
            near = (1.0 - share) * z + share * self.middle
            x = np.clip(self.coordinates.parameters(near), problem.lower, problem.upper)
            physical = is_physical(x[self.blocks]) & (self.coordinates.smallest_eigenvalues(x) > 0)
            if np.all(physical):
                return x
        raise IdentificationError(
            "Newton's parameters are not physical after rounding: a body of the prior is too flat "
            "for double precision.",
            advice="Check the units of the prior, or raise gamma.",
            solver="newton",
        )

    @cached_property
    def rows(self) -> Rows:
        """Upper triangular F (p, p), in Fortran's order, and f (p,) of the cost ½ ‖F z − f‖²."""
        p, triangle = len(self.middle), self.data
        extra = np.vstack([np.sqrt(self.weight) * self.prior, self.fixing])
        if len(extra):
            rows = np.column_stack([extra, np.zeros(len(extra))])
            triangle = triangular_factor([triangle, rows])[:p]
        factor = np.asfortranarray(np.sqrt(2.0) * np.triu(triangle[:, :p]))
        return factor, np.sqrt(2.0) * triangle[:, p]

    @cached_property
    def gamma(self) -> Array:
        """(n,) weights w γ_i; a barrier has a least one, so that rounding does not drown it."""
        least = np.where(self.barrier, _LEAST * self.excess(self.middle), 0.0)
        return np.maximum(self.weight * self.gammas, least)

    @cached_property
    def targets(self) -> Array:
        """(m,) weights w γ_k of the inequalities."""
        given = self.scalars.weights
        return np.append(self.weight * given, np.zeros(len(self.inequalities[1]) - len(given)))

    @property
    def weights(self) -> Array:
        """All weights of entropic priors and barriers."""
        return np.append(self.gamma, self.targets[self.targets > 0])

    def cost(self, z: Array) -> float:
        """Return the cost at z (p,), counted from a perfect fit at the prior."""
        S, (F, f), ratios = self.matrices(z), self.rows, self.scalars.ratios(z)
        divergences = np.trace(S, axis1=1, axis2=2) - np.linalg.slogdet(S)[1] - 4.0
        scalars = self.weight * self.scalars.weights @ (ratios - np.log(ratios) - 1.0)
        return float(0.5 * np.square(F @ z - f).sum() + self.gamma @ divergences + scalars)


def _undetermined(rows: Array, scalars: NDArray[np.intp]) -> Array:
    """Return weak rows for the directions of scalars (indices) that no row determines."""
    if not len(scalars):
        return np.zeros((0, rows.shape[1]))
    _, sizes, directions = np.linalg.svd(triangular_factor([rows[:, scalars]]))
    unknown = directions[sizes <= _UNDETERMINED * max(sizes[0], 1e-300)]
    return _FIXING * unknown @ np.eye(rows.shape[1])[scalars]
