"""What a ranking says of a kind of effects."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.diagnosis.judgement import Judgement
from geodrake.effects import Effect, Role
from geodrake.identification.logs.hypothesis import Hypothesis


@dataclass(frozen=True, eq=False)
class Ranked:
    """A kind of effects at the places where it convinces, refitted as a whole.

    Attributes:
        classes: Classes of the effects, two for a pair found together.
        where: Joints or bodies.
        effects: The effects added; none for a delay or a looser prior.
        hypothesis: The hypothesis with them.
        judgement: What held-out errors say of it.
        tied: Whether the logs cannot distinguish it from the best.
    """

    classes: tuple[type[Effect], ...]
    where: tuple[str, ...]
    effects: tuple[Effect, ...]
    hypothesis: Hypothesis
    judgement: Judgement
    tied: bool = False

    @property
    def score(self) -> float:
        """Gain less the penalty of the parameters."""
        return self.judgement.score

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(kind.name for kind in self.classes)

    @property
    def complexity(self) -> int:
        """That of its kind; the delay of a joint alone is less simple than that of all."""
        late_alone = all(kind.role is Role.DELAY for kind in self.classes) and bool(self.where)
        return max(kind.complexity for kind in self.classes) + late_alone

    @property
    def reported(self) -> tuple[str, ...]:
        """Names of what it adds: those of its kind, less any that it does without everywhere."""
        added = {effect.name for effect in self.effects}
        return tuple(name for name in self.names if not added or name in added)

    def is_same(self, other: Ranked) -> bool:
        """Whether this adds just what another one does, as dry friction alone for a pair."""
        return bool(self.effects) and set(self.effects) == set(other.effects)

    def includes(self, other: Ranked) -> bool:
        """Whether this is another one and something more, no alternative to it."""
        return bool(other.effects) and set(self.effects) > set(other.effects)
