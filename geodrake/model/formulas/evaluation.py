"""Recorded formulas evaluated with numbers of any scalar type of Drake's."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pydrake.math
from numpy.typing import NDArray
from pydrake import symbolic
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression

from geodrake.model.formulas.symbols import Formulas, Symbol, in_order

Scalars = NDArray[Any]
"""An array of floats, or of one of Drake's other scalar types."""

_DRAKES = {  # NumPy's name -> that in pydrake.math
    **{name: name for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: f"a{name[3:]}" for name in ("arcsin", "arccos", "arctan")},
    **{"absolute": "abs", "maximum": "max", "minimum": "min", "arctan2": "atan2"},
}
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    **{"negative": operator.neg, "add": operator.add, "subtract": operator.sub},
    **{"multiply": operator.mul, "divide": operator.truediv},
    **{"greater": operator.gt, "greater_equal": operator.ge, "less": operator.lt},
    **{"less_equal": operator.le, "equal": operator.eq, "not_equal": operator.ne},
}
_OF_OTHERS: Mapping[str, Callable[..., Any]] = {  # by functions that they have
    "power": lambda f, x, y: x**y if isinstance(y, float) else f("exp", y * f("log", x)),
    "cbrt": lambda f, x: f("sign", x) * f("absolute", x) ** (1.0 / 3.0),
    "expm1": lambda f, x: f("exp", x) - 1.0,
    "log1p": lambda f, x: f("log", 1.0 + x),
    "log10": lambda f, x: f("log", x) * (1.0 / np.log(10.0)),
    "arcsinh": lambda f, x: f("log", x + f("sqrt", x * x + 1.0)),
    "arccosh": lambda f, x: f("log", x + f("sqrt", x * x - 1.0)),
    "arctanh": lambda f, x: 0.5 * f("log", (1.0 + x) / (1.0 - x)),
    "hypot": lambda f, x, y: f("sqrt", x * x + y * y),
    "sign": lambda f, x: f("where", x > 0.0, 1.0, f("where", x < 0.0, -1.0, 0.0)),
    "remainder": lambda f, x, y: x - f("floor", x / y) * y,
    "fmod": lambda f, x, y: x - f("where", x / y >= 0.0, f("floor", x / y), f("ceil", x / y)) * y,
}


def evaluated(formulas: Formulas, inputs: Mapping[str, Scalars], scalar: type) -> Scalars:
    """Return the values of formulas in the same shape, all of a scalar type.

    Args:
        inputs: Name -> its values, for the inputs that the formulas are of; some may be floats.
    """
    apply = _AUTODIFF if scalar is AutoDiffXd else _SYMBOLIC
    flat, known = np.asarray(formulas, object).ravel(), dict[Symbol, Any]()
    for node in in_order(flat):
        if node.operation == "input":
            name, place = node.operands
            known[node] = inputs[name][place]
        else:
            operands = (known[x] if isinstance(x, Symbol) else x for x in node.operands)
            known[node] = apply(node.operation, *operands)
    values = [known[x] if isinstance(x, Symbol) else x for x in flat]
    found = np.empty(len(flat), object)
    found[:] = [x if isinstance(x, scalar) else scalar(x) for x in values]
    return found.reshape(np.shape(formulas))


def _applied(scalar: type, own: Mapping[str, Callable[..., Any]]) -> Any:
    """A function that applies operations by name to numbers of a scalar type, or to floats."""

    def apply(name: str, *operands: Any) -> Any:
        if name in own:
            return own[name](*operands)
        if not any(isinstance(x, scalar) for x in operands):
            return getattr(np, name)(*operands)
        if name in _OPERATORS:
            return _OPERATORS[name](*operands)
        if name in _DRAKES:
            each = [x if isinstance(x, scalar) else scalar(x) for x in operands]
            return getattr(pydrake.math, _DRAKES[name])(*each)
        return _OF_OTHERS[name](apply, *operands)

    return apply


def _value(x: Any) -> float:
    return float(x.value()) if isinstance(x, AutoDiffXd) else float(x)


def _root(x: Any) -> Any:
    """√x; of what is zero and stays so, as a speed at rest squared, no slope."""
    if not isinstance(x, AutoDiffXd):
        return np.sqrt(x)
    return 0.0 if x.value() == 0.0 and not x.derivatives().any() else pydrake.math.sqrt(x)


def _if_then_else(condition: Any, first: Any, last: Any) -> Any:
    if isinstance(condition, symbolic.Formula):
        each = (x if isinstance(x, Expression) else Expression(x) for x in (first, last))
        return symbolic.if_then_else(condition, *each)
    return first if condition else last


def _formula(x: Any) -> symbolic.Formula:
    if isinstance(x, symbolic.Formula):
        return x
    return symbolic.Formula.True_() if x else symbolic.Formula.False_()


_AUTODIFF = _applied(
    AutoDiffXd,
    {
        "sqrt": _root,
        "where": lambda condition, first, last: first if condition else last,
        "logical_and": lambda x, y: bool(x) and bool(y),
        "logical_or": lambda x, y: bool(x) or bool(y),
        "logical_not": lambda x: not x,
        "floor": lambda x: float(np.floor(_value(x))),
        "ceil": lambda x: float(np.ceil(_value(x))),
        "sign": lambda x: float(np.sign(_value(x))),
    },
)
_SYMBOLIC = _applied(
    Expression,
    {
        "where": _if_then_else,
        "logical_and": lambda x, y: symbolic.logical_and(_formula(x), _formula(y)),
        "logical_or": lambda x, y: symbolic.logical_or(_formula(x), _formula(y)),
        "logical_not": lambda x: symbolic.logical_not(_formula(x)),
        "floor": lambda x: symbolic.floor(Expression(x)),
        "ceil": lambda x: symbolic.ceil(Expression(x)),
    },
)
