"""Physical effects: what a rigid-body model lacks, one effect a file.

The effort that a robot needs is that of its rigid bodies and a sum of effects (docs/design.md).
`catalogue` lists the effects that come with geodrake. One of your own is a frozen dataclass with a
name, its parameters with units and bounds, and the regressor columns that multiply them. A hose
that hangs from a link, and turns with it, takes ten lines:

    from dataclasses import dataclass
    import numpy as np
    from geodrake.effects import JointEffect, Parameter

    @dataclass(frozen=True)
    class HangingHose(JointEffect):
        name = "hanging_hose"
        parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))

        def columns(self, joint):
            return [np.cos(joint.q), np.sin(joint.q)]

`HangingHose("elbow")` then works wherever an effect does; `load_effect_file` reads such a file, and
its effects are passed on as `extra`. Further fields are shape parameters, and `shapes` says which
values of them to try (see `StribeckFriction`). What an effect needs to know of more than one
joint it gets by overriding `rows` (see `CoupledFriction`); what acts on a body derives from
`BodyEffect` (see `Payload`). Excitation needs derivatives of the columns; `slopes` gives them, and
without it they are taken by differences. `Effect` lists all that an effect may declare. An effect
of the catalogue declares more of it, and is one file of this package, which `catalogue` finds; what
type checkers know of it, `__init__.pyi`, is written by `generated.stub`.
"""

from __future__ import annotations

from geodrake.effects.base import (
    BodyEffect,
    Effect,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    Proposer,
    RobotMotion,
    Role,
    Shape,
)
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.effects.lookup import catalogue, effect_class, make_effect
from geodrake.effects.robot_effect import RobotEffect
from geodrake.effects.user_code import load_effect_file

__all__ = [
    "BodyEffect",
    "Effect",
    "FittedEffect",
    "JointEffect",
    "JointMotion",
    "JointPairEffect",
    "Parameter",
    "Proposer",
    "RobotEffect",
    "RobotMotion",
    "Role",
    "Shape",
    "catalogue",
    "effect_class",
    "load_effect_file",
    "make_effect",
]
__all__ += [effect.__name__ for effect in catalogue()]


def __getattr__(name: str) -> type[Effect]:
    """The effects of the catalogue, by the names of their classes."""
    for effect in catalogue():
        if effect.__name__ == name:
            return effect
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
