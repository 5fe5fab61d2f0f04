"""A model's effort as source code without dependencies, in Python or C++."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, one_of, typed
from geodrake.boundary.escaping import identifier, printable, quoted
from geodrake.effects import Effect, FittedEffect, RobotMotion, Role
from geodrake.effects.base import BEYOND_MOTION
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.model.export import repair_comments
from geodrake.model.formulas import (
    BodyFormulas,
    Operand,
    Symbol,
    Symbols,
    in_order,
    inverse_dynamics_formula,
    recorded_rows,
)
from geodrake.model.robot_model import RobotModel

_MOST_OPERATIONS = 12  # in a line

Term = Callable[[str, tuple[str, ...]], str]
"""Returns an operation as text, from the texts of its operands."""


def straight_line(
    results: Sequence[Operand], write: Term, number: Callable[[float], str]
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the (name, expression) pairs of assignments, and the expressions of the results."""
    symbols = [*in_order(results)]
    uses = Counter(x for x in (*results, *(x for s in symbols for x in s.operands)))
    written: dict[Operand, str] = {}
    sizes: dict[Operand, int] = {}
    statements: list[tuple[str, str]] = []

    def text(x: Operand) -> str:
        return written[x] if isinstance(x, Symbol) else number(float(x))

    for symbol in symbols:
        name, operands = symbol.operation, symbol.operands
        if name == "input":
            written[symbol] = write(name, tuple(map(str, operands)))
            continue
        expression = write(name, tuple(map(text, operands)))
        size = 1 + sum(sizes.get(x, 0) for x in operands)
        repeated = uses[symbol] > 1 and name != "negative"
        if repeated or size > _MOST_OPERATIONS:
            statements.append((f"x{len(statements)}", expression))
            expression, size = statements[-1][0], 0
        written[symbol], sizes[symbol] = expression, size
    return statements, [text(x) for x in results]


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
_FUNCTIONS = {  # NumPy's name -> the name in C and in Python's math, if different
    "arcsin": "asin",
    "arccos": "acos",
    "arctan": "atan",
    "arctan2": "atan2",
    "arcsinh": "asinh",
    "arccosh": "acosh",
    "arctanh": "atanh",
    "power": "pow",
}


_PYTHON = '''{comment}

import math

JOINTS = (
{joints}
)


def effort(q, v, vd):
    """Effort that a motion needs at the joints, N·m or N, in the order of JOINTS.

    q are {nq} positions, v and vd {nv} velocities and accelerations, in SI units.
    """
{statements}
    return [
{results}
    ]


def sign(x):
    """-1, 0 or 1."""
    return float(x > 0.0) - float(x < 0.0)
'''

_CPP = """{comment}

#pragma once

#include <array>
#include <cmath>

namespace {name} {{

inline constexpr int kPositions = {nq};
inline constexpr int kJoints = {nv};

inline constexpr std::array<const char*, kJoints> kJointNames = {{
{joints}
}};

inline double sign(double x) {{ return double(x > 0.0) - double(x < 0.0); }}

inline double floored_remainder(double x, double y) {{ return x - y * std::floor(x / y); }}

// Effort that a motion needs at the joints, N·m or N, in the order of kJointNames:
// positions q, velocities v and accelerations vd in SI units.
inline std::array<double, kJoints> effort(
    [[maybe_unused]] const std::array<double, kPositions>& q,
    [[maybe_unused]] const std::array<double, kJoints>& v,
    [[maybe_unused]] const std::array<double, kJoints>& vd) {{
{statements}
  return {{
{results}
  }};
}}

}}  // namespace {name}
"""


@dataclass(frozen=True)
class Language:
    """A programming language, with formats of the parts of a source file."""

    suffix: str
    template: str
    comment: str  # prefix of a comment line
    statement: str  # format of a name and an expression
    result: str
    string: Callable[[str], str]
    module: str  # prefix of mathematical functions
    special: Mapping[str, str]  # operation -> format of its operands, if irregular

    def operation(self, name: str, operands: tuple[str, ...]) -> str:
        """Return an operation, by NumPy's name, on the texts of its operands.

        The operands of an input are its name and index.
        """
        if name in self.special:
            return self.special[name].format(*operands)
        if name == "input":
            return f"{operands[0]}[{operands[1]}]"
        if name in _INFIX:
            return f"({operands[0]} {_INFIX[name]} {operands[1]})"
        if name == "negative":
            return f"(-{operands[0]})"
        return f"{self.module}{_FUNCTIONS.get(name, name)}({', '.join(operands)})"

    def number(self, value: float) -> str:
        """Return a number with all digits."""
        if not np.isfinite(value):
            raise ModelError(
                f"The formula of the effort contains {value:g}, which is not a number.",
                advice="Remove the effect that uses an unknown, such as the position of a "
                "joint of several degrees of freedom.",
            )
        return repr(float(value)) if value >= 0.0 else f"({float(value)!r})"


PYTHON = Language(
    ".py",
    _PYTHON,
    "# ",
    "    {} = {}",
    "        {},",
    quoted,
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
    ".hpp",
    _CPP,
    "// ",
    "  const double {} = {};",
    "      {},",
    lambda name: quoted(printable(name)),
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


_NOT_INCLUDED = {
    Role.DELAY: "logged efforts are delayed by it",
    Role.DEFLECTION: "it depends on the history of the motion",
    Role.EPISODE: "it belongs to one log",
}


@typed
def is_written(effect: Effect) -> bool:
    """Return whether a formula of q, v and v̇ can express an effect exactly."""
    return effect.role not in _NOT_INCLUDED and not effect.depends_on & BEYOND_MOTION


def _formulas(
    model: RobotModel, sign_width: ArrayLike
) -> tuple[list[Operand], list[str], list[str]]:
    """Return efforts (nv) as formulas, the included effects, and those left out."""
    nv = len(model.joints)
    q = Symbols.inputs("q", model.tree.num_positions)
    v, vd = Symbols.inputs("v", nv), Symbols.inputs("vd", nv)
    load = inverse_dynamics_formula(model.tree, q, v, vd, model.total_phi)
    by_joint = Symbols.of(np.full((1, nv), np.nan))  # for joints of several degrees
    by_joint[0, model.single_places] = q[model.single_places]
    motion = RobotMotion(
        model.joints,
        by_joint,
        v[None],
        vd[None],
        load[None],
        model.sign_widths(sign_width),
        _no_columns,
        BodyFormulas(model.tree, q[None], model.total_phi),
    )
    effort, gains = load.copy(), []
    included, left_out = [], []
    for fitted in model.effects:
        effect, description = fitted.effect, _description(fitted)
        if effect.role in _NOT_INCLUDED:
            left_out.append(f"{description}: {_NOT_INCLUDED[effect.role]}")
            continue
        if effect.role is Role.SCALE:
            gains.append(fitted)
        elif effect.role is not Role.BODY:
            for joint, columns in recorded_rows(effect, motion).items():
                row = motion.index(joint)
                effort[row] = effort[row] + columns @ fitted.parameters.astype(object)
        included.append(description)
        if not is_written(effect):
            warm = "temperature" in effect.depends_on
            left_out.append(
                f"the temperature of {description}: the reference is assumed"
                if warm
                else f"the history of {description}: a long previous motion is assumed"
            )
    total = effort.copy()
    for fitted in gains:
        row = motion.index(fitted.effect.where[0])
        total[row] = total[row] + float(fitted.parameters[0]) * effort[row]
    return total.tolist(), included, left_out


def _description(fitted: FittedEffect) -> str:
    effect = fitted.effect
    values, _ = effect.reported(fitted.parameters, np.full(len(fitted.parameters), np.nan))
    listed = ", ".join(f"{name} {value:.6g}" for name, value in values.items())
    place = effect.place if effect.where else "the robot"
    return f"{effect.name} of {place}{f' ({listed})' if listed else ''}"


def _no_columns(body: str) -> Array:
    raise ArgumentError(
        f"The inertial columns of {body!r} are unknown here.",
        advice="Use motion.body_motions, or a payload.",
    )


_WIDTH = 96
_LANGUAGES = {"python": PYTHON, "cpp": CPP}


def python_source(model: RobotModel, *, sign_width: ArrayLike = 0.0) -> str:
    """Return a Python module with a function effort(q, v, vd) that imports only `math`.

    The function includes the rigid bodies, payloads and effects of the model, except effects that
    depend on the history of the motion, which a comment lists.

    Args:
        sign_width: Lower bound of the speed below which dry friction fades, rad/s or m/s; one for
            all velocities or (nv,). At 0, dry friction jumps where the model's does.
    """
    return effort_source(model, "python", sign_width=sign_width).text


def cpp_source(model: RobotModel, *, sign_width: ArrayLike = 0.0) -> str:
    """Return a C++17 header with a function effort(q, v, vd), without dependencies.

    Raises:
        ModelError: An effect cannot be written as source code.
    """
    return effort_source(model, "cpp", sign_width=sign_width).text


@dataclass(frozen=True)
class EffortSource:
    """A source file with a model's effort."""

    file_name: str  # such as `arm_effort.py`
    text: str
    left_out: tuple[str, ...]  # effects that are missing or simplified, with the reason


def effort_source(model: RobotModel, language: str, *, sign_width: ArrayLike = 0.0) -> EffortSource:
    """Return a model's effort in a language, "python" or "cpp"; see `python_source`."""
    kind = _LANGUAGES[one_of(language, "language", _LANGUAGES)]
    formulas, included, left_out = _formulas(instance(model, "model", RobotModel), sign_width)
    statements, efforts = straight_line(formulas, kind.operation, kind.number)
    paragraphs = [
        f"Effort that {quoted(model.path.name)} needs for a motion, written by geodrake.",
        f"Rigid bodies, payloads included, and: {'; '.join(included) or 'no effect'}.",
        *(f"Not included: {reason}." for reason in left_out),
        *repair_comments(model),
    ]
    lines = [line for p in paragraphs for line in textwrap.wrap(printable(p), _WIDTH)]
    # A backslash at the end of a line would continue the comment in C++.
    comment = [kind.comment + line + ("." if line.endswith("\\") else "") for line in lines]
    text = kind.template.format(
        comment="\n".join(comment),
        name=f"{_name(model)}_model",
        nq=model.tree.num_positions,
        nv=len(model.joints),
        joints="\n".join(f"    {kind.string(joint)}," for joint in model.joints),
        statements="\n".join(kind.statement.format(name, _unwrapped(x)) for name, x in statements),
        results="\n".join(kind.result.format(_unwrapped(x)) for x in efforts),
    )
    return EffortSource(f"{_name(model)}_effort{kind.suffix}", text, tuple(left_out))


def _unwrapped(expression: str) -> str:
    """Return an expression without its outermost parentheses."""
    depth = 0
    for place, letter in enumerate(expression):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and place < len(expression) - 1:
            return expression
    return expression[1:-1]


def _name(model: RobotModel) -> str:
    """Return an ASCII identifier for the robot, from its file name."""
    plain = "".join(c if c.isascii() else " " for c in model.path.name.partition(".")[0])
    return identifier(plain)
