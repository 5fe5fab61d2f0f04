"""Reading, writing and checking of numbers in model files.

Numbers that Drake misreads, such as 1,5, or that are so large that Drake aborts are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import WeldJoint

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.inertia.kernels import calc_from_mass_com_inertia
from geodrake.robot.files.xml_text import wrong_at

TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
UPPER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
ADDED_MASS = tuple(a + b for i, a in enumerate("xyzpqr") for b in "xyzpqr"[i:])
"""SDF's names of the entries of a matrix (6, 6) by rows: forces x, y, z, and moments p, q, r."""


def drop(element: Element, *tags: str) -> None:
    """Remove all elements with these tags below an element."""
    for parent in list(element.iter()):
        for child in [child for child in parent if child.tag in tags]:
            parent.remove(child)


def numbers(text: str, count: int) -> Array:
    """Return the numbers in a text, NaN for others; an empty text means zeros."""
    parts = text.split()
    if not parts:
        return np.zeros(count)
    try:
        values = np.array(parts, float)
    except ValueError:
        return np.full(count, np.nan)
    return values if len(values) == count else np.full(count, np.nan)


def is_off(text: str) -> bool:
    """Return whether a text is empty, `false`, `no`, or all zeros."""
    words = text.split()
    if not words or text.strip().lower() in ("false", "no"):
        return True
    try:
        return not any(float(word) for word in words)
    except ValueError:
        return False


def number(parent: Element, tag: str, attribute: str = "") -> float:
    """Return the number in a child's attribute or text; 0 if missing, NaN if invalid."""
    child = parent.find(tag)
    if child is None:
        return 0.0
    return float(numbers(child.get(attribute, "") if attribute else child.text or "", 1)[0])


def symmetric(texts: Iterable[str]) -> Array:
    """Return the symmetric matrix (3, 3) of six numbers in the order of `TENSOR`."""
    matrix = np.zeros((3, 3))
    matrix[UPPER] = [numbers(text, 1)[0] for text in texts]
    return matrix + np.triu(matrix, 1).T


def added_mass_matrix(entries: Iterable[float]) -> Array:
    """Return the symmetric matrix (6, 6) of entries in the order of `ADDED_MASS`."""
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = [*entries]
    return matrix + np.triu(matrix, 1).T


def rotation(values: Array) -> Array:
    """Return the rotation of roll, pitch, yaw (3,) or of a quaternion w, x, y, z (4,)."""
    if not np.isfinite(values).all() or (len(values) == 4 and not values.any()):
        return np.full((3, 3), np.nan)
    if len(values) == 3:
        return RollPitchYaw(values).ToRotationMatrix().matrix()
    return RotationMatrix(Quaternion(values / np.linalg.norm(values))).matrix()


def inertial_parameters_of(mass: float, com: Array, R: Array, inertia: Array) -> Array:
    """Return parameters (10,) for a central inertia (3, 3) in axes with the rotation R."""
    with np.errstate(over="ignore", invalid="ignore"):  # NaN stays NaN
        return calc_from_mass_com_inertia(np.asarray(mass, float), com, R @ inertia @ R.T)


def tensor_words(inertia: Array) -> dict[str, str]:
    """Return name in `TENSOR` -> entry of an inertia matrix, as text."""
    return dict(zip(TENSOR, words(inertia[UPPER]).split(), strict=True))


def words(values: Array | float) -> str:
    """Return a text of numbers that reads back exactly."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


LARGEST = 1e12
"""Largest valid number in SI units, except for limits."""

_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|inf)")


@dataclass(frozen=True)
class Numbers:
    """Requirements on the numbers of an attribute or text."""

    counts: range = range(1, 2)  # valid counts; Drake checks empty texts
    least: float = -LARGEST
    most: float = LARGEST

    def problem(self, text: str) -> str:
        """Return the problem of a text, or ""."""
        words = text.split()
        wrong = [word for word in words if not _NUMBER.fullmatch(word)]
        if wrong:
            return f"{wrong[0][:50]!r} is not a number"
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
"""Tag, "" for all -> attribute, "" for the text -> numbers, or None for any word."""

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
    "dynamics": {"damping": Numbers(range(1, 4), least=0.0), "friction": _POSITIVE},
    "drake:gear_ratio": {"value": _ONE},
    "drake:rotor_inertia": {"value": _POSITIVE},
    "drake:screw_thread_pitch": {"value": _ONE},
}
SDF_NUMBERS: Numeric = {
    "pose": {"": Numbers(range(6, 8))},
    "xyz": {"": _VECTOR},
    "lower": {"": _LIMIT},
    "upper": {"": _LIMIT},
    "effort": {"": _LIMIT},  # negative for none
    "velocity": {"": _LIMIT},
    "damping": {"": _POSITIVE},
    "friction": {"": _POSITIVE},
    "drake:gear_ratio": {"": _ONE},
    "drake:rotor_inertia": {"": _POSITIVE},
}
MJCF_NUMBERS: Numeric = {
    "": {
        **dict.fromkeys(("pos", "axis", "euler", "zaxis", "gravity", "wind", "anchor"), _VECTOR),
        **dict.fromkeys(("ref", "springref", "coef", "gravcomp"), _ONE),
        **dict.fromkeys(("springlength", "springdamper"), Numbers(range(1, 3))),
        "polycoef": Numbers(range(1, 6)),
        "relpose": Numbers(range(7, 8)),
        **dict.fromkeys(("quat", "axisangle"), _FOUR),
        **dict.fromkeys(("xyaxes", "fromto"), _SIX),
        "size": Numbers(range(1, 5)),
        "gear": Numbers(range(1, 7)),
        **dict.fromkeys(("range", "ctrlrange", "forcerange", "actuatorfrcrange"), _RANGE),
        **dict.fromkeys(("armature", "frictionloss", "density", "viscosity", "mass"), _POSITIVE),
        "damping": Numbers(range(1, 4), least=0.0),
        "stiffness": Numbers(range(1, 4)),
    },
    "flag": dict.fromkeys(("gravity", "frictionloss")),
}


def check_numbers(root: Element, numeric: Numeric, path: Path) -> None:
    """Raise for text that is not a number, wrong counts, and numbers out of bounds.

    The repair of inertias handles those of an `inertial`.
    """
    inside = {each for inertial in root.iter("inertial") for each in inertial.iter()}
    for element in (each for each in root.iter() if each not in inside):
        requirements = {**numeric.get("", {}), **numeric.get(element.tag, {})}
        for attribute, numbers in requirements.items():
            text = element.get(attribute, "") if attribute else (element.text or "")
            problem = numbers.problem(text) if numbers and (attribute or not len(element)) else ""
            if problem:
                words = f"{attribute}={text[:50]!r}" if attribute else repr(text.strip()[:50])
                raise _wrong(element, path, f"has {words}: {problem}")


def check_link(link: Element, phi: Array | None, path: Path) -> None:
    """Raise for a name that Drake would attribute to another model, and too large inertias (10,).

    Inertias that are not finite are accepted.
    """
    name, largest = link.get("name", ""), 0.0 if phi is None else np.abs(phi).max()
    if "::" in name:
        raise _wrong(link, path, f"has name={name!r}: :: separates model and link")
    if LARGEST < largest < np.inf:
        reason = f"{name!r} has {largest:g} kg, kg·m or kg·m², above {LARGEST:g}"
        raise _wrong(link, path, reason)


def check_limits(root: Element, path: Path) -> None:
    """Raise for lower limits above upper ones."""
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
    """Raise for poses of joints that are not finite or too large."""
    for joint in (plant.get_joint(index) for index in plant.GetJointIndices()):
        frames = (joint.frame_on_parent(), joint.frame_on_child())
        poses = [frame.GetFixedPoseInBodyFrame() for frame in frames]
        if isinstance(joint, WeldJoint):
            poses.append(joint.X_FM())
        for pose in poses:
            if not np.all(np.abs(pose.GetAsMatrix34()) <= LARGEST):
                raise ModelError(
                    f"{path} puts the joint {joint.name()!r} {pose.translation().tolist()} m away, "
                    f"rotated by {pose.rotation().matrix().ravel().tolist()}.",
                    advice="Correct the pose there.",
                )
    if not np.isfinite(plant.GetDefaultPositions()).all():
        raise ModelError(
            f"{path} has default positions that are not numbers.",
            advice="Correct default_joint_positions, or default_free_body_pose.",
        )


def _wrong(element: Element, path: Path, reason: str) -> ModelError:
    return wrong_at(element, path, f"<{element.tag}> {reason}.")
