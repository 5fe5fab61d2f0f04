"""`geodrake explain --draft-effect`: formulas for what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from geodrake.cli.options import ExplainOptions
from geodrake.cli.progress import step_teller
from geodrake.cli.session import Command, Input, Maker, run
from geodrake.cli.tables import REST, head, say, show_explanation, show_list, show_table
from geodrake.diagnosis.drafting import Draft, draft_effects, source_of
from geodrake.diagnosis.results import Explanation
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import draft_dict, explanation_dict
from geodrake.report.numbers import Units, number
from geodrake.report.tables import formulas_table
from geodrake.report.words import correlate_words


@dataclass(frozen=True, eq=False)
class _Drafted:
    """What the command found."""

    explanation: Explanation
    draft: Draft

    @property
    def model(self) -> RobotModel:
        """The model to save: that of the explanation, without the formulas."""
        return self.explanation.model

    @property
    def is_interrupted(self) -> bool:
        """Whether this is what was found by an interrupt."""
        return self.explanation.is_interrupted


def run_drafting(options: ExplainOptions, target: Path) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """

    def drafted(given: Input) -> _Drafted:
        found = draft_effects(
            given.model,
            given.logs,
            extra=given.extra,
            progress=step_teller(given.progress),
            **given.settings,
        )
        return _Drafted(*found)

    command = Command(
        "explain",
        "Explaining",
        drafted,
        lambda found: {**explanation_dict(found.explanation), "draft": draft_dict(found.draft)},
        "render_drafted",
        _show,
        paged=lambda found: (found.explanation, found.draft),
        more={"draft-effect": target},
        makers=_makers,
        sampled=lambda found: found.explanation,
    )
    run(command, options)


def _makers(found: _Drafted) -> Mapping[str, Maker]:
    return {"draft-effect": lambda: source_of(found.draft)} if found.draft.effects else {}


def _show(console: Console, found: _Drafted, units: Units) -> None:
    show_explanation(console, found.explanation, units, advised=False)
    draft = found.draft
    show_list(console, REST, [*map(correlate_words, draft.correlates)])
    if not draft.effects:
        words = "no formula takes away enough of the error to be believed; no file was written."
        say(console, "Draft", words)
        return
    head(console, "Formulas for the rest; RMS on held-out data, everything refitted")
    show_table(console, formulas_table(draft))
    before, after = draft.before, draft.after
    nrms = f"{number(before.nrms)} -> {number(after.nrms)}"
    words = f"held-out nrms {nrms}, sensor noise {number(after.floor_nrms)}"
    say(console, "Draft", f"{words}. Use the file with --effects; the saved model is without it.")
    needless = [f"{e.name} of {', '.join(e.where)}" for e in draft.needless]
    show_list(console, "Needless beside the formulas", needless)
