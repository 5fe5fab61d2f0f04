"""Which part of a file is the log, where a file can hold several."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.arguments import instance, integer


@dataclass(frozen=True)
class Selection:
    """The part of a file that is read.

    Attributes:
        topic: Topic of a bag or channel of an LCM log; None for the only one that fits.
        episode: Episode of a dataset; None for all of them.

    Raises:
        ArgumentError: They are no text and no number from 0 on.
    """

    topic: str | None = None
    episode: int | None = None

    def __post_init__(self) -> None:
        if self.topic is not None:
            instance(self.topic, "topic", str)
        if self.episode is not None:
            integer(self.episode, "episode", lower=0)
