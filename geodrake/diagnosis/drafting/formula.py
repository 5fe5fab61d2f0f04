"""Formulas: sums of products of simple functions of positions, velocities, accelerations, loads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect, JointMotion, Parameter, RobotMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Function:
    """Function of one signal x and optionally a constant c."""

    evaluate: Callable[[Array, float], Array]  # values of x (N,) and c
    code: str  # in Python, with {x} and {c}
    words: str
    power: int  # of the signal's unit


FUNCTIONS: Mapping[str, _Function] = {
    "value": _Function(lambda x, c: x, "{x}", "{x}", 1),
    "square": _Function(lambda x, c: x * x, "{x}**2", "square of the {x}", 2),
    "size": _Function(lambda x, c: np.abs(x), "np.abs({x})", "size of the {x}", 1),
    "drag": _Function(
        lambda x, c: x * np.abs(x), "{x} * np.abs({x})", "signed square of the {x}", 2
    ),
    "sine": _Function(lambda x, c: np.sin(x), "np.sin({x})", "sine of the {x}", 0),
    "cosine": _Function(lambda x, c: np.cos(x), "np.cos({x})", "cosine of the {x}", 0),
    "sine_twice": _Function(
        lambda x, c: np.sin(2 * x), "np.sin(2.0 * {x})", "sine of twice the {x}", 0
    ),
    "cosine_twice": _Function(
        lambda x, c: np.cos(2 * x), "np.cos(2.0 * {x})", "cosine of twice the {x}", 0
    ),
    "above": _Function(
        lambda x, c: np.maximum(x - c, 0.0),
        "np.maximum({x} - {c}, 0.0)",
        "{x} beyond {c} upwards",
        1,
    ),
    "below": _Function(
        lambda x, c: np.minimum(x - c, 0.0),
        "np.minimum({x} - {c}, 0.0)",
        "{x} beyond {c} downwards",
        1,
    ),
}
"""Functions of a signal, by name."""

_SIGNALS: Mapping[str, tuple[str, str]] = {
    "q": ("position", "rad"),
    "v": ("velocity", "rad/s"),
    "vd": ("acceleration", "rad/s²"),
    "load": ("load", "N·m"),
    "sign_v": ("direction of motion", ""),
}
"""Fields of `JointMotion`: their words, and their unit at a revolute joint."""


@dataclass(frozen=True)
class Factor:
    """Function of one signal of one joint."""

    joint: str
    signal: str
    function: str = "value"
    constant: float = 0.0  # breakpoint of "above" and "below"

    @property
    def turns(self) -> bool:
        """Return whether it has a breakpoint."""
        return self.function in ("above", "below")

    def values(self, motion: JointMotion) -> Array:
        """Return the (N,) values over its joint's motion."""
        return FUNCTIONS[self.function].evaluate(getattr(motion, self.signal), self.constant)

    def code(self, variable: str) -> str:
        """Return Python code of the values, where `variable` is the `JointMotion`."""
        x = f"{variable}.{self.signal}"
        return FUNCTIONS[self.function].code.format(x=x, c=f"{self.constant:.6g}")

    def words(self, own: str) -> str:
        """Return a description, as seen from the joint `own`."""
        signal = _SIGNALS[self.signal][0]
        whose = f"its {signal}" if self.joint == own else f"the {signal} of {self.joint}"
        words = FUNCTIONS[self.function].words.format(x="\0", c=f"{self.constant:.3g}")
        return words.replace("the \0", whose).replace("\0", whose)

    @property
    def unit(self) -> str:
        """Return the unit, such as "rad" or "(rad)²"; empty for a dimensionless factor."""
        unit, power = _SIGNALS[self.signal][1], FUNCTIONS[self.function].power
        if not unit or power == 0:
            return ""
        return unit if power == 1 else f"({unit})²"


@dataclass(frozen=True)
class FormulaTerm:
    """Product of factors."""

    factors: tuple[Factor, ...]  # one or two; none for a constant

    def values(self, motions: Callable[[str], JointMotion], samples: int) -> Array:
        """Return the (N,) values."""
        product = np.ones(samples)
        for factor in self.factors:
            product = product * factor.values(motions(factor.joint))
        return product

    @property
    def signals(self) -> frozenset[tuple[str, str]]:
        """Return the joints and signals that it depends on."""
        return frozenset((factor.joint, factor.signal) for factor in self.factors)

    @property
    def complexity(self) -> int:
        """Return the number of factors, nontrivial functions and constants."""
        return sum(1 + (f.function != "value") + f.turns for f in self.factors)

    @property
    def unit(self) -> str:
        """Return the unit of the coefficient that turns it into an effort."""
        units = [factor.unit for factor in self.factors if factor.unit]
        if not units:
            return "N·m"
        per = "·".join(units)
        return f"N·m/({per})" if len(units) > 1 or "/" in per or "·" in per else f"N·m/{per}"

    def words(self, own: str) -> str:
        """Return a description, as seen from the joint `own`."""
        return " times ".join(f.words(own) for f in self.factors) or "a constant"

    def turned(self, index: int, constant: float) -> FormulaTerm:
        """Return the term with another breakpoint in one of its factors."""
        factors = list(self.factors)
        factors[index] = replace(factors[index], constant=constant)
        return FormulaTerm(tuple(factors))

    @property
    def kind(self) -> FormulaTerm:
        """Return the term with all constants set to zero."""
        return FormulaTerm(tuple(replace(factor, constant=0.0) for factor in self.factors))

    @property
    def turning(self) -> tuple[int, ...]:
        """Return the indices of the factors with a breakpoint."""
        return tuple(k for k, factor in enumerate(self.factors) if factor.turns)


@dataclass(frozen=True)
class Formula(Effect):
    """Effort at a joint as a sum of terms with coefficients.

    The search uses one effect for each term; a draft combines them in one class.
    """

    joint: str
    terms: tuple[FormulaTerm, ...]
    places: ClassVar[str] = "joint"

    @cached_property
    def name(self) -> str:  # type: ignore[override]
        """Return its words without constants, which distinguish the terms of a formula."""
        return " + ".join(term.kind.words(self.joint) for term in self.terms)

    @property
    def where(self) -> tuple[str, ...]:
        """Return the joint."""
        return (self.joint,)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """Return the names and units of the coefficients."""
        return tuple(Parameter(f"c{k + 1}", term.unit) for k, term in enumerate(self.terms))

    @cached_property
    def complexity(self) -> int:  # type: ignore[override]
        """Return the sum over all terms and their coefficients."""
        return sum(1 + term.complexity for term in self.terms)

    @property
    def free_shapes(self) -> int:
        """Return the number of breakpoints chosen by the data."""
        return sum(len(term.turning) for term in self.terms)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Return the columns at the joint."""
        motions = {name: motion.joint(name) for name in self.joints}
        values = [term.values(motions.__getitem__, len(motion.v)) for term in self.terms]
        return {self.joint: np.stack(values, -1)}

    def words(self) -> str:
        """Return a description such as "its direction of motion times the position of wrist"."""
        return " + ".join(term.words(self.joint) for term in self.terms)

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the joints whose motion it depends on."""
        return tuple(dict.fromkeys(f.joint for term in self.terms for f in term.factors))
