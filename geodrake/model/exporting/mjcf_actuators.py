"""Actuators in MJCF: motors, position servos, and their delays.

MuJoCo (3.5 and later) keeps the last `nsample` control signals of an actuator, one of each step,
and reads the signal of `delay` ago from them. What is longer ago than they reach is read as the
oldest of them, unsaid, so nsample · step has to be the delay at least. What is younger than a step
is not there yet, so a delay is a step at least.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from geodrake.model.exporting.joints import ExportedJoint, exported_joints
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_sections import with_sections
from geodrake.robot.files.reading import model_text_of
from geodrake.robot.files.values import words

SHORTEST_STEP = 1e-3
"""Step of the simulation, s, down to which delays are kept where the file's own is longer."""


def with_actuators(
    data: bytes, path: Path, model: RobotModel, *, anew: bool
) -> tuple[bytes, tuple[str, ...]]:
    """Return an MJCF file with actuators at the end, sensors of late efforts, and notes on it.

    Actuators of the file stay as they are, and the joints that they drive get no other one. A file
    of the user's own gets some only for servos and delays, which it does not hold otherwise.

    Args:
        anew: Whether the file was written from the model alone.
    """
    text = model_text_of(data, path)
    if not isinstance(text, MjcfText) or model.transmission:
        return data, ()
    joints, driven = list(exported_joints(model).values()), text.driven_joints
    free = [each for each in joints if each.driven and each.name not in driven]
    wanted = [each for each in joints if each.is_servo or each.delay]
    kept = [each for each in wanted if each.name in driven]
    notes = [_kept_note(kept, path)] if kept else []
    if text.actuator_defaults and set(wanted).intersection(free):
        notes.append(
            f"{path.name} has defaults of actuators, which would change what an export adds: it "
            "has no actuators for servos and delays of the model"
        )
        free = []
    late = [each for each in joints if each.measured_late]
    adds = free if anew or set(wanted).intersection(free) else []
    if not adds and not late:
        return data, tuple(notes)
    step = min(text.timestep, SHORTEST_STEP)
    sections = {
        "actuator": [_actuator(each, step) for each in adds],
        "sensor": [_sensor(each, step) for each in late],
    }
    data = with_sections(data, path, sections, [each.name for each in (*adds, *late)])
    return data, (*notes, *_notes(adds, late, step, text.timestep))


def samples_of(delay: float, step: float) -> int:
    """Return how many signals MuJoCo has to keep for a delay: one more than the steps it takes."""
    return int(np.ceil(delay / step - 1e-9)) + 1


def _actuator(joint: ExportedJoint, step: float) -> str:
    name = quoteattr(joint.name)
    attributes = [f"name={name} joint={name}"]
    if joint.is_servo:
        attributes.append(_gains(joint))
    if np.isfinite(joint.effort):
        limit = words(np.array([-joint.effort, joint.effort]))
        attributes.append(f'forcelimited="true" forcerange="{limit}"')
        if not joint.is_servo:
            attributes.append(f'ctrllimited="true" ctrlrange="{limit}"')
    if joint.delay:
        attributes.append(_delay(joint.delay, step))
    return f"<{'position' if joint.is_servo else 'motor'} {' '.join(attributes)}/>"


def _gains(joint: ExportedJoint) -> str:
    return f'kp="{words(joint.kp)}" kv="{words(joint.kd)}"'


def _sensor(joint: ExportedJoint, step: float) -> str:
    name, of = quoteattr(f"{joint.name}_effort"), quoteattr(joint.name)
    return f"<jointactuatorfrc name={name} joint={of} {_delay(joint.measured_late, step)}/>"


def _delay(delay: float, step: float) -> str:
    return f'delay="{words(delay)}" nsample="{samples_of(delay, step)}" interp="linear"'


def _notes(
    adds: Sequence[ExportedJoint], late: Sequence[ExportedJoint], step: float, timestep: float
) -> list[str]:
    notes = []
    damped = [each.name for each in adds if each.is_servo and each.kd]
    if damped:
        notes.append(
            f"kv of {', '.join(damped)} damps the motion itself, and that of the model its error: "
            "told c + (kv / kp) dc/dt, they do the same"
        )
    delays = {each.name: each.delay for each in adds if each.delay}
    delays |= {each.name: each.measured_late for each in late}
    if delays:
        notes.append(
            "delays need MuJoCo 3.5 or later; they are kept with steps of the simulation of "
            f"{step:g} s and more, and shorter with others unless nsample grows"
        )
    if late:
        notes.append(
            f"efforts of {', '.join(each.name for each in late)} are measured late: sensors "
            "<joint>_effort have them as the log does"
        )
    short = [joint for joint, delay in delays.items() if delay < timestep * (1.0 - 1e-9)]
    if short:
        notes.append(
            f"MuJoCo delays by one step at least, and the file's step of {timestep:g} s is longer "
            f"than the delay of {', '.join(short)}: make timestep {min(delays.values()):.3g} s or "
            "less"
        )
    return notes


def _kept_note(kept: Sequence[ExportedJoint], path: Path) -> str:
    """Return what the user's own actuators would need to be those of the model."""
    of_each = []
    for each in kept:
        parts = [_gains(each)] if each.is_servo else []
        parts += [_delay(each.delay, SHORTEST_STEP)] if each.delay else []
        of_each.append(f"{each.name}: {' '.join(parts)}")
    values = "; ".join(of_each)
    return f"actuators of {path.name} stay as they are; those of the model have {values}"
