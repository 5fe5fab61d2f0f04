"""Rules for names of columns: quantity, joint, unit, and whether it was measured.

Loggers name columns as they like: `actual_q_0`, `tau_J[0]`, `/joint_states/elbow/effort`. `RULES`
for such names are asked one after the other, and know the words in `words.yaml`.

Joints of a model are matched by their names, by names that end alike, and by numbers.
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
"""Quantity of a column beside one of whole seconds, such as nanoseconds."""

OF_JOINTS = (*QUANTITIES, *SIGNAL_KINDS, PASSIVE)
"""Quantities of a joint's column."""


def _words(kind: str) -> frozenset[str]:
    return frozenset(WORDS[kind].split())


def by_word(said: Mapping[str, str]) -> dict[str, str]:
    """Return the meaning of each word in lists of words."""
    return {word: what for what, words in said.items() for word in words.split()}


QUANTITY_WORDS: Mapping[str, str] = by_word(WORDS["quantities"])
"""Words that name a quantity."""

_QUALIFIES = "load"  # a position or a velocity, as well as it is a torque
_DERIVED = {"dot": {"position": "velocity"}, "ddot": {"position": "acceleration"}}
_CURRENT = WORDS["quantities"]["current"].split()
MEASURED, PLAIN, MOTOR, DESIRED, PREVIOUS, OTHER = range(6)
ROLE_WORDS: Mapping[str, int] = {
    word: ("measured", "", "motor", "desired", "previous", "other").index(role)
    for word, role in by_word(WORDS["roles"]).items()
}
"""Words that show whether a column was measured at the joint, by preference."""

ROLES = ("measured", "", "of motors", "desired", "of the row before", "of something else")
MAPPED = ("mapped",)
"""The style of columns that the user named."""

_COMMAND, SHORT, _FILLERS = map(_words, ("commands", "short", "fillers"))
_FLAGS, _COUNTED, _STATES = map(_words, ("flags", "counted", "states"))
_NO_SIGNAL, _SUPPLY, _NAMING = map(_words, ("no_signal", "supply", "naming"))
_TIMES, _NANOSECONDS, _SAMPLES = map(_words, ("times", "nanoseconds", "samples"))
_COUNTING = _words("counting")
PAIRS = _words("pairs")
"""Words that tell two robots apart."""

_GRIPPERS, _FINGERS = map(_words, ("grippers", "fingers"))
_SIDES = by_word(WORDS["sides"])
_TIME_OF_DAY = _TIMES - {"date"}
_BESIDE_TIME = _TIMES | _NANOSECONDS | _words("beside_time")
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[^\W\d_A-Z]+|[A-Z]+|\d+")
_INCREMENTAL = ("inc", "cnt", "qc")  # a kind of encoder, where they stand in no brackets
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_REWRITTEN = [(re.compile(form), meant) for form, meant in WORDS["rewritten"].items()]
_GROUP = re.compile(r"(?<=.)[/.](?![^(\[]*[)\]])")  # behind a name that stands in no brackets
_BRACKETS = re.compile(r"\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]\s*$")
_FRONT = re.compile(r"[\[(]([^\])]+)[\])]\s*(.+)")
_APART = re.compile(r"\s+(?:/|in|-(?=\s+\S\S))\s+|,\s*")  # `pos - A` may be of joint A
_FURTHER_SENSOR = re.compile(r"\][./]temperature\[[1-9]\d*\]$")
_FORMS = str.maketrans(  # of brackets, and of symbols of quantities and their derivatives
    dict(zip("（）［］【】｛｝₀₁₂₃₄₅₆₇₈₉", "()[][]{}0123456789", strict=True))
    | {"θ": "theta", "φ": "angle", "ω": "omega", "τ": "tau", "\u0307": "_dot", "\u0308": "_ddot"}
)
_UNSPACED = re.compile(  # words between which no blanks are written
    "|".join(
        sorted(re.findall(r"[\u3040-\u30ff\u4e00-\u9fff]+", str(WORDS)), key=len, reverse=True)
    )
)
_ROMAN = re.compile(r"(?<![A-Z\d])[IVX]+(?![A-Za-z\d])")
_NUMERALS = WORDS["numerals"].split()
_NO_WORD = "zzz"  # which says nothing
_FEW_OF_FAMILY = 3  # words that are enough
_LONGEST_NAME = 200  # letters of a name of words


@dataclass(frozen=True)
class Meaning:
    """The meaning of a column by its name."""

    column: str
    quantity: str  # time, `PART`, or of `OF_JOINTS`
    joint: str = ""  # what the name calls the joint; "" if it has a number at most
    words: Words = ()  # the words of that, without those that say nothing, and its number
    role: int = PLAIN
    unit: Unit | None = None
    # What columns have in common whose joints are told apart by words alone, and by their groups.
    style: tuple[str, ...] = ()
    group: Words = ()  # the words of groups that the column is in, as in `left/joint_states/q[0]`
    is_wanted: bool = False  # whether it is what was asked for, and not what was
    gain: float = 1.0  # what its numbers are multiplied by, beside the unit
    beside: Meaning | None = None  # column of what is to be added to time, such as nanoseconds

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the file."""
        return (self.column,) if self.beside is None else (self.column, self.beside.column)

    @property
    def factor(self) -> float:
        """Factor that converts its numbers to SI units."""
        return self.gain * (self.unit.factor if self.unit else 1.0)

    @property
    def offset(self) -> float:
        """Offset that is added to its numbers after the factor."""
        return self.gain * self.unit.offset if self.unit else 0.0

    @property
    def log_quantity(self) -> str:
        """The quantity of a log that it may be: efforts have several kinds."""
        return "effort" if self.quantity in EFFORT_KINDS else self.quantity

    @property
    def is_bare(self) -> bool:
        """Whether it has a quantity of a joint, but no joint name."""
        return self.quantity in OF_JOINTS and not (self.words or self.joint)

    @property
    def number(self) -> int | None:
        """The number of the joint, if its name is only a number."""
        only = self.words[0] if len(self.words) == 1 else None
        return only if isinstance(only, int) else None


@lru_cache(maxsize=10_000)
def meaning_of(name: str) -> Meaning | None:
    """Return the meaning of a column name; None if it is neither of a joint nor time."""
    own = _own(name)
    if own is not None or len(name) > _LONGEST_NAME:
        return own
    plain = _in_brackets(_UNSPACED.sub(r" \g<0> ", name.translate(_FORMS)).strip())
    found = next((found for rule in RULES if (found := rule(plain)) is not None), None)
    return None if found is None else replace(found, column=name)


def meanings_of(names: Iterable[str], joints: Sequence[str] = ()) -> list[Meaning]:
    """Return the meanings of columns whose names have one.

    A letter that is a unit of what the name says, as in `cur_A`, is no joint if neither the model
    nor another column has it. A column with the whole name of a joint of the model is of it,
    whatever else words of this say, such as `base` and `wrist_angle`.
    """
    names = list(names)
    whole = {_split(joint): joint for joint in joints if _has_name(joint)}
    roman = _roman_numbers(names)
    of_model = {number: joint for joint, (_, number) in _roman_numbers(joints).items()}
    found = list[Meaning]()
    for name in names:
        plain, number = roman.get(name, (name, 0))
        others = {_Q.sub("d", plain), plain.replace("current", "voltage")} - {plain}
        if "current" in plain and not others.isdisjoint(names):
            plain = _Q.sub(
                "iq", plain
            )  # an axis of currents, as d, or of voltages is, and no place
        if (told := _of_joint(name, whole) or meaning_of(plain) or meaning_of(name)) is None:
            continue
        if number and told.quantity in OF_JOINTS and not told.joint:
            joint = of_model.get(number, f"joint_{_NUMERALS[number - 1]}")
            words = words_of(joint) if number in of_model else told.words
            told = replace(told, joint=joint, words=words)
        found.append(replace(told, column=name))
    units = _units_of_family(names)
    for k, meaning in enumerate(found):
        if meaning.unit is None and (said := units.get(meaning.quantity)) is not None:
            found[k] = replace(meaning, unit=find_unit(said, meaning.quantity))
    again = {name.removesuffix(".1") for name in names if name.endswith(".1")}
    for k, meaning in enumerate(found):
        if meaning.column in again and meaning.is_bare:  # the first of those that pandas numbers
            found[k] = replace(meaning, words=(0,))
    counts = Counter(meaning.words for meaning in found)
    for k, meaning in enumerate(found):
        is_known = meaning.joint in joints or meaning.style[:1] == ("own",)
        is_letter = len(meaning.joint) == 1 and not is_known
        unit = find_unit(meaning.joint, meaning.quantity) if is_letter else None
        if unit is not None and counts[meaning.words] == 1:
            found[k] = replace(meaning, joint="", words=(), unit=unit)
    return found


def joint_columns(names: Iterable[str], joints: Sequence[str] = ()) -> list[Meaning]:
    """Return the meanings of columns that have a quantity of a joint."""
    return [m for m in meanings_of(names, joints) if m.quantity in OF_JOINTS]


def as_positions(names: Iterable[str], joints: Sequence[str]) -> list[Meaning]:
    """Return the columns that are called only as joints of a model, or as `joint` and number."""
    called = {words_of(joint): joint for joint in joints if _has_name(joint)}
    found = []
    for name in names:
        words, own = _split(name), called.get(words_of(name), "")
        said = {w for w in words[:-1] if w not in ROLE_WORDS and w not in _STATES}
        is_counted = bool(said) and _COUNTED.issuperset(said) and isinstance(words[-1], int)
        if (own or is_counted) and meaning_of(name) is None:
            role = max((ROLE_WORDS[w] for w in words if w in ROLE_WORDS), default=PLAIN)  # type: ignore[index]
            style = ("position", str(role))
            found.append(
                Meaning(name, "position", own, words_of(own) or words[-1:], role, style=style)
            )
    return found


def _roman_numbers(names: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Return names that count in Roman numerals from I on, with their Arabic ones, and numbers."""
    told = {n: found for n in names if (found := _ROMAN.search(n)) is not None}
    alike = defaultdict[tuple[str, str], dict[str, int]](dict)
    for name, found in told.items():
        if found[0] in _NUMERALS:
            number = 1 + _NUMERALS.index(found[0])
            alike[name[: found.start()], name[found.end() :]][name] = number
    return {
        name: (f"{head}{number}{tail}", number)
        for (head, tail), own in alike.items()
        if len(own) > 1 and sorted(own.values()) == [*range(1, 1 + len(own))]
        for name, number in own.items()
    }


def _units_of_family(names: Sequence[str]) -> Mapping[str, str]:
    """Return the unit of quantities that columns tell by what their maker has beside them."""
    ends = {name.lower().rstrip("_0123456789") for name in names}
    for family in WORDS["families"].values():
        said = [w for w in family["words"].split() if any(e.endswith(w) for e in ends)]
        if len(said) >= _FEW_OF_FAMILY:
            return family
    return {}


def _of_joint(name: str, joints: Mapping[Words, str]) -> Meaning | None:
    """Return the meaning of a column whose name has that of one of some joints as a whole."""
    spans = [found.span() for found in _WORD.finditer(name)] if joints else []
    words = _split(name)
    for own, joint in joints.items():
        places = [k for k in range(len(words)) if words[k : k + len(own)] == own]
        if len(places) != 1 or len(own) == len(words) or _own(name) is not None:
            continue
        start, end = spans[places[0]][0], spans[places[0] + len(own) - 1][1]
        told = meaning_of(f"{name[:start]}{_NO_WORD}{name[end:]}")
        if told is not None and told.quantity in OF_JOINTS:
            return replace(told, column=name, joint=joint, words=words_of(joint))
    return None


def is_time(name: str) -> bool:
    """Return whether a column name means time, or a part of it."""
    meaning = meaning_of(name)
    return meaning is not None and meaning.quantity in ("time", PART)


def tells_clock(name: str) -> bool:
    """Return whether a name has a word for time, and may be the clock of columns beside it."""
    return is_time(name) or not _TIMES.isdisjoint(_split(name))


def quantity_of(text: str) -> str | None:
    """Return the quantity that a text names, such as the name of a file."""
    return _quantity(_split(text))


def bracketed(column: str) -> str:
    """Return the text in brackets behind a name."""
    found = _BRACKETS.search(column.translate(_FORMS))
    return found[1] if found else ""


def is_unknown_word(text: str) -> bool:
    """Return whether a text is a word that names of columns do not have otherwise."""
    known = _FILLERS | _FLAGS | ROLE_WORDS.keys() | QUANTITY_WORDS.keys() | _SIDES.keys()
    return bool(re.fullmatch(r"[^\W\d_]\D*", text)) and known.isdisjoint(_split(text))


@lru_cache(maxsize=10_000)
def names_joints(column: str) -> bool:
    """Return whether a column of words, by its name, has names of joints."""
    words = plain_words(column)
    return bool(_NAMING.intersection(words)) and "frame" not in words


@lru_cache(maxsize=10_000)
def tells(column: str, *kinds: str) -> bool:
    """Return whether a column says of which of some robots, recordings or signals each row is."""
    words = _split(column)
    return any(
        not own.isdisjoint(words) and (own | _COUNTING).issuperset(words)
        for own in map(_words, kinds)
    )


def numbers_joints(column: str) -> bool:
    """Return whether a column of integers, by its name, has the joint of each row."""
    return names_joints(column) and number_of(column) is None and meaning_of(column) is None


def plain_words(text: str) -> frozenset[str]:
    """Return the words in a text, in small letters."""
    return frozenset(word for word in _split(text) if isinstance(word, str))


def is_gripper(joint: str) -> bool:
    """Return whether a joint is called a gripper."""
    return not _GRIPPERS.isdisjoint(_split(joint))


def number_of(text: str) -> int | None:
    """Return the number that a text ends in."""
    last = _split(text)[-1:]
    return last[0] if last and isinstance(last[0], int) else None


def words_of(text: str) -> Words:
    """Return the words and numbers that distinguish a joint's name from others."""
    words = _split(text)
    return _telling(words) or words


def _telling(words: Words) -> Words:
    """Return words without those that any joint may have; `a` and `j` are such before a number."""
    return tuple(
        word
        for word, following in zip_longest(words, words[1:])
        if word not in _FILLERS and not (word in ("a", "j") and isinstance(following, int))
    )


def _has_name(text: str) -> bool:
    """Return whether a text has more than a number and words that any joint may have."""
    return any(isinstance(word, str) for word in _telling(_split(text)))


def _split(text: str) -> Words:
    words = _WORD.findall(text.replace("feedBack", "feedback"))  # as ABB's EGM has it
    return tuple(int(w) if w.isdecimal() else w.lower() for w in words)


def _own(name: str) -> Meaning | None:
    """Return `time` and `<joint>.<quantity>`, the names of geodrake's own format."""
    if name == "time":
        return Meaning(name, "time", role=MEASURED, style=("time",))
    joint, dot, quantity = name.rpartition(".")
    if not dot or quantity not in OF_JOINTS:
        return None
    if (joint.rpartition(".")[2] in _SAMPLES and "." in joint) or joint.startswith("servo_stats"):
        return None  # of states and references of one joint
    return Meaning(name, quantity, joint, words_of(joint), MEASURED, style=("own", quantity))


def _time(name: str) -> Meaning | None:
    """Read a name of time stamps, such as `Time (ms)`, `header.stamp.secs` or `%time`."""
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
    if unit is None and len(words) == 1 and (own := find_unit(plain, "time")) is not None:
        words, unit, suffix = ((), own, True) if own.factor < 1.0 else (words, None, False)
    is_part = unit is not None and unit.factor < 1.0 and not _TIMES.intersection(words)
    if not (words or is_part) or not (_BESIDE_TIME | ROLE_WORDS.keys()).issuperset(words):
        group, *inside = _GROUP.split(name, maxsplit=1)  # a group of any name
        if not inside or (found := _time(inside[0])) is None:
            return None
        return replace(found, column=name, role=found.role + 1, style=(group, *found.style))
    asked = DESIRED in (ROLE_WORDS.get(str(w)) for w in words)  # by a plan's clock
    context = tuple(map(str, words if suffix else words[:-1]))
    if is_part or words[-1] in _NANOSECONDS:  # beside seconds
        return Meaning(name, PART, unit=unit or find_unit("ns", "time"), style=context)
    if not _TIMES.intersection(words):
        return None
    if name.startswith("%"):
        unit = find_unit("ns", "time")  # of `rostopic echo -p`
    rank = 0 if "header" in words else 1 if not name.startswith(("_", "%")) else 2
    rank += 3 * asked + ("date" in words and not _TIME_OF_DAY.intersection(words))
    rank += 3 * ("tick" in words)  # which may count rows
    return Meaning(name, "time", role=1 + rank, unit=unit, style=context)


def _joint(column: str) -> Meaning | None:
    """Parse a name of a joint's quantity, with words in any order."""
    name = column
    for form, meant in _REWRITTEN:
        name = form.sub(meant, name)
    brackets = _BRACKETS.search(name)
    cut = brackets.start() if brackets else len(name)
    parts = [part for part in name[:cut].split("/") if part] or [name]
    parts[-1] += name[cut:] if parts[-1] != name else ""
    has_unit = brackets is not None and any(find_unit(brackets[1], each) for each in UNITS)
    told = [_quantity(_split(_BRACKETS.sub("", part) if has_unit else part)) for part in parts]
    place = next((k for k in reversed(range(len(parts))) if told[k]), None)
    if place is None:
        return None
    quantity = told[place] or ""
    said = frozenset(w for w in _split(name) if isinstance(w, str))
    if quantity == "command":  # of what, another part may say
        other = _quantity(tuple(w for w in _split(name) if w not in _COMMAND)) or "position"
        quantity = quantity if other == "position" else other
    if quantity in (*SIGNAL_KINDS, *PARTIAL) and _NO_SIGNAL.intersection(said):
        return None
    if quantity in ("current", "voltage") and _SUPPLY.intersection(said):
        return None
    if quantity == "temperature" and _without_brackets(name, "time")[1] is not None:
        return None  # as of "Temps (s)" in French
    unit, plain = _take_unit(parts, place, quantity), parts[place]
    of_vendor = (own for form, own in WORDS["vendors"].items() if re.search(form, column))
    unit = unit or find_unit(next(of_vendor, ""), quantity)
    used = _used(_split(plain))
    joint = _rest(plain, used)
    is_before = place + 1 == len(parts) or not _has_name(parts[-1])
    is_counted = is_before and place + 1 < len(parts)  # as in command/data[2]
    counted = f"{plain}/{parts[-1]}" if is_counted else plain
    numbers = [w for w in _split(counted) if isinstance(w, int)]
    if not _has_name(joint) and not numbers and (place > 0 or not is_before):
        told_by = (k for k in reversed(range(place)) if _telling(_split(parts[k])))
        place = next(told_by, place - 1) if is_before else len(parts) - 1
        joint = parts[place]
        numbers = [w for w in _split(joint) if isinstance(w, int)]
    named = _has_name(joint)
    words = words_of(joint) if named else ()
    if not named or (is_counted and parts[-1].isdecimal()):  # as of run1_q/0
        words += tuple(numbers[-1:])
    named_so = plain_words(_BRACKETS.sub("", name) if has_unit else name)  # min is no unit's
    roles = [ROLE_WORDS[word] for word in named_so & ROLE_WORDS.keys()]
    role = max(roles, default=PLAIN)
    is_late = role == PREVIOUS and quantity not in EFFORT_KINDS
    every = _split(name)
    last = max((k for k, w in enumerate(every) if w in QUANTITY_WORDS or w in _COMMAND), default=0)
    is_flag = not _FLAGS.isdisjoint(every[last:])
    if is_late or _FURTHER_SENSOR.search(column) or is_flag:
        role = OTHER
    group = tuple(word for part in parts[:place] for word in _telling(_split(part)))
    called, style = joint if named else "", (quantity, *sorted(used))
    return Meaning(column, quantity, called, words, role, unit, style, group, DESIRED in roles)


def _take_unit(parts: list[str], place: int, quantity: str) -> Unit | None:
    """Take the unit out of the last part of a name, or of that with the quantity."""
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


def _measured_in(name: str) -> Meaning | None:
    """Read a name in any language by the unit behind it, as in `Winkel 1 [°]` or `elbow_deg`.

    Units of time, and of what stands for efforts but mA, count in brackets alone.
    """
    units = {q: _without_brackets(name, q) for q in ("time", *QUANTITIES, *SIGNAL_KINDS)}
    counts = _COUNTER.search(name)
    bare = [(quantity, *without_unit(name, quantity)) for quantity in QUANTITIES if not counts]
    bare = [e for e in bare if e[2] and (not e[2].signal or e[2].name == "mA")]
    for quantity, plain, unit in [*((q, *told) for q, told in units.items()), *bare]:
        if unit is None or (unit.signal and not _SUPPLY.isdisjoint(_split(name))):
            continue
        if quantity == "time":
            return Meaning(name, quantity, role=OTHER, unit=unit, style=(plain,))
        words = _split(plain)
        numbers = tuple(word for word in words if isinstance(word, int))[-1:]
        named = tuple(str(word) for word in words if isinstance(word, str))
        role = max((ROLE_WORDS[word] for word in named if word in ROLE_WORDS), default=PLAIN)
        kind, joint = unit.signal or quantity, "" if numbers else plain.strip()
        return Meaning(name, kind, joint, numbers or words_of(plain), role, unit, (kind, *named))
    return None


RULES: tuple[Callable[[str], Meaning | None], ...] = (_time, _joint, _measured_in)
"""Rules for names other than geodrake's own, the most certain first."""


def _quantity(words: Words) -> str | None:
    """Return the quantity that words name."""
    counted = any(isinstance(w, int) or ROLE_WORDS.get(w) == MEASURED for w in words)
    named = [w for w in words if w in QUANTITY_WORDS and (counted or w not in SHORT)]
    if len(named) > 1:  # the current position is no motor current, and voltage in V no velocity
        named = [w for w in named if w not in (*_CURRENT, *SHORT, _QUALIFIES)] or named
    found = {QUANTITY_WORDS[w] for w in named}  # type: ignore[index]
    quantity = next((each for each in WORDS["quantities"] if each in found), None)
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
    """Return a name without these words."""
    kept = _WORD.sub(lambda found: "\0" if found[0].lower() in used else found[0], text)
    return re.sub(r"[\s_.\-\[\]()]*\0[\s_.\-]*", "_", kept).strip(" _.-[]()")


def _in_brackets(name: str) -> str:
    """Return a name with its unit in brackets behind it: of `q1 / deg`, `q1 in °` or `[deg] q1`."""
    front = _FRONT.fullmatch(name)
    apart = [(name[: mark.start()], name[mark.end() :]) for mark in _APART.finditer(name)]
    for rest, unit in [front.group(2, 1)] if front else apart:
        if any(find_unit(unit, quantity) for quantity in UNITS):
            return f"{rest} [{unit}]"
    return name


def _without_brackets(name: str, quantity: str) -> tuple[str, Unit | None]:
    """Return a name, and the unit that was in brackets behind it."""
    found = _BRACKETS.search(name)
    unit = scaled_unit(found[1], quantity) if found else None
    return (name[: found.start()], unit) if found and unit else (name, None)


def without_unit(name: str, quantity: str, *, alone: bool = True) -> tuple[str, Unit | None]:
    """Return a name without its unit, in brackets or its own part: `q_deg_1`, `torque_Nmm`."""
    plain, unit = _without_brackets(name, quantity)
    if unit is not None:
        return plain, unit
    parts = re.split(r"[_\s.]+", name)
    for count in (3, 2, 1):
        for first in range(len(parts) - count, 0, -1):
            text = "_".join(parts[first : first + count])
            last = first + count == len(parts)
            is_long = len(re.split(r"[_\s.]+", name)) > 2 or parts[0][-1:].isdecimal() or not alone
            if len(text) < 2 and not (last and is_long and text in ("A", "N", "V", "%")):
                continue
            unit = None if text in _INCREMENTAL else find_unit(text, quantity)
            if unit is not None and (last or parts[-1].isdecimal()):
                return "_".join(parts[:first] + parts[first + count :]), unit
    words = _CAMEL.sub("_", name)  # of joint1PosDeg
    return (name, None) if words == name or "_" in name else without_unit(words, quantity)


ONLY = "joint"  # what a joint is called whose columns name none
NUMBERED = re.compile(r"joint_(\d+)")  # and those that columns only number


def matched(
    meanings: Sequence[Meaning], joints: Sequence[str] | None
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the joint of each column that belongs to one, and notes on ambiguous names."""
    if joints is None:
        return _by_their_own_words(meanings), ()
    styles: dict[tuple[str, ...], list[Meaning]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning)
    found: dict[str, str] = {}
    spans: list[str] = []
    ordered: dict[int, set[str]] = defaultdict(set)  # number -> joints
    for style in sorted(styles.values(), key=len, reverse=True):
        names, by_order = _as_others(style, ordered), False
        for part, own in () if names else _parts_of_robot(style, joints):
            told, is_ordered = _match_style(part, own)
            names, by_order = {**names, **told}, by_order or is_ordered
        names = {m.column: names[m.column] for m in style if _may_be(m, names.get(m.column))}
        found |= _by_their_own_words(style) | names
        if by_order and names:
            for meaning in style:
                if meaning.number is not None and meaning.column in names:
                    ordered[meaning.number].add(names[meaning.column])
            taken = [meaning.column for meaning in style if meaning.column in names]
            spans.append(f"{taken[0]} … {taken[-1]}")
    if not spans:
        return found, ()
    order = f"in the model's order, from {joints[0]} to {joints[-1]}"
    return found, (f"columns {', '.join(spans)} are numbered: assigned to joints {order}",)


def _may_be(meaning: Meaning, joint: str | None) -> bool:
    """Return whether a column may be of a joint, if any: not of another part of a robot."""
    told = [{*map(str, each)} for each in ((*meaning.group, *meaning.words), _split(joint or ""))]
    sides = [{_SIDES[word] for word in words if word in _SIDES} for words in told]
    is_gripper = bool(told[0] & _GRIPPERS) and not told[1] & (_GRIPPERS | _FINGERS)
    is_beside = all(sides) and not sides[0] & sides[1]
    return joint is not None and not is_gripper and not is_beside


def _as_others(style: Sequence[Meaning], ordered: Mapping[int, set[str]]) -> dict[str, str]:
    """Return joints of numbered columns, where those of all joints are in order."""
    found = {m.column: ordered.get(-1 if m.number is None else m.number, set()) for m in style}
    are_alone = all(len(joints) == 1 for joints in found.values())
    if len(style) == len(ordered) or not are_alone or any(m.role >= OTHER for m in style):
        return {}
    return {column: next(iter(joints)) for column, joints in found.items()}


def _by_their_own_words(meanings: Sequence[Meaning]) -> dict[str, str]:
    """Return joints by the names that the columns give them, one for the same words."""
    called: dict[Words, str] = {}
    found = {}
    for meaning in meanings:
        if meaning.style[0] == "own":
            called.setdefault(meaning.words, meaning.joint)
            found[meaning.column] = meaning.joint
        elif meaning.role < OTHER:
            number = ONLY if meaning.number is None else f"joint_{meaning.number}"
            found[meaning.column] = called.setdefault(meaning.words, meaning.joint or number)
    return found


Part = tuple[Words, Words | None]
"""Words of a group of the file, and of names without their number; None for those without one."""


def _parts_of_robot(
    style: Sequence[Meaning], joints: Sequence[str]
) -> Iterator[tuple[Sequence[Meaning], Sequence[str]]]:
    """Yield columns that are named alike, those of each arm apart, and the joints they may be of.

    Joints of the model are of the part with whose words they are called. Where none is, parts of
    which only numbers are told may be robots alike.
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
    called = _with_side_first([(*head, *(rest or ())) for head, rest in parts])
    common |= set.intersection(*({*words} for words in called))
    said = {part: {*words} - common for part, words in zip(parts, called, strict=True)}
    named = [_unnumbered(words) for words in _with_side_first([*map(words_of, joints)])]
    if 0 in set().union(*said.values()) - set().union(*named):  # as of legs, that they count
        for part, own_words in said.items():
            said[part] = {word + 1 if isinstance(word, int) else word for word in own_words}
    own: dict[Part, list[str]] = {part: [] for part in parts}
    for joint, words in zip(joints, named, strict=True):
        near = [part for part in parts if said[part].issubset(words)]
        most = max((len(said[part]) for part in near), default=0)
        for part in near:
            own[part] += [joint] if len(said[part]) == most else []
    are_told = any(own[part] and said[part] for part in parts)
    sizes = [len(columns) for (_, rest), columns in parts.items() if rest is not None]
    size = len(joints) if len(joints) in sizes else max(sizes, default=0)
    for part, columns in parts.items():
        if own[part] or part[1] is None:
            yield columns, own[part] or joints
        elif not are_told and len(columns) == size:
            yield columns, joints


def _with_side_first(names: Sequence[Words]) -> list[Words]:
    """Return words of names; where they tell both sides of a robot, first the side by one word."""
    sides = [tuple(_SIDES[w] for w in map(str, words) if w in _SIDES) for words in names]
    if len(set[str]().union(*sides)) < 2 or 2 * sum(map(bool, sides)) < len(names):
        return [*names]  # as of axes S, L, U, R, B and T
    rest = [tuple(word for word in words if str(word) not in _SIDES) for words in names]
    return [side + words for side, words in zip(sides, rest, strict=True)]


def _match_style(style: Sequence[Meaning], joints: Sequence[str]) -> tuple[dict[str, str], bool]:
    """Return column -> joint of columns that are named alike, and whether it is by their order."""
    exact = {m.column: m.joint for m in style if m.joint in set(joints)}
    if len(exact) == len(style):
        return exact, False
    by_words = {m.words: m for m in style}
    if list(by_words) == [()]:  # which names no joint
        return {m.column: joints[0] for m in style if len(joints) == 1 and m.role < OTHER}, False
    names = _by_name(by_words, joints)
    numbers = _numbers(list(by_words))
    by_order = False
    if exact:
        if len(numbers) == len(joints) and min(numbers.values()) == 0:  # and the joints' from 1
            shifted = _by_number(numbers, joints) or {}
            return {m.column: shifted[m.words] for m in style if m.words in shifted}, bool(shifted)
        names = {words: joint for words, joint in names.items() if joint not in exact.values()}
    elif (len(names) < len(by_words) or () in by_words) and numbers and style[0].role < OTHER:
        named = _by_number(numbers, joints)
        by_order = named is None and len(numbers) == len(joints)
        if by_order:
            order = sorted(numbers, key=lambda words: numbers[words])
            named = dict(zip(order, joints, strict=True))
        names = {} if named is None else named
    found = {m.column: names[m.words] for m in style if m.words in names}
    return found | exact, by_order and len(joints) > 1


def _by_name(keys: Mapping[Words, Meaning], joints: Sequence[str]) -> dict[Words, str]:
    """Return joints whose words end as those of a column, or the reverse; each as often."""
    ends: dict[Words, list[tuple[int, str]]] = defaultdict(list)
    for joint, words in zip(joints, _with_side_first([*map(words_of, joints)]), strict=True):
        for first in range(len(words)):
            ends[words[first:]].append((first, joint))
    sided = dict(zip(keys, _with_side_first([*keys]), strict=True))
    found = {}
    for key, meaning in keys.items():
        if meaning.number is not None:
            continue  # a number alone may count from 0: see _by_number
        words = sided[key]
        tails = (words[first:] for first in range(len(words)))
        near = next((ends[tail] for tail in tails if tail in ends), [])
        least = [joint for extra, joint in near if extra == min(near)[0]]
        whole = [joint for extra, joint in near if extra == 0]
        if len(least) == 1 and (words in ends or whole):
            found[key] = least[0]
    taken = Counter(found.values())
    if len({*taken.values()}) == 1:  # each of several robots may have all of them
        return found
    return {key: joint for key, joint in found.items() if taken[joint] == 1}


def _numbers(keys: Sequence[Words]) -> dict[Words, int]:
    """Return the number in which the columns differ, if that is all in which they do."""
    told = [key for key in keys if key]  # one without any is of the whole robot
    places = [k for k, words in enumerate(zip_longest(*told)) if len({*words}) > 1]
    if len(told) == 1:
        places = [k for k, word in enumerate(told[0]) if isinstance(word, int)][-1:]
    if len(places) != 1:
        return {}
    found = {key: key[places[0]] for key in told if len(key) > places[0]}
    return {k: n for k, n in found.items() if isinstance(n, int)} if len(found) == len(told) else {}


def _number(words: Words) -> int | None:
    """Return the last number among words."""
    return next((word for word in reversed(words) if isinstance(word, int)), None)


def _unnumbered(words: Words) -> Words:
    """Return words without the last number among them."""
    last = max((k for k, word in enumerate(words) if isinstance(word, int)), default=len(words))
    return (*words[:last], *words[last + 1 :])


def _by_number(numbers: Mapping[Words, int], joints: Sequence[str]) -> dict[Words, str] | None:
    """Return the joints whose names have these numbers, from 0 or 1; None if any is missing."""
    ends = defaultdict[int | None, list[str]](list)
    for joint in joints:
        ends[_number(words_of(joint))].append(joint)
    for shift in (0, 1) if min(numbers.values()) == 0 and 0 not in ends else (0,):
        near = {key: ends.get(number + shift, [""]) for key, number in numbers.items()}
        least = {key: min(own, key=lambda joint: len(words_of(joint))) for key, own in near.items()}
        alike = (
            len(words_of(j)) == len(words_of(least[k])) for k, own in near.items() for j in own
        )
        if all(least.values()) and sum(alike) == len(numbers):
            return least
    return None
