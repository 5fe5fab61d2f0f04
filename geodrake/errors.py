"""Errors of geodrake: what was wrong, with the values, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class GeodrakeError(Exception):
    """Base of every error that geodrake raises on purpose.

    Args:
        problem: What was wrong, with the values, as one or more full sentences.
        advice: What the user can do about it; appended to the message.
        evidence: The values behind the message, kept as `evidence` for programs.
    """

    def __init__(self, problem: str, *, advice: str = "", **evidence: Any) -> None:
        super().__init__(f"{problem} {advice}".strip())
        self.problem = problem
        self.advice = advice
        self.evidence = evidence

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how pickle rebuilds the error, with advice and evidence."""
        return _remade, (type(self), self.problem, self.advice, self.evidence)


class ArgumentError(GeodrakeError, ValueError):
    """A function or command got an argument it cannot take (shape, range, name)."""


class LogError(GeodrakeError):
    """A log cannot be read, or says too little to be used."""


class ModelError(GeodrakeError):
    """A model file cannot be read, or does not describe a usable robot."""


class IdentificationError(GeodrakeError):
    """A program for the parameters has no usable solution."""


class ConvergenceError(GeodrakeError):
    """An iteration did not reach its tolerance."""


class DigestError(GeodrakeError):
    """A digest or its settings cannot be read, or do not fit others."""


class FleetError(GeodrakeError):
    """A fleet file cannot be read, or what it names cannot be used together."""


class OutputError(GeodrakeError):
    """A result cannot be written where it was asked for."""


def nearest(name: object, known: Iterable[str], count: int = 3) -> str:
    """Return "Did you mean …? " with the known names nearest to an unknown one, or ""."""
    near = get_close_matches(str(name), list(known), count, 0.5)
    return f"Did you mean {', '.join(near)}? " if near else ""


def _remade(
    kind: type[GeodrakeError], problem: str, advice: str, evidence: dict[str, Any]
) -> GeodrakeError:
    return kind(problem, advice=advice, **evidence)
