"""Export of a draft as a Python file of effect classes."""

from __future__ import annotations

import textwrap

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import docstring_text, identifiers, quoted
from geodrake.diagnosis.drafting.formula import Formula
from geodrake.diagnosis.drafting.results import Draft, DraftedEffect

_HEAD = '''"""{title}

Drafted by geodrake from {logs}. A formula that fits is not yet a cause: once you know the cause,
give the effect its name, and its parameters theirs. Use it as it is with

    geodrake explain MODEL LOG --effects THIS_FILE.py
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from geodrake.effects import Effect, Parameter, RobotMotion
'''

_WIDTH = 92  # of docstring lines
_TAKEN = ("np", "motion", "self", "cls", "columns")  # names used in the template
_CLASS = '''

@dataclass(frozen=True)
class {title}(Effect):
    """{text}
    """

    joint: str = {quoted}

    name: ClassVar[str] = {name}
    places: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
{parameters}
    )

    @property
    def where(self) -> tuple[str, ...]:
        return (self.joint,)

    def rows(self, motion: RobotMotion) -> Mapping[str, np.ndarray]:
{motions}
        columns = [
{columns}
        ]
        return {{self.joint: np.stack([np.broadcast_to(c, len(motion.v)) for c in columns], -1)}}

    @classmethod
    def candidates(cls, joint: str, peak_speed: float) -> "list[Effect]":
        return [cls()] if joint == {quoted} else []
'''


@typed
def source_of(draft: Draft) -> str:
    """Return drafted effects as a Python file for `geodrake.effects.load_effect_file`."""
    joints, names = ", ".join(draft.names), draft.names
    titles = identifiers(names.values(), style=_title)
    head = _HEAD.format(
        title=docstring_text(f"Missing effects at {joints}."),
        logs=docstring_text(", ".join(draft.logs)),
    )
    classes = []
    for effect in draft.effects:
        name = names[effect.formula.joint]
        classes.append(_class(effect, name, titles[name]))
    return head + "".join(classes)


def _title(name: str) -> str:
    """Return the class name of an effect, such as "ElbowJointDraft"."""
    return "".join(part.capitalize() for part in name.split("_"))


def _class(effect: DraftedEffect, name: str, title: str) -> str:
    formula = effect.formula
    variables = identifiers(formula.joints, taken=_TAKEN)
    parameters = [
        f"        Parameter({quoted(p.name)}, {quoted(p.unit)})," for p in formula.parameters
    ]
    motions = [
        f"        {variable} = motion.joint({quoted(joint)})"
        for joint, variable in variables.items()
    ]
    return _CLASS.format(
        title=title,
        quoted=quoted(formula.joint),
        text=_docstring(effect),
        name=quoted(name),
        parameters="\n".join(parameters),
        motions="\n".join(motions),
        columns="\n".join(f"            {code}," for code in _codes(formula, variables)),
    )


def _docstring(effect: DraftedEffect) -> str:
    fitted = zip(effect.formula.parameters, effect.coefficients, effect.deviations, strict=True)
    paragraphs = (
        f"Effort of {effect.formula.joint}: {effect.formula.words()}.",
        f"Held-out RMS of the joint {effect.rms_before:.3g} without it, "
        f"{effect.rms_after:.3g} with it; sensor noise {effect.floor:.3g}. Fitted: "
        + ", ".join(f"{p.name} = {c:.4g} ± {d:.2g} {p.unit}" for p, c, d in fitted)
        + ".",
    )
    lines = [textwrap.fill(docstring_text(p), _WIDTH, break_long_words=False) for p in paragraphs]
    return textwrap.indent("\n\n".join(lines), "    ").lstrip()


def _codes(formula: Formula, variables: dict[str, str]) -> list[str]:
    return [
        " * ".join(_bracketed(f.code(variables[f.joint])) for f in term.factors) or "1.0"
        for term in formula.terms
    ]


def _bracketed(code: str) -> str:
    """Return the code of a factor, in brackets if a product needs them."""
    return f"({code})" if " * np" in code else code
