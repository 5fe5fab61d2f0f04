"""The report of an explanation, with motions under commands and what the rest goes with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from geodrake.boundary.arguments import typed
from geodrake.control.rollout import Rollout
from geodrake.diagnosis.drafting import Correlate
from geodrake.diagnosis.results import Explanation
from geodrake.report.numbers import Units
from geodrake.report.page import Section
from geodrake.report.report import render_explanation
from geodrake.report.tables import departures_table
from geodrake.report.words import MOTIONS, correlate_words, draft_advice


@typed
def render_explained(
    found: tuple[Explanation, Sequence[Correlate], Sequence[Rollout] | None],
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an explanation and of what its rest goes with; see `render_drafted`.

    Args:
        found: An explanation, what `geodrake.diagnosis.drafting.rest_correlates` gives, and
            rollouts under commands before, after the steps, and after the last, if there are any.
        model_name: What the model is called.
        log_names: What the logs are called.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    explanation, correlates, motions = found
    units = Units.of(explanation.model)
    advice = draft_advice(explanation)
    return render_explanation(
        explanation,
        title=title,
        model_name=model_name,
        log_names=log_names,
        more=(motions_section(motions, units), rest_section(correlates)),
        advice=(advice,) if advice else (),
        links=links,
    )


def motions_section(motions: Sequence[Rollout] | None, units: Units) -> Section:
    """Return how far the robot departs from its motion under commands; empty without commands."""
    if motions is None:
        return Section(MOTIONS)
    before, *between, after = motions
    text = (
        f"The model is simulated under the logged commands, in windows of {after.horizon:g} s that "
        "start at the measured state, and its motion compared with the measured one; before with "
        "the model as it was and the same servos, and after each step."
    )
    return Section(MOTIONS, (text,), (departures_table(after, before, units, between),))


def rest_section(correlates: Sequence[Correlate]) -> Section:
    """Return what an error goes with that nothing explains; empty if nothing is known."""
    text = ("Shares of the error left at a joint that go with simple signals, on held-out data.",)
    items = tuple(map(correlate_words, correlates))
    return Section("What the rest goes with", text if items else (), items=items)
