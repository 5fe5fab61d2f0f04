"""What an effect is bound to: a joint, two joints, a body, all bodies, the robot or the log."""

from __future__ import annotations

from typing import NamedTuple


class Place(NamedTuple):
    """A kind of place.

    Attributes:
        field: The field of the effect that says where it is; empty if none does.
        counts: How many names that may be.
        words: The kind of place in words.
    """

    field: str
    counts: tuple[int, ...]
    wanted: str
    words: str


PLACES = {
    "joint": Place("joint", (1,), "one joint", "joint"),
    "joint_pair": Place("joints", (2,), "two joints", "joint pair"),
    "body": Place("body", (1,), "one body", "body"),
    "bodies": Place("", (0,), "no place, as it is one of all bodies", "bodies"),
    "robot": Place("", (0,), "no place, as it is one of the whole robot", "robot"),
    "log": Place("joint", (0, 1), "one joint or none", "log, or joint"),
}
"""The kinds of places by their name, `Effect.places`."""
