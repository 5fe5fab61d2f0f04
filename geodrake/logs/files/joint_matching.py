"""Which joint of a model a column is of: by its name, by a name that ends alike, by its number."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from geodrake.logs.files.recognition import OTHER, Meaning, Words, words_of

ONLY = "joint"  # what a joint is called whose columns name none


def matched(
    meanings: Sequence[Meaning], joints: Sequence[str] | None
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The joint that each column is of.

    Args:
        joints: The model's joints in its order, if there is a model.

    Returns:
        Name of the column -> name of its joint, for those that are of one; and notes of what was
        not told by names.
    """
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
        if not names:
            names, by_order = _match_style(style, joints)
        own = _by_their_own_words(style)
        kept = own if style[0].style[0] == "own" or not names else {}
        found |= kept | names
        if by_order:
            for meaning in style:
                if meaning.number is not None and meaning.column in names:
                    ordered[meaning.number].add(names[meaning.column])
            taken = [meaning.column for meaning in style if meaning.column in names]
            spans.append(f"{taken[0]} … {taken[-1]}")
    if not spans:
        return found, ()
    order = f"in the model's order, from {joints[0]} to {joints[-1]}"
    return found, (f"columns {', '.join(spans)} have numbers alone: taken for joints {order}",)


def _as_others(style: Sequence[Meaning], ordered: Mapping[int, set[str]]) -> dict[str, str]:
    """Column -> joint of numbered columns of some joints, where those of all joints are in order.

    Args:
        ordered: Number -> joints that columns of others have under it.
    """
    found: dict[str, str] = {}
    if len(style) == len(ordered):
        return found
    for meaning in style:
        joints = ordered.get(-1 if meaning.number is None else meaning.number, set())
        if meaning.role >= OTHER or len(joints) != 1:
            return {}
        found[meaning.column] = next(iter(joints))
    return found


def _by_their_own_words(meanings: Sequence[Meaning]) -> dict[str, str]:
    """Joints under the names that the columns themselves give them, one for the same words."""
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


def _match_style(style: Sequence[Meaning], joints: Sequence[str]) -> tuple[dict[str, str], bool]:
    """Column -> joint of columns that are named alike, and whether it is by their order."""
    exact = {m.column: m.joint for m in style if m.joint in set(joints)}
    if len(exact) == len(style):
        return exact, False
    by_words = {m.words: m for m in style}
    names = _by_name(by_words, joints)
    numbers = _numbers(list(by_words))
    by_order = False
    if (len(names) < len(by_words) or () in by_words) and numbers and style[0].role < OTHER:
        named = _by_number(numbers, joints)
        by_order = named is None and len(numbers) == len(joints)
        if by_order:
            order = sorted(numbers, key=lambda words: numbers[words])
            named = dict(zip(order, joints, strict=True))
        names = {} if named is None else named
    found = {m.column: names[m.words] for m in style if m.words in names}
    return found | exact, by_order and len(joints) > 1


def _by_name(keys: Mapping[Words, Meaning], joints: Sequence[str]) -> dict[Words, str]:
    """Joints whose words end as those of a column, or the other way round; each joint once."""
    ends: dict[Words, list[tuple[int, str]]] = defaultdict(list)
    for joint in joints:
        words = words_of(joint)
        for first in range(len(words)):
            ends[words[first:]].append((first, joint))
    found = {}
    for key, meaning in keys.items():
        if meaning.number is not None:
            continue  # a number alone may count from 0: see _by_number
        tails = (key[first:] for first in range(len(key)))
        near = next((ends[tail] for tail in tails if tail in ends), [])
        least = [joint for extra, joint in near if extra == min(near)[0]]
        whole = [joint for extra, joint in near if extra == 0]
        if len(least) == 1 and (key in ends or whole):
            found[key] = least[0]
    taken = list(found.values())
    return {key: joint for key, joint in found.items() if taken.count(joint) == 1}


def _numbers(keys: Sequence[Words]) -> dict[Words, int]:
    """The number in which the columns differ, if that is all in which they do."""
    if list(keys) == [()]:
        return {(): 0}
    told = [key for key in keys if key]  # one without any is of the whole robot
    if len({key[:-1] for key in told}) > 1:
        return {}
    found = {key: key[-1] for key in told if isinstance(key[-1], int)}
    return found if len(found) == len(told) else {}


def _by_number(numbers: Mapping[Words, int], joints: Sequence[str]) -> dict[Words, str] | None:
    """The joints whose names end in these numbers, counted from 0 or from 1; None if not all do."""
    ends: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for joint in joints:
        words = words_of(joint)
        if isinstance(words[-1], int):
            ends[words[-1]].append((len(words), joint))
    lowest = min(numbers.values())
    for shift in (0, 1) if lowest == 0 and 0 not in ends else (0,):
        found = {}
        for key, number in numbers.items():
            near = ends.get(number + shift, [])
            least = [joint for extra, joint in near if extra == min(near)[0]]
            if len(least) == 1:
                found[key] = least[0]
        if len(found) == len(numbers):
            return found
    return None
