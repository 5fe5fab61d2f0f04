"""What files for simulators say of joints: friction, rotors, springs, limits, servos and delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects import Effect
from geodrake.model.file_terms import Damping, DryFriction, Rotor, Spring
from geodrake.model.robot_model import RobotModel, from_loaded_plant
from geodrake.model.servos import servos_of
from geodrake.robot.plant import load_plant

_TERMS: Mapping[type[Effect], str] = {
    Damping: "damping",
    DryFriction: "friction",
    Rotor: "armature",
}
_NUMBERS = ("damping", "friction", "armature", "stiffness", "rest")
_UNCHANGED = 1e-13  # relative difference up to which a number counts as the same


@dataclass(frozen=True)
class ExportedJoint:
    """A joint of one degree of freedom, and what drives it; N and m where it slides.

    Attributes:
        turns: Whether it is revolute.
        velocity: Largest speed, rad/s; infinite where there is none.
        driven: Whether it has a motor.
        effort: Largest effort, N·m; infinite where there is no limit, 0 without a motor.
        kp: Gain of a servo that is told positions, N·m/rad; 0 for a motor that is told efforts.
        kd: Damping of a servo, on its velocity, N·m·s/rad.
        delay: By how much what it is told acts late, s.
        measured_late: By how much measured efforts are late, s.
        damping: Viscous friction, N·m·s/rad.
        friction: Dry friction, N·m.
        armature: Inertia of the rotor, seen at the joint, kg·m².
        stiffness: Stiffness of a spring across the joint, N·m/rad.
        rest: Position at which the spring is at rest, rad.
    """

    name: str
    scoped: str
    turns: bool
    driven: bool
    velocity: float
    effort: float
    kp: float
    kd: float
    delay: float
    measured_late: float
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0

    @property
    def is_servo(self) -> bool:
        """Whether it is told positions."""
        return self.kp > 0.0


def exported_joints(model: RobotModel) -> dict[str, ExportedJoint]:
    """Return all joints of one degree of freedom by name; effects of other kinds do not count.

    A delay of efforts that are logged late is one of their measurement. Efforts that are logged
    ahead act late, as commands do.
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
    scoped = model.scoped_joints
    names = scoped if len(scoped) == len(model.joints) else model.joints  # behind a transmission
    limits = model.velocity_limits.tolist(), model.known_effort_limits.tolist()
    drives = servos_of(model), model.delays.tolist()
    found = {}
    for joint, name, velocity, effort, servo, delay in zip(
        model.joints, names, *limits, *drives, strict=True
    ):
        if joint in values:
            driven = joint not in model.motorless
            found[joint] = ExportedJoint(
                joint,
                name,
                turns=joint not in model.sliding_joints,
                driven=driven,
                velocity=velocity,
                effort=effort if driven else 0.0,
                kp=servo.gain if servo else 0.0,
                kd=servo.damping if servo else 0.0,
                delay=max(-delay, 0.0) * driven + (servo.delay if servo else 0.0),
                measured_late=max(delay, 0.0) * driven,
                **values[joint],
            )
    return found


def all_numbers(model: RobotModel) -> dict[str, dict[str, float]]:
    """Return what a model has at its joints, by scoped name and name of the number."""
    return {
        joint.scoped: {name: getattr(joint, name) for name in _NUMBERS}
        for joint in exported_joints(model).values()
    }


def changed_numbers(model: RobotModel) -> dict[str, dict[str, float]]:
    """Return what a model has otherwise than its own file, by scoped name and name of the number.

    Stiffness and rest go together.
    """
    loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
    own_file = exported_joints(from_loaded_plant(loaded, floating=model.floating))
    before = {joint.scoped: joint for joint in own_file.values()}
    joints, found = exported_joints(model), dict[str, dict[str, float]]()
    for after in map(joints.__getitem__, model.single_joints):
        old, changed = before[after.scoped], dict[str, float]()
        for name in _NUMBERS:
            if not np.isclose(getattr(old, name), getattr(after, name), rtol=_UNCHANGED, atol=0.0):
                changed[name] = getattr(after, name)
        if changed.keys() & {"stiffness", "rest"}:
            changed |= {"stiffness": after.stiffness, "rest": after.rest}
        found[after.scoped] = changed
    return found
