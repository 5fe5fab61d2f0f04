"""What was made of the names of a log's columns, in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from geodrake.logs.files.column_names import Source, listed
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import PLAIN, ROLES, Meaning, meaning_of
from geodrake.logs.files.units import Unit
from geodrake.logs.motion import QUANTITIES


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
            words = f" ({', '.join(sorted(why))})" if why else ""
            yield (f"{quantity}: {_span(chosen)} taken, and not {_span(others)}{words}")
        if chosen and all(meaning.role > PLAIN for meaning in chosen):
            yield f"{quantity}: {_span(chosen)} may not be measured at the joints, by the name"


def unit_words(sources: Mapping[str, Source], reading: Reading) -> Iterator[str]:
    """Which units were converted, in words.

    Args:
        sources: Column of the log -> where it comes from.
        reading: What the user said of the log.
    """
    for quantity in ("time", *QUANTITIES):
        same = {n: s for n, s in sources.items() if n.rpartition(".")[2] == quantity}
        units = dict.fromkeys(s.unit.name for s in same.values() if s.unit and s.unit.factor != 1.0)
        if units:
            told = "as asked for" if quantity in reading.units else "by the names of columns"
            yield f"{quantity} is in {', '.join(units)}, {told}: converted"
        if quantity != "effort":
            continue
        bare = [
            n.rpartition(".")[0]
            for n, s in same.items()
            if _is_current(s) and not _gained(n, s, reading)
        ]
        if bare:
            yield (
                f"efforts of {listed(bare)} are motor currents, in A, and no efforts: give A to "
                "N·m by --gain JOINT=VALUE (torque constant × gear ratio)"
            )


def _is_current(source: Source) -> bool:
    if source.unit is not None:
        return source.unit.is_current
    meaning = meaning_of(source.column)
    return meaning is not None and meaning.is_current


def _gained(name: str, source: Source, reading: Reading) -> bool:
    mapped = reading.mapping is not None and source.factor != (source.unit or Unit("A", 1.0)).factor
    return mapped or name.rpartition(".")[0] in reading.gains


def _span(meanings: Sequence[Meaning]) -> str:
    """The first column of each style, with the last."""
    styles: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning.column)
    return ", ".join(
        names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}" for names in styles.values()
    )
