"""Numbers in the text of model files."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix

from geodrake.inertia.kernels import Array, calc_from_mass_com_inertia

TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
UPPER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])


def drop(element: Element, *tags: str) -> None:
    """Removes all elements with these tags below an element."""
    for parent in list(element.iter()):
        for child in [child for child in parent if child.tag in tags]:
            parent.remove(child)


def numbers(text: str, count: int) -> Array:
    """Return numbers of a text, NaN where there are none; an empty text means zeros."""
    parts = text.split()
    if not parts:
        return np.zeros(count)
    try:
        values = np.array(parts, float)
    except ValueError:
        return np.full(count, np.nan)
    return values if len(values) == count else np.full(count, np.nan)


def number(parent: Element, tag: str, attribute: str) -> float:
    """Return the number in a child's attribute; 0 where it is left out, NaN if invalid."""
    child = parent.find(tag)
    return float(numbers("" if child is None else child.get(attribute, ""), 1)[0])


def symmetric(texts: Iterable[str]) -> Array:
    """Return the symmetric matrix (3, 3) of six numbers in the order of `TENSOR`."""
    matrix = np.zeros((3, 3))
    matrix[UPPER] = [numbers(text, 1)[0] for text in texts]
    return matrix + np.triu(matrix, 1).T


def rotation(values: Array) -> Array:
    """Return the rotation of roll, pitch, yaw (3,) or of a quaternion w, x, y, z (4,)."""
    if not np.isfinite(values).all() or (len(values) == 4 and not values.any()):
        return np.full((3, 3), np.nan)
    if len(values) == 3:
        return RollPitchYaw(values).ToRotationMatrix().matrix()
    return RotationMatrix(Quaternion(values / np.linalg.norm(values))).matrix()


def inertial_parameters_of(mass: float, com: Array, R: Array, inertia: Array) -> Array:
    """Parameters (10,) of a central inertia (3, 3) that is expressed in a frame turned by R."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number stays none
        return calc_from_mass_com_inertia(np.asarray(mass, float), com, R @ inertia @ R.T)


def tensor_words(inertia: Array) -> dict[str, str]:
    """Return the six entries of an inertia matrix by their name in `TENSOR`."""
    return dict(zip(TENSOR, words(inertia[UPPER]).split(), strict=True))


def words(values: Array | float) -> str:
    """Return a text of numbers that reads back exactly."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))
