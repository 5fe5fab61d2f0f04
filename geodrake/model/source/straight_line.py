"""Formulas as a straight line of statements: what is needed twice is computed once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from geodrake.model.formulas.symbols import Operand, Symbol, in_order

_MOST_OPERATIONS = 12  # in a line
_COMMUTING = ("add", "multiply", "maximum", "minimum", "equal", "not_equal")

Key = tuple[Any, ...]
"""What tells an operation from others, or a number."""

Term = Callable[[str, tuple[str, ...]], str]
"""Writes an operation on operands that are written already."""


def straight_line(
    results: Sequence[Operand], write: Term, number: Callable[[float], str]
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return names and expressions of statements in their order, and expressions of the results.

    Args:
        write: Writes an operation; of an input, its operands are its name and place.
    """
    operations, found = _operations(results)
    uses = Counter(key for _, keys in operations.values() for key in keys if key in operations)
    uses.update(key for key in found if key in operations)
    written: dict[Key, str] = {}
    sizes: dict[Key, int] = {}
    statements: list[tuple[str, str]] = []

    def text(key: Key) -> str:
        return written[key] if key in written else number(key[0])

    for key, (name, operands) in operations.items():
        if name == "input":
            written[key], sizes[key] = write(name, tuple(map(str, operands))), 0
            continue
        expression = write(name, tuple(text(x) for x in operands))
        size = 1 + sum(sizes.get(x, 0) for x in operands)
        repeated = uses[key] > 1 and name != "negative"
        if repeated or size > _MOST_OPERATIONS:
            statements.append((f"x{len(statements)}", expression))
            expression, size = statements[-1][0], 0
        written[key], sizes[key] = expression, size
    return statements, [text(key) for key in found]


def _operations(results: Sequence[Operand]) -> tuple[dict[Key, tuple[str, Key]], list[Key]]:
    """Return all operations, each after its operands and once; and which of them are the results.

    An operation is known by its name and by its operands, of which numbers are known by
    themselves.
    """
    operations: dict[Key, tuple[str, Key]] = {}
    keys: dict[Symbol, Key] = {}
    numbers: dict[Key, int] = {}

    def key_of(x: Operand) -> Key:
        return keys[x] if isinstance(x, Symbol) else (float(x),)

    for symbol in in_order(results):
        operands: Key = symbol.operands
        if symbol.operation != "input":
            operands = tuple(map(key_of, operands))
            if symbol.operation in _COMMUTING:
                operands = tuple(sorted(operands, key=str))
        identity = (symbol.operation, operands)
        key = keys[symbol] = ("operation", numbers.setdefault(identity, len(numbers)))
        operations.setdefault(key, identity)
    return operations, [key_of(x) for x in results]
