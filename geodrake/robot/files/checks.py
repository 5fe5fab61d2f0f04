"""Numbers of model files that Drake would misread, such as 1,5, or end the process over."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import WeldJoint

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.xml_text import wrong_at

LARGEST = 1e12
"""In SI units, larger than anything of a robot but a limit, which may stand for none."""

_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|inf)")


@dataclass(frozen=True)
class Numbers:
    """What numbers may stand in one place.

    Attributes:
        counts: How many; none at all is left to Drake.
        least: Lower bound of each.
        most: Upper bound of each.
    """

    counts: range = range(1, 2)
    least: float = -LARGEST
    most: float = LARGEST

    def problem(self, text: str) -> str:
        """Return what is wrong with a text, to be read after it; nothing if it will do."""
        words = text.split()
        wrong = [word for word in words if not _NUMBER.fullmatch(word)]
        if wrong:
            return f"{wrong[0][:50]!r} is no number"
        if words and len(words) not in self.counts:
            few, many = self.counts[0], self.counts[-1]
            return f"it needs {few if few == many else f'{few} to {many}'} numbers"
        values = np.array(words, float)
        outside = values[(values < self.least) | (values > self.most) | np.isnan(values)]
        if not len(outside):
            return ""
        bound, word = (self.least, "below") if outside[0] < self.least else (self.most, "above")
        return f"{outside[0]:g} is {word} {bound:g}"


Numeric = Mapping[str, Mapping[str, Numbers | None]]
"""Tag -> attribute -> numbers, None for any word.

The attribute "" is the text, the tag "" stands for all.
"""

_ONE, _VECTOR, _FOUR, _SIX = (Numbers(range(count, count + 1)) for count in (1, 3, 4, 6))
_POSITIVE = Numbers(least=0.0)
_LIMIT = Numbers(least=-np.inf, most=np.inf)
_MAGNITUDE = Numbers(least=0.0, most=np.inf)
_RANGE = Numbers(range(2, 3), least=-np.inf, most=np.inf)

URDF_NUMBERS: Numeric = {
    "origin": {"xyz": _VECTOR, "rpy": _VECTOR},
    "axis": {"xyz": _VECTOR},
    "limit": {
        "lower": _LIMIT,
        "upper": _LIMIT,
        "effort": _MAGNITUDE,
        "velocity": _MAGNITUDE,
        "drake:acceleration": _MAGNITUDE,
    },
    "dynamics": {"damping": _POSITIVE, "friction": _POSITIVE},
    "drake:gear_ratio": {"value": _ONE},
    "drake:rotor_inertia": {"value": _POSITIVE},
    "drake:screw_thread_pitch": {"value": _ONE},
}
SDF_NUMBERS: Numeric = {
    "pose": {"": Numbers(range(6, 8))},
    "xyz": {"": _VECTOR},
    "lower": {"": _LIMIT},
    "upper": {"": _LIMIT},
    "effort": {"": _LIMIT},  # below zero stands for none
    "velocity": {"": _LIMIT},
    "damping": {"": _POSITIVE},
    "friction": {"": _POSITIVE},
    "drake:gear_ratio": {"": _ONE},
    "drake:rotor_inertia": {"": _POSITIVE},
}
MJCF_NUMBERS: Numeric = {
    "": {
        **dict.fromkeys(("pos", "axis", "euler", "zaxis", "gravity"), _VECTOR),
        **dict.fromkeys(("quat", "axisangle"), _FOUR),
        **dict.fromkeys(("xyaxes", "fromto"), _SIX),
        "size": Numbers(range(1, 5)),
        "gear": Numbers(range(1, 7)),
        **dict.fromkeys(("range", "ctrlrange", "forcerange", "actuatorfrcrange"), _RANGE),
        **dict.fromkeys(("armature", "frictionloss", "density", "mass"), _POSITIVE),
        "damping": Numbers(range(1, 4), least=0.0),
        "stiffness": Numbers(range(1, 4)),
    },
    "flag": {"gravity": None},
}


def check_numbers(root: Element, numeric: Numeric, path: Path) -> None:
    """Refuse text that is no number, too few or too many numbers, and numbers out of bounds.

    Those of an `inertial` are left to the repair of inertias.
    """
    for element in _but_inertials(root):
        every = {**numeric.get("", {}), **numeric.get(element.tag, {})}
        for attribute, numbers in every.items():
            text = element.get(attribute, "") if attribute else (element.text or "")
            problem = numbers.problem(text) if numbers and (attribute or not len(element)) else ""
            if problem:
                words = f"{attribute}={text[:50]!r}" if attribute else repr(text.strip()[:50])
                raise _wrong(element, path, f"has {words}: {problem}")


def check_links(links: Mapping[str, Element], path: Path) -> None:
    """Refuse names that Drake takes for a link of another model."""
    for link in links.values():
        if "::" in link.get("name", ""):
            raise _wrong(link, path, f"has name={link.get('name')!r}: :: separates model and link")


def check_inertia(link: Element, phi: Array, path: Path) -> None:
    """Refuse inertial parameters (10,) that are numbers, but larger than anything of a robot.

    What is not finite passes.
    """
    largest = np.abs(phi).max()
    if LARGEST < largest < np.inf:
        reason = f"{link.get('name')!r} has {largest:g} kg, kg·m or kg·m², above {LARGEST:g}"
        raise _wrong(link, path, reason)


def check_limits(root: Element, path: Path) -> None:
    """Refuse lower limits above upper ones."""
    for element in root.iter():
        limits = []
        if element.tag == "limit":
            pair = [
                element.get(key) or element.findtext(key, "").strip() for key in ("lower", "upper")
            ]
            limits.append(("a limit", pair))
        if element.get("limited") != "false":
            keys = [key for key in element.attrib if key.endswith("range")]
            limits += [(key, element.get(key, "").split()) for key in keys]
        for what, pair in limits:
            ordered = [float(word) for word in pair if _NUMBER.fullmatch(word)]
            if len(ordered) == 2 and ordered[0] > ordered[1]:
                reason = f"has {what} whose lower end {pair[0]} is above its upper end {pair[1]}"
                raise _wrong(element, path, reason)


def check_poses(plant: MultibodyPlant, path: Path) -> None:
    """Refuse joints at places that are no numbers, or beyond all that is a robot."""
    for joint in (plant.get_joint(index) for index in plant.GetJointIndices()):
        frames = (joint.frame_on_parent(), joint.frame_on_child())
        poses = [frame.GetFixedPoseInBodyFrame() for frame in frames]
        if isinstance(joint, WeldJoint):
            poses.append(joint.X_FM())
        for pose in poses:
            if not np.all(np.abs(pose.GetAsMatrix34()) <= LARGEST):
                raise ModelError(
                    f"{path} puts the joint {joint.name()!r} {pose.translation().tolist()} m away, "
                    f"turned by {pose.rotation().matrix().ravel().tolist()}.",
                    advice="Correct the pose there.",
                    path=path,
                )
    if not np.isfinite(plant.GetDefaultPositions()).all():
        raise ModelError(
            f"{path} gives default positions that are no numbers.",
            advice="Correct default_joint_positions, or default_free_body_pose.",
            path=path,
        )


def _but_inertials(root: Element) -> Iterator[Element]:
    waiting = [root]
    while waiting:
        element = waiting.pop()
        yield element
        waiting.extend(child for child in reversed(element) if child.tag != "inertial")


def _wrong(element: Element, path: Path, reason: str) -> ModelError:
    return wrong_at(element, path, f"<{element.tag}> {reason}.")
