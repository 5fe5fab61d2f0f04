"""Symbolic efforts, recorded by running NumPy code on symbols.

The columns of effects and the efforts of rigid bodies are NumPy code. With arrays of symbols
instead of numbers, the same code yields its formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from geodrake.compiling import interpreted
from geodrake.effects import Effect, RobotMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.column_checks import line_of
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import (
    Samples,
    calc_acceleration,
    calc_inverse_dynamics,
    calc_kinematics,
)

Operand = Any
"""A `Symbol`, or a number."""

Formulas = NDArray[Any]
"""An array of symbols and numbers."""

_ALIASES = {  # NumPy's aliases of operations
    "true_divide": "divide",
    "float_power": "power",
    "fabs": "absolute",
    "fmax": "maximum",
    "fmin": "minimum",
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "invert": "logical_not",
    "mod": "remainder",
}
_UNARY = (
    *("negative", "absolute", "sign", "sqrt", "cbrt", "exp", "expm1", "log", "log1p", "log10"),
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("arcsinh", "arccosh", "arctanh", "floor", "ceil", "logical_not"),
)
_BINARY = (
    *("add", "subtract", "multiply", "divide", "power", "remainder", "fmod", "arctan2", "hypot"),
    *("maximum", "minimum", "greater", "greater_equal", "less", "less_equal", "equal"),
    *("not_equal", "logical_and", "logical_or"),
)
_COMMUTING = ("add", "multiply", "maximum", "minimum", "equal", "not_equal")
OPERATIONS = frozenset((*_UNARY, *_BINARY, "where"))
"""Operations that can be recorded; `where` takes a condition and both values."""

_COMPOSED: dict[str, Callable[..., Operand]] = {  # compositions of other operations
    "square": lambda x: x * x,
    "reciprocal": lambda x: 1.0 / x,
    "positive": lambda x: x,
    "conjugate": lambda x: x,
    "exp2": lambda x: record("power", 2.0, x),
    "deg2rad": lambda x: x * (np.pi / 180.0),
    "radians": lambda x: x * (np.pi / 180.0),
    "rad2deg": lambda x: x * (180.0 / np.pi),
    "degrees": lambda x: x * (180.0 / np.pi),
    "clip": lambda x, low, high: record("minimum", record("maximum", x, low), high),
    "heaviside": lambda x, at: record(
        "where", record("equal", x, 0.0), at, record("where", record("greater", x, 0.0), 1.0, 0.0)
    ),
}

_OF_EQUAL_OPERANDS: dict[str, Callable[[Operand], Operand]] = {
    "add": lambda x: record("multiply", 2.0, x),
    "subtract": lambda x: 0.0,
}


def record(name: str, *operands: Operand) -> Operand:
    """Return an operation, by NumPy's name; a number if no operand is a symbol."""
    name = _ALIASES.get(name, name)
    if name in _COMPOSED:
        return _COMPOSED[name](*operands)
    if name not in OPERATIONS:
        raise ArgumentError(
            f"numpy.{name} cannot be written as source code.",
            advice=f"Use {', '.join(sorted(OPERATIONS))}.",
        )
    if not any(isinstance(x, Symbol) for x in operands):
        return getattr(np, name)(*operands).item()
    operands = tuple(x if isinstance(x, Symbol) else float(x) for x in operands)
    if name in _OF_EQUAL_OPERANDS and operands[0] is operands[1]:
        return _OF_EQUAL_OPERANDS[name](operands[0])
    simpler = _simplified(name, operands)
    return Symbol.known(name, operands) if simpler is None else simpler


def _simplified(name: str, operands: tuple[Operand, ...]) -> Operand | None:
    """Return the simplified result of an operation, such as with an operand 0 or 1, or None."""
    first, last = operands[0], operands[-1]
    result = None
    match name, *operands:
        case ("add" | "subtract", _, 0.0) | ("multiply" | "divide" | "power", _, 1.0):
            result = first
        case ("add", 0.0, _) | ("multiply", 1.0, _):
            result = last
        case ("multiply", 0.0, _) | ("multiply", _, 0.0) | ("divide", 0.0, _):
            result = 0.0
        case ("subtract", 0.0, _) | ("multiply", -1.0, _):
            result = record("negative", last)
        case ("multiply" | "divide", _, -1.0):
            result = record("negative", first)
        case ("power", _, 2.0):
            result = first * first
        case ("power", _, 3.0):
            result = first * first * first
        case ("where", float(), _, _):
            result = operands[1] if first else last
        case ("negative", Symbol(operation="negative")):
            result = first.operands[0]
        case ("multiply", float(), Symbol(operation="multiply", operands=(float() as own, other))):
            result = record("multiply", first * own, other)
        case ("add" | "subtract", _, Symbol(operation="negative")):
            result = record("subtract" if name == "add" else "add", first, last.operands[0])
    return result


@dataclass(frozen=True, eq=False)
class Symbol(NDArrayOperatorsMixin):
    """An unknown number: an input or the result of an operation."""

    operation: str  # NumPy's name of the operation, or "input"
    operands: tuple[Operand, ...]  # symbols and floats; name and index of an input

    __hash__, __eq__, __ne__ = object.__hash__, object.__eq__, object.__ne__

    @classmethod
    def known(cls, operation: str, operands: tuple[Operand, ...]) -> Symbol:
        """Return the unique symbol of an operation on operands."""
        keys = [x if isinstance(x, Symbol) else str(x) for x in operands]
        if operation in _COMMUTING:
            keys.sort(key=lambda x: (isinstance(x, str), id(x)))
        key = (operation, *keys)
        symbol = _SYMBOLS.get(key)
        if symbol is None:
            symbol = _SYMBOLS[key] = cls(operation, operands)
        return symbol

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Operand, **options: Any
    ) -> Operand:
        """Record a NumPy function; `x += …` does not change the original symbol."""
        if options.get("out", (None,))[0] is self:
            del options["out"]
        return _recorded(ufunc, method, inputs, options)

    def __getattr__(self, name: str) -> Callable[[], Operand]:
        """Return the method that NumPy calls for a function of an object array."""
        if name in _UNARY or name in _COMPOSED:
            return lambda: record(name, self)
        raise AttributeError(name)

    def __repr__(self) -> str:
        """Return a short form, as there may be thousands of operands."""
        return f"<{self.operation}>"

    def __bool__(self) -> bool:
        raise ArgumentError(
            "It branches on an unknown value, as `if`, `max` or a boolean index do.",
            advice="Use NumPy functions on whole arrays, such as np.where.",
        )

    def __float__(self) -> float:
        raise ArgumentError(
            "It needs the value of an unknown.",
            advice="Use NumPy functions on whole arrays, not those of `math`.",
        )


_SYMBOLS: WeakValueDictionary[tuple[Any, ...], Symbol] = WeakValueDictionary()
"""(Operation, operands) -> symbol."""


def in_order(formulas: Iterable[Operand]) -> Iterator[Symbol]:
    """Yield each symbol of formulas once, operands first, without recursion."""
    pending, visited = [x for x in formulas if isinstance(x, Symbol)][::-1], set[Symbol]()
    while pending:
        symbol = pending[-1]
        operands = () if symbol.operation == "input" or symbol in visited else symbol.operands
        waiting = [x for x in operands if isinstance(x, Symbol) and x not in visited]
        pending += waiting
        if not waiting:
            pending.pop()
            if symbol not in visited:
                visited.add(symbol)
                yield symbol


class Symbols(np.ndarray):
    """An array of symbols and numbers, on which NumPy operations are recorded."""

    @classmethod
    def of(cls, values: Any) -> Symbols:
        """Return an array of symbols and numbers in nested sequences or an array."""
        return np.array(values, object).view(cls)

    @classmethod
    def inputs(cls, name: str, count: int) -> Symbols:
        """Return (count,) inputs of a function: the entries of a named array."""
        return cls.of([Symbol("input", (name, k)) for k in range(count)])

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Operand, **options: Any
    ) -> Operand:
        """Record a NumPy function entry by entry."""
        return _recorded(ufunc, method, inputs, options)

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        """Run other NumPy functions, but record `where`."""
        if func is np.where and len(args) == 3:
            return _entrywise("where", args)
        found = super().__array_function__(func, types, args, kwargs)
        return _as_symbols(found)


def _recorded(
    ufunc: np.ufunc, method: str, inputs: Sequence[Operand], options: dict[str, Any]
) -> Operand:
    out = options.pop("out", None)
    if method == "__call__" and ufunc.signature is None:
        result = _entrywise(ufunc.__name__, inputs)
    else:  # reductions and matrix products, which call this again for their entries
        plain = [np.asarray(x, object) if isinstance(x, np.ndarray) else x for x in inputs]
        result = _as_symbols(getattr(ufunc, method)(*plain, **options))
    if out is None:
        return result
    out[0][...] = result
    return out[0]


def _entrywise(name: str, inputs: Sequence[Operand]) -> Operand:
    function = np.frompyfunc(lambda *x: record(name, *x), len(inputs), 1)
    boxed = [_boxed(x) for x in inputs]
    return _as_symbols(function(*boxed))


def _boxed(x: Operand) -> Any:
    """Return an operand in a plain object array."""
    box = np.empty((), object)
    if isinstance(x, Symbol):
        box[()] = x
        return box
    return np.asarray(np.asarray(x), object)


def _as_symbols(found: Any) -> Any:
    if isinstance(found, np.ndarray) and found.dtype == object:
        return found.view(Symbols)
    return found


def recorded_rows(effect: Effect, motion: RobotMotion) -> Mapping[str, Formulas]:
    """Return joint -> steady-state columns (k,) of an effect for one sample of symbols."""
    try:
        rows: Any = effect.formula_rows(motion)
        count = len(effect.parameters)
        return {joint: np.asarray(x, object).reshape(count) for joint, x in rows.items()}
    except Exception as error:  # NumPy may raise any type for symbols
        line = line_of(type(effect), "columns", "rows", "formula_rows")
        problem = error.problem if isinstance(error, ArgumentError) else str(error)
        raise ModelError(
            f"{effect.name} of {effect.place} works with numbers only{line}, so it cannot be "
            f"written as source code: {problem}",
            advice=getattr(error, "advice", None)
            or "Use NumPy functions on whole arrays, or define formula_rows.",
        ) from error


_DIGITS = 15  # of rotations, to remove rounding errors of zeros and ones


def joint_formulas(tree: KinematicTree, q: Formulas) -> Formulas:
    """Return positions of the tree's joints as formulas of the robot's positions (nq)."""
    if (actuation := tree.actuation) is None:
        return q
    if actuation.constant is None:
        raise ModelError(
            "Source code cannot contain a closed loop, or a transmission with varying ratio.",
            advice="Export the formula of the joints, and map it in your own code.",
        )
    return q @ actuation.constant.T + actuation.offset


def _empty_symbols(shape: Any, dtype: np.dtype[Any] | None = None) -> Any:
    """Return an empty object array of symbols, in place of compiled code's arrays of numbers."""
    if dtype is None:
        return np.empty(shape, object)
    fields = [(name, object, dtype[name].shape) for name in dtype.names or ()]
    return np.recarray(shape, fields)


_OBJECT_NUMPY = SimpleNamespace(empty=_empty_symbols, cos=np.cos, sin=np.sin, sqrt=np.sqrt)
_inverse_dynamics = interpreted(calc_inverse_dynamics, np=_OBJECT_NUMPY)
_kinematics = interpreted(calc_kinematics, np=_OBJECT_NUMPY)
_acceleration = interpreted(calc_acceleration, np=_OBJECT_NUMPY)


def _records(tree: KinematicTree) -> tuple[Any, Any]:
    """Return the tree's records for interpreted code."""
    mobilizers, dofs = tree.records
    plain = mobilizers.copy()
    plain["rotation"] = np.round(plain["rotation"], _DIGITS) + 0.0
    return plain.view(np.recarray), dofs


def inverse_dynamics_formula(
    tree: KinematicTree, q: Formulas, v: Formulas, vd: Formulas, phi: Array
) -> Formulas:
    """Return the effort (nv,) of bodies φ (nb, 10), at the actuators if there are any."""
    theta, J = joint_formulas(tree, q), _jacobian(tree)
    theta, rates, accelerations = (np.array([x], object) for x in (theta, J @ v, J @ vd))
    effort = np.zeros((1, len(J)), object)
    samples = theta, rates, rates, accelerations
    _inverse_dynamics(_records(tree.joints), samples, phi, effort)
    return Symbols.of(J.T @ effort[0])


def _jacobian(tree: KinematicTree) -> Array:
    """Return the Jacobian (joints, nv), which must be constant."""
    J = None if tree.actuation is None else tree.actuation.constant
    return np.eye(tree.num_velocities) if J is None else J


@dataclass(frozen=True, eq=False)
class BodyFormulas(RobotBodies):
    """The bodies of a robot in a symbolic configuration; `q` is (1, nq)."""

    def tree_samples(self, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Return positions, velocities and accelerations (1, ·) of the tree's joints, and J."""
        theta = joint_formulas(self.tree, Symbols.of(self.q)[0])
        J = _jacobian(self.tree)
        rates, accelerations = (Symbols.of([J @ x[0]]) for x in (v, vd))
        return theta[None], rates, accelerations, J[None]

    def last_acceleration(self, tree: KinematicTree, samples: Samples) -> tuple[Array, Array]:
        """Return the angular acceleration of a tree's last body, and that of Bo, (1, 3), in B."""
        q, v, _, vd = (np.array(x, object) for x in samples)
        angular, linear = np.zeros((2, 1, 3), object)
        _acceleration(_records(tree), (q, v, v, vd), angular, linear)
        return Symbols.of(angular), Symbols.of(linear)

    def kinematics(self, tree: KinematicTree) -> tuple[Array, Array, Array]:
        """Return the pose and Jacobians of a tree's only body, for velocities of the joints."""
        q = np.array([joint_formulas(self.tree, Symbols.of(self.q)[0])], object)
        poses = np.zeros((1, 1, 4, 4), object)
        angular, linear = np.zeros((2, 1, 1, 3, tree.num_velocities), object)
        _kinematics(_records(tree), q, poses, angular, linear)
        return Symbols.of(poses), Symbols.of(angular), Symbols.of(linear)
