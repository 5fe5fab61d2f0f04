"""Errors of geodrake, which state the problem with its values and give advice."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class GeodrakeError(Exception):
    """Base class of geodrake's errors.

    Args:
        problem: Description of the problem with its values, in full sentences.
        advice: How the user can solve it; appended to the message.
        evidence: Values for programs, available as `evidence`.
    """

    def __init__(self, problem: str, *, advice: str = "", **evidence: Any) -> None:
        super().__init__(f"{problem} {advice}".strip())
        self.problem = problem
        self.advice = advice
        self.evidence = evidence

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how pickle rebuilds the error, with advice and evidence."""
        return _restored, (type(self), self.problem, self.advice, self.evidence)


class ArgumentError(GeodrakeError, ValueError):
    """An argument of a function or command is invalid (shape, range, name)."""


class LogError(GeodrakeError):
    """A log cannot be read, or contains too little information."""


class ModelError(GeodrakeError):
    """A model file cannot be read, or does not describe a valid robot."""


class IdentificationError(GeodrakeError):
    """An optimization problem for the parameters has no valid solution."""


class ConvergenceError(GeodrakeError):
    """An iteration did not reach its tolerance."""


class DigestError(GeodrakeError):
    """A digest or its settings cannot be read, or are incompatible with others."""


class FleetError(GeodrakeError):
    """A fleet file cannot be read, or its robots, models and logs are incompatible."""


class OutputError(GeodrakeError):
    """A result cannot be written to the requested place."""


def nearest(name: object, known: Iterable[str], count: int = 3) -> str:
    """Return "Did you mean …? " with the known names most similar to an unknown one, or ""."""
    similar = get_close_matches(str(name), list(known), count, 0.5)
    return f"Did you mean {', '.join(similar)}? " if similar else ""


def _restored(
    kind: type[GeodrakeError], problem: str, advice: str, evidence: dict[str, Any]
) -> GeodrakeError:
    return kind(problem, advice=advice, **evidence)
