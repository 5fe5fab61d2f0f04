"""What several messages say of some joints each, as one table: every joint by its name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.motion import EFFORT_KINDS

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
JointKey = str | int
"""The name of a joint, or its number from 0 on in messages without names."""

_LARGEST_RATIO = 2.0  # of two rates that can be brought together
_LONGEST_BRIDGE = 5.0  # periods between two samples that are interpolated


@dataclass(frozen=True, eq=False)
class JointSeries:
    """Joints that come in the same messages.

    Attributes:
        stamps: (N,) when they were measured, ns.
        values: (N, n) numbers of each quantity.
    """

    joints: tuple[JointKey, ...]
    stamps: Stamps
    values: Mapping[str, Array]

    @classmethod
    def of(
        cls,
        joints: tuple[JointKey, ...],
        quantities: Sequence[str],
        stamps: Stamps,
        numbers: Array,
    ) -> JointSeries:
        """The series of numbers that stand one message after the other.

        Args:
            quantities: The m quantities in each message.
            stamps: (N,) when messages were measured, ns.
            numbers: (N·m·n,) their numbers.
        """
        table = numbers.reshape(len(stamps), len(quantities), len(joints))
        return cls(joints, stamps, {name: table[:, k] for k, name in enumerate(quantities)})

    @property
    def is_complete(self) -> bool:
        """Whether it has positions and efforts, or commands in the place of these."""
        return is_complete(self.values)


def is_complete(quantities: Iterable[str]) -> bool:
    """Whether positions and something of efforts are among quantities."""
    known = set(quantities)
    return "position" in known and not known.isdisjoint((*EFFORT_KINDS, "command"))


@dataclass(frozen=True, eq=False)
class _Track:
    """What is known of one joint."""

    stamps: Stamps
    values: Mapping[str, Array]

    @property
    def period(self) -> float:
        """Time between two samples, s."""
        return float(np.median(np.diff(self.stamps))) / 1e9 if len(self.stamps) > 1 else np.inf

    def at(self, stamps: Stamps) -> _Track:
        """Interpolated at other instants; nothing where its samples are far apart."""
        if np.array_equal(stamps, self.stamps):
            return self
        since = (self.stamps - stamps[0]).astype(float)
        instants = (stamps - stamps[0]).astype(float)
        after = np.clip(np.searchsorted(since, instants), 1, len(since) - 1)
        far = np.diff(since)[after - 1] > _LONGEST_BRIDGE * 1e9 * self.period
        values = {}
        for quantity, numbers in self.values.items():
            found = np.interp(instants, since, numbers, left=np.nan, right=np.nan)
            values[quantity] = np.where(far & (since[after] != instants), np.nan, found)
        return _Track(stamps, values)


def joint_columns(
    series: Sequence[JointSeries], topic: str, *, part: bool = False
) -> tuple[dict[str, Array], tuple[str, ...], int]:
    """One table of what several series say: `time` and `<joint>.<quantity>`.

    Args:
        series: At least one with positions and efforts; others are left out.
        topic: What messages call the topic.
        part: Whether it is a part of a log, of which nothing is left out.

    Returns:
        The columns, what was noticed, in words, and when time is zero, ns since 1970. Joints
        without names are `position[0]`, ….

    Raises:
        LogError: Stamps run backwards, or joints come at rates that do not go together.
    """
    complete = [each for each in series if (each.values if part else each.is_complete)]
    notes = _order_notes(complete, topic)
    heard = {joint for each in complete for joint in each.joints}
    silent = dict.fromkeys(j for each in series for j in each.joints if j not in heard)
    if silent:
        notes.append(f"joints without effort left out: {', '.join(map(str, silent))}")
    once = [_without_repeats(each, topic, notes) for each in complete]
    tracks = _tracks(once)
    base_joint, base = max(tracks.items(), key=lambda item: len(item[1].stamps))
    others = [joint for joint, track in tracks.items() if not _goes_with(track, base)]
    for joint in others:
        _check_rates(topic, (joint, tracks[joint]), (base_joint, base))
    if others:
        notes.append(
            f"{', '.join(map(str, others))} interpolated to the instants of {base_joint}, as they "
            "come in messages of their own"
        )
    columns = {"time": (base.stamps - base.stamps[0]) / 1e9}
    for joint, track in tracks.items():
        for quantity, numbers in track.at(base.stamps).values.items():
            name = f"{quantity}[{joint}]" if isinstance(joint, int) else f"{joint}.{quantity}"
            columns[name] = numbers
    columns, before = _trimmed(columns) if others else (columns, 0.0)
    return columns, tuple(notes), int(base.stamps[0]) + round(1e9 * before)


def _order_notes(series: Sequence[JointSeries], topic: str) -> list[str]:
    orders: dict[frozenset[JointKey], set[tuple[JointKey, ...]]] = {}
    for each in series:
        orders.setdefault(frozenset(each.joints), set()).add(each.joints)
    if all(len(found) == 1 for found in orders.values()):
        return []
    return [f"the order of joints changes in {topic}: they are told apart by their names"]


def _without_repeats(series: JointSeries, topic: str, notes: list[str]) -> JointSeries:
    """The series with each instant once, or an error if it is not in time."""
    steps = np.diff(series.stamps)
    if np.all(steps > 0):
        return series
    if np.any(steps < 0):
        at = int(np.argmax(steps < 0))
        raise LogError(
            f"Time runs backwards in {topic}: message {at + 2} is {-steps[at] / 1e9:.3g} s before "
            f"message {at + 1} of {', '.join(map(str, series.joints[:3]))}, ….",
            advice="Was a clock set, a simulation started again, or does somebody else publish on "
            "it? Cut the recording there.",
            message=at + 2,
        )
    kept = np.concatenate([[True], steps > 0])
    notes.append(f"{np.count_nonzero(~kept)} messages with the stamp of the one before left out")
    values = {quantity: numbers[kept] for quantity, numbers in series.values.items()}
    return JointSeries(series.joints, series.stamps[kept], values)


def _tracks(series: Sequence[JointSeries]) -> dict[JointKey, _Track]:
    """Every joint by itself, from all series that it is in, in time."""
    parts: dict[JointKey, list[_Track]] = {}
    for each in series:
        for k, joint in enumerate(each.joints):
            values = {quantity: numbers[:, k] for quantity, numbers in each.values.items()}
            parts.setdefault(joint, []).append(_Track(each.stamps, values))
    return {joint: _joined(found) for joint, found in parts.items()}


def _joined(parts: Sequence[_Track]) -> _Track:
    if len(parts) == 1:
        return parts[0]
    stamps, first = np.unique(np.concatenate([p.stamps for p in parts]), return_index=True)
    values = {}
    for quantity in dict.fromkeys(q for part in parts for q in part.values):
        there = [p.values.get(quantity, np.full(len(p.stamps), np.nan)) for p in parts]
        values[quantity] = np.concatenate(there)[first]
    return _Track(stamps, values)


def _goes_with(track: _Track, base: _Track) -> bool:
    return track.stamps is base.stamps or np.array_equal(track.stamps, base.stamps)


def _check_rates(topic: str, one: tuple[JointKey, _Track], other: tuple[JointKey, _Track]) -> None:
    """Refuse rates of which one is much lower."""
    if one[1].period <= _LARGEST_RATIO * other[1].period:
        return
    rates = [f"{joint} at {1 / track.period:.4g} Hz" for joint, track in (one, other)]
    raise LogError(
        f"Joints come at rates that do not go together in {topic}: {' and '.join(rates)}.",
        advice="Record all joints at one rate, or those of interest on a topic of their own.",
    )


def _trimmed(columns: Mapping[str, Array]) -> tuple[dict[str, Array], float]:
    """The rows from the first to the last in which every joint is known, and when they begin."""
    known = np.logical_and.reduce([np.isfinite(numbers) for numbers in columns.values()])
    if not known.any():
        return dict(columns), 0.0
    rows = slice(int(np.argmax(known)), len(known) - int(np.argmax(known[::-1])))
    trimmed = {name: numbers[rows] for name, numbers in columns.items()}
    before = float(trimmed["time"][0])
    return {**trimmed, "time": trimmed["time"] - before}, before
