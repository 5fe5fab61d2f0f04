"""`geodrake explain`: the steps, and in a few words what they leave."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from rich.console import Console

from geodrake.cli.options import Options
from geodrake.cli.progress import step_teller
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, show_explanation, show_table
from geodrake.control.rollout import Rollout, commanded_motions
from geodrake.diagnosis.drafting import Correlate, rest_correlates
from geodrake.diagnosis.explain import investigate
from geodrake.diagnosis.results import Explanation
from geodrake.errors import LogError, ModelError
from geodrake.identification.logs.case import open_case
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import correlates_list, explanation_dict, motions_dict
from geodrake.report.numbers import Units
from geodrake.report.tables import departures_table
from geodrake.report.words import MOTIONS, correlate_words


@dataclass(frozen=True, eq=False)
class _Explained:
    """What the command found."""

    explanation: Explanation
    correlates: tuple[Correlate, ...]
    motions: tuple[Rollout, ...] | None = None

    @property
    def model(self) -> RobotModel:
        """The model to save."""
        return self.explanation.model

    @property
    def is_interrupted(self) -> bool:
        """Whether this is what was found by an interrupt."""
        return self.explanation.is_interrupted


def run_explaining(options: Options, promise: str = "") -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    command = Command(
        "explain",
        "Explaining",
        _explained,
        lambda found: {
            **explanation_dict(found.explanation),
            "correlates": correlates_list(found.correlates),
            **motions_dict(found.motions),
        },
        "render_explained",
        _show,
        paged=lambda found: (found.explanation, found.correlates, found.motions),
        sampled=lambda found: found.explanation,
        promise=promise,
    )
    run(command, options)


def _explained(given: Input) -> _Explained:
    case = open_case(given.model, given.logs, candidates=True, extra=given.extra, **given.settings)
    found = investigate(case, progress=step_teller(given.progress))
    explanation = found.explanation
    if explanation.is_interrupted:
        return _Explained(explanation, ())
    motions = _motions(given, explanation)
    if explanation.verdict != "unexplained":
        return _Explained(explanation, (), motions)
    given.progress("Looking what the rest goes with")
    return _Explained(explanation, rest_correlates(found), motions)


def _motions(given: Input, found: Explanation) -> tuple[Rollout, ...] | None:
    """Motions under commands before, after the steps, and after the last; None without."""
    between = [step.model for step in found.steps if step.model is not None]
    for models in (between, []):  # an effect on the way may be one that no simulation has
        with suppress(LogError, ModelError):  # as where nothing moves for as long as a window
            return commanded_motions(given.model, found.model, given.logs, between=models)
    return None


def _show(console: Console, found: _Explained, units: Units) -> None:
    rest = [*map(correlate_words, found.correlates)]
    show_explanation(console, found.explanation, units, rest=rest)
    if found.motions is not None:
        before, *between, after = found.motions
        head(console, f"{MOTIONS}, RMS in windows of {after.horizon:g} s")
        show_table(console, departures_table(after, before, units, between))
