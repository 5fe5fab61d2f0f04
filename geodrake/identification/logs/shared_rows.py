"""What reductions of the same logs share, so that none computes it again."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Blocks = Mapping[int, Array]
"""Columns (K, k) by the index of the joint."""

ROOM = 10_000_000
"""Reductions of the same logs share at most so many numbers: 80 MB."""

SIGNALS_ROOM = 2_000_000
"""At most so many of them are signals at the logs' full rate; filtered columns cost more."""


class SharedRows:
    """What reductions of the same logs by the same robot share, by what it belongs to.

    The columns of an effect do not depend on what else is tried, so that only those have to be
    evaluated that no reduction had before. When there is no more room, no more is kept.

    Args:
        signals: How many of them may be signals at the full rate, which only those need who
            evaluate further columns.
    """

    def __init__(self, room: int = ROOM, *, signals: int = SIGNALS_ROOM) -> None:
        self._room, self._signals, self._kept = room, signals, dict[Hashable, Blocks]()

    def get(self, key: Hashable) -> Blocks | None:
        """Return what is kept under a key, if anything is."""
        return self._kept.get(key)

    def once(self, key: Hashable, make: Callable[[], Blocks], *, signals: bool = False) -> Blocks:
        """Return what is kept under a key, or make it and keep it; `signals` as in `keep`."""
        found = self._kept.get(key)
        if found is None:
            found = make()
            self.keep(key, found, signals=signals)
        return found

    def read_only(self) -> SharedRows:
        """Return what is kept here, for reductions whose columns are not needed again."""
        reader = SharedRows(0)
        reader._kept = self._kept
        return reader

    def keep(self, key: Hashable, blocks: Blocks, *, signals: bool = False) -> None:
        """Keep blocks as long as there is room; `signals` are at the full rate."""
        size = sum(block.size for block in blocks.values())
        room = min(self._room, self._signals) if signals else self._room
        if 0 < size <= room and key not in self._kept:
            self._room -= size
            self._signals -= size if signals else 0
            self._kept[key] = {at: np.array(block, order="C") for at, block in blocks.items()}
