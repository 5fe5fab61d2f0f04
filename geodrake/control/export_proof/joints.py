"""Joints in files for simulators: friction, rotors, springs, limits, servos and delays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.effects import Effect
from geodrake.effects.file_terms import Damping, DryFriction, Rotor, Spring
from geodrake.model.robot_model import RobotModel, from_loaded_plant
from geodrake.model.servos import servos_of
from geodrake.robot.files.checks import words
from geodrake.robot.files.description import model_text_of
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.model_edits import EditedFile
from geodrake.robot.plant import load_plant, scoped_joint_names

_TERMS: Mapping[type[Effect], str] = {
    Damping: "damping",
    DryFriction: "friction",
    Rotor: "armature",
}
_NUMBERS = ("damping", "friction", "armature", "stiffness", "rest")
_UNCHANGED = 1e-13  # relative difference up to which a number counts as the same


@dataclass(frozen=True)
class ExportedJoint:
    """A joint of one degree of freedom, and what drives it; N and m where it slides."""

    name: str
    scoped: str
    turns: bool  # whether it is revolute
    driven: bool = False  # whether it has a motor
    velocity: float = np.inf  # largest speed, rad/s; infinite where there is none
    effort: float = 0.0  # largest effort, N·m; infinite where there is no limit, 0 without a motor
    # Gain of a servo that is told positions, N·m/rad; 0 for a motor that is told efforts.
    kp: float = 0.0
    kd: float = 0.0  # damping of a servo, on its velocity, N·m·s/rad
    rate_share: float = 0.0  # how much of the command's rate that damping knows
    delay: float = 0.0  # by how much what it is told acts late, s
    measured_late: float = 0.0  # by how much measured efforts are late, s
    damping: float = 0.0  # viscous friction, N·m·s/rad
    friction: float = 0.0  # dry friction, N·m
    armature: float = 0.0  # inertia of the rotor, seen at the joint, kg·m²
    stiffness: float = 0.0  # stiffness of a spring across the joint, N·m/rad
    rest: float = 0.0  # position at which the spring is at rest, rad

    @property
    def numbers(self) -> dict[str, float]:
        """Its numbers in files, by the names of `EditedFile.set_joint_numbers`."""
        return {name: getattr(self, name) for name in _NUMBERS}

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
    names = tuple(model.joints)
    if not model.transmission:  # else joints are behind a transmission
        every = scoped_joint_names(model.plant)
        names = tuple(every[k] for k in sorted(model.coordinates.standing))
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
                rate_share=servo.rate_share if servo else 0.0,
                delay=max(-delay, 0.0) * driven + (servo.delay if servo else 0.0),
                measured_late=max(delay, 0.0) * driven,
                **values[joint],
            )
    return found


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


SHORTEST_STEP = 1e-3
"""Step of the simulation, s, down to which delays are kept where the file's own is longer."""


def add_actuators(file: EditedFile, model: RobotModel, *, anew: bool) -> tuple[str, ...]:
    """Add actuators to an MJCF, at the end, and sensors of late efforts; return notes on it.

    Actuators of the file stay as they are, and the joints that they drive get no other one. A file
    of the user's own gets some only for servos and delays, which it does not hold otherwise.

    Args:
        anew: Whether the file was written from the model alone.
    """
    text, path = model_text_of(file.content, file.path), file.path
    if not isinstance(text, MjcfText) or model.transmission:
        return ()
    joints = list(exported_joints(model).values())
    driven = {name.rpartition("::")[2] for name in text.terms.driven}
    free = [each for each in joints if each.driven and each.name not in driven]
    wanted = [each for each in joints if each.is_servo or each.delay]
    kept = [each for each in wanted if each.name in driven]
    notes = [_kept_note(kept, path)] if kept else []
    if text.actuator_defaults and set(wanted).intersection(free):
        notes.append(
            f"{path.name} has defaults of actuators, which would change exported ones, so "
            "servos and delays of the model are not exported"
        )
        free = []
    late = [each for each in joints if each.measured_late]
    adds = free if anew or set(wanted).intersection(free) else []
    if not adds and not late:
        return tuple(notes)
    step = min(text.timestep, SHORTEST_STEP)
    sections = {
        "actuator": [_actuator(each, step) for each in adds],
        "sensor": [
            Element(
                "jointactuatorfrc",
                {"name": f"{e.name}_effort", "joint": e.name, **_delay(e.measured_late, step)},
            )
            for e in late
        ],
    }
    file.add_sections(sections, [each.name for each in (*adds, *late)])
    return (*notes, *_notes(adds, late, step, text.timestep))


def _actuator(joint: ExportedJoint, step: float) -> Element:
    attributes = {"name": joint.name, "joint": joint.name, **_gains(joint)}
    if np.isfinite(joint.effort):
        limit = words(np.array([-joint.effort, joint.effort]))
        attributes |= {"forcelimited": "true", "forcerange": limit}
        if not joint.is_servo:
            attributes |= {"ctrllimited": "true", "ctrlrange": limit}
    attributes |= _delay(joint.delay, step)
    return Element("position" if joint.is_servo else "motor", attributes)


def _gains(joint: ExportedJoint) -> dict[str, str]:
    return {"kp": words(joint.kp), "kv": words(joint.kd)} if joint.is_servo else {}


def _delay(delay: float, step: float) -> dict[str, str]:
    """Return attributes of a delay: MuJoCo keeps one signal more than the steps that it takes."""
    kept = int(np.ceil(delay / step - 1e-9)) + 1
    return {"delay": words(delay), "nsample": str(kept), "interp": "linear"} if delay else {}


def _notes(
    adds: Sequence[ExportedJoint], late: Sequence[ExportedJoint], step: float, timestep: float
) -> list[str]:
    notes = []
    damped = [each.name for each in adds if each.is_servo and each.kd * each.rate_share]
    if damped:
        notes.append(
            f"kv of {', '.join(damped)} damps the motion, but that of the model the error: "
            "with commands c + rate_share (kv / kp) dc/dt, they are equal"
        )
    delays = {each.name: each.delay for each in adds if each.delay}
    delays |= {each.name: each.measured_late for each in late}
    if delays:
        notes.append(
            f"delays need MuJoCo 3.5 or later; they hold for time steps of {step:g} s and "
            "more, and are shorter with smaller ones unless nsample grows"
        )
    if late:
        notes.append(
            f"measured efforts of {', '.join(each.name for each in late)} are delayed: "
            "sensors <joint>_effort have them as in the log"
        )
    short = [joint for joint, delay in delays.items() if delay < timestep * (1.0 - 1e-9)]
    if short:
        notes.append(
            f"MuJoCo delays by at least one step, but the file's step of {timestep:g} s is "
            f"longer than the delay of {', '.join(short)}: set timestep to "
            f"{min(delays.values()):.3g} s or less"
        )
    return notes


def _kept_note(kept: Sequence[ExportedJoint], path: Path) -> str:
    """Return what the user's own actuators would need to be those of the model."""
    of_each = []
    for each in kept:
        own = {**_gains(each), **_delay(each.delay, SHORTEST_STEP)}
        of_each.append(f"{each.name}: " + " ".join(f'{key}="{x}"' for key, x in own.items()))
    values = "; ".join(of_each)
    return f"actuators of {path.name} are unchanged; those of the model have {values}"
