"""`geodrake explain --draft-effect`: formulas for what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from geodrake.cli.options import ExplainOptions
from geodrake.cli.session import Command, Input, Maker, run
from geodrake.cli.tables import (
    REST,
    head,
    lines_of,
    number_columns,
    say,
    show_explanation,
    show_list,
    table_of,
)
from geodrake.cli.wording import Wording
from geodrake.diagnosis.results import Explanation
from geodrake.drafting import Draft, DraftedEffect, draft_effects, source_of
from geodrake.json_output import draft_dict, explanation_dict
from geodrake.model import RobotModel


@dataclass(frozen=True, eq=False)
class _Drafted:
    """What the command found."""

    explanation: Explanation
    draft: Draft

    @property
    def model(self) -> RobotModel:
        """The model to save: that of the explanation, without the formulas."""
        return self.explanation.model


def run_drafting(options: ExplainOptions, target: Path) -> None:
    """Run the command.

    Args:
        options: What it was told.
        target: The file to write.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """

    def drafted(given: Input) -> _Drafted:
        found = draft_effects(
            given.model,
            given.logs,
            extra=given.extra,
            progress=lambda words, nrms: given.tell(f"Found {words}: nrms {nrms:.3f}"),
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
    )
    run(command, options)


def _makers(found: _Drafted) -> Mapping[str, Maker]:
    return {"draft-effect": lambda: source_of(found.draft)} if found.draft.effects else {}


def _show(console: Console, found: _Drafted, wording: Wording) -> None:
    show_explanation(console, found.explanation, wording)
    draft = found.draft
    show_list(console, REST, [str(c) for c in draft.correlates])
    if not draft.effects:
        words = "no formula takes away enough of the error to be believed; no file was written."
        say(console, "Draft", words)
        return
    head(console, "Formulas for the rest; RMS on held-out data, everything refitted")
    table = table_of(console, "effect", "where, how much")
    number_columns(table, "before", "after", "noise")
    for effect in draft.effects:
        numbers = (effect.rms_before, effect.rms_after, effect.floor)
        table.add_row(
            draft.names[effect.formula.joint],
            lines_of(console, [effect.formula.words(), *_coefficients(effect)]),
            *(f"{value:.3g}" for value in numbers),
        )
    console.print(table)
    before, after = draft.before.nrms, draft.after
    words = f"held-out nrms {before:.3f} -> {after.nrms:.3f}, sensor noise {after.floor_nrms:.3f}"
    say(console, "Draft", f"{words}. Use the file with --effects; the saved model is without it.")
    needless = [f"{e.name} of {', '.join(e.where)}" for e in draft.needless]
    show_list(console, "Needless beside the formulas", needless)


def _coefficients(effect: DraftedEffect) -> list[str]:
    values = zip(effect.formula.parameters, effect.coefficients, effect.deviations, strict=True)
    return [f"{p.name} {c:.3g} ± {d:.2g} {p.unit}" for p, c, d in values]
