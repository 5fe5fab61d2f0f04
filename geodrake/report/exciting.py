"""Pages of `excite` and `identifiable`: what a motion, or logs, can tell of a model."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from geodrake.excitation import ExcitationResult, FourierMotion, Separation, SplineMotion
from geodrake.excitation.design import THRESHOLD, identifiable_directions, improvement
from geodrake.excitation.identifiable import LogIdentifiability
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.tell_apart import CLEAR, distinguished_pairs
from geodrake.inertia import Array
from geodrake.report.charts import MOST_PANELS, Chart, Panel, Plot, Stage
from geodrake.report.json_output import number_or, picked
from geodrake.report.numbers import UNKNOWN, Units, number, percent, relative
from geodrake.report.page import About, Cell, Page, Records, Section, Table, Tile, View, cells
from geodrake.report.series_table import Columns
from geodrake.report.words import effect_label, listed, places_label

_FINE = 600  # instants that are drawn
_COLUMNS = (
    ("position", "rad", ""),
    ("velocity", "rad/s", "velocity"),
    ("acceleration", "rad/s²", "acceleration"),
    ("effort", "N·m", "effort"),
)
_DESIGNED = Stage("designed", "designed", "after")
_DOTS = Stage("designed", "designed", "after", look="dots")
_EFFECT, _IMITATION = (
    Stage("effect", "effect", "after"),
    Stage("imitation", "best imitation", "before"),
)
_FOUND = Stage("found", "identifiable", "after", look="dots")
_LOST = Stage("lost", "not identifiable", "before", look="dots")
_IDEAL = Stage("ideal", "at sensor noise alone", "noise")
_MOST_PAIRS, _MOST_DRAWN = 12, 4
_MOST_COMBINATIONS, _MOST_DIRECTIONS = 12, 8
_SMALL = 0.05  # share of a direction below which a body is not named
_HALF = 0.5  # of a parameter: a body of which less is possible is not spoken of
_FULL, _HARDLY = 0.9, 0.1  # shares of a body above which it counts as all, and below as nothing
_CERTAIN = 1e-6  # least deviation that is drawn


def excitation_page(result: ExcitationResult, about: About) -> Page:
    """Say what a designed motion is worth, and how it uses the robot's limits."""
    apart = isinstance(result.objective, Separation)
    units, nearest = Units.of(result.objective.target.model), _nearest(result)
    return Page(
        about.title,
        f"{about.model}: {motion_words(result)}",
        "compared",
        "designed",
        excitation_verdict(result),
        tuple(filter(None, (f"Nearest to each other: {nearest}" * bool(nearest), _time(result)))),
        _pair_tiles(result) if apart else _tiles(result),
        (
            _pairs_section(result, units) if apart else _directions_section(result),
            Section(
                "The motion",
                "Where the joints move, and the largest shares of their limits.",
                tables=(limits_table(result, units),),
                charts=(motion_chart(result, units),),
            ),
            Section(
                "Starts",
                "What a design made of each random motion; less is better.",
                (
                    "The criterion is one over the squared deviations of the hardest pair."
                    if apart
                    else f"The criterion is {result.objective.criterion.name}.",
                ),
                tables=(_starts_table(result),),
            ),
            Section("Notes", items=result.notes),
        ),
        "Made by geodrake: limits hold between samples too; information is that of the samples "
        "with the noise that was asked for.",
        about.links,
    )


def motion_words(result: ExcitationResult) -> str:
    """Return what kind of motion it is."""
    family = result.trajectory.family
    if isinstance(family, FourierMotion):
        base = family.omega / (2.0 * np.pi)
        return (
            f"a Fourier motion of {family.duration:g} s, {family.modes} harmonics of {base:.3g} Hz"
        )
    if isinstance(family, SplineMotion):
        return f"a spline motion of {family.duration:g} s, {family.points} control points"
    return f"{family.count // 3} free samples"


def excitation_verdict(result: ExcitationResult) -> str:
    """Return what a designed motion amounts to, in a few sentences."""
    if distinguished_pairs(result):
        return _separation_verdict(result)
    criterion, normalization = result.objective.criterion.name, result.objective.normalization
    words = f"{criterion.replace('_', ' ')} {number(result.value)}"
    if criterion == "e_optimality" and normalization == "geometric":
        words += f": the worst direction has a deviation of {relative(result.value**0.5)}"
    words += f"; {_times(improvement(result))} better than the best random motion."
    if normalization == "geometric":
        words += (
            f" Its {result.samples} samples identify {identifiable_directions(result)} of "
            f"{len(result.eigenvalues)} directions to within {percent(THRESHOLD**0.5)}."
        )
    return words[:1].upper() + words[1:]


def _separation_verdict(result: ExcitationResult) -> str:
    hardest, gained = distinguished_pairs(result)[0], improvement(result) ** 0.5
    units = Units.of(result.objective.target.model)
    words = (
        f"Every pair differs by at least {number(hardest.deviations)} standard deviations of the "
        f"noise of all {result.samples} samples together, {_times(gained)} what the best random "
        f"motion makes of it. Hardest to distinguish is {hardest.pair.truth} of "
        f"{places_label(hardest.pair.where, units.joints)} from {hardest.pair.rival}, which leaves "
        f"an effort of {number(hardest.effort)} {units.effort()} RMS unexplained."
    )
    if hardest.deviations < CLEAR:
        words += " That is little: such a log will hardly distinguish them."
    return words


def _times(factor: float) -> str:
    return f"{number(factor)} times" if np.isfinite(factor) else "infinitely"


def _nearest(result: ExcitationResult) -> str:
    """Say how near the robot comes to itself and to each obstacle; "" if nobody looked."""
    use = result.use
    if not use.clearances:
        return ""
    parts = [
        f"{names} {1e3 * least:.0f} mm apart"
        for least, names in sorted(use.clearances.values(), key=lambda each: each[0])
    ]
    return f"{'; '.join(parts)}, where {1e3 * use.clearance:.0f} mm are to be kept."


def _time(result: ExcitationResult) -> str:
    """Say how long the motion takes and where it starts; "" of samples without a time."""
    trajectory = result.trajectory
    if not trajectory.length:
        return ""
    units = Units.of(result.objective.target.model)
    pairs = zip(result.limits.joints, trajectory.states([0.0])[0, 0].tolist(), strict=True)
    at = ", ".join(f"{joint} {number(q)} {units.at(joint, 'rad')}" for joint, q in pairs)
    words = f"{trajectory.length:g} s from rest to rest, starting at {at}; "
    if result.ramps is not None:
        return f"{words}{result.executed.length:.1f} s with the ramps from and to where it stands."
    return f"{words}bring the robot there first, or say where it stands: --stand."


def _tiles(result: ExcitationResult) -> tuple[Tile, ...]:
    objective, count = result.objective, len(result.eigenvalues)
    criterion = objective.criterion.name.replace("_", " ")
    tiles = (
        Tile(criterion, number(result.value), f"{objective.normalization} normalization"),
        Tile("better than random", f"{number(improvement(result))} ×", "than the best start"),
    )
    if objective.normalization != "geometric":
        return tiles
    found = f"{identifiable_directions(result)} of {count}"
    most = percent(float(np.sqrt(THRESHOLD)))
    return (*tiles, Tile("directions identifiable", found, f"to {most}"))


def _pair_tiles(result: ExcitationResult) -> tuple[Tile, ...]:
    """Return the hardest pair in numbers."""
    pairs = distinguished_pairs(result)
    factor = float(np.sqrt(improvement(result)))
    clear = sum(entry.deviations >= CLEAR for entry in pairs)
    return (
        Tile("least difference", f"{number(pairs[0].deviations)} σ", "of the noise of all samples"),
        Tile("better than random", f"{number(factor)} ×", "than the best start"),
        Tile("pairs", str(len(pairs)), f"with at least {number(CLEAR)} σ: {clear}"),
    )


def _directions_section(result: ExcitationResult) -> Section:
    """Return deviations along the principal directions, from the most certain on."""
    values = result.eigenvalues[::-1]
    deviations = 1.0 / np.sqrt(np.where(values > 0, values, np.nan))
    geometric = result.objective.normalization == "geometric"
    limits = (float(np.sqrt(THRESHOLD)),) * geometric
    plot = _over_directions("deviation", {_DOTS.key: deviations}, limits)
    caption = "Relative deviation of an estimate along every principal direction."
    if geometric:
        caption += f" Dotted: {percent(THRESHOLD**0.5)}."
    chart = Chart("directions", caption, (_DOTS,), (Panel("", "", _NONE, (plot,)),), abreast=True)
    return Section(
        "What it identifies",
        f"From {result.samples} samples, along directions in the space of all parameters.",
        (
            "Directions are combinations of inertial parameters and of those of effects, in the "
            "units of the normalization.",
        ),
        charts=(chart,),
        detailed=True,
    )


_NONE = np.array([])


def _over_directions(label: str, curves: dict[str, Array], limits: tuple[float, ...]) -> Plot:
    count = np.arange(1.0, 1.0 + len(next(iter(curves.values()))))
    return Plot(label, curves, limits, log=True, over=count, axis="principal direction")


def _pairs_section(result: ExcitationResult, units: Units) -> Section:
    """Return every pair with its difference, and how the hardest look."""
    count = len(distinguished_pairs(result))
    some = f": the hardest {_MOST_PAIRS} of {count} pairs" if count > _MOST_PAIRS else ""
    return Section(
        "What it distinguishes",
        f"How far two effects differ once everything else is refitted{some}.",
        (
            f"In standard deviations of the noise of all {result.samples} samples together. RMS is "
            "at the joint where it is most.",
        ),
        tables=(_pairs_table(result, units),),
        charts=(_imitation_chart(result, units),),
    )


def _pairs_table(result: ExcitationResult, units: Units) -> Table:
    """Return pairs of effects and by how much they differ on a motion, the most alike first."""
    rows = tuple(
        cells(
            _shaped(entry.pair.truth),
            places_label(entry.pair.where, units.joints),
            _shaped(entry.pair.rival),
            f"{number(entry.deviations)} σ",
            number(entry.effort),
        )
        for entry in distinguished_pairs(result)[:_MOST_PAIRS]
    )
    unit = units.effort(result.limits.joints)
    head = ("if the robot has", "where", "and is thought to have", "they differ by", f"RMS, {unit}")
    return Table(head, rows, words=3)


def _shaped(name: str) -> Cell:
    """Return an effect with its shape: `nonlinear viscous friction (exponent 2)`."""
    effect, bracket, shape = name.partition(" (")
    return Cell(effect_label(effect) + bracket + shape, typed=name)


def _imitation_chart(result: ExcitationResult, units: Units) -> Chart:
    """Return efforts of effects, and the best that their rivals make of them."""
    separation, family = result.objective, result.trajectory.family
    times = family.times(result.samples)
    at = times if family.timed else np.arange(float(len(times)))
    panels = []
    for entry in distinguished_pairs(result)[:_MOST_DRAWN]:
        if not isinstance(separation, Separation):
            continue
        truth, imitated = separation.imitation(result.motion, separation.pairs.index(entry.pair))
        j = int(np.argmax(np.square(truth - imitated).sum(0)))
        joint = result.limits.joints[j]
        words = f"{joint}: {_shaped(entry.pair.truth).text} for {_shaped(entry.pair.rival).text}"
        curves = {_EFFECT.key: truth[:, j], _IMITATION.key: imitated[:, j]}
        plot = Plot(f"effort, {units.at(joint, 'N·m')}", curves)
        panels.append(Panel(words, "", at, (plot,)))
    caption = (
        "What the effect adds to the effort of the joint where its rival fails most, and the most "
        "that the rival and everything else that is refitted make of it, the hardest pair first. "
        "Where the sign of the speed is hardly known, samples count less."
    )
    return Chart(
        "pairs",
        caption,
        (_EFFECT, _IMITATION),
        tuple(panels),
        (("", float(at[0]), float(at[-1]), 0.0),),
        "time, s" if family.timed else "sample",
        "Pairs",
    )


def limits_table(result: ExcitationResult, units: Units) -> Table:
    """Return ranges of the joints, and the largest shares of their limits that a motion uses."""
    limits, use = result.limits, result.use
    q = result.trajectory.states(result.trajectory.family.times(result.samples))[0]
    rows = tuple(
        cells(
            f"{joint}, {units.at(joint, 'rad')}",
            f"{number(float(limits.lower[j]))} … {number(float(limits.upper[j]))}",
            f"{number(float(q[:, j].min()))} … {number(float(q[:, j].max()))}",
            percent(float(use.position[j])),
            *(
                percent(float(getattr(use, name)[j]))
                if np.isfinite(getattr(limits, name)[j])
                else UNKNOWN
                for name in ("velocity", "acceleration", "jerk", "effort")
            ),
            *(number(float(use.peaks[name][j])) for name in ("velocity", "acceleration")),
        )
        for j, joint in enumerate(limits.joints)
    )
    shares = ("range", "velocity", "acceleration", "jerk", "effort")
    head = ("joint", "limits", "moves in", *shares, "peak speed", "peak acceleration")
    return Table(head, rows)


def _starts_table(result: ExcitationResult) -> Table:
    """Return what a design made of every random motion that it began with."""
    rows = tuple(
        cells(
            str(outcome.seed),
            outcome.status,
            number(outcome.random_value),
            number(outcome.value),
            str(outcome.evaluations),
            f"{outcome.seconds:.1f}",
        )
        for outcome in result.outcomes
    )
    head = ("seed", "solver", "random motion", "designed", "evaluations", "seconds")
    return Table(head, rows, words=2)


def motion_chart(result: ExcitationResult, units: Units) -> Chart:
    """Return position, velocity, acceleration and effort of every joint, with their limits."""
    model, limits, trajectory = result.objective.target.model, result.limits, result.trajectory
    timed, times = trajectory.family.timed, trajectory.family.times(_FINE)
    states = trajectory.states(times)
    width = result.objective.target.sign_width
    effort = model.effort(trajectory.motion_of(states), sign_width=width)
    at = times if timed else np.arange(float(len(times)))
    stage = _DESIGNED if timed else _DOTS
    panels = []
    for j, joint in enumerate(limits.joints):
        plots = tuple(
            Plot(
                f"{name}, {units.at(joint, unit)}",
                {stage.key: values[:, j]},
                tuple(b for b in _bounds(limits, j, limit) if abs(b) <= _reach(values[:, j])),
                tall=name == "position",
            )
            for values, (name, unit, limit) in zip((*states, effort), _COLUMNS, strict=True)
        )
        panels.append(Panel(joint, "", at, plots, shown=j < MOST_PANELS))
    caption = (
        "Position, velocity, acceleration and effort of every joint. Dotted lines are limits; an "
        "axis without them shows a motion that stays far inside."
    )
    spans = (("", float(at[0]), float(at[-1]), 0.0),)
    axis = "time, s" if timed else "sample"
    return Chart("motion", caption, (stage,), tuple(panels), spans, axis)


def _bounds(limits: MotionLimits, j: int, name: str) -> tuple[float, float]:
    """Return the limits of a joint's position, or of another signal by name."""
    if not name:
        return float(limits.lower[j]), float(limits.upper[j])
    most = float(getattr(limits, name)[j])
    return -most, most


def _reach(values: Array) -> float:
    """Return how far away a limit may be to be drawn."""
    return 2.5 * max(float(np.abs(values).max()), 1e-9)


def identifiability_page(found: LogIdentifiability, about: About) -> Page:
    """Say which parameters logs identify, and which they do not."""
    units, most = about.units, percent(found.identifiable.threshold**0.5)
    count = sum(entry.is_identifiable for entry in found.effects)
    effects = (
        [Tile("effects identifiable", f"{count} of {len(found.effects)}")] if found.effects else []
    )
    rest = found.unidentifiable
    return Page(
        about.title,
        about.against,
        "compared",
        "identifiable",
        f"{_identifiable_share(found)}.",
        tuple(filter(None, [_beyond(found)])),
        (
            Tile(
                "directions identifiable",
                f"{found.count} of {found.possible}",
                f"to within {most}",
            ),
            Tile(
                "at sensor noise alone", f"{found.count_at_floor}", "if the model left nothing else"
            ),
            *effects,
        ),
        (
            Section(
                "Bodies",
                f"Parameters identifiable to within {most}, of those that any motion could show.",
                (
                    "A body has ten inertial parameters; so many of them are identifiable from the "
                    "best of motions, some only together with those of others. Part of one can be.",
                ),
                tables=(bodies_identifiable_table(found),),
            ),
            Section(
                "Effects",
                "Deviation of an estimate from these logs alone, everything else estimated too.",
                tables=(_effects_table(found, units),),
            ),
            Section(
                "Directions",
                "Relative deviation along principal directions, and what these are mostly of.",
                tables=(_directions_table(found),),
                charts=(_directions_chart(found),),
            ),
            Section(
                "Not identifiable",
                f"{len(rest)} of {found.possible} combinations of parameters, SI units, the worst "
                f"{min(len(rest), _MOST_COMBINATIONS)} first; --json has all.",
                tables=(_combinations_table(found),),
            ),
            Section("Notes", items=found.notes),
        ),
        "Made by geodrake: relative deviations are lengths in the geometric metric of inertial "
        "parameters, and depend neither on frames nor on units.",
        about.links,
    )


def identifiability_verdict(found: LogIdentifiability) -> str:
    """Return what is identifiable from logs, in a few sentences."""
    return f"{_identifiable_share(found)}. {_beyond(found)}".rstrip()


def _beyond(found: LogIdentifiability) -> str:
    """Return which effects are identifiable, and what would be with a better model."""
    words = []
    unknown = [entry.label for entry in found.effects if not entry.is_identifiable]
    if unknown:
        words.append(f"Not identifiable: {listed(unknown)}.")
    elif found.effects:
        words.append("All parameters of effects are identifiable.")
    if found.count_at_floor > found.count:
        words.append(
            f"If the model left nothing but sensor noise, {found.count_at_floor} would be."
        )
    return " ".join(words)


def _identifiable_share(found: LogIdentifiability) -> str:
    """Return `9 of 12 directions are identifiable to within 10 %; hand in full`."""
    most = percent(found.identifiable.threshold**0.5)
    share = f"{found.count} of {found.possible} directions are identifiable to within {most}"
    return share + _whose_bodies(found)


def _whose_bodies(found: LogIdentifiability) -> str:
    """Return which bodies are identifiable in full, and which hardly at all."""
    seen = [body for body in found.bodies if body.possible >= _HALF]
    full = [body.name for body in seen if body.share > _FULL]
    none = [body.name for body in seen if body.share < _HARDLY]
    words = f"; {listed(full)} in full" if full else ""
    return f"{words}; {listed(none)} hardly at all" if none else words


def bodies_identifiable_table(found: LogIdentifiability) -> Table:
    """Return how many parameters of every body are identifiable, of those that a motion shows."""
    rows = [
        cells(
            body.name,
            Cell(f"{body.count:.1f}", bar=min(1.0, body.share)),
            f"{body.possible:.1f}",
            percent(body.share),
        )
        for body in found.bodies
    ]
    counts = [
        f"{sum(getattr(b, name) for b in found.bodies):.1f}" for name in ("count", "possible")
    ]
    head = ("body", "identifiable", "of", "share")
    return Table(head, (*rows, cells("all bodies", *counts, "")), total=1)


def _effects_table(found: LogIdentifiability, units: Units) -> Table:
    """Return every parameter of an effect with the deviation of an estimate."""
    rows = tuple(
        cells(
            entry.name,
            places_label(entry.where, units.joints),
            "identifiable" if entry.is_identifiable else "not identifiable",
            number(entry.value),
            number(entry.deviation),
            units.parameter(entry.effect, entry.parameter, " & ".join(entry.where)),
        )
        for entry in found.effects
    )
    head = ("parameter", "where", "", "value", "deviation", "unit")
    return Table(head, rows, words=3)


def _directions_table(found: LogIdentifiability) -> Table:
    """Return the best and worst directions, and those about the threshold."""
    variances, names = found.identifiable.variances, found.blocks
    count, half = len(variances), _MOST_DIRECTIONS // 4
    near = {*range(half), *range(found.count - half, found.count + half)}
    near |= {*range(count - half, count)}
    rows, before = [], -1
    for k in sorted(k for k in near if 0 <= k < count):
        if k > before + 1:
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
        before = k
    head = ("", "mostly of", "identifiable", "deviation", "at sensor noise")
    return Table(head, tuple(rows), words=3)


def _directions_chart(found: LogIdentifiability) -> Chart:
    """Return the deviations along all principal directions, the most certain first."""
    kept = np.arange(found.possible) < found.count
    deviations = np.sqrt(found.identifiable.variances)
    drawn = np.where(np.isfinite(deviations), np.maximum(deviations, _CERTAIN), np.nan)
    ideal = np.sqrt(found.floor_variances)
    curves = {
        _FOUND.key: np.where(kept, drawn, np.nan),
        _LOST.key: np.where(kept, np.nan, drawn),
        _IDEAL.key: np.where(np.isfinite(ideal), np.maximum(ideal, _CERTAIN), np.nan),
    }
    plot = _over_directions("relative deviation", curves, (found.identifiable.threshold**0.5,))
    caption = "Directions below the dotted line are identifiable."
    panels = (Panel("", "", _NONE, (plot,)),)
    return Chart("directions", caption, (_FOUND, _LOST, _IDEAL), panels, abreast=True)


def _combinations_table(found: LogIdentifiability) -> Table:
    """Return the base parameters that are not identifiable, worst first."""
    rows = tuple(
        cells(c.words, number(c.value), number(c.deviation), relative(c.relative))
        for c in found.unidentifiable[:_MOST_COMBINATIONS]
    )
    return Table(("combination", "in the model", "deviation", "relative"), rows)


def excitation_dict(result: ExcitationResult) -> dict[str, Any]:
    """Return a designed motion: its coefficients, what it is worth, what it uses of the limits.

    Args:
        result: The result of `geodrake.excitation.design_excitation`; of a `Separation`, its value
            is 1/Δ of the pair that is hardest to distinguish.
    """
    objective, family = result.objective, result.trajectory.family
    use, limits, target = result.use, result.limits, result.objective.target
    pairs, shares = distinguished_pairs(result), ("velocity", "acceleration", "effort", "jerk")
    coefficients = zip(result.trajectory.joints, result.trajectory.coefficients.T, strict=True)

    def by_joint(of: object, *names: str) -> dict[str, dict[str, float]]:
        return {
            joint: {name: getattr(of, name)[j] for name in names}
            for j, joint in enumerate(limits.joints)
        }

    return {
        "criterion": "separation" if pairs else objective.criterion.name,
        "normalization": objective.normalization,
        "value": result.value,
        "improvement_over_random": improvement(result),
        "verdict": excitation_verdict(result),
        **picked(result, "eigenvalues", interrupted="is_interrupted"),
        "directions_told": None if pairs else identifiable_directions(result),
        "pairs": [
            {
                **picked(found.pair, "truth", "where", "rival"),
                **picked(found, "deviations", effort_rms="effort"),
            }
            for found in pairs
        ],
        "samples": result.samples,
        "noise": dict(zip(target.model.joints, target.noise, strict=True)),
        "motion": {
            "family": family.name,
            **asdict(family),  # type: ignore[call-overload]
            "coefficients": dict(coefficients),
        },
        "limits": by_joint(limits, "lower", "upper", *shares),
        "use": by_joint(use, "position", *shares),
        "peaks": {
            joint: {name: values[j] for name, values in use.peaks.items()}
            for j, joint in enumerate(limits.joints)
        },
        "clearances": {
            party: {"least": least, "between": names}
            for party, (least, names) in use.clearances.items()
        },
        "seconds": {
            "motion": result.trajectory.length,
            "with_ramps": result.executed.length,
            "search": result.seconds,
        },
        "start": dict(zip(limits.joints, result.trajectory.states([0.0])[0, 0], strict=True)),
        "distance": {
            "least": number_or(use.distance, "collisions were not looked for"),
            **picked(use, "clearance", between="nearest"),
        },
        "starts": result.outcomes,
        "notes": result.notes,
    }


def identifiable_dict(found: LogIdentifiability) -> dict[str, Any]:
    """Return what is identifiable from logs: directions, bodies, effects and base parameters.

    Returns:
        `told` of `possible` directions, `threshold`, and `directions`, `bodies`, `effects`,
        `combinations` with their (relative) deviations.
    """
    identifiable = found.identifiable
    directions = zip(
        identifiable.variances, found.floor_variances, identifiable.shares.T, strict=True
    )
    joints = zip(found.model.joints, found.noise, found.floor, found.samples, strict=True)
    block = {"told": "count", "possible": "possible", "share": "share"}
    return {
        **picked(found, "possible", told="count", told_at_sensor_noise="count_at_floor"),
        "threshold": identifiable.threshold,
        "verdict": identifiability_verdict(found),
        "directions": [
            {
                "variance": variance,
                "variance_at_sensor_noise": ideal,
                "told": k < found.count,
                "shares": dict(zip(found.blocks, shares, strict=True)),
            }
            for k, (variance, ideal, shares) in enumerate(directions)
        ],
        "bodies": {body.name: picked(body, **block) for body in found.bodies},
        "effects": [
            {
                **picked(entry, "effect", "parameter", "where"),
                **picked(entry, "value", "deviation", **block),
            }
            for entry in found.effects
        ],
        "combinations": found.combinations,
        "joints": {
            joint: {"noise": noise, "sensor_noise": floor, "samples": samples}
            for joint, noise, floor, samples in joints
        },
        "notes": found.notes,
    }


def _use_records(found: ExcitationResult) -> Records:
    names = ("position", "velocity", "acceleration", "effort")
    return [
        {"joint": joint, **{f"{name}_share": float(getattr(found.use, name)[j]) for name in names}}
        for j, joint in enumerate(found.limits.joints)
    ]


def _motion(found: ExcitationResult) -> Columns:
    trajectory = found.trajectory
    times = trajectory.family.times(found.samples)
    states = zip(("position", "velocity", "acceleration"), trajectory.states(times), strict=True)
    columns: dict[str, Any] = {"time": times}
    for name, values in states:
        columns |= {f"{j}.{name}": values[:, k] for k, j in enumerate(trajectory.joints)}
    return columns


VIEWS = {
    ExcitationResult: View(excitation_page, excitation_dict, _use_records, _motion, "motion"),
    LogIdentifiability: View(
        identifiability_page,
        identifiable_dict,
        lambda found: [asdict(block) for block in (*found.bodies, *found.effects)],
        figure="directions",
    ),
}
"""How to see each of these results."""
