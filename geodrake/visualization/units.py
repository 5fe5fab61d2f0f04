"""Units of joints and of what steps report, and effects' names in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from geodrake.effects import Effect, catalogue
from geodrake.effects.shape_units import SHAPE_UNITS, when_sliding
from geodrake.escaping import printable
from geodrake.model import RobotModel

_OTHER_SIGNATURES = {
    "wrong_inertia": "the inertia of links differs from the model's",
    "payload": "a body held by the robot that its model does not have",
}
_PROPER_NAMES = {"coulomb": "Coulomb", "stribeck": "Stribeck", "com": "CoM"}


@dataclass(frozen=True)
class Units:
    """Units of a robot's joints and of the parameters of effects.

    Attributes:
        prismatic: Names of the joints whose effort is a force, N, and whose position is in m.
        effects: Effect classes by name, those of the catalogue and the user's own.
    """

    prismatic: frozenset[str] = frozenset()
    effects: Mapping[str, type[Effect]] = field(
        default_factory=lambda: {effect.name: effect for effect in catalogue()}
    )

    @classmethod
    def of(cls, model: RobotModel) -> Units:
        """The units of a model's joints, and of the effects that it has."""
        own = {fitted.effect.name: type(fitted.effect) for fitted in model.effects}
        return cls(frozenset(model.sliding_joints), {**cls().effects, **own})

    def at(self, joint: str, unit: str) -> str:
        """A unit that is written for a revolute joint, at a joint."""
        if joint in self.prismatic:
            return when_sliding(unit)
        return unit

    def effort(self, joints: Collection[str]) -> str:
        """The unit of the efforts of several joints."""
        return " or ".join(dict.fromkeys(self.at(joint, "N·m") for joint in joints)) or "N·m"

    def parameter(self, effect: str, name: str, place: str) -> str:
        """Unit of a parameter of a step; "" for plain numbers and those nothing is known of."""
        known = self.effects[effect].parameters if effect in self.effects else ()
        unit = {p.name: p.unit for p in known}.get(name, SHAPE_UNITS.get(name, ""))
        return "" if unit == "1" else self.at(place.partition(" & ")[0], unit)

    def signature(self, effect: str) -> str:
        """What an effect looks like, in words; "" where nothing is known of it."""
        if effect in _OTHER_SIGNATURES:
            return _OTHER_SIGNATURES[effect]
        return self.effects[effect].signature if effect in self.effects else ""


def effect_label(name: str) -> str:
    """The name of an effect or a parameter in words, such as "Coulomb friction"."""
    words = printable(name).replace("load_dependent", "load-dependent").replace("_", " ").split(" ")
    return " ".join(_PROPER_NAMES.get(word, word) for word in words)


def places_label(where: Sequence[str], joints: Collection[str], *, most: int | None = None) -> str:
    """Where an effect acts, in words.

    Args:
        where: Names of joints or bodies; none for the whole log.
        joints: Names of all joints of the robot.
        most: Names told at most; more are counted.

    Returns:
        "all 6 joints", "the whole log", "5 joints" or the names.
    """
    if not where:
        return "the whole log"
    if len(joints) > 2 and set(where) == set(joints):
        return f"all {len(joints)} joints"
    if most is not None and len(where) > most:
        return f"{len(where)} {'joints' if set(where) <= set(joints) else 'links'}"
    return listed(where)


def listed(names: Sequence[str], last: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} {last} {tail}" if head else tail
