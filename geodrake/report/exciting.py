"""Pages of `excite` and `identifiable`: the information in a motion or in logs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from geodrake.excitation import FourierMotion, Separation, SplineMotion
from geodrake.excitation.design import (
    THRESHOLD,
    ExcitationResult,
    identifiable_directions,
    improvement,
)
from geodrake.excitation.identifiable import LogIdentifiability
from geodrake.excitation.tell_apart import CLEAR, distinguished_pairs
from geodrake.inertia import Array
from geodrake.report.charts import MOST_PANELS, Chart, Panel, Plot, Stage
from geodrake.report.json_output import keys_of
from geodrake.report.numbers import UNKNOWN, Units, number, percent, relative
from geodrake.report.page import About, Cell, Page, Section, Table, View, cells
from geodrake.report.views import Columns
from geodrake.report.words import capitalized, effect_label, listed, places_label

_COMBINATION = ("combination", "in the model", "deviation", "relative")
_STARTS = ("seed", "solver", "random motion", "designed", "evaluations", "seconds")
_FINE = 600  # drawn instants
_COLUMNS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²", "effort": "N·m"}
_REACH = 2.5  # multiple of the largest value beyond which limits are not drawn
_DESIGNED = Stage("designed", "after")
_DOTS = Stage("designed", "after", look="dots")
_EFFECT, _IMITATION = Stage("effect", "after"), Stage("best imitation", "before")
_IDENTIFIABLE = Stage("identifiable", "after", look="dots")
_UNIDENTIFIABLE = Stage("not identifiable", "before", look="dots")
_IDEAL = Stage("at sensor noise alone", "noise")
_MOST_PAIRS, _MOST_DRAWN = 12, 4
_MOST_COMBINATIONS, _MOST_DIRECTIONS = 12, 8
_SMALL = 0.05  # share of a direction below which a body is not named
_LEAST_POSSIBLE = 0.5  # parameters; bodies with fewer possible ones are not mentioned
_LEAST_SHOWN = 0.05  # parameters; fewer are printed as 0.0
_FULL, _HARDLY = 0.9, 0.1  # shares of a body that count as "all of" and "hardly any of" it
_LEAST_DEVIATION = 1e-6  # smallest deviation on the logarithmic axis


def excitation_page(result: ExcitationResult, about: About) -> Page:
    """Return the page of a designed motion."""
    is_separation = isinstance(result.objective, Separation)
    units = Units.of(result.objective.target.model)
    starts = [
        cells(
            *(start.seed, _status(start.status), start.random_value, start.value),
            *(start.evaluations, f"{start.seconds:.1f}"),
        )
        for start in result.outcomes
    ]
    headline, *more = excitation_sentences(result)
    facts = dict(zip(("Hardest", "Warning"), more, strict=False))
    if more and not is_separation:
        (headline,) = more
        facts = {"Criterion": _criterion_words(result), "Improvement": _gain_words(result)}
    return Page(
        about,
        headline,
        (
            _pairs_section(result, units) if is_separation else _directions_section(result),
            Section(
                "The motion",
                "The path of each joint, and its largest shares of the limits.",
                tables=(_limits_table(result, units),),
                charts=(_motion_chart(result, units),),
            ),
            Section(
                "Starts",
                "Result from each random initial motion; smaller is better.",
                (
                    "The criterion is the inverse squared deviation of the hardest pair."
                    if is_separation
                    else f"The criterion is {result.objective.criterion.name}."
                ),
                tables=(Table(_STARTS, starts, words=2),),
                deep=True,
            ),
            Section("Notes", items=result.notes),
        ),
        of=f"{about.model}: {_motion_words(result)}",
        verdict="designed",
        facts={**facts, **_motion_facts(result)},
        footer="Made by geodrake. Limits also hold between samples; the information is that of "
        "the samples with the requested noise.",
    )


def _status(status: str) -> str:
    """Return a solver's status in words, such as `iteration limit` for Drake's kIterationLimit."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", status.removeprefix("k"))
    return words.lower() if status.startswith("k") else status


def _motion_words(result: ExcitationResult) -> str:
    """Return the family of motions in words."""
    family = result.trajectory.family
    if isinstance(family, FourierMotion):
        harmonics = f"{family.modes} harmonics of {family.omega / (2.0 * np.pi):.3g} Hz"
        return f"a Fourier motion of {family.duration:g} s, {harmonics}"
    if isinstance(family, SplineMotion):
        return f"a spline motion of {family.duration:g} s, {family.points} control points"
    return f"{family.count // 3} free samples"


def excitation_sentences(result: ExcitationResult) -> list[str]:
    """Return the value of a designed motion in sentences."""
    if pairs := distinguished_pairs(result):
        gained = improvement(result)
        hardest, units = pairs[0], Units.of(result.objective.target.model)
        sentences = [
            f"Every pair differs by at least {number(hardest.deviations)} standard deviations of "
            f"the noise in {result.samples} samples, {_times(gained**0.5)} as much as on the best "
            "random motion.",
            f"The hardest to distinguish are {hardest.pair.truth} of "
            f"{places_label(hardest.pair.where, units.driven)} and {hardest.pair.rival}, with an "
            f"unexplained effort of {number(hardest.effort)} {units.effort()} RMS.",
        ]
        is_hard = hardest.deviations < CLEAR
        return [*sentences, *["Such a log will hardly distinguish them."] * is_hard]
    sentences = [f"{_criterion_words(result)}; {_gain_words(result)}."]
    if result.objective.normalization == "geometric":
        sentences.append(
            f"Its {result.samples} samples identify {identifiable_directions(result)} of "
            f"{len(result.eigenvalues)} directions to within {percent(THRESHOLD**0.5)}."
        )
    return sentences


def _criterion_words(result: ExcitationResult) -> str:
    """Return the criterion of a design with its value."""
    criterion, normalization = result.objective.criterion.name, result.objective.normalization
    words = capitalized(f"{criterion.replace('_', ' ')} {number(result.value)}")
    if criterion == "e_optimality" and normalization == "geometric":
        words += f": the worst direction has a relative deviation of {relative(result.value**0.5)}"
    return words


def _gain_words(result: ExcitationResult) -> str:
    return f"{_times(improvement(result))} better than the best random motion"


def _times(factor: float) -> str:
    return f"{number(factor)} times" if np.isfinite(factor) else "infinitely"


def _motion_facts(result: ExcitationResult) -> dict[str, str]:
    """Return the distances, balance and duration of a motion, where they apply."""
    use, trajectory, stance = result.use, result.trajectory, result.trajectory.stance
    facts = {}
    if use.clearances:
        parts = [
            f"{names} {1e3 * least:.0f} mm apart"
            for least, names in sorted(use.clearances.values(), key=lambda each: each[0])
        ]
        clearance = f"the clearance is {1e3 * use.clearance:.0f} mm"
        facts["Smallest distance"] = f"{'; '.join(parts)}; {clearance}"
    if stance is not None:
        facts["Balance"] = (
            f"on {listed([foot.frame for foot in stance.feet])}, the zero-moment point goes up to "
            f"{percent(use.polygon)} of the way from the centre of the feet to their edge "
            f"({percent(use.margin)} is allowed), and uses {percent(use.friction)} of the friction "
            f"coefficient {stance.friction:g}"
        )
    if trajectory.length:
        facts["Start"] = "move the robot to the start, or give its rest position with --stand"
        if result.ramps is not None:
            facts["Start"] = "the robot is at rest, where the motion begins and ends"
            facts["Duration"] = f"{result.executed.length:.1f} s with the ramps from and to rest"
    return facts


def _directions_section(result: ExcitationResult) -> Section:
    """Return deviations along the principal directions, the most certain first."""
    values = result.eigenvalues[::-1]
    deviations = 1.0 / np.sqrt(np.where(values > 0, values, np.nan))
    geometric = result.objective.normalization == "geometric"
    caption = "Relative deviation of an estimate along each principal direction."
    caption += f" Dotted: {percent(THRESHOLD**0.5)}." * geometric
    limits, curves = (THRESHOLD**0.5,) * geometric, {_DOTS: deviations}
    chart = _directions_chart("deviation", caption, curves, limits)
    return Section(
        "Identifiable directions",
        f"From {result.samples} samples, along directions in the space of all parameters.",
        "Directions combine inertial parameters and those of effects, in the units of the "
        "normalization.",
        charts=(chart,),
        detailed=True,
    )


def _directions_chart(
    label: str, caption: str, curves: dict[Stage, Array], limits: tuple[float, ...]
) -> Chart:
    count = np.arange(1.0, 1.0 + len(next(iter(curves.values()))))
    plot = Plot(label, curves, limits, log=True, over=count, axis="principal direction")
    panels = (Panel("", "", np.array([]), (plot,)),)
    return Chart("directions", caption, panels, abreast=True)


def _pairs_section(result: ExcitationResult, units: Units) -> Section:
    """Return the differences of all pairs, the hardest first, and a chart of the hardest."""
    pairs = distinguished_pairs(result)
    rows = [
        cells(
            _effect_cell(entry.pair.truth),
            places_label(entry.pair.where, units.driven),
            _effect_cell(entry.pair.rival),
            f"{number(entry.deviations)} σ",
            entry.effort,
        )
        for entry in pairs[:_MOST_PAIRS]
    ]
    unit = units.effort(result.limits.joints)
    head = ("if the robot has", "where", "and the model has", "they differ by", f"RMS, {unit}")
    count = f": the hardest {_MOST_PAIRS} of {len(pairs)} pairs" if len(pairs) > len(rows) else ""
    return Section(
        "Distinguishable effects",
        f"How far two effects differ after refitting everything else{count}.",
        f"In standard deviations of the noise in all {result.samples} samples. RMS is at the "
        "joint where it is largest.",
        tables=(Table(head, rows, words=3),),
        charts=(_imitation_chart(result, units),),
    )


def _effect_cell(name: str) -> Cell:
    """Return an effect with its shape: `nonlinear viscous friction (exponent 2)`."""
    effect, bracket, shape = name.partition(" (")
    return Cell(effect_label(effect) + bracket + shape, typed=name)


def _imitation_chart(result: ExcitationResult, units: Units) -> Chart:
    """Return efforts of effects, and the best approximations by their rivals."""
    separation, family = result.objective, result.trajectory.family
    times = family.times(result.samples)
    axis = times if family.timed else np.arange(float(len(times)))
    panels = []
    for entry in distinguished_pairs(result)[:_MOST_DRAWN]:
        if not isinstance(separation, Separation):
            continue
        pair = separation.pairs.index(entry.pair)
        truth, imitation = separation.imitation(result.motion, pair)
        j = int(np.argmax(np.square(truth - imitation).sum(0)))
        joint = result.limits.joints[j]
        names = [_effect_cell(name).text for name in (entry.pair.truth, entry.pair.rival)]
        curves = {_EFFECT: truth[:, j], _IMITATION: imitation[:, j]}
        plot = Plot(f"effort, {units.at(joint, 'N·m')}", curves)
        panels.append(Panel(f"{joint}: {' for '.join(names)}", "", axis, (plot,)))
    caption = (
        "Effort of the effect at the joint where its rival fits worst, and the best fit by "
        "the rival with everything else refitted; the hardest pair first. Where the sign of "
        "the velocity is uncertain, samples have less weight."
    )
    return Chart(
        "pairs",
        caption,
        tuple(panels),
        axis="time, s" if family.timed else "sample",
        parts="Pairs",
    )


def _limits_table(result: ExcitationResult, units: Units) -> Table:
    """Return the ranges of the joints, and the largest shares of their limits in a motion."""
    limits, use, rows = result.limits, result.use, []
    trajectory = result.trajectory
    q = trajectory.states(trajectory.family.times(result.samples))[0]
    start = trajectory.states([0.0])[0, 0].tolist()
    for j, joint in enumerate(limits.joints):
        ends = (limits.lower[j], limits.upper[j]), (q[:, j].min(), q[:, j].max())
        ranges = (f"{number(float(low))} … {number(float(high))}" for low, high in ends)
        shares = [
            percent(float(getattr(use, name)[j]))
            if np.isfinite(getattr(limits, name)[j])
            else UNKNOWN
            for name in ("velocity", "acceleration", "jerk", "effort")
        ]
        peaks = (float(use.peaks[name][j]) for name in ("velocity", "acceleration"))
        name = f"{joint}, {units.at(joint, 'rad')}"
        position = percent(float(use.position[j]))
        rows.append(cells(name, start[j], *ranges, position, *shares, *peaks))
    shares_of = ("range", "velocity", "acceleration", "jerk", "effort")
    head = ("joint", "start", "limits", "moves in", *shares_of, "peak speed", "peak acceleration")
    return Table(head, rows, deep=("limits", "range", "jerk", "peak speed", "peak acceleration"))


def _motion_chart(result: ExcitationResult, units: Units) -> Chart:
    """Return position, velocity, acceleration and effort of every joint, with their limits."""
    model, limits, trajectory = result.objective.target.model, result.limits, result.trajectory
    timed, times = trajectory.family.timed, trajectory.family.times(_FINE)
    states = trajectory.states(times)
    width = result.objective.target.sign_width
    effort = trajectory.efforts(model, times, sign_width=width)
    instants = times if timed else np.arange(float(len(times)))
    stage = _DESIGNED if timed else _DOTS
    panels = []
    for j, joint in enumerate(limits.joints):
        plots = []
        for values, (name, unit) in zip((*states, effort), _COLUMNS.items(), strict=True):
            ends = limits.lower[j], limits.upper[j]
            if name != "position":
                ends = -getattr(limits, name)[j], getattr(limits, name)[j]
            reach = _REACH * max(float(np.abs(values[:, j]).max()), 1e-9)
            drawn = tuple(float(end) for end in ends if abs(end) <= reach)
            label, curves = f"{name}, {units.at(joint, unit)}", {stage: values[:, j]}
            plots.append(Plot(label, curves, drawn, tall=name == "position"))
        panels.append(Panel(joint, "", instants, tuple(plots), shown=j < MOST_PANELS))
    caption = (
        "Position, velocity, acceleration and effort of each joint. Dotted: limits, where they "
        "are within the range of the axis."
    )
    return Chart("motion", caption, tuple(panels), axis="time, s" if timed else "sample")


def identifiability_page(found: LogIdentifiability, about: About) -> Page:
    """Return the page of the identifiability of logs."""
    threshold = percent(found.identifiable.threshold**0.5)
    unidentifiable = found.unidentifiable
    combinations = [
        cells(each.words, each.value, each.deviation, relative(each.relative))
        for each in unidentifiable[:_MOST_COMBINATIONS]
    ]
    directions = f"{found.count} of {found.possible}"
    return Page(
        about,
        f"{directions} directions are identifiable to within {threshold}.",
        (
            Section(
                "Bodies",
                f"Parameters that are identifiable to within {threshold}, of those that any "
                "motion could identify.",
                "A body has ten inertial parameters, of which the best motion can identify "
                "this many, some only in combination with those of other bodies.",
                tables=(_bodies_table(found),),
            ),
            Section(
                "Effects",
                "Deviation of an estimate from these logs alone, with everything else "
                "estimated too.",
                tables=(_effects_table(found, about.units),),
            ),
            Section(
                "Directions",
                "Relative deviation along principal directions, and their largest components.",
                tables=(_directions_table(found),),
                charts=(_identifiable_chart(found),),
                deep=True,
            ),
            Section(
                "Not identifiable",
                f"{len(unidentifiable)} of {found.possible} combinations of parameters in SI "
                f"units; the {len(combinations)} worst are shown, --json has all.",
                tables=(Table(_COMBINATION, combinations),),
                deep=True,
            ),
            Section("Notes", items=found.notes, deep=True),
        ),
        verdict="identifiable",
        facts=_identifiable_facts(found),
        footer="Made by geodrake. Relative deviations are lengths in the geometric metric of "
        "inertial parameters, which depend neither on frames nor on units.",
    )


def _identifiable_facts(found: LogIdentifiability) -> dict[str, str]:
    """Return the bodies and effects that are identifiable, and those that are not."""
    bodies = [body for body in found.bodies if body.possible >= _LEAST_POSSIBLE]
    unknown = listed([entry.label for entry in found.effects if not entry.is_identifiable])
    is_less = found.count < found.count_at_floor
    return {
        "All of": listed([body.name for body in bodies if body.share > _FULL]),
        "Hardly any of": listed([body.name for body in bodies if body.share < _HARDLY]),
        "Not identifiable": unknown,
        "Effects": "all parameters are identifiable" if found.effects and not unknown else "",
        "With sensor noise only": f"{found.count_at_floor} directions" if is_less else "",
    }


def identifiable_sentences(found: LogIdentifiability) -> list[str]:
    """Return sentences such as `9 of 12 directions are identifiable to within 10 %`."""
    threshold, facts = percent(found.identifiable.threshold**0.5), _identifiable_facts(found)
    words = f"{found.count} of {found.possible} directions are identifiable to within {threshold}"
    for share in ("all of", "hardly any of"):
        names = facts[capitalized(share)]
        words += f", {share} {names}" if names else ""
    sentences = [f"{words}."]
    if facts["Not identifiable"]:
        sentences.append(f"Not identifiable: {facts['Not identifiable']}.")
    elif found.effects:
        sentences.append("All parameters of effects are identifiable.")
    if found.count_at_floor > found.count:
        sentences.append(f"If only sensor noise remained, {found.count_at_floor} would be.")
    return sentences


def _bodies_table(found: LogIdentifiability) -> Table:
    """Return the identifiable parameters of each body, out of those that any motion can show."""
    rows = [
        cells(
            body.name,
            Cell(f"{body.count:.1f}", bar=min(1.0, body.share)),
            f"{body.possible:.1f}",
            percent(body.share) if body.possible >= _LEAST_SHOWN else UNKNOWN,
        )
        for body in found.bodies
    ]
    sums = (sum(getattr(b, name) for b in found.bodies) for name in ("count", "possible"))
    rows.append(cells("all bodies", *(f"{each:.1f}" for each in sums), ""))
    return Table(("body", "identifiable", "of", "share"), rows, total=1)


def _effects_table(found: LogIdentifiability, units: Units) -> Table:
    """Return every parameter of an effect with the deviation of an estimate."""
    rows = []
    for entry in found.effects:
        verdict = "identifiable" if entry.is_identifiable else "not identifiable"
        unit = units.parameter(entry.effect, entry.parameter, " & ".join(entry.where))
        where = places_label(entry.where, units.driven)
        rows.append(cells(entry.name, where, verdict, entry.value, entry.deviation, unit))
    head = ("parameter", "where", "", "value", "deviation", "unit")
    return Table(head, rows, words=3)


def _directions_table(found: LogIdentifiability) -> Table:
    """Return the best and worst directions, and those shown the threshold."""
    variances, names = found.identifiable.variances, found.blocks
    count, half = len(variances), _MOST_DIRECTIONS // 4
    shown = {*range(half), *range(found.count - half, found.count + half)}
    shown |= {*range(count - half, count)}
    rows, previous = [], -1
    for k in sorted(k for k in shown if 0 <= k < count):
        if k > previous + 1:
            rows.append(cells("…", "", "", "", ""))
        shares = found.identifiable.shares[:, k]
        order = [i for i in np.argsort(-shares) if shares[i] > _SMALL][:3]
        rows.append(
            cells(
                str(k + 1),
                ", ".join(f"{names[i]} {percent(float(shares[i]))}" for i in order),
                "yes" if k < found.count else "no",
                relative(float(np.sqrt(variances[k]))),
                relative(float(np.sqrt(found.floor_variances[k]))),
            )
        )
        previous = k
    head = ("", "mostly of", "identifiable", "deviation", "at sensor noise")
    return Table(head, tuple(rows), words=3)


def _identifiable_chart(found: LogIdentifiability) -> Chart:
    """Return the deviations along all principal directions, the most certain first."""
    is_identifiable = np.arange(found.possible) < found.count
    drawn, ideal = (
        np.where(np.isfinite(deviations), np.maximum(deviations, _LEAST_DEVIATION), np.nan)
        for deviations in (np.sqrt(found.identifiable.variances), np.sqrt(found.floor_variances))
    )
    curves = {
        _IDENTIFIABLE: np.where(is_identifiable, drawn, np.nan),
        _UNIDENTIFIABLE: np.where(is_identifiable, np.nan, drawn),
        _IDEAL: ideal,
    }
    caption = "Directions below the dotted line are identifiable."
    limits = (found.identifiable.threshold**0.5,)
    return _directions_chart("relative deviation", caption, curves, limits)


def _excitation_values(result: ExcitationResult) -> dict[str, Any]:
    """Return the value of a designed motion, its coefficients, and its use of the limits."""
    objective, trajectory, pairs = result.objective, result.trajectory, distinguished_pairs(result)
    identifiable = None if pairs else identifiable_directions(result)
    family, joints = trajectory.family, result.limits.joints
    coefficients = zip(trajectory.free_joints, trajectory.coefficients.T, strict=True)
    use, balance = result.use, dict[str, Any]()
    if trajectory.stance is not None:
        shares = {"polygon": use.polygon, "margin": use.margin, "friction": use.friction}
        balance = {"balance": shares}

    def by_joint(names: Iterable[str], values: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        return {joint: {n: values[n][j] for n in names} for j, joint in enumerate(joints)}

    return {
        "criterion": "separation" if pairs else objective.criterion.name,
        "improvement_over_random": improvement(result),
        "verdict": " ".join(excitation_sentences(result)),
        "directions_identifiable": identifiable,
        "directions_told": identifiable,
        "pairs": pairs,
        "motion": {
            "family": family.name,
            **asdict(family),  # type: ignore[call-overload]
            "coefficients": dict(coefficients),
        },
        "limits": by_joint(keys_of("Limits"), vars(result.limits)),
        "use": by_joint(keys_of("Used"), vars(result.use)),
        "peaks": by_joint(result.use.peaks, result.use.peaks),
        "start": dict(zip(joints, trajectory.states([0.0])[0, 0], strict=True)),
        **balance,
    }


def _identifiable_values(found: LogIdentifiability) -> dict[str, Any]:
    """Return the directions, and the effort noise of each joint."""
    variances, shares = found.identifiable.variances, found.identifiable.shares.T
    return {
        "verdict": " ".join(identifiable_sentences(found)),
        "directions": [
            (variance, ideal, k < found.count, dict(zip(found.blocks, share, strict=True)))
            for k, (variance, ideal, share) in enumerate(
                zip(variances, found.floor_variances, shares, strict=True)
            )
        ],
        "joints": {
            joint: tuple(each)
            for joint, *each in zip(
                found.model.joints, found.noise, found.floor, found.samples, strict=True
            )
        },
    }


def _motion(found: ExcitationResult) -> Columns:
    trajectory = found.trajectory
    times = trajectory.family.times(found.samples)
    states = zip(("position", "velocity", "acceleration"), trajectory.states(times), strict=True)
    columns: dict[str, Any] = {"time": times}
    for name, values in states:
        columns |= {f"{j}.{name}": values[:, k] for k, j in enumerate(trajectory.joints)}
    return columns


VIEWS = {
    ExcitationResult: View(
        excitation_page,
        "Excitation",
        _excitation_values,
        records=lambda found: [
            {
                "joint": joint,
                "position_share": float(found.use.position[j]),
                "velocity_share": float(found.use.velocity[j]),
                "acceleration_share": float(found.use.acceleration[j]),
                "effort_share": float(found.use.effort[j]),
            }
            for j, joint in enumerate(found.limits.joints)
        ],
        samples=_motion,
        figure="motion",
    ),
    LogIdentifiability: View(
        identifiability_page,
        "Identifiability",
        _identifiable_values,
        records=lambda found: [asdict(block) for block in (*found.bodies, *found.effects)],
        figure="directions",
    ),
}
"""Type of result -> its view."""
