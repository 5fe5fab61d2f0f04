"""Topics of a recording, and which of them is the log."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geodrake.errors import LogError
from geodrake.logs.files.joint_messages import MessageRows
from geodrake.logs.files.joint_series import is_complete, joint_columns
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable

_MOST_LISTED = 8


@dataclass(frozen=True)
class Topic:
    """A topic of a bag, or a channel of an LCM log.

    Attributes:
        name: Its name.
        kind: Its message type.
        rows: What its messages, or the first of them, say of joints; None if none of it is known.
        made_for_joints: Whether the type is for the state of joints, and nothing else.
    """

    name: str
    kind: str
    rows: MessageRows | None = None
    made_for_joints: bool = False

    @property
    def fits(self) -> bool:
        """Whether it has positions and efforts, or commands in the place of these."""
        return self.rows is not None and is_complete(self.rows.quantities)

    @property
    def has_efforts(self) -> bool:
        """Whether efforts are among what it has."""
        return self.rows is not None and "effort" in self.rows.quantities

    def __str__(self) -> str:
        if self.rows is None or not self.rows.quantities:
            return f"{self.name} ({self.kind})"
        missing = [q for q in ("position", "effort") if q not in self.rows.quantities]
        missing = [] if self.fits else missing
        words = f"without {' and '.join(missing)}" if missing else f"{len(self.rows.joints)} joints"
        return f"{self.name} ({self.kind}, {words})"


def chosen_topic(path: Path, topics: Sequence[Topic], reading: Reading) -> Topic:
    """The topic that is the log.

    Args:
        path: The recording, for messages.
        topics: All its topics.
        reading: Whether the user named one.

    Raises:
        LogError: None fits, several do, or there is no such topic.
    """
    if not topics:
        raise LogError(
            f"Log {str(path)!r} has no messages.", advice="Check how it was recorded.", path=path
        )
    if reading.topic is not None:
        return _named(path, topics, reading.topic)
    fitting = [topic for topic in topics if topic.fits]
    fitting = [topic for topic in fitting if topic.has_efforts] or fitting
    best = [topic for topic in fitting if topic.made_for_joints] or fitting
    if len(best) == 1:
        return best[0]
    if best:
        raise LogError(
            f"Log {str(path)!r} has {len(best)} topics with positions and efforts of joints: "
            f"{_listed(best)}.",
            advice=f"Choose one of them, as in --topic {best[0].name}.",
            topics=[topic.name for topic in best],
        )
    raise LogError(
        f"Log {str(path)!r} has no topic with both positions and efforts of joints; it has "
        f"{_listed(topics)}.",
        advice="Record joint states with efforts, such as sensor_msgs/JointState of all joints, or "
        "the state of a controller, which has positions and commands.",
        topics=[topic.name for topic in topics],
    )


def topic_table(path: Path, topic: Topic, others: Sequence[Topic]) -> LogTable:
    """The table of a topic.

    Args:
        path: The recording.
        topic: One that fits, with all its messages.
        others: All topics of the recording.

    Raises:
        LogError: Its messages do not go together.
    """
    rows = topic.rows
    if rows is None or not topic.fits:  # the first messages had efforts, and none has both
        raise LogError(f"Topic {topic} of log {str(path)!r} has no positions with efforts.")
    columns, notes, origin = joint_columns(rows.series(), topic.name)
    said = [f"read from {topic.name} ({topic.kind})"]
    fitting = [o for o in others if o.fits and o.has_efforts >= topic.has_efforts]
    also = [other.name for other in fitting if other.name != topic.name]
    if also:
        said[0] += f"; {', '.join(also)} would fit too (--topic)"
    if not rows.all_stamped:
        said.append("messages have no stamps: the time is that of receipt")
    if rows.from_controller:
        said.append("efforts are the output of the controller, as no measured ones are there")
    return LogTable(path, columns, notes=(*said, *notes), origins={"time": origin})


def _named(path: Path, topics: Sequence[Topic], name: str) -> Topic:
    found = [topic for topic in topics if topic.name.strip("/") == name.strip("/")]
    if found and found[0].fits:
        return found[0]
    if found:
        raise LogError(
            f"Topic {found[0]} of log {str(path)!r} has not both positions and efforts of joints.",
            advice=_offer([topic for topic in topics if topic.fits]),
            topic=name,
        )
    names = [topic.name for topic in topics]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    raise LogError(
        f"Log {str(path)!r} has no topic {name!r}"
        + (f" (nearest: {close[0]!r})" if close else "")
        + f"; it has {_listed(topics)}.",
        advice="Names are those of the bag or the LCM log; without --topic, the one that fits is "
        "taken.",
        topic=name,
    )


def _offer(fitting: Sequence[Topic]) -> str:
    return f"Those that do: {_listed(fitting)}." if fitting else "No topic of it has both."


def _listed(topics: Sequence[Topic]) -> str:
    ordered = sorted(topics, key=lambda topic: not topic.fits)  # what matters most comes first
    more = f" … ({len(topics)} in all)" if len(topics) > _MOST_LISTED else ""
    return ", ".join(map(str, ordered[:_MOST_LISTED])) + more
