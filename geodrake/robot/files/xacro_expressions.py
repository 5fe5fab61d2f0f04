"""Expressions in xacro files: Python's, of values and known functions alone, and within bounds.

Each is a syntax tree that is walked here. Nothing is handed to Python's `eval`, as whoever reaches
one class or function there reaches all of them. The standard library alone is imported: the process
that expands a file loads nothing else.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from copy import copy
from functools import partial
from itertools import islice
from typing import Any, NoReturn, Protocol

_MOST = 100_000  # letters of a text, values of a list
_MOST_BITS = 10_000  # of an integer
_WITHHELD = ("type", "vars")  # which give classes, and what they are made of
_WRITTEN = {ast.Lambda: "a lambda", ast.NamedExpr: "an assignment", ast.Await: "await"}
_DATA = (str, list, dict, tuple, set, frozenset, int, float, complex)  # which have methods
_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}


class Names(Protocol):
    """Name -> value; the value may be found only when it is asked for."""

    def __getitem__(self, name: str, /) -> Any: ...


class NamesWithin:
    """Names, and those around them.

    Args:
        inner: The names that come first; `KeyError` is raised for others.
    """

    def __init__(self, inner: Names, outer: Names) -> None:
        self._inner, self._outer = inner, outer

    def __getitem__(self, name: str) -> Any:
        try:
            return self._inner[name]
        except KeyError:
            return self._outer[name]


class RefusedError(BaseException):
    """An expression asks for more than values; no Exception, as xacro catches and wraps those."""


def withhold(symbols: MutableMapping[str, Any]) -> None:
    """Put refusals in the place of functions that lead further than to values."""
    for name in _WITHHELD:
        symbols[name] = partial(_refuse, name)


def _refuse(name: str, *_: Any, **__: Any) -> NoReturn:
    raise RefusedError(f"{name} is asked for")


def functions_of(symbols: Mapping[str, Any]) -> list[Callable[..., Any]]:
    """Return the functions among symbols."""
    found = []
    for name, value in symbols.items():
        if isinstance(value, dict):
            found += functions_of(value)
        elif callable(value) and not name.startswith("_"):
            found.append(value)
    return found


class Expressions:
    """Evaluates expressions.

    Args:
        functions: What may be called, and be handed to what is called.
        dotted: Its type of mappings of YAML, whose values are attributes too.
    """

    def __init__(
        self,
        names: Names,
        functions: Iterable[Callable[..., Any]],
        namespace: type,
        dotted: type,
    ) -> None:
        self._names, self._namespace, self._dotted = names, namespace, dotted
        self._functions = {id(each): each for each in functions}

    def evaluate(self, text: str) -> Any:
        """Return the value of an expression.

        Raises:
            RefusedError: It asks for more than values.
            Exception: It has none, as Python says.
        """
        try:
            return self._value(ast.parse(text.strip(), "<expression>", mode="eval").body)
        except RefusedError as error:
            raise RefusedError(f"{error} in '{text}'") from None

    def _value(self, node: ast.expr) -> Any:
        value = self._unchecked(node)
        if callable(value) and id(value) not in self._functions:
            raise RefusedError(f"{_name(value)} is asked for")
        return _bounded(value)

    def _unchecked(self, node: ast.expr) -> Any:  # noqa: PLR0911, PLR0912
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return self._named(name)
            case ast.BinOp(left, kind, right):
                return _combined(type(kind), self._value(left), self._value(right))
            case ast.UnaryOp(kind, operand):
                return _OPERATORS[type(kind)](self._value(operand))
            case ast.BoolOp(kind, operands):
                return self._either(isinstance(kind, ast.Or), operands)
            case ast.Compare(left, kinds, others):
                return self._compared(self._value(left), kinds, others)
            case ast.IfExp(test, then, otherwise):
                return self._value(then if self._value(test) else otherwise)
            case ast.Subscript(owner, index):
                return self._value(owner)[self._value(index)]
            case ast.Slice(lower, upper, step):
                return slice(*(end and self._value(end) for end in (lower, upper, step)))
            case ast.Attribute(owner, name):
                return self._attribute(self._value(owner), name)
            case ast.Call(function, arguments, keywords):
                named = ((each.arg, each.value) for each in keywords)
                return self._called(function)(*self._elements(arguments), **self._pairs(named))
            case ast.List(elements):
                return self._elements(elements)
            case ast.Tuple(elements):
                return tuple(self._elements(elements))
            case ast.Set(elements):
                return set(self._elements(elements))
            case ast.Dict(keys, values):
                return self._pairs(zip(keys, values, strict=True))
            case ast.ListComp(element, loops):
                return _filled(inner._value(element) for inner in self._each(loops))
            case ast.GeneratorExp(element, loops):
                return (inner._value(element) for inner in self._each(loops))
        raise RefusedError(f"{_WRITTEN.get(type(node), type(node).__name__)} is asked for")

    def _named(self, name: str) -> Any:
        try:
            return self._names[name]
        except KeyError:
            raise NameError(f"name '{name}' is not defined") from None

    def _either(self, stop: bool, operands: Sequence[ast.expr]) -> Any:
        value = None
        for operand in operands:
            value = self._value(operand)
            if bool(value) is stop:
                break
        return value

    def _compared(self, value: Any, kinds: Sequence[ast.cmpop], others: Sequence[ast.expr]) -> Any:
        result: Any = True
        for kind, other in zip(kinds, others, strict=True):
            right = self._value(other)
            result = _OPERATORS[type(kind)](value, right)
            if not result:
                break
            value = right
        return result

    def _attribute(self, owner: Any, name: str) -> Any:
        """Return a value of a namespace or of YAML by its name, never what Python keeps there."""
        if isinstance(owner, (self._namespace, self._dotted)):
            values: Any = owner
            try:
                return values[name]
            except KeyError:
                raise NameError(f"name '{name}' is not defined") from None
        raise RefusedError(f"the attribute {name!r} of {type(owner).__name__} is asked for")

    def _called(self, node: ast.expr) -> Callable[..., Any]:
        """Return the function or the method of a value that a call is of."""
        if isinstance(node, ast.Attribute):
            owner = self._value(node.value)
            is_data = isinstance(owner, _DATA) and not isinstance(owner, self._namespace)
            if is_data and _is_method(type(owner), node.attr):
                method: Callable[..., Any] = getattr(owner, node.attr)
                return method
            function = self._attribute(owner, node.attr)
        else:
            function = self._value(node)
        if callable(function) and id(function) not in self._functions:
            raise RefusedError(f"a call of {_name(function)} is asked for")
        called: Callable[..., Any] = function  # or no function, as Python says
        return called

    def _elements(self, nodes: Sequence[ast.expr]) -> list[Any]:
        found: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                found += _filled(self._value(node.value))
            else:
                found.append(self._value(node))
        return found

    def _pairs(self, pairs: Iterable[tuple[ast.expr | str | None, ast.expr]]) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        for key, node in pairs:
            if key is None:
                found = {**found, **self._value(node)}
            else:
                name = self._value(key) if isinstance(key, ast.expr) else key
                found[name] = self._value(node)
        return found

    def _each(self, loops: Sequence[ast.comprehension]) -> Iterator[Expressions]:
        """Yield this with the names that loops of a comprehension give, one time after another."""
        if not loops:
            yield self
            return
        loop = loops[0]
        for item in self._value(loop.iter):
            names: dict[str, Any] = {}
            _assign(loop.target, item, names)
            inner = copy(self)
            inner._names = NamesWithin(names, self._names)
            if all(inner._value(test) for test in loop.ifs):
                yield from inner._each(loops[1:])


def _is_method(kind: type, name: str) -> bool:
    """Whether a method of data makes data alone; a format reaches the attributes of values."""
    return name[0] != "_" and "format" not in name and callable(getattr(kind, name, None))


def _name(value: Any) -> str:
    return str(getattr(value, "__name__", type(value).__name__))


def _assign(target: ast.expr, value: Any, names: dict[str, Any]) -> None:
    """Give names of a loop their values."""
    if isinstance(target, ast.Name):
        names[target.id] = value
        return
    if not isinstance(target, (ast.Tuple, ast.List)):
        raise RefusedError("an assignment is asked for")
    for each, part in zip(target.elts, value, strict=True):
        _assign(each, part, names)


def _filled(values: Iterable[Any]) -> list[Any]:
    """Return a list of no more values than the bound."""
    return list(_bounded(list(islice(values, _MOST + 1))))


def _bounded(value: Any) -> Any:
    if isinstance(value, int):
        _check("an integer", value.bit_length(), _MOST_BITS, "bits")
    elif isinstance(value, (str, list, tuple, dict, set, frozenset, range)):
        _check("a value", len(value), _MOST, "elements")
    return value


def _combined(kind: type[ast.AST], left: Any, right: Any) -> Any:
    """Return what an operator gives, once it is clear that this has an end."""
    if isinstance(left, int) and isinstance(right, int):
        bits = abs(left).bit_length()
        size: dict[type[ast.AST], int] = {
            ast.Pow: bits * right if bits > 1 else 0,
            ast.LShift: bits + right,
        }
        _check("an integer", size.get(kind, 0), _MOST_BITS, "bits")
    elif kind is ast.Mult:
        for values, count in ((left, right), (right, left)):
            if isinstance(values, (str, list, tuple)) and isinstance(count, int):
                _check("a value", len(values) * count, _MOST, "elements")
    return _OPERATORS[kind](left, right)


def _check(what: str, size: int, most: int, unit: str) -> None:
    if size > most:
        raise OverflowError(f"{what} has more than {most:,} {unit}")
