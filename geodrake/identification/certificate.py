"""What the MathematicalProgram of a fit says of the reported parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Scope = Literal["global", "local"]

TOLERANCE = 1e-6
"""How far a fit may be above the solver's cost, and that above the least, as shares of the cost.

It is also the greatest violation of a constraint.
"""


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What the MathematicalProgram of a fit says of the reported parameters.

    Attributes:
        solver: The conic solver that solved the program.
        gap: How far the cost of the reported parameters is above its minimum at most: their
            difference from the solver's solution, and the duality gap of that. inf if the solver
            found no solution.
        cost: Size of the cost, in the same unit: with whitened data, that of squared deviations.
        violation: How far the reported parameters are outside the program's constraints (P ⪰ 0,
            bounds, ellipsoids, masses, residual) at most, in its dimensionless variables.
        scope: "global" of a convex program; "local" where a distance that is not convex was
            replaced by its second order at the reported parameters, so that they are certified
            as a local minimum.
        replaced: Whether the reported parameters are the solver's, as the fit itself was worse.
        failure: Why the solver found no solution; empty if it did.
    """

    solver: str
    gap: float
    cost: float
    violation: float
    scope: Scope = "global"
    replaced: bool = False
    failure: str = ""

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the cost."""
        return self.gap / self.cost

    @property
    def holds(self) -> bool:
        """Whether both parts of the gap and the violation are within `TOLERANCE`."""
        return self.relative_gap <= 2.0 * TOLERANCE and self.violation <= TOLERANCE

    @property
    def words(self) -> str:
        """The certificate in a line."""
        if self.failure:
            return f"{self.solver} could not certify the fit: {self.failure}"
        least = "a local minimum" if self.scope == "local" else "the least"
        near = f"its cost is within {self.relative_gap:.0e} of {least}"
        if not self.holds:
            kept = f"constraints are kept to {self.violation:.0e}"
            return f"the fit is not certified by {self.solver}: {near}, and {kept}"
        how = "that of" if self.replaced else "certified by"
        return f"the fit is {how} {self.solver}: {near}, bodies are physical, and bounds are kept"
