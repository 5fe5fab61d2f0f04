"""A model's effort as a function without dependencies, in Python or C++, for a controller."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, one_of
from geodrake.boundary.escaping import identifier, printable, quoted
from geodrake.model.export import repair_comments
from geodrake.model.robot_model import RobotModel
from geodrake.model.source.effort_formula import EffortFormula, effort_formula
from geodrake.model.source.languages import CPP, PYTHON
from geodrake.model.source.straight_line import straight_line

_WIDTH = 96
_LANGUAGES = {"python": PYTHON, "cpp": CPP}


def python_source(model: RobotModel, *, sign_width: ArrayLike = 0.0) -> str:
    """Return a Python module with a function effort(q, v, vd); it imports `math` alone.

    The function has the rigid bodies, payloads and effects of the model. What needs the history of
    the motion is named in the comment at its head.

    Args:
        model: The model.
        sign_width: Speed below which dry friction fades, rad/s or m/s, at least; one for all
            velocities or (nv,). At 0, the sign of a velocity jumps where the model's does.

    Raises:
        ModelError: An effect cannot be written as source code.
    """
    return effort_source(model, "python", sign_width=sign_width).text


def cpp_source(model: RobotModel, *, sign_width: ArrayLike = 0.0) -> str:
    """Return a C++17 header with a function effort(q, v, vd); it includes standard headers alone.

    Raises:
        ModelError: An effect cannot be written as source code.
    """
    return effort_source(model, "cpp", sign_width=sign_width).text


@dataclass(frozen=True)
class EffortSource:
    """A file with a model's effort.

    Attributes:
        file_name: Its name, such as `arm_effort.py`.
        left_out: The effects that it has not, or not as they are, with the reason.
    """

    file_name: str
    text: str
    left_out: tuple[str, ...]


def effort_source(model: RobotModel, language: str, *, sign_width: ArrayLike = 0.0) -> EffortSource:
    """Return a model's effort as a file in a language, "python" or "cpp"; see `python_source`.

    Raises:
        ArgumentError: It is another language.
        ModelError: An effect cannot be written as source code.
    """
    kind = _LANGUAGES[one_of(language, "language", _LANGUAGES)]
    formula = effort_formula(instance(model, "model", RobotModel), sign_width)
    lines, efforts = straight_line(formula.efforts, kind.operation, kind.number)
    text = kind.template.format(
        comment=_comment(model, formula, kind.comment),
        name=f"{_name(model)}_model",
        nq=model.tree.num_positions,
        nv=len(model.joints),
        joints="\n".join(f"    {kind.string(joint)}," for joint in model.joints),
        statements="\n".join(kind.statement.format(name, _bare(x)) for name, x in lines),
        results="\n".join(kind.result.format(_bare(x)) for x in efforts),
    )
    return EffortSource(f"{_name(model)}_effort{kind.suffix}", text, formula.left_out)


def _bare(expression: str) -> str:
    """Return an expression without brackets around all of it."""
    depth = 0
    for place, letter in enumerate(expression):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and place < len(expression) - 1:
            return expression
    return expression[1:-1]


def _name(model: RobotModel) -> str:
    """Return an ASCII identifier for the robot, of its file's name."""
    plain = "".join(c if c.isascii() else " " for c in model.path.name.partition(".")[0])
    return identifier(plain)


def _comment(model: RobotModel, formula: EffortFormula, mark: str) -> str:
    """Return what the file is, line by line; names are quoted, as they may hold anything."""
    paragraphs = [
        f"Effort that {quoted(model.path.name)} needs for a motion, written by geodrake.",
        f"Rigid bodies, payloads included, and: {'; '.join(formula.included) or 'no effect'}.",
        *(f"Not included: {one}." for one in formula.left_out),
        *repair_comments(model),
    ]
    lines = [line for p in paragraphs for line in textwrap.wrap(printable(p), _WIDTH)]
    return "\n".join(f"{mark}{line}{_ended(line)}" for line in lines)


def _ended(line: str) -> str:
    """Return what ends a line of a comment, as C++ goes on in the next one after a backslash."""
    return "." if line.endswith("\\") else ""
