"""How operations are written in Python and in C++."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.errors import ModelError

_INFIX = {
    "add": "+",
    "subtract": "-",
    "multiply": "*",
    "divide": "/",
    "greater": ">",
    "greater_equal": ">=",
    "less": "<",
    "less_equal": "<=",
    "equal": "==",
    "not_equal": "!=",
}
_FUNCTIONS = {  # of C and of Python's math, where the name is not NumPy's
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
    "arctan2": "atan2",
    "arcsinh": "asinh",
    "arccosh": "acosh",
    "arctanh": "atanh",
    "power": "pow",
}


@dataclass(frozen=True)
class Language:
    """A language that formulas are written in.

    Attributes:
        module: What stands before the names of mathematical functions.
        own: Operations that are written in a way of their own, as formats of their operands.
    """

    module: str
    own: Mapping[str, str]

    def operation(self, name: str, operands: tuple[str, ...]) -> str:
        """An operation on operands that are written already.

        Args:
            name: NumPy's name of it.
            operands: Its operands; of an input, its name and place.
        """
        if name in self.own:
            return self.own[name].format(*operands)
        if name == "input":
            return f"{operands[0]}[{operands[1]}]"
        if name in _INFIX:
            return f"({operands[0]} {_INFIX[name]} {operands[1]})"
        if name == "negative":
            return f"(-{operands[0]})"
        return f"{self.module}{_FUNCTIONS.get(name, name)}({', '.join(operands)})"

    def number(self, value: float) -> str:
        """A number with all its digits.

        Raises:
            ModelError: It is not finite.
        """
        if not np.isfinite(value):
            raise ModelError(
                f"The formula of the effort has {value:g} in it, which is no number.",
                advice="Leave the effect out that uses what is not known, such as the position of "
                "a joint of several degrees.",
            )
        return repr(float(value)) if value >= 0.0 else f"({float(value)!r})"


PYTHON = Language(
    "math.",
    {
        "absolute": "abs({0})",
        "maximum": "max({0}, {1})",
        "minimum": "min({0}, {1})",
        "sign": "sign({0})",
        "where": "({1} if {0} else {2})",
        "remainder": "({0} % {1})",
        "logical_and": "bool({0} and {1})",
        "logical_or": "bool({0} or {1})",
        "logical_not": "(not {0})",
    },
)

CPP = Language(
    "std::",
    {
        "absolute": "std::abs({0})",
        "maximum": "std::fmax({0}, {1})",
        "minimum": "std::fmin({0}, {1})",
        "sign": "sign({0})",
        "where": "({0} ? {1} : {2})",
        "remainder": "floored_remainder({0}, {1})",
        "logical_and": "({0} && {1})",
        "logical_or": "({0} || {1})",
        "logical_not": "(!{0})",
    },
)
