"""Joint properties in exports: friction, rotors, springs, limits, servos and delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.effects.file_terms import Spring
from geodrake.model.robot_model import RobotModel, from_loaded_plant
from geodrake.model.servos import servos_of
from geodrake.robot.files.checks import words
from geodrake.robot.files.description import model_text_of
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.model_edits import EditedFile
from geodrake.robot.plant import load_plant, scoped_joint_names

POSITIVE_TERMS = ("damping", "friction", "armature")
"""Properties that files of all formats have for each joint."""
_NUMBERS = (*POSITIVE_TERMS, "stiffness", "rest")
_UNCHANGED = 1e-13  # relative difference below which a number is unchanged


@dataclass(frozen=True)
class ExportedJoint:
    """A joint with one degree of freedom, and its actuator; in N and m if prismatic."""

    name: str
    scoped: str
    turns: bool  # whether it is revolute
    driven: bool = False  # whether it has a motor
    velocity: float = np.inf  # speed limit, rad/s; infinite for none
    effort: float = 0.0  # effort limit, N·m; infinite for none, 0 without a motor
    kp: float = 0.0  # position gain of a servo, N·m/rad; 0 for a motor with effort commands
    kd: float = 0.0  # damping of a servo, on its velocity, N·m·s/rad
    rate_share: float = 0.0  # fraction of the command's rate in the servo's damping term
    delay: float = 0.0  # of commands, s
    measured_late: float = 0.0  # delay of measured efforts, s
    damping: float = 0.0  # viscous friction, N·m·s/rad
    friction: float = 0.0  # dry friction, N·m
    armature: float = 0.0  # reflected rotor inertia, kg·m²
    stiffness: float = 0.0  # of a spring across the joint, N·m/rad
    rest: float = 0.0  # rest position of the spring, rad

    @property
    def numbers(self) -> dict[str, float]:
        """Passive properties, by the names of `EditedFile.set_joint_numbers`."""
        return {name: getattr(self, name) for name in _NUMBERS}

    @property
    def is_servo(self) -> bool:
        """Whether it takes position commands."""
        return self.kp > 0.0


def exported_joints(model: RobotModel) -> dict[str, ExportedJoint]:
    """Return all joints with one degree of freedom by name, without effects that do not fit.

    A positive delay of logged efforts is one of their measurement; a negative one delays commands.
    """
    values: dict[str, dict[str, float]] = {joint: {} for joint in model.single_joints}
    for fitted in model.effects:
        effect = fitted.effect
        terms = values.get(effect.where[0], {}) if effect.where else {}
        if (term := effect.file_term.joint) in POSITIVE_TERMS:
            terms[term] = terms.get(term, 0.0) + float(fitted.parameters[0])
        elif isinstance(effect, Spring) and effect.exponent == 1 and fitted.parameters[0]:
            stiffness, preload = fitted.parameters.tolist()
            terms |= {"stiffness": stiffness, "rest": effect.center - preload / stiffness}
    names = tuple(model.joints)
    if not model.transmission:
        plant_names = scoped_joint_names(model.plant)
        names = tuple(plant_names[k] for k in sorted(model.coordinates.standing))
    limits = model.velocity_limits.tolist(), model.known_effort_limits.tolist()
    drives = servos_of(model), model.delays.tolist()
    exported = {}
    for joint, name, velocity, effort, servo, delay in zip(
        model.joints, names, *limits, *drives, strict=True
    ):
        if joint in values:
            driven = joint not in model.motorless
            exported[joint] = ExportedJoint(
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
    return exported


def changed_numbers(model: RobotModel) -> dict[str, dict[str, float]]:
    """Return the values of a model that differ from its file, by scoped name and property.

    Stiffness and rest are returned together.
    """
    loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
    from_file = exported_joints(from_loaded_plant(loaded, floating=model.floating))
    original = {joint.scoped: joint for joint in from_file.values()}
    joints, changes = exported_joints(model), dict[str, dict[str, float]]()
    for joint in map(joints.__getitem__, model.single_joints):
        old, changed = original[joint.scoped], dict[str, float]()
        for name in _NUMBERS:
            if not np.isclose(getattr(old, name), getattr(joint, name), rtol=_UNCHANGED, atol=0.0):
                changed[name] = getattr(joint, name)
        if changed.keys() & {"stiffness", "rest"}:
            changed |= {"stiffness": joint.stiffness, "rest": joint.rest}
        changes[joint.scoped] = changed
    return changes


SHORTEST_STEP = 1e-3
"""Shortest simulation step, s, for which MuJoCo's delay buffers are long enough."""


def add_actuators(file: EditedFile, model: RobotModel, *, anew: bool) -> tuple[str, ...]:
    """Append actuators, and sensors of delayed efforts, to an MJCF; return notes.

    Actuators of the file do not change, and their joints get no others. To a user's file actuators
    are added only if the model has servos or delays.

    Args:
        anew: Whether the file was generated from the model.
    """
    text, path = model_text_of(file.content, file.path), file.path
    if not isinstance(text, MjcfText) or model.transmission:
        return ()
    joints = list(exported_joints(model).values())
    driven = {name.rpartition("::")[2] for name in text.terms.driven}
    free = [joint for joint in joints if joint.driven and joint.name not in driven]
    needed = [joint for joint in joints if joint.is_servo or joint.delay]
    conflicting = [joint for joint in needed if joint.name in driven]
    notes = [_conflict_note(conflicting, path)] if conflicting else []
    if text.actuator_defaults and set(needed).intersection(free):
        notes.append(
            f"{path.name} has defaults of actuators, which would change exported ones, so "
            "servos and delays of the model are not exported"
        )
        free = []
    late = [joint for joint in joints if joint.measured_late]
    added = free if anew or set(needed).intersection(free) else []
    if not added and not late:
        return tuple(notes)
    step = min(text.timestep, SHORTEST_STEP)
    sections = {
        "actuator": [_actuator(joint, step) for joint in added],
        "sensor": [
            Element(
                "jointactuatorfrc",
                {"name": f"{j.name}_effort", "joint": j.name, **_delay(j.measured_late, step)},
            )
            for j in late
        ],
    }
    file.add_sections(sections, [joint.name for joint in (*added, *late)])
    return (*notes, *_notes(added, late, step, text.timestep))


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
    """Return attributes of a delay; MuJoCo's buffer needs one sample more than its steps."""
    count = int(np.ceil(delay / step - 1e-9)) + 1
    return {"delay": words(delay), "nsample": str(count), "interp": "linear"} if delay else {}


def _notes(
    added: Sequence[ExportedJoint], late: Sequence[ExportedJoint], step: float, timestep: float
) -> list[str]:
    notes = []
    damped = [joint.name for joint in added if joint.is_servo and joint.kd * joint.rate_share]
    if damped:
        notes.append(
            f"kv of {', '.join(damped)} damps the motion, but that of the model the error: "
            "with commands c + rate_share (kv / kp) dc/dt, they are equal"
        )
    delays = {joint.name: joint.delay for joint in added if joint.delay}
    delays |= {joint.name: joint.measured_late for joint in late}
    if delays:
        notes.append(
            f"delays need MuJoCo 3.5 or later; they hold for time steps of {step:g} s and "
            "more, and are shorter with smaller ones unless nsample grows"
        )
    if late:
        notes.append(
            f"measured efforts of {', '.join(joint.name for joint in late)} are delayed: "
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


def _conflict_note(joints: Sequence[ExportedJoint], path: Path) -> str:
    """Return a note with the attributes that the user's actuators would need."""
    words_by_joint = []
    for joint in joints:
        attributes = {**_gains(joint), **_delay(joint.delay, SHORTEST_STEP)}
        values = " ".join(f'{key}="{value}"' for key, value in attributes.items())
        words_by_joint.append(f"{joint.name}: {values}")
    values = "; ".join(words_by_joint)
    return f"actuators of {path.name} are unchanged; those of the model have {values}"
