"""What was made of the names of a log's columns, in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from geodrake.logs.files.column_names import Source, listed
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import MOTOR, PLAIN, ROLES, Meaning
from geodrake.logs.motion import PARTIAL, QUANTITIES, SIGNAL_KINDS

_SI = {"current": "A", "voltage": "V", "pwm": "shares of the supply"}
_UNITS_WITH = {**dict.fromkeys(SIGNAL_KINDS, "effort"), "command": "position"}
_CONSTANT = " (torque constant × gear ratio)"
_KIND_WORDS = {"current": "motor currents", "voltage": "voltages", "pwm": "duty cycles"}


def choice_words(best: Mapping[tuple[str, str], Sequence[Meaning]]) -> Iterator[str]:
    """Which columns were taken where several are of one quantity, in words.

    Args:
        best: (joint, quantity) -> what may be it, what is taken first.
    """
    for quantity in QUANTITIES:
        several = [same for (_, q), same in best.items() if q == quantity]
        chosen, others = [s[0] for s in several], [m for s in several for m in s[1:]]
        if others:
            why = {ROLES[m.role] for m in others if m.role > PLAIN} - {""}
            why |= {m.quantity for m in others} - {m.quantity for m in chosen}
            words = f" ({', '.join(sorted(why))})" if why else ""
            yield (f"{quantity}: {_span(chosen)} taken, and not {_span(others)}{words}")
        if quantity not in PARTIAL and chosen and all(map(_is_doubtful, chosen)):
            yield f"{quantity}: {_span(chosen)} may not be measured at the joints, by the name"


def _is_doubtful(meaning: Meaning) -> bool:
    """Whether a column may not be measured at the joint; currents are of motors anyway."""
    return meaning.role > (MOTOR if meaning.quantity in SIGNAL_KINDS else PLAIN)


def unit_words(sources: Mapping[str, Source], reading: Reading) -> Iterator[str]:
    """Which units were converted, in words."""
    same: dict[str, dict[str, Source]] = defaultdict(dict)
    for name, source in sources.items():
        quantity = name.rpartition(".")[2]
        same[source.kind if quantity == "effort" else quantity][name] = source
    for quantity in ("time", *QUANTITIES, *SIGNAL_KINDS):
        columns = same[quantity].values()
        units = dict.fromkeys(s.unit.name for s in columns if s.unit and s.unit.factor != 1.0)
        if units:
            asked = {quantity, _UNITS_WITH.get(quantity, quantity)}.intersection(reading.units)
            told = "as asked for" if asked else "by the names of columns"
            yield f"{quantity} is in {', '.join(units)}, {told}: converted"
    for kind in SIGNAL_KINDS:
        joints = [name.rpartition(".")[0] for name in same[kind]]
        if joints:
            yield (
                f"efforts of {listed(joints)} are {_KIND_WORDS[kind]}, in {_SI[kind]}, and no "
                "efforts: their gains are found from the model's inertias, unless --gain "
                f"JOINT=VALUE gives them{_CONSTANT if kind == 'current' else ''}"
            )
    measured = {name.rpartition(".")[0] for name in sources if name.endswith(".effort")}
    commanded = [name.rpartition(".")[0] for name in same["command"]]
    bare = [joint for joint in commanded if joint not in measured]
    if bare:
        yield (
            f"no efforts of {listed(bare)}: commands are in their place, and what servos make of "
            "them is found from the model's inertias"
        )


def _span(meanings: Sequence[Meaning]) -> str:
    """The first column of each style, with the last."""
    styles: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning.column)
    return ", ".join(
        names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}" for names in styles.values()
    )
