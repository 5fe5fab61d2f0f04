"""Rules that parse column names: quantity, joint, unit, and whether it was measured.

Every logger has its own names: `actual_q_0`, `tau_J[0]`, `/joint_states/elbow/effort`. `RULES` are
tried in order, with the vocabulary in `words.yaml`. Columns are then matched to the joints of a
model by name, by the last words of names, and by number.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import zip_longest

from geodrake.logs.files.units import UNITS, WORDS, Unit, find_unit, scaled_unit
from geodrake.logs.motion import EFFORT_KINDS, PARTIAL, PASSIVE, QUANTITIES, SIGNAL_KINDS

Words = tuple[str | int, ...]

PART = "part of a second"
"""Quantity of a column of fractions of a second, such as nanoseconds."""

OF_JOINTS = (*QUANTITIES, *SIGNAL_KINDS, PASSIVE)
"""Quantities of joints."""


def _words(kind: str) -> frozenset[str]:
    return frozenset(WORDS[kind].split())


def by_word(said: Mapping[str, str]) -> dict[str, str]:
    """Invert a mapping of meanings to lists of words."""
    return {word: what for what, words in said.items() for word in words.split()}


QUANTITY_WORDS: Mapping[str, str] = by_word(WORDS["quantities"])
"""Words that name a quantity."""

_QUALIFIES = "load"  # may qualify a position or a velocity, besides meaning a torque
_DERIVED = {"dot": {"position": "velocity"}, "ddot": {"position": "acceleration"}}
_CURRENT = WORDS["quantities"]["current"].split()
MEASURED, PLAIN, MOTOR, DESIRED, PREVIOUS, OTHER = range(6)
ROLE_WORDS: Mapping[str, int] = {
    word: ("measured", "", "motor", "desired", "previous", "other").index(role)
    for word, role in by_word(WORDS["roles"]).items()
}
"""Words that show whether a column was measured at the joint, with their rank."""

ROLES = ("measured", "", "of motors", "desired", "of the row before", "of something else")
MAPPED = ("mapped",)
"""Style of columns that the user mapped."""

_COMMAND, SHORT, _FILLERS = map(_words, ("commands", "short", "fillers"))
_FLAGS, _COUNTED, _STATES = map(_words, ("flags", "counted", "states"))
_NO_SIGNAL, _SUPPLY, _NAMING = map(_words, ("no_signal", "supply", "naming"))
_TIMES, _NANOSECONDS, _SAMPLES = map(_words, ("times", "nanoseconds", "samples"))
_COUNTING = _words("counting")
PAIRS = _words("pairs")
"""Words that distinguish two robots."""

_GRIPPERS, _FINGERS = map(_words, ("grippers", "fingers"))
_SIDES = by_word(WORDS["sides"])
_TIME_OF_DAY = _TIMES - {"date"}
_BESIDE_TIME = _TIMES | _NANOSECONDS | _words("beside_time")
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[^\W\d_A-Z]+|[A-Z]+|\d+")
_INCREMENTAL = ("inc", "cnt", "qc")  # units in brackets, otherwise an encoder type
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_REWRITTEN = [(re.compile(form), meant) for form, meant in WORDS["rewritten"].items()]
_GROUP = re.compile(r"(?<=.)[/.](?![^(\[]*[)\]])")  # separator outside of brackets
_BRACKETS = re.compile(r"\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]\s*$")
_FRONT = re.compile(r"[\[(]([^\])]+)[\])]\s*(.+)")
_APART = re.compile(r"\s+(?:/|in|-(?=\s+\S\S))\s+|,\s*")  # `pos - A` may be of joint A
_FURTHER_SENSOR = re.compile(r"\][./]temperature\[[1-9]\d*\]$")
_FORMS = str.maketrans(  # variants of brackets and digits, and symbols of quantities
    dict(zip("（）［］【】｛｝₀₁₂₃₄₅₆₇₈₉", "()[][]{}0123456789", strict=True))
    | {"θ": "theta", "φ": "angle", "ω": "omega", "τ": "tau", "\u0307": "_dot", "\u0308": "_ddot"}
)
_UNSPACED = re.compile(  # words of languages without blanks
    "|".join(
        sorted(re.findall(r"[\u3040-\u30ff\u4e00-\u9fff]+", str(WORDS)), key=len, reverse=True)
    )
)
_ROMAN = re.compile(r"(?<![A-Z\d])[IVX]+(?![A-Za-z\d])")
_NUMERALS = WORDS["numerals"].split()
_NO_WORD = "zzz"  # placeholder without a meaning
_FEW_OF_FAMILY = 3  # words needed to recognize a family
_LONGEST_NAME = 200  # characters of a name that is parsed


@dataclass(frozen=True)
class Meaning:
    """Meaning of a column according to its name."""

    column: str
    quantity: str  # time, `PART`, or of `OF_JOINTS`
    joint: str = ""  # name of the joint in the column name; "" if there is at most a number
    words: Words = ()  # the distinctive words and the number of the joint
    role: int = PLAIN
    unit: Unit | None = None
    # Common to columns that differ only in the words and groups of their joints.
    style: tuple[str, ...] = ()
    group: Words = ()  # the words of enclosing groups, as in `left/joint_states/q[0]`
    is_wanted: bool = False  # whether it is a target rather than a measurement
    gain: float = 1.0  # factor in addition to the unit
    beside: Meaning | None = None  # column of fractions of a second to add to time

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in the file."""
        return (self.column,) if self.beside is None else (self.column, self.beside.column)

    @property
    def factor(self) -> float:
        """Factor that converts numbers to SI units."""
        return self.gain * (self.unit.factor if self.unit else 1.0)

    @property
    def offset(self) -> float:
        """Offset added after the factor, in SI units."""
        return self.gain * self.unit.offset if self.unit else 0.0

    @property
    def log_quantity(self) -> str:
        """Quantity of a log; all kinds of efforts are `effort`."""
        return "effort" if self.quantity in EFFORT_KINDS else self.quantity

    @property
    def is_bare(self) -> bool:
        """Whether the column has a quantity of a joint, but neither name nor number of one."""
        return self.quantity in OF_JOINTS and not (self.words or self.joint)

    @property
    def number(self) -> int | None:
        """Number of the joint, if its name is only a number."""
        only = self.words[0] if len(self.words) == 1 else None
        return only if isinstance(only, int) else None


@lru_cache(maxsize=10_000)
def meaning_of(name: str) -> Meaning | None:
    """Return the meaning of a column name; None if it is neither a joint's quantity nor time."""
    native = _native(name)
    if native is not None or len(name) > _LONGEST_NAME:
        return native
    plain = _in_brackets(_UNSPACED.sub(r" \g<0> ", name.translate(_FORMS)).strip())
    meaning = next((meaning for rule in RULES if (meaning := rule(plain)) is not None), None)
    return None if meaning is None else replace(meaning, column=name)


def meanings_of(names: Iterable[str], joints: Sequence[str] = ()) -> list[Meaning]:
    """Return the meanings of the columns whose names have one.

    A letter that is a unit, as in `cur_A`, names no joint unless the model or another column has
    that joint. The full name of a model's joint takes precedence over the meanings of its words,
    as in `wrist_angle`.
    """
    names = list(names)
    known = frozenset(names)
    full_names = {_split(joint): joint for joint in joints if _has_name(joint)}
    roman = _roman_numbers(names)
    of_model = {number: joint for joint, (_, number) in _roman_numbers(joints).items()}
    meanings = list[Meaning]()
    for name in names:
        plain, number = roman.get(name, (name, 0))
        stem = plain.rstrip("d")
        derived = {f"{stem}d": f"{stem}_dot", f"{stem}dd": f"{stem}_ddot"}
        if derived.keys() | {stem} <= known:  # q1, q1d, q1dd
            plain = derived.get(plain, plain)
        others = {_Q.sub("d", plain), plain.replace("current", "voltage")} - {plain}
        if "current" in plain and not others.isdisjoint(names):
            plain = _Q.sub("iq", plain)  # q-axis current beside d, not a position
        if (parsed := _of_joint(name, full_names) or meaning_of(plain) or meaning_of(name)) is None:
            continue
        if number and parsed.quantity in OF_JOINTS and not parsed.joint:
            joint = of_model.get(number, f"joint_{_NUMERALS[number - 1]}")
            words = words_of(joint) if number in of_model else parsed.words
            parsed = replace(parsed, joint=joint, words=words)
        meanings.append(replace(parsed, column=name))
    units = _units_of_family(names)
    for k, meaning in enumerate(meanings):
        if meaning.unit is None and (unit_text := units.get(meaning.quantity)) is not None:
            meanings[k] = replace(meaning, unit=find_unit(unit_text, meaning.quantity))
    duplicated = {name.removesuffix(".1") for name in names if name.endswith(".1")}
    for k, meaning in enumerate(meanings):
        if meaning.column in duplicated and meaning.is_bare:  # pandas numbers only later duplicates
            meanings[k] = replace(meaning, words=(0,))
    counts = Counter(meaning.words for meaning in meanings)
    for k, meaning in enumerate(meanings):
        is_known = meaning.joint in joints or meaning.style[:1] == ("own",)
        is_letter = len(meaning.joint) == 1 and not is_known
        unit = find_unit(meaning.joint, meaning.quantity) if is_letter else None
        if unit is not None and counts[meaning.words] == 1:
            meanings[k] = replace(meaning, joint="", words=(), unit=unit)
    return meanings


def joint_columns(names: Iterable[str], joints: Sequence[str] = ()) -> list[Meaning]:
    """Return the meanings of the columns with a quantity of a joint."""
    return [m for m in meanings_of(names, joints) if m.quantity in OF_JOINTS]


def as_positions(names: Iterable[str], joints: Sequence[str]) -> list[Meaning]:
    """Interpret columns named only like joints, or `joint` with a number, as positions."""
    joint_of = {words_of(joint): joint for joint in joints if _has_name(joint)}
    meanings = []
    for name in names:
        words, joint = _split(name), joint_of.get(words_of(name), "")
        context = {w for w in words[:-1] if w not in ROLE_WORDS and w not in _STATES}
        is_counted = bool(context) and _COUNTED.issuperset(context) and isinstance(words[-1], int)
        if (joint or is_counted) and meaning_of(name) is None:
            role = max((ROLE_WORDS[w] for w in words if w in ROLE_WORDS), default=PLAIN)  # type: ignore[index]
            style = ("position", str(role))
            meanings.append(
                Meaning(name, "position", joint, words_of(joint) or words[-1:], role, style=style)
            )
    return meanings


def _roman_numbers(names: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Return names numbered in Roman numerals from I -> name in Arabic numerals, and number."""
    matches = {n: match for n in names if (match := _ROMAN.search(n)) is not None}
    series = defaultdict[tuple[str, str], dict[str, int]](dict)
    for name, match in matches.items():
        if match[0] in _NUMERALS:
            number = 1 + _NUMERALS.index(match[0])
            series[name[: match.start()], name[match.end() :]][name] = number
    return {
        name: (f"{head}{number}{tail}", number)
        for (head, tail), members in series.items()
        if len(members) > 1 and sorted(members.values()) == [*range(1, 1 + len(members))]
        for name, number in members.items()
    }


def _units_of_family(names: Sequence[str]) -> Mapping[str, str]:
    """Return quantity -> unit, if names show whose controller wrote the log."""
    ends = {name.lower().rstrip("_0123456789") for name in names}
    for family in WORDS["families"].values():
        matching = [w for w in family["words"].split() if any(e.endswith(w) for e in ends)]
        if len(matching) >= _FEW_OF_FAMILY:
            return family
    return {}


def _of_joint(name: str, joints: Mapping[Words, str]) -> Meaning | None:
    """Return the meaning of a column whose name contains the full name of a joint."""
    spans = [match.span() for match in _WORD.finditer(name)] if joints else []
    words = _split(name)
    for joint_words, joint in joints.items():
        places = [k for k in range(len(words)) if words[k : k + len(joint_words)] == joint_words]
        if len(places) != 1 or len(joint_words) == len(words) or _native(name) is not None:
            continue
        start, end = spans[places[0]][0], spans[places[0] + len(joint_words) - 1][1]
        parsed = meaning_of(f"{name[:start]}{_NO_WORD}{name[end:]}")
        if parsed is not None and parsed.quantity in OF_JOINTS:
            return replace(parsed, column=name, joint=joint, words=words_of(joint))
    return None


def is_time(name: str) -> bool:
    """Return whether a column name means time, or fractions of a second."""
    meaning = meaning_of(name)
    return meaning is not None and meaning.quantity in ("time", PART)


def tells_clock(name: str) -> bool:
    """Return whether a column may be the clock of a group, as its name has a word for time."""
    return is_time(name) or not _TIMES.isdisjoint(_split(name))


def quantity_of(text: str) -> str | None:
    """Return the quantity that a text, such as a file name, contains."""
    return _quantity(_split(text))


def bracketed(column: str) -> str:
    """Return the text in brackets at the end of a name."""
    found = _BRACKETS.search(column.translate(_FORMS))
    return found[1] if found else ""


def is_unknown_word(text: str) -> bool:
    """Return whether a text is a word without a known meaning in column names."""
    known = _FILLERS | _FLAGS | ROLE_WORDS.keys() | QUANTITY_WORDS.keys() | _SIDES.keys()
    return bool(re.fullmatch(r"[^\W\d_]\D*", text)) and known.isdisjoint(_split(text))


@lru_cache(maxsize=10_000)
def names_joints(column: str) -> bool:
    """Return whether a column of words contains joint names, according to its own name."""
    words = plain_words(column)
    return bool(_NAMING.intersection(words)) and "frame" not in words


@lru_cache(maxsize=10_000)
def tells(column: str, *kinds: str) -> bool:
    """Return whether a column assigns rows to some `kinds`: robots, recordings or signals."""
    words = _split(column)
    return any(
        not vocabulary.isdisjoint(words) and (vocabulary | _COUNTING).issuperset(words)
        for vocabulary in map(_words, kinds)
    )


def numbers_joints(column: str) -> bool:
    """Return whether a column of integers contains joint numbers, according to its name."""
    return names_joints(column) and number_of(column) is None and meaning_of(column) is None


def plain_words(text: str) -> frozenset[str]:
    """Return the words in a text, in lower case."""
    return frozenset(word for word in _split(text) if isinstance(word, str))


def is_gripper(joint: str) -> bool:
    """Return whether a joint is named like a gripper."""
    return not _GRIPPERS.isdisjoint(_split(joint))


def number_of(text: str) -> int | None:
    """Return the number at the end of a text."""
    last = _split(text)[-1:]
    return last[0] if last and isinstance(last[0], int) else None


def words_of(text: str) -> Words:
    """Return the words and numbers that distinguish a joint's name."""
    words = _split(text)
    return _telling(words) or words


def _telling(words: Words) -> Words:
    """Drop words that any joint may have, such as `a` and `j` before a number."""
    return tuple(
        word
        for word, following in zip_longest(words, words[1:])
        if word not in _FILLERS and not (word in ("a", "j") and isinstance(following, int))
    )


def _has_name(text: str) -> bool:
    """Return whether a text contains a word that distinguishes a joint."""
    return any(isinstance(word, str) for word in _telling(_split(text)))


def _split(text: str) -> Words:
    words = _WORD.findall(text.replace("feedBack", "feedback"))  # in ABB's EGM
    return tuple(int(w) if w.isdecimal() else w.lower() for w in words)


def _native(name: str) -> Meaning | None:
    """Parse a name of geodrake's own format: `time` or `<joint>.<quantity>`."""
    if name == "time":
        return Meaning(name, "time", role=MEASURED, style=("time",))
    joint, dot, quantity = name.rpartition(".")
    if not dot or quantity not in OF_JOINTS:
        return None
    if (joint.rpartition(".")[2] in _SAMPLES and "." in joint) or joint.startswith("servo_stats"):
        return None  # fields of one joint's state or reference
    return Meaning(name, quantity, joint, words_of(joint), MEASURED, style=("own", quantity))


def _time(name: str) -> Meaning | None:
    """Parse a name of time stamps, such as `Time (ms)`, `header.stamp.secs` or `%time`."""
    plain, unit = _without_brackets(name, "time")
    suffix = False
    parts = [part for part in re.split(r"[_\s./]+", _CAMEL.sub("_", plain)) if part]
    if unit is None and len(parts) > 1 and parts[-1].lower() not in _TIMES | _NANOSECONDS:
        unit = find_unit(parts[-1], "time")
        suffix = unit is not None
        plain = "_".join(parts[:-1]) if suffix else plain
    words = _split(plain)
    if words[-2:-1] == ("nano",):
        words = (*words[:-2], "nanosec")
    if unit is None and len(words) == 1 and (exact := find_unit(plain, "time")) is not None:
        words, unit, suffix = ((), exact, True) if exact.factor < 1.0 else (words, None, False)
    is_part = unit is not None and unit.factor < 1.0 and not _TIMES.intersection(words)
    if not (words or is_part) or not (_BESIDE_TIME | ROLE_WORDS.keys()).issuperset(words):
        group, *inside = _GROUP.split(name, maxsplit=1)  # a group of any name
        if not inside or (inner := _time(inside[0])) is None:
            return None
        return replace(inner, column=name, role=inner.role + 1, style=(group, *inner.style))
    is_planned = DESIRED in (ROLE_WORDS.get(str(w)) for w in words)  # the clock of a plan
    context = tuple(map(str, words if suffix else words[:-1]))
    if is_part or words[-1] in _NANOSECONDS:  # fractions of seconds
        return Meaning(name, PART, unit=unit or find_unit("ns", "time"), style=context)
    if not _TIMES.intersection(words):
        return None
    if name.startswith("%"):
        unit = find_unit("ns", "time")  # of `rostopic echo -p`
    rank = 0 if "header" in words else 1 if not name.startswith(("_", "%")) else 2
    rank += 3 * is_planned + ("date" in words and not _TIME_OF_DAY.intersection(words))
    rank += 3 * ("tick" in words)  # which may count rows
    return Meaning(name, "time", role=1 + rank, unit=unit, style=context)


def _joint(column: str) -> Meaning | None:
    """Parse a name of a joint's quantity with words in any order."""
    name = column
    for form, replacement in _REWRITTEN:
        name = form.sub(replacement, name)
    brackets = _BRACKETS.search(name)
    cut = brackets.start() if brackets else len(name)
    parts = [part for part in name[:cut].split("/") if part] or [name]
    parts[-1] += name[cut:] if parts[-1] != name else ""
    has_unit = brackets is not None and any(find_unit(brackets[1], each) for each in UNITS)
    kinds = [_quantity(_split(_BRACKETS.sub("", part) if has_unit else part)) for part in parts]
    place = next((k for k in reversed(range(len(parts))) if kinds[k]), None)
    if place is None:
        return None
    quantity = kinds[place] or ""
    all_words = frozenset(w for w in _split(name) if isinstance(w, str))
    if quantity == "command":  # another part may name its quantity
        target = _quantity(tuple(w for w in _split(name) if w not in _COMMAND)) or "position"
        quantity = quantity if target == "position" else target
    if quantity in (*SIGNAL_KINDS, *PARTIAL) and _NO_SIGNAL.intersection(all_words):
        return None
    if quantity in ("current", "voltage") and _SUPPLY.intersection(all_words):
        return None
    if quantity == "temperature" and _without_brackets(name, "time")[1] is not None:
        return None  # as in "Temps (s)", French for time
    unit, plain = _take_unit(parts, place, quantity), parts[place]
    vendor_units = (text for form, text in WORDS["vendors"].items() if re.search(form, column))
    unit = unit or find_unit(next(vendor_units, ""), quantity)
    consumed = _used(_split(plain))
    joint = _rest(plain, consumed)
    is_last = place + 1 == len(parts) or not _has_name(parts[-1])
    is_counted = is_last and place + 1 < len(parts)  # as in command/data[2]
    counted = f"{plain}/{parts[-1]}" if is_counted else plain
    numbers = [w for w in _split(counted) if isinstance(w, int)]
    if not _has_name(joint) and not numbers and (place > 0 or not is_last):
        naming_parts = (k for k in reversed(range(place)) if _telling(_split(parts[k])))
        place = next(naming_parts, place - 1) if is_last else len(parts) - 1
        joint = parts[place]
        numbers = [w for w in _split(joint) if isinstance(w, int)]
    is_named = _has_name(joint)
    words = words_of(joint) if is_named else ()
    if not is_named or (is_counted and parts[-1].isdecimal()):  # as in run1_q/0
        words += tuple(numbers[-1:])
    role_words = plain_words(_BRACKETS.sub("", name) if has_unit else name)  # `min` may be a unit
    roles = [ROLE_WORDS[word] for word in role_words & ROLE_WORDS.keys()]
    role = max(roles, default=PLAIN)
    is_late = role == PREVIOUS and quantity not in EFFORT_KINDS
    tokens = _split(name)
    last = max((k for k, w in enumerate(tokens) if w in QUANTITY_WORDS or w in _COMMAND), default=0)
    is_flag = not _FLAGS.isdisjoint(tokens[last:])
    if is_late or _FURTHER_SENSOR.search(column) or is_flag:
        role = OTHER
    group = tuple(word for part in parts[:place] for word in _telling(_split(part)))
    joint_name, style = joint if is_named else "", (quantity, *sorted(consumed))
    return Meaning(column, quantity, joint_name, words, role, unit, style, group, DESIRED in roles)


def _take_unit(parts: list[str], place: int, quantity: str) -> Unit | None:
    """Remove the unit from the last part of a name, or from the one with the quantity."""
    for kind in (quantity, "effort") if quantity in SIGNAL_KINDS else (quantity,):
        parts[-1], unit = without_unit(parts[-1], kind, alone=len(parts) == 1)
        if unit is None:
            parts[place], unit = without_unit(parts[place], kind)
        if unit is not None:
            return unit
    return None


_Q = re.compile(r"(?<![A-Za-z])q(?![a-z])")
_COUNTER = re.compile(
    r"(?i)(step|loop|sample|cycle|row|frame|packet|message|msg|error)[ _]?(count|cnt)$"
)


def _by_unit(name: str) -> Meaning | None:
    """Parse a name in any language by its unit, as in `Winkel 1 [°]` or `elbow_deg`.

    Units of time, and of signals for efforts other than mA, must be in brackets.
    """
    units = {q: _without_brackets(name, q) for q in ("time", *QUANTITIES, *SIGNAL_KINDS)}
    counts = _COUNTER.search(name)
    suffixed = [(quantity, *without_unit(name, quantity)) for quantity in QUANTITIES if not counts]
    suffixed = [e for e in suffixed if e[2] and (not e[2].signal or e[2].name == "mA")]
    for quantity, plain, unit in [*((q, *rest) for q, rest in units.items()), *suffixed]:
        if unit is None or (unit.signal and not _SUPPLY.isdisjoint(_split(name))):
            continue
        if quantity == "time":
            return Meaning(name, quantity, role=OTHER, unit=unit, style=(plain,))
        words = _split(plain)
        numbers = tuple(word for word in words if isinstance(word, int))[-1:]
        texts = tuple(str(word) for word in words if isinstance(word, str))
        role = max((ROLE_WORDS[word] for word in texts if word in ROLE_WORDS), default=PLAIN)
        kind, joint = unit.signal or quantity, "" if numbers else plain.strip()
        return Meaning(name, kind, joint, numbers or words_of(plain), role, unit, (kind, *texts))
    return None


RULES: tuple[Callable[[str], Meaning | None], ...] = (_time, _joint, _by_unit)
"""Rules for names other than geodrake's own, most reliable first."""


def _quantity(words: Words) -> str | None:
    """Return the quantity that some words name."""
    counted = any(isinstance(w, int) or ROLE_WORDS.get(w) == MEASURED for w in words)
    matching = [w for w in words if w in QUANTITY_WORDS and (counted or w not in SHORT)]
    if len(matching) > 1:  # as in `current position`, and V of a voltage
        matching = [w for w in matching if w not in (*_CURRENT, *SHORT, _QUALIFIES)] or matching
    quantities = {QUANTITY_WORDS[w] for w in matching}  # type: ignore[index]
    quantity = next((each for each in WORDS["quantities"] if each in quantities), None)
    for word, derived in _DERIVED.items():
        if word in words:
            quantity = derived.get(quantity or "", quantity)
    return quantity or ("command" if _COMMAND.intersection(words) else None)


def _used(words: Words) -> frozenset[str]:
    """Return the words that determine quantity and role."""
    return frozenset(
        w
        for w in words
        if isinstance(w, str)
        and (w in QUANTITY_WORDS or w in ROLE_WORDS or w in _DERIVED or w in _FLAGS)
    )


def _rest(text: str, used: frozenset[str]) -> str:
    """Remove some words from a name."""
    kept = _WORD.sub(lambda found: "\0" if found[0].lower() in used else found[0], text)
    return re.sub(r"[\s_.\-\[\]()]*\0[\s_.\-]*", "_", kept).strip(" _.-[]()")


def _in_brackets(name: str) -> str:
    """Rewrite `q1 / deg`, `q1 in °` or `[deg] q1` with the unit in brackets at the end."""
    front = _FRONT.fullmatch(name)
    apart = [(name[: mark.start()], name[mark.end() :]) for mark in _APART.finditer(name)]
    for rest, unit in [front.group(2, 1)] if front else apart:
        if any(find_unit(unit, quantity) for quantity in UNITS):
            return f"{rest} [{unit}]"
    return name


def _without_brackets(name: str, quantity: str) -> tuple[str, Unit | None]:
    """Split a name from the unit in brackets at its end."""
    found = _BRACKETS.search(name)
    unit = scaled_unit(found[1], quantity) if found else None
    return (name[: found.start()], unit) if found and unit else (name, None)


def without_unit(name: str, quantity: str, *, alone: bool = True) -> tuple[str, Unit | None]:
    """Split a name from its unit, in brackets or as a word: `q_deg_1`, `torque_Nmm`."""
    plain, unit = _without_brackets(name, quantity)
    if unit is not None:
        return plain, unit
    parts = re.split(r"[_\s.]+", name)
    for count in (3, 2, 1):
        for first in range(len(parts) - count, 0, -1):
            text = "_".join(parts[first : first + count])
            is_last = first + count == len(parts)
            is_long = len(re.split(r"[_\s.]+", name)) > 2 or parts[0][-1:].isdecimal() or not alone
            if len(text) < 2 and not (is_last and is_long and text in ("A", "N", "V", "%")):
                continue
            unit = None if text in _INCREMENTAL else find_unit(text, quantity)
            if unit is not None and (is_last or parts[-1].isdecimal()):
                return "_".join(parts[:first] + parts[first + count :]), unit
    words = _CAMEL.sub("_", name)  # as in joint1PosDeg
    return (name, None) if words == name or "_" in name else without_unit(words, quantity)


ONLY = "joint"  # name of the only joint if no column names it
NUMBERED = re.compile(r"joint_(\d+)")  # names of joints that columns only number


def matched(
    meanings: Sequence[Meaning], joints: Sequence[str] | None
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Assign columns to joints, with a note on those assigned by order."""
    if joints is None:
        return _by_column_words(meanings), ()
    styles: dict[tuple[str, ...], list[Meaning]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning)
    joint_of: dict[str, str] = {}
    spans: list[str] = []
    ordered: dict[int, set[str]] = defaultdict(set)  # number -> joints
    for style in sorted(styles.values(), key=len, reverse=True):
        names, is_ordered = _in_known_order(style, ordered), False
        for part, candidates in () if names else _parts_of_robot(style, joints):
            assigned, is_part_ordered = _match_style(part, candidates)
            names, is_ordered = {**names, **assigned}, is_ordered or is_part_ordered
        names = {m.column: names[m.column] for m in style if _is_plausible(m, names.get(m.column))}
        joint_of |= _by_column_words(style) | names
        if is_ordered and names:
            for meaning in style:
                if meaning.number is not None and meaning.column in names:
                    ordered[meaning.number].add(names[meaning.column])
            columns = [meaning.column for meaning in style if meaning.column in names]
            spans.append(f"{columns[0]} … {columns[-1]}")
    if not spans:
        return joint_of, ()
    order = f"in the model's order, from {joints[0]} to {joints[-1]}"
    return joint_of, (f"columns {', '.join(spans)} are numbered: assigned to joints {order}",)


def _is_plausible(meaning: Meaning, joint: str | None) -> bool:
    """Return whether a column and its joint may be on the same side and part of a robot."""
    sets = [{*map(str, each)} for each in ((*meaning.group, *meaning.words), _split(joint or ""))]
    sides = [{_SIDES[word] for word in words if word in _SIDES} for words in sets]
    is_gripper = bool(sets[0] & _GRIPPERS) and not sets[1] & (_GRIPPERS | _FINGERS)
    is_other_side = all(sides) and not sides[0] & sides[1]
    return joint is not None and not is_gripper and not is_other_side


def _in_known_order(style: Sequence[Meaning], ordered: Mapping[int, set[str]]) -> dict[str, str]:
    """Assign numbered columns of some joints as a complete set was assigned by order."""
    joints_of = {m.column: ordered.get(-1 if m.number is None else m.number, set()) for m in style}
    are_unique = all(len(joints) == 1 for joints in joints_of.values())
    if len(style) == len(ordered) or not are_unique or any(m.role >= OTHER for m in style):
        return {}
    return {column: next(iter(joints)) for column, joints in joints_of.items()}


def _by_column_words(meanings: Sequence[Meaning]) -> dict[str, str]:
    """Assign columns to the joints that they name, one joint for equal words."""
    joints: dict[Words, str] = {}
    joint_of = {}
    for meaning in meanings:
        if meaning.style[0] == "own":
            joints.setdefault(meaning.words, meaning.joint)
            joint_of[meaning.column] = meaning.joint
        elif meaning.role < OTHER:
            number = ONLY if meaning.number is None else f"joint_{meaning.number}"
            joint_of[meaning.column] = joints.setdefault(meaning.words, meaning.joint or number)
    return joint_of


Part = tuple[Words, Words | None]
"""Words of a group and of names without their number; None if the names are joints."""


def _parts_of_robot(
    style: Sequence[Meaning], joints: Sequence[str]
) -> Iterator[tuple[Sequence[Meaning], Sequence[str]]]:
    """Split columns of one style by arm or leg, and yield each part with its candidate joints.

    A joint belongs to the part whose words are in its name. If no part has joints, parts of equal
    size may be identical robots.
    """
    parts: dict[Part, list[Meaning]] = defaultdict(list)
    common = set.intersection(*({*m.group, *m.words} for m in style))
    ends = {meaning.words[-1] if meaning.words else "" for meaning in style}
    counts = len(ends) > 1 and all(isinstance(end, int) for end in ends)
    for meaning in style:
        head = meaning.words[:-1] if counts else meaning.words
        words = tuple(word for word in head if word not in common) + meaning.words[len(head) :]
        is_named = words and _number(words) is None
        parts[meaning.group, None if is_named else _unnumbered(words)].append(meaning)
    keys = {meaning.words: meaning for meaning in style}
    if len(parts) < 2 or (() not in keys and len(_by_name(keys, joints)) == len(style)):
        yield style, joints
        return
    part_words = _with_side_first([(*head, *(rest or ())) for head, rest in parts])
    common |= set.intersection(*({*words} for words in part_words))
    specific = {part: {*words} - common for part, words in zip(parts, part_words, strict=True)}
    joint_words = [_unnumbered(words) for words in _with_side_first([*map(words_of, joints)])]
    if 0 in set().union(*specific.values()) - set().union(*joint_words):  # legs counted from 0
        for part, own_words in specific.items():
            specific[part] = {word + 1 if isinstance(word, int) else word for word in own_words}
    joints_of: dict[Part, list[str]] = {part: [] for part in parts}
    for joint, words in zip(joints, joint_words, strict=True):
        fitting = [part for part in parts if specific[part].issubset(words)]
        most = max((len(specific[part]) for part in fitting), default=0)
        for part in fitting:
            joints_of[part] += [joint] if len(specific[part]) == most else []
    are_distinct = any(joints_of[part] and specific[part] for part in parts)
    sizes = [len(columns) for (_, rest), columns in parts.items() if rest is not None]
    size = len(joints) if len(joints) in sizes else max(sizes, default=0)
    for part, columns in parts.items():
        if joints_of[part] or part[1] is None:
            yield columns, joints_of[part] or joints
        elif not are_distinct and len(columns) == size:
            yield columns, joints


def _with_side_first(names: Sequence[Words]) -> list[Words]:
    """Move the side of a robot to the front, as one word, if names contain both sides."""
    sides = [tuple(_SIDES[w] for w in map(str, words) if w in _SIDES) for words in names]
    if len(set[str]().union(*sides)) < 2 or 2 * sum(map(bool, sides)) < len(names):
        return [*names]  # such as axes S, L, U, R, B and T
    rest = [tuple(word for word in words if str(word) not in _SIDES) for words in names]
    return [side + words for side, words in zip(sides, rest, strict=True)]


def _match_style(style: Sequence[Meaning], joints: Sequence[str]) -> tuple[dict[str, str], bool]:
    """Assign columns of one style to joints, and return whether by order only."""
    exact = {m.column: m.joint for m in style if m.joint in set(joints)}
    if len(exact) == len(style):
        return exact, False
    by_words = {m.words: m for m in style}
    if list(by_words) == [()]:  # no joint is named
        return {m.column: joints[0] for m in style if len(joints) == 1 and m.role < OTHER}, False
    names = _by_name(by_words, joints)
    numbers = _numbers(list(by_words))
    by_order = False
    if exact:
        if len(numbers) == len(joints) and min(numbers.values()) == 0:  # joints count from 1
            shifted = _by_number(numbers, joints) or {}
            return {m.column: shifted[m.words] for m in style if m.words in shifted}, bool(shifted)
        names = {words: joint for words, joint in names.items() if joint not in exact.values()}
    elif (len(names) < len(by_words) or () in by_words) and numbers and style[0].role < OTHER:
        numbered = _by_number(numbers, joints)
        by_order = numbered is None and len(numbers) == len(joints)
        if by_order:
            order = sorted(numbers, key=lambda words: numbers[words])
            numbered = dict(zip(order, joints, strict=True))
        names = {} if numbered is None else numbered
    joint_of = {m.column: names[m.words] for m in style if m.words in names}
    return joint_of | exact, by_order and len(joints) > 1


def _by_name(keys: Mapping[Words, Meaning], joints: Sequence[str]) -> dict[Words, str]:
    """Match joints and columns whose last words agree, each joint equally often."""
    ends: dict[Words, list[tuple[int, str]]] = defaultdict(list)
    for joint, words in zip(joints, _with_side_first([*map(words_of, joints)]), strict=True):
        for first in range(len(words)):
            ends[words[first:]].append((first, joint))
    sided = dict(zip(keys, _with_side_first([*keys]), strict=True))
    joint_of = {}
    for key, meaning in keys.items():
        if meaning.number is not None:
            continue  # a number alone may count from 0: see _by_number
        words = sided[key]
        tails = (words[first:] for first in range(len(words)))
        matches = next((ends[tail] for tail in tails if tail in ends), [])
        closest = [joint for extra, joint in matches if extra == min(matches)[0]]
        complete = [joint for extra, joint in matches if extra == 0]
        if len(closest) == 1 and (words in ends or complete):
            joint_of[key] = closest[0]
    counts = Counter(joint_of.values())
    if len({*counts.values()}) == 1:  # several robots may share all names
        return joint_of
    return {key: joint for key, joint in joint_of.items() if counts[joint] == 1}


def _numbers(keys: Sequence[Words]) -> dict[Words, int]:
    """Return the number of each column, if columns differ by their number only."""
    full = [key for key in keys if key]  # names without words refer to the whole robot
    places = [k for k, words in enumerate(zip_longest(*full)) if len({*words}) > 1]
    if len(full) == 1:
        places = [k for k, word in enumerate(full[0]) if isinstance(word, int)][-1:]
    if len(places) != 1:
        return {}
    found = {key: key[places[0]] for key in full if len(key) > places[0]}
    return {k: n for k, n in found.items() if isinstance(n, int)} if len(found) == len(full) else {}


def _number(words: Words) -> int | None:
    """Return the last number among words."""
    return next((word for word in reversed(words) if isinstance(word, int)), None)


def _unnumbered(words: Words) -> Words:
    """Return words without the last number among them."""
    last = max((k for k, word in enumerate(words) if isinstance(word, int)), default=len(words))
    return (*words[:last], *words[last + 1 :])


def _by_number(numbers: Mapping[Words, int], joints: Sequence[str]) -> dict[Words, str] | None:
    """Match joints by numbers from 0 or 1; None if any number is missing or ambiguous."""
    ends = defaultdict[int | None, list[str]](list)
    for joint in joints:
        ends[_number(words_of(joint))].append(joint)
    for shift in (0, 1) if min(numbers.values()) == 0 and 0 not in ends else (0,):
        pool = {key: ends.get(number + shift, [""]) for key, number in numbers.items()}
        least = {key: min(own, key=lambda joint: len(words_of(joint))) for key, own in pool.items()}
        alike = (
            len(words_of(j)) == len(words_of(least[k])) for k, own in pool.items() for j in own
        )
        if all(least.values()) and sum(alike) == len(numbers):
            return least
    return None
