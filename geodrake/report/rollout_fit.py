"""The report of a fit of rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from geodrake.boundary.arguments import typed
from geodrake.control.rollout import RolloutFit
from geodrake.model.effort_signal import SERVO
from geodrake.report.numbers import Units
from geodrake.report.page import Page, Section, Tile, render
from geodrake.report.rollout import rollout_chart
from geodrake.report.tables import rollout_fit_table, rollout_values_table
from geodrake.report.words import departure, rollout_fit_words


@typed
def render_rollout_fit(
    found: RolloutFit,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of a fit of rollouts.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units, (before, after) = units or Units(), found.held_out
    words = rollout_fit_words(found)
    text = (
        f"RMS of simulated − measured position over windows of {after.horizon:g} s: "
        f"{sum(not tested for tested in found.tested)} that were fitted, and {sum(found.tested)} "
        "that the fit did not see."
    )
    page = Page(
        title,
        f"{model_name} under the {after.under} of {', '.join(log_names)}",
        "compared",
        "fitted" if found.taken else "stays",
        f"{words[:1].upper()}{words[1:]}",
        (f"{_fitted(found)}, fitted to how the simulated robot moves; all else stays.",),
        (
            Tile("before", departure(before.relative), "of the motion, held out"),
            Tile("fitted", departure(after.relative), "of the motion, held out"),
            Tile("horizon", f"{after.horizon:g} s", "from a measured state on"),
        ),
        (
            Section("What was fitted", tables=(rollout_values_table(found, units),)),
            Section(
                "Joint by joint",
                (text,),
                (rollout_fit_table(found, units),),
                charts=(rollout_chart(found.after, found.before, units),),
            ),
        ),
        f"Made by geodrake: a plant with the model's inertias and effects under the logged "
        f"{after.under}.",
        links or {},
    )
    return render(page)


def _fitted(found: RolloutFit) -> str:
    """Return what was free."""
    servos = any(value.effect == SERVO for value in found.values)
    return "Soft joints, play, their servos and motors" if servos else "Soft joints and play"
