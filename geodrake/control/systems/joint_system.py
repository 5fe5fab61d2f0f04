"""Systems of all scalar types that have one number of each kind for every joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext

import numpy as np
from numpy.typing import ArrayLike
from pydrake.symbolic import Expression
from pydrake.systems.framework import Context

from geodrake.boundary.arguments import real_array
from geodrake.model.formulas.evaluation import Scalars, evaluated
from geodrake.model.formulas.symbols import Symbols
from geodrake.model.simulation.scalar_system import ScalarSystem


def count_of(value: ArrayLike, name: str) -> int:
    """How many joints there are, by numbers (n,) or the one number of the only joint.

    Raises:
        ArgumentError: It is no such array.
    """
    numbers = real_array(value, name)
    return len(numbers) if numbers.ndim == 1 else len(real_array([value], name, ("n",)))


class JointSystem(ScalarSystem):
    """Numeric parameters of the Context with names, (n,) each; laws in functions of NumPy's."""

    def _declare_numbers(self, numbers: Mapping[str, Scalars]) -> None:
        self._named, self._count = tuple(numbers), len(next(iter(numbers.values())))
        for values in numbers.values():
            self.DeclareNumericParameter(self._vector(values))

    def _numbers(self, context: Context) -> dict[str, Scalars]:
        """The parameters by name."""
        return {
            name: np.asarray(context.get_numeric_parameter(i).CopyToVector())
            for i, name in enumerate(self._named)
        }

    def _set_numbers(self, context: Context, values: Mapping[str, Scalars]) -> None:
        for name, own in values.items():
            parameter = context.get_mutable_numeric_parameter(self._named.index(name))
            self._set(parameter, own)

    def _apply(self, law: Callable[..., Scalars], *inputs: Scalars) -> Scalars:
        """What a law makes of arrays (n,), of floats or of the system's scalar type."""
        if self._of is float:
            return law(*inputs)
        named = {f"x{i}": values for i, values in enumerate(inputs)}
        symbols = (Symbols.inputs(name, len(values)) for name, values in named.items())
        # (Drake's symbols raise flags of floating point that say nothing.)
        with np.errstate(invalid="ignore") if self._of is Expression else nullcontext():
            return evaluated(law(*symbols), named, self._of)
