"""Compiled kernels for a robot's parameters: physical bodies, and coefficients with lower bounds.

P is the pseudo-inertia of a body φ, and X(b) the symmetric matrix with tr(P(φ) X(b)) = φᵀ b
([Lee2019] Eq. (B.1.8)). Kernels scale P to a unit diagonal, so that units do not cost precision.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import LARGEST
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds.base import Array, MirrorSpan

Places = NDArray[np.int64]
Factors = tuple[Places, Array, Places, Array, Array]
"""Starts (k,) of bodies in a point (n,) and their 1/w for weights w of the barriers; indices (m,)
of all other parameters, their lower bounds and 1/w.
"""

_USUAL_GROWTH = 4.0  # largest |log| growth of a slack in one step
_LONGEST = 2.0  # largest half step for scaling and squaring
_SHORT = 3e-3  # norm for which five terms of the exponential are exact to rounding
_WELL_INSIDE = 1e-12  # least ratio of det P to the product of its diagonal
_CLEAR = 1e-12  # least det P in units in which the largest second moment is the mass
_ROOT = 2.0**0.5


@inlined
def put_pseudo_inertia(phi: Array, P: Array) -> None:
    """Write P(φ) (4, 4)."""
    half = 0.5 * (phi[4] + phi[5] + phi[6])
    P[0, 0], P[1, 1], P[2, 2], P[3, 3] = half - phi[4], half - phi[5], half - phi[6], phi[0]
    P[0, 1] = P[1, 0] = -phi[7]
    P[1, 2] = P[2, 1] = -phi[8]
    P[2, 0] = P[0, 2] = -phi[9]
    for i in range(3):
        P[i, 3] = P[3, i] = phi[1 + i]


@inlined
def put_parameters(P: Array, phi: Array) -> None:
    """Write φ (10,) from P."""
    phi[0], phi[1], phi[2], phi[3] = P[3, 3], P[0, 3], P[1, 3], P[2, 3]
    phi[4], phi[5], phi[6] = P[1, 1] + P[2, 2], P[2, 2] + P[0, 0], P[0, 0] + P[1, 1]
    phi[7], phi[8], phi[9] = -P[0, 1], -P[1, 2], -P[2, 0]


@inlined
def put_dual(b: Array, X: Array) -> None:
    """Write X(b) (4, 4)."""
    X[0, 0], X[1, 1], X[2, 2], X[3, 3] = b[5] + b[6], b[6] + b[4], b[4] + b[5], b[0]
    X[0, 1] = X[1, 0] = -0.5 * b[7]
    X[1, 2] = X[2, 1] = -0.5 * b[8]
    X[2, 0] = X[0, 2] = -0.5 * b[9]
    for i in range(3):
        X[i, 3] = X[3, i] = 0.5 * b[1 + i]


@compiled
def put_product(A: Array, B: Array, out: Array) -> None:
    """Write A B of matrices (4, 4); inlining would slow compilation."""
    for i in range(4):
        for j in range(4):
            total = 0.0
            for k in range(4):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@inlined
def put_congruence(A: Array, B: Array, room: Array, out: Array) -> None:
    """Write Aᵀ B A of matrices (4, 4); `out` may be B."""
    put_product(B, A, room)
    for i in range(4):
        for j in range(4):
            total = 0.0
            for k in range(4):
                total += A[k, i] * room[k, j]
            out[i, j] = total


@inlined
def put_triangular_congruence(L: Array, B: Array, room: Array, out: Array) -> None:
    """Write the lower triangle of Lᵀ B L (4, 4) for a lower triangular L; `out` may be B."""
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(j, 4):
                total += B[i, k] * L[k, j]
            room[i, j] = total
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 4):
                total += L[k, i] * room[k, j]
            out[i, j] = total


@inlined
def frobenius_norm(Z: Array) -> float:
    """Return the Frobenius norm of a matrix (4, 4)."""
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += Z[i, j] * Z[i, j]
    return float(np.sqrt(total))


@inlined
def put_identity(out: Array) -> None:
    """Write 𝟙 (4, 4)."""
    for i in range(4):
        for j in range(4):
            out[i, j] = 0.0
        out[i, i] = 1.0


@inlined
def put_exponential(Z: Array, size: float, room: Array, E: Array) -> None:
    """Write exp(Z) of a matrix (4, 4) of Frobenius norm `size`, by scaling and squaring."""
    share, squarings = 1.0, 0
    while size * share > _SHORT:
        share, squarings = 0.5 * share, squarings + 1
    # Horner's scheme, ((… 𝟙 + Z/3) Z/2 + 𝟙) Z + 𝟙.
    put_identity(E)
    for term in range(5, 0, -1):
        put_product(E, Z, room)
        for i in range(4):
            for j in range(4):
                E[i, j] = share / term * room[i, j]
            E[i, i] += 1.0
    for _ in range(squarings):
        put_product(E, E, room)
        for i in range(4):
            for j in range(4):
                E[i, j] = room[i, j]


@inlined
def put_root(P: Array, L: Array) -> float:
    """Write the lower triangular L (4, 4) with P = L Lᵀ; return det P, or 0 without such an L."""
    determinant = 1.0
    for j in range(4):
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > 0.0:
            return 0.0
        determinant *= pivot
        L[j, j] = np.sqrt(pivot)
        for i in range(j + 1, 4):
            entry = P[i, j]
            for k in range(j):
                entry -= L[i, k] * L[j, k]
            L[i, j] = entry / L[j, j]
            L[j, i] = 0.0
    return determinant


@inlined
def put_units(P: Array, d: Array) -> bool:
    """Scale P to a unit diagonal by roots d (4,); return False if its diagonal is not positive."""
    for i in range(4):
        if not P[i, i] > 0.0:
            return False
        d[i] = np.sqrt(P[i, i])
    for i in range(4):
        for j in range(4):
            P[i, j] /= d[i] * d[j]
    return True


@compiled
def put_body_root(phi: Array, P: Array, d: Array, L: Array) -> bool:
    """Write the lower triangular L (4, 4) with P(φ) = L Lᵀ; return False without such an L."""
    put_pseudo_inertia(phi, P)
    if not (put_units(P, d) and put_root(P, L) > 0.0):
        return False
    for i in range(4):
        for j in range(4):
            L[i, j] *= d[i]
    return True


@compiled
def calc_natural_steps(x: Array, b: Array, factors: Factors, time: float, out: Array) -> bool:
    """Write the geodesics from x (n,) along −time g⁻¹ b ([Lee2019] Eq. (2.2.9)).

    For a body, P⁺ = exp(Z) P = E P Eᵀ with Z = −time P X(b) and E = exp(½ Z). For a lower bound l,
    x⁺ = l + (x − l) exp(−time (x − l) b). Return False, with `out` incomplete, if the step is very
    long or ends close to the boundary.
    """
    bodies, shares, places, lower, other_shares = factors
    P, X, Z = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    E, F, d = np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    for body in range(len(bodies)):
        first, last = bodies[body], bodies[body] + PARAMETERS_PER_BODY
        put_pseudo_inertia(x[first:last], P)
        if not put_units(P, d):
            return False
        put_dual(b[first:last], X)
        for i in range(4):
            for j in range(4):
                X[i, j] *= -0.5 * time * shares[body] * d[i] * d[j]
        put_product(X, P, Z)  # Eᵀ = exp(Z)
        size = frobenius_norm(Z)
        if not size < _LONGEST:
            return False
        if size == 0.0:  # unchanged to the last digit
            out[first:last] = x[first:last]
            continue
        put_exponential(Z, size, F, E)
        put_congruence(E, P, F, P)
        if not put_root(P, F) > _WELL_INSIDE * P[0, 0] * P[1, 1] * P[2, 2] * P[3, 3]:
            return False
        for i in range(4):
            for j in range(4):
                P[i, j] *= d[i] * d[j]
        put_parameters(P, out[first:last])
    return grown(x, b, (places, lower, time * other_shares), out)


@inlined
def grown(x: Array, b: Array, others: tuple[Places, Array, Array], out: Array) -> bool:
    """Write the steps of `calc_natural_steps` for parameters with lower bounds, each with its time.

    Return whether the steps are short and end inside.
    """
    (places, lower, times), length, size = others, 0.0, 0.0
    for k in range(len(places)):
        at = places[k]
        slack = x[at] - lower[k]
        growth = -times[k] * slack * b[at]
        out[at] = x[at] + slack * np.expm1(growth)
        if not out[at] > lower[k]:
            return False
        length += growth * growth
        size += out[at] * out[at]
    return length <= _USUAL_GROWTH * _USUAL_GROWTH and size < LARGEST


@compiled
def calc_clearly_inside(x: Array, factors: Factors) -> bool:
    """Return whether x (n,) is inside by more than rounding."""
    bodies, _, places, lower, _ = factors
    P, L = np.empty((4, 4)), np.empty((4, 4))
    for first in bodies:
        put_pseudo_inertia(x[first : first + PARAMETERS_PER_BODY], P)
        moment = max(P[0, 0], P[1, 1], P[2, 2])
        least = _CLEAR * P[3, 3] * moment * moment * moment
        if not max(least, 0.0) < put_root(P, L) < np.inf:
            return False
    inside = True
    for k in range(len(places)):
        inside &= lower[k] < x[places[k]] < np.inf
    return inside


@compiled
def calc_whitened(x: Array, rows: Array, factors: Factors, L: Array, out: Array) -> None:
    """Write covectors A (r, n) in an orthonormal frame at x (n,), with A g⁻¹ Aᵀ = W Wᵀ.

    For a body, Lᵀ X(b) L with P = L Lᵀ, in a basis of the symmetric matrices; the roots L (k, 4, 4)
    are NaN if P is not positive definite. For a lower bound, (x − l) b.
    """
    bodies, shares, places, lower, other_shares = factors
    P, X, F, d = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    for body in range(len(bodies)):
        root, first, share = L[body], bodies[body], np.sqrt(shares[body])
        if not put_body_root(x[first : first + PARAMETERS_PER_BODY], P, d, root):
            root[:] = np.nan
        for r in range(len(rows)):
            is_nonzero = False
            for j in range(first, first + PARAMETERS_PER_BODY):
                is_nonzero |= rows[r, j] != 0.0
                out[r, j] = 0.0
            if not is_nonzero:  # such as bodies inboard of a joint
                continue
            put_dual(rows[r, first : first + PARAMETERS_PER_BODY], X)
            put_triangular_congruence(root, X, F, X)
            entry = first
            for i in range(4):
                out[r, entry] = share * X[i, i]
                for j in range(i):
                    out[r, entry + 1 + j] = share * _ROOT * X[i, j]
                entry += i + 1
    for k in range(len(places)):
        scale = (x[places[k]] - lower[k]) * np.sqrt(other_shares[k])
        for r in range(len(rows)):
            out[r, places[k]] = scale * rows[r, places[k]]


@inlined
def put_combination(rows: Array, multipliers: Array, share: float, M: Array) -> None:
    """Write 𝟙 − share Σ λ W (4, 4) for W (r, 10) of `calc_whitened`."""
    entry = 0
    for i in range(4):
        for j in range(-1, i):  # −1 stands for the diagonal
            value = 0.0
            for r in range(len(rows)):
                value += multipliers[r] * rows[r, entry]
            if j < 0:
                M[i, i] = 1.0 - share * value
            else:
                M[i, j] = M[j, i] = -share * value / _ROOT
            entry += 1


@compiled
def calc_spanned(
    x: Array, span: tuple[Array, Array], multipliers: Array, factors: Factors, out: Array
) -> None:
    """Write the point with the gradient ∇h(x) + Aᵀ λ; NaN where no such point exists.

    For a body, P⁺ = L (𝟙 − Σ λ W)⁻¹ Lᵀ from P⁻¹ − X(Aᵀ λ), with λ (r,), and L and W of
    `calc_whitened`. For a lower bound, the inverse slack is linear in λ.
    """
    (L, rows), (bodies, shares, places, lower, other_shares) = span, factors
    M, C, Y, P = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    for body in range(len(bodies)):
        first, last = bodies[body], bodies[body] + PARAMETERS_PER_BODY
        put_combination(rows[:, first:last], multipliers, np.sqrt(shares[body]), M)
        if not put_root(M, C) > 0.0:
            out[first:last] = np.nan
            continue
        # Y = C⁻¹ Lᵀ, and P = Yᵀ Y.
        for j in range(4):
            for i in range(4):
                value = L[body, j, i]
                for k in range(i):
                    value -= C[i, k] * Y[k, j]
                Y[i, j] = value / C[i, i]
        for i in range(4):
            for j in range(4):
                total = 0.0
                for k in range(4):
                    total += Y[k, i] * Y[k, j]
                P[i, j] = total
        put_parameters(P, out[first:last])
    for k in range(len(places)):
        at, value = places[k], 0.0
        for r in range(len(rows)):
            value += multipliers[r] * rows[r, at]
        ratio = 1.0 - np.sqrt(other_shares[k]) * value
        out[at] = lower[k] + (x[at] - lower[k]) / ratio if ratio > 0.0 else np.nan


def robot_span(x: Array, rows: Array, factors: Factors) -> MirrorSpan:
    """Return the mirror span of a robot's parameters x (..., n) along covectors (r, ..., n)."""
    flat, roots = x.ravel(), np.empty((len(factors[0]), 4, 4))
    whitened = np.empty((len(rows), x.size))
    calc_whitened(flat, rows.reshape(whitened.shape), factors, roots, whitened)

    def point(multipliers: Array) -> Array:
        y = np.empty(x.shape)
        calc_spanned(flat, (roots, whitened), contiguous(multipliers), factors, y.reshape(-1))
        return y

    return MirrorSpan(whitened @ whitened.T, point)


def factors_of(
    bodies: Sequence[tuple[int, float]], bounded: Sequence[tuple[int, float, float]]
) -> Factors:
    """Return factors for the compiled kernels.

    Args:
        bodies: Start of each body, and 1/w.
        bounded: Index of each other parameter, its lower bound, and 1/w.
    """
    starts, shares = np.reshape(np.array(bodies, float), (-1, 2)).T.copy()
    places, lower, other_shares = np.reshape(np.array(bounded, float), (-1, 3)).T.copy()
    return starts.astype(np.int64), shares, places.astype(np.int64), lower, other_shares
