"""Numbers of joints as model files have them: damping, dry friction, armature, springs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects import Effect
from geodrake.model.file_terms import Damping, DryFriction, Rotor, Spring
from geodrake.model.robot_model import RobotModel, from_loaded_plant
from geodrake.robot.plant import load_plant

_TERMS: Mapping[type[Effect], str] = {
    Damping: "damping",
    DryFriction: "friction",
    Rotor: "armature",
}


@dataclass(frozen=True)
class JointNumbers:
    """What a model file may say of a joint beside its place.

    Attributes:
        damping: Viscous friction, N·m·s/rad or N·s/m.
        friction: Dry friction, N·m or N.
        armature: Inertia of the rotor, seen at the joint, kg·m² or kg.
        stiffness: Stiffness of a spring across the joint, N·m/rad or N/m.
        rest: Position at which the spring is at rest, rad or m.
        turns: Whether the joint is revolute.
    """

    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    turns: bool = True


def joint_numbers(model: RobotModel) -> Mapping[str, JointNumbers]:
    """Numbers of all joints of one degree of freedom, by scoped name `robot::joint`.

    Args:
        model: The model; effects of other kinds do not count.
    """
    values: dict[str, dict[str, float]] = {joint: {} for joint in model.single_joints}
    for fitted in model.effects:
        effect = fitted.effect
        own = values.get(effect.where[0], {}) if effect.where else {}
        if (term := _TERMS.get(type(effect))) is not None:
            own[term] = own.get(term, 0.0) + float(fitted.parameters[0])
        elif isinstance(effect, Spring) and effect.exponent == 1 and fitted.parameters[0]:
            stiffness, preload = fitted.parameters.tolist()
            own |= {"stiffness": stiffness, "rest": effect.center - preload / stiffness}
    names = dict(zip(model.joints, model.scoped_joints, strict=True))
    slides = model.sliding_joints
    return {
        names[joint]: JointNumbers(**own, turns=joint not in slides)
        for joint, own in values.items()
    }


def stated_numbers(model: RobotModel) -> Mapping[str, JointNumbers]:
    """What the model's own file says of its joints.

    Args:
        model: The model, fitted or not.
    """
    loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
    return joint_numbers(from_loaded_plant(loaded, floating=model.floating))


def changed_numbers(
    before: JointNumbers, after: JointNumbers, tolerance: float = 1e-13
) -> dict[str, float]:
    """The numbers that differ, by name; stiffness and rest go together.

    Args:
        before: What a file has.
        after: What it is to have.
        tolerance: Relative difference up to which a number counts as the same.
    """
    names = ("damping", "friction", "armature", "stiffness", "rest")
    pairs = {name: (getattr(before, name), getattr(after, name)) for name in names}
    changed = {
        name: new
        for name, (old, new) in pairs.items()
        if not np.isclose(old, new, rtol=tolerance, atol=0.0)
    }
    if changed.keys() & {"stiffness", "rest"}:
        changed |= {"stiffness": after.stiffness, "rest": after.rest}
    return changed
