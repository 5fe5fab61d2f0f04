"""Numbers of joints written into the text of a URDF, SDF or MJCF file, which otherwise stays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from geodrake.errors import ModelError
from geodrake.robot.files.source_text import SourceElement, SourceText, check_in_itself
from geodrake.robot.files.values import numbers, words

Change = Mapping[str, float]
"""damping, friction, armature, stiffness and rest of a joint, those that change, SI."""

_DRAKE = "http://drake.mit.edu"
_SDF_TAGS = {
    "damping": "damping",
    "friction": "friction",
    "stiffness": "spring_stiffness",
    "rest": "spring_reference",
}
_MJCF_NAMES = {
    "damping": "damping",
    "friction": "frictionloss",
    "armature": "armature",
    "stiffness": "stiffness",
    "rest": "springref",
}


def with_joint_numbers(data: bytes, path: Path, changes: Mapping[str, Change]) -> bytes:
    """A model file in which joints have other numbers.

    Args:
        data: Bytes of the file.
        path: Where they are from, for messages and for the name of a model that has none.
        changes: Scoped name of the joint -> what changes.

    Raises:
        ModelError: A joint is not in the file itself.
    """
    changes = {name: change for name, change in changes.items() if change}
    if not changes:
        return data
    text = SourceText(data, path)
    find, write = _FORMATS[text.root.tag]
    joints = find(text.root, path)
    check_in_itself(changes, joints, path)
    for name, change in changes.items():
        write(text, joints[name], change)
    return text.edited()


def with_gravity(data: bytes, path: Path, gravity: np.ndarray) -> bytes:
    """An MJCF file with another gravity.

    Args:
        data: Bytes of the file.
        path: Where they are from, for messages.
        gravity: (3,) acceleration of gravity in the world's frame, m/s².
    """
    text = SourceText(data, path)
    options = [*text.root.all("option")]
    stated = [option for option in options if "gravity" in option.attributes]
    if options:
        text.set_attribute((stated or options)[-1], "gravity", words(gravity))
    else:
        text.insert(text.root, f'<option gravity="{words(gravity)}"/>')
    return text.edited()


def _urdf_joints(root: SourceElement, path: Path) -> dict[str, SourceElement]:
    scope = root.attributes.get("name") or path.stem
    every = [*root.all("joint"), *root.all("drake:joint")]
    return {f"{scope}::{joint.attributes.get('name')}": joint for joint in every}


def _sdf_joints(root: SourceElement, path: Path, scope: str = "") -> dict[str, SourceElement]:
    found: dict[str, SourceElement] = {}
    for model in [*root.all("model"), *(m for w in root.all("world") for m in w.all("model"))]:
        own = model.attributes.get("name", "")
        name = f"{scope}::{own}" if scope else own
        found |= {f"{name}::{joint.attributes.get('name')}": joint for joint in model.all("joint")}
        found |= _sdf_joints(model, path, name)
    return found


def mjcf_joints(root: SourceElement, path: Path) -> dict[str, SourceElement]:
    """The joints of an MJCF file by scoped name, nameless ones as geodrake calls them.

    Args:
        root: The root element.
        path: The file, for the name of a model that has none.
    """
    scope = root.attributes.get("model") or path.stem
    found = {}
    for k, body in enumerate(b for b in root.walk() if b.tag == "body"):
        own = body.attributes.get("name") or f"body_{k}"
        for i, joint in enumerate(body.all("joint")):
            name = joint.attributes.get("name") or f"{own}_joint_{i}"
            found[f"{scope}::{name}"] = joint
    return found


def _write_urdf(text: SourceText, joint: SourceElement, change: Change) -> None:
    given = {name: words(change[name]) for name in ("damping", "friction") if name in change}
    dynamics = joint.find("dynamics")
    if given and dynamics is None:
        attributes = " ".join(f'{name}="{word}"' for name, word in given.items())
        text.insert(joint, f"<dynamics {attributes}/>")
    elif dynamics is not None:
        for name, word in given.items():
            text.set_attribute(dynamics, name, word)
    if "armature" in change:
        _write_transmission(text, joint.attributes.get("name", ""), change["armature"])


def _write_transmission(text: SourceText, joint: str, armature: float) -> None:
    """Drake's rotor inertia; with the gear ratio of the file, where it states one."""
    root = text.root
    for actuator in _actuators(root, joint):
        ratio, rotor = actuator.find("drake:gear_ratio"), actuator.find("drake:rotor_inertia")
        gear = 1.0 if ratio is None else numbers(ratio.attributes.get("value", "1"), 1)[0]
        usable = bool(np.isfinite(gear) and gear)
        word = words(armature / gear**2 if usable else armature)
        if rotor is not None:
            text.set_attribute(rotor, "value", word)
        else:
            text.insert(actuator, f'<drake:rotor_inertia value="{word}"/>')
        if ratio is not None and not usable:
            text.set_attribute(ratio, "value", "1.0")
        break
    else:
        text.insert(
            root,
            f'<transmission name="{joint}_rotor">',
            "  <type>transmission_interface/SimpleTransmission</type>",
            f'  <joint name="{joint}"/>',
            f'  <actuator name="{joint}_motor">',
            f'    <drake:rotor_inertia value="{words(armature)}"/>',
            '    <drake:gear_ratio value="1.0"/>',
            "  </actuator>",
            "</transmission>",
        )
    _declare_drake(text)


def _actuators(root: SourceElement, joint: str) -> list[SourceElement]:
    """Actuators of a joint in transmissions of the type that Drake reads."""
    return [
        actuator
        for transmission in root.all("transmission")
        if any("SimpleTransmission" in each.text for each in transmission.all("type"))
        and any(each.attributes.get("name") == joint for each in transmission.all("joint"))
        for actuator in transmission.all("actuator")
    ]


def _declare_drake(text: SourceText) -> None:
    if "xmlns:drake" not in text.root.attributes:
        text.set_attribute(text.root, "xmlns:drake", _DRAKE)
        text.root.attributes["xmlns:drake"] = _DRAKE


def _write_sdf(text: SourceText, joint: SourceElement, change: Change) -> None:
    axis = joint.find("axis")
    if axis is None:
        raise ModelError(f"{joint.attributes.get('name')} has no <axis> to write numbers into.")
    given = {tag: words(change[name]) for name, tag in _SDF_TAGS.items() if name in change}
    dynamics = axis.find("dynamics")
    if given and dynamics is None:
        inside = (f"  <{tag}>{word}</{tag}>" for tag, word in given.items())
        text.insert(axis, "<dynamics>", *inside, "</dynamics>")
    elif dynamics is not None:
        _set_children(text, dynamics, given)
    if "armature" in change:
        ratio = joint.find("drake:gear_ratio")
        gear = 1.0 if ratio is None else numbers(ratio.text, 1)[0]
        if not (np.isfinite(gear) and gear):
            gear = 1.0
        rotor = {"drake:rotor_inertia": words(change["armature"] / gear**2)}
        _set_children(text, joint, rotor | ({} if ratio else {"drake:gear_ratio": "1.0"}))
        _declare_drake(text)


def _set_children(text: SourceText, parent: SourceElement, given: Mapping[str, str]) -> None:
    """Gives children of an element other texts, and adds those that it lacks."""
    new = []
    for tag, word in given.items():
        child = parent.find(tag)
        if child is None:
            new.append(f"<{tag}>{word}</{tag}>")
        else:
            text.set_text(child, word)
    if new:
        text.insert(parent, *new)


def _write_mjcf(text: SourceText, joint: SourceElement, change: Change) -> None:
    for name, value in change.items():
        text.set_attribute(joint, _MJCF_NAMES[name], words(value))


_Find = Callable[[SourceElement, Path], dict[str, SourceElement]]
_Write = Callable[[SourceText, SourceElement, Change], None]
_FORMATS: Mapping[str, tuple[_Find, _Write]] = {
    "robot": (_urdf_joints, _write_urdf),
    "sdf": (_sdf_joints, _write_sdf),
    "mujoco": (mjcf_joints, _write_mjcf),
}
"""Root element -> the joints of a format by scoped name, and what writes into one."""
