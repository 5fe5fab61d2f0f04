"""Follow the central path of an entropic fit to its minimum, from anywhere inside."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geodrake.errors import IdentificationError
from geodrake.identification.newton_program import IDENTITY, WeightedProgram, smat, svec
from geodrake.identification.newton_step import Iterate, Linearization
from geodrake.inertia import Array

_STEPS, _PATIENCE, _HALVINGS = 100, 3, 8
_ROOM, _LEAST_ROOM = 0.02, 1e-5
"""Share of the way to the boundary that a step leaves, far from and close to the solution."""
_PUSH, _SLACK = 10.0, 0.1
"""Multipliers at the start, relative to the cost's slope, and least slack there."""
_SHORT, _BACK = 0.4, 0.7
"""Length below which a step is bad, and the share of the excess that is kept to go back."""
_FEASIBLE = 1e-9
_EXACT = 1e-11
"""Gap, relative to the smallest γ, from which one more step is exact to rounding."""
_QUADRATIC = 1e-4
"""Gap, relative to the smallest γ, below which Newton's method converges quadratically."""
_ROUNDING = 1e-16
"""Gap, relative to the cost, below which there is only rounding."""
_GOOD = 1e-9
"""Gap, relative to the cost, that will do when rounding leaves no way further."""
_ACTIVE = 1e-3
"""Slack, relative to the coordinates, below which an inequality counts as active at a start."""
_LEAST_EIGENVALUE = 1e-9
"""Eigenvalue of P(φ⁰)⁻¹ P(φ) to which a warm start is lifted."""
_WELL_INSIDE = 0.1
"""Least product S Z of a warm start, relative to γ."""
_LIFT = 1e-2
"""Share of the smallest weight to which a warm start lifts the products s λ."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Minimum of a `WeightedProgram`.

    Attributes:
        weighted: The program.
        point: The minimum with its multipliers.
        steps: Newton steps that were taken.
        gap: Bound on how much lower the cost was before the last step, to first order.
        linearization: The conditions next to the point.
    """

    weighted: WeightedProgram
    point: Iterate
    steps: int
    gap: float
    linearization: Linearization

    @property
    def excess(self) -> float:
        """Squared residual beyond the least of any parameters."""
        return self.weighted.program.excess(self.point.z)

    def derivative(self) -> float:
        """Derivative of the squared residual by the logarithm of the prior's weight."""
        data, z = self.weighted.program.data, self.point.z
        errors = data @ np.append(z, -1.0)
        return float(2.0 * errors @ (data[:, :-1] @ self.linearization.tangent()))


def minimize(weighted: WeightedProgram, start: Iterate) -> Minimum:
    """The minimum of a program, by damped Newton steps that stay strictly inside.

    Args:
        weighted: The program.
        start: A point with positive definite S and Z and positive slacks and multipliers.

    Raises:
        IdentificationError: The constraints contradict each other, or rounding got in the way.
    """
    best: Minimum | None = None
    gamma = weighted.least_weight
    stalled = 0
    here, last = _linearized(weighted, start), start
    for count in range(_STEPS):
        if here is None:
            break
        last, gap, cost = here.at, _gap(here), weighted.cost(here.at.z)
        feasible = _feasible(here)
        stalled += 1
        if feasible and (best is None or gap < best.gap):
            stalled = 0 if best is None or gap < 0.5 * best.gap else stalled
            best = Minimum(weighted, here.at, count, gap, here)
        if feasible and gap <= max(_EXACT * gamma, min(_QUADRATIC * gamma, _ROUNDING * cost)):
            break
        if best is not None and stalled > _PATIENCE and best.gap <= _GOOD * cost:
            break
        here = _next(here)
    if best is None or best.gap > _GOOD * max(weighted.cost(best.point.z), weighted.total_weight):
        raise _failure(weighted, last)
    if best.gap > _QUADRATIC * gamma:
        return best
    # One more step on the factor at hand, which nearly squares the error that is left.
    step = best.linearization.direction(0.0)
    length = min(1.0, (1.0 - _LEAST_ROOM) * best.linearization.reach(step))
    return replace(best, point=best.point.moved(step.step, length))


def _linearized(weighted: WeightedProgram, point: Iterate) -> Linearization | None:
    """The conditions at a point; None where rounding has put it at the boundary."""
    try:
        return Linearization(weighted, point)
    except np.linalg.LinAlgError:
        return None


def _gap(here: Linearization) -> float:
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return here.gap()
    except FloatingPointError:
        return np.inf


def _next(here: Linearization) -> Linearization | None:
    """The conditions one step further; None where rounding leaves no way.

    Multipliers of constraints that contradict each other grow until they overflow.
    """
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return _stepped(here)
    except FloatingPointError:
        return None


def _stepped(here: Linearization) -> Linearization | None:
    """The conditions after a predictor and a corrector; None where rounding leaves no way."""
    excess = here.excess()
    predictor = here.direction(0.0)
    length = min(1.0, (1.0 - _LEAST_ROOM) * here.reach(predictor))
    ratio = min(1.0, here.excess(predictor, length) / excess) if excess > 0 else 0.0
    step = here.direction(ratio**3 * excess, predictor)
    reach = here.reach(step)
    if reach < _SHORT:
        # Second-order terms can mislead far from the path; go back towards it.
        back = here.direction(_BACK * excess)
        step, reach = max((step, reach), (back, here.reach(back)), key=lambda pair: pair[1])
    # The closer to the solution, the closer to the boundary a step may end.
    room = min(_ROOM, max(ratio, _LEAST_ROOM))
    length = min(1.0, (1.0 - room) * reach)
    for _ in range(_HALVINGS):
        there = _linearized(here.weighted, here.at.moved(step.step, length))
        if there is not None:
            return there
        length *= 0.5  # Rounding was more than the room.
    return None


def _feasible(here: Linearization) -> bool:
    scale = 1.0 + np.abs(here.at.z).max(initial=0.0)
    worst = max(
        np.abs(here.slack_error).max(initial=0.0), np.abs(here.equality_error).max(initial=0.0)
    )
    return bool(worst <= _FEASIBLE * scale)


def cold_start(weighted: WeightedProgram) -> Iterate:
    """The prior, with multipliers larger than all slopes of the cost there."""
    program = weighted.program
    z = program.middle()
    slope = weighted.slope(z)
    slope[program.blocks] -= weighted.gamma[:, None] * IDENTITY
    G, h = program.inequalities
    slack = G @ z - h
    push = _PUSH * float(np.abs(slope).max(initial=0.0))
    if np.any(slack < 0):
        push = max(push, float(weighted.gamma.max(initial=0.0)))
    push = push or 1.0
    # Columns of scalars have unit length, so a scalar moves about as far as the error is large.
    error = np.linalg.norm(weighted.factor @ z - weighted.target)
    scalars = np.ones(program.size)
    scalars[program.blocks] = 0.0
    slack = np.maximum(slack, _SLACK * (1.0 + error * np.linalg.norm(G * scalars, axis=1)))
    Z = (weighted.gamma + push)[:, None, None] * np.eye(4)
    multipliers = (push + weighted.targets) / slack
    return Iterate(z, Z, slack, multipliers, np.zeros(len(program.equalities[1])))


def warm_start(weighted: WeightedProgram, z: Array) -> Iterate:
    """A start at coordinates (p,) near the minimum; their blocks may be at the boundary.

    Args:
        weighted: The program, with the weight to solve it for.
        z: (p,) coordinates.
    """
    program = weighted.program
    z = program.lifted(z, _LEAST_EIGENVALUE)
    S, slope = program.matrices(z), weighted.slope(z)
    G, h = program.inequalities
    slack = G @ z - h
    entropic = weighted.targets > 0
    multipliers = np.zeros(len(slack))
    multipliers[entropic] = weighted.targets[entropic] / slack[entropic]
    # What the slope has beyond γ S⁻¹ is for the active inequalities and the equalities.
    rest = slope - G.T @ multipliers
    inverse = np.asarray(np.linalg.inv(S), float)
    rest[program.blocks] -= weighted.gamma[:, None] * svec(inverse)
    near = ~entropic & (slack < _ACTIVE * (1.0 + np.abs(z).max(initial=0.0)))
    E = program.equalities[0]
    known = np.linalg.lstsq(np.vstack([G[near], E]).T, rest)[0]
    forces = known[np.count_nonzero(near) :]
    push = _LIFT * min(weighted.least_weight, 1.0)
    multipliers[near] = known[: np.count_nonzero(near)]
    slope = slope - G.T @ multipliers - E.T @ forces
    held = ~entropic & (np.maximum(multipliers, 0.0) > push / _ACTIVE)
    free = np.where(entropic, slack, np.maximum(slack, _ACTIVE))
    slack = np.where(held, push / np.where(held, multipliers, 1.0), free)
    multipliers = np.where(held | entropic, multipliers, push / slack)
    # The slope that is left would be svec(Z) at the minimum; products S Z are kept positive.
    root = np.linalg.cholesky(S)
    turned = np.swapaxes(root, 1, 2)
    values, vectors = np.linalg.eigh(turned @ smat(slope[program.blocks]) @ root)
    products = np.maximum(values, _WELL_INSIDE * weighted.gamma[:, None])
    half = np.linalg.solve(turned, vectors)
    Z = half * products[:, None, :] @ np.swapaxes(half, 1, 2)
    return Iterate(z, Z, slack, multipliers, forces)


def continued(minimum: Minimum, weighted: WeightedProgram) -> Iterate:
    """A start from the minimum of the same program with another weight.

    Args:
        minimum: The minimum for another weight.
        weighted: The program, with the weight to solve it for.
    """
    point, before = minimum.point, minimum.weighted.gamma[:, None]
    gamma = weighted.gamma[:, None]
    # Z takes up the new slope of γ tr S, as long as it stays well inside: only S Z is then wrong.
    values, vectors = np.linalg.eigh(weighted.program.matrices(point.z))
    duals = np.maximum(before / values + gamma - before, _WELL_INSIDE * gamma / values)
    Z = vectors * duals[:, None, :] @ np.swapaxes(vectors, 1, 2)
    push = _LIFT * min(weighted.least_weight, 1.0)
    s, entropic = point.slack, weighted.targets > 0
    raised = minimum.weighted.targets / s + weighted.targets - minimum.weighted.targets
    y = np.where(
        entropic, np.maximum(raised, _WELL_INSIDE * weighted.targets / s), point.multipliers
    )
    # Products of nothing would hold the next steps at the boundary that is active here.
    active = ~entropic & (s * weighted.gamma.max(initial=1.0) < y)
    slack = np.where(active, np.maximum(s, push / y), s)
    multipliers = np.where(active | entropic, y, np.maximum(y, push / s))
    return Iterate(point.z, Z, slack, multipliers, point.forces)


def _failure(weighted: WeightedProgram, point: Iterate) -> IdentificationError:
    program = weighted.program
    G, h = program.inequalities
    E, e = program.equalities
    missed = float(
        max((h - G @ point.z).max(initial=0.0), np.abs(E @ point.z - e).max(initial=0.0))
    )
    if missed > 1e-7 * (1.0 + np.abs(point.z).max(initial=0.0)):
        cause = "The bounds and constraints contradict each other for physical bodies."
        advice = "Widen the bounds, check the ellipsoids' sign and the total mass."
    else:
        cause = "Most often the data and the prior differ by very many orders of magnitude."
        advice = "Check units and noise levels, raise gamma, or use the solver clarabel."
    return IdentificationError(
        f"newton found no parameters. {cause}", advice=advice, solver="newton", violation=missed
    )
