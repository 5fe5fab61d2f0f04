"""Parse column names of a floating base, its IMU and its contacts.

Names are geodrake's own (`geodrake.logs.floating`), those of ROS messages, and variants such as
`base_quat_w`, `base_roll_deg`, `base_R_00`, `imu_gyro_x [deg/s]` or `FL_foot.force.z_kgf`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache

from geodrake.errors import ArgumentError
from geodrake.logs.files.name_rules import MAPPED, Meaning, by_word, without_unit
from geodrake.logs.files.units import WORDS, unit_of
from geodrake.logs.floating import ANGLES, AXES, FLAG

_FIELDS, _SHORT = (by_word(WORDS[kind]) for kind in ("base_fields", "short_base_fields"))
_QUANTITIES: Mapping[str, str] = WORDS["base_units"]
IS_BASE = re.compile(r"odom|base|pose|mocap|floating|root|trunk|torso|pelvis", re.IGNORECASE)
_IMU = re.compile(r"imu", re.IGNORECASE)
_VECTOR = re.compile(
    rf"(?P<head>.*?)[./]?(?P<field>{'|'.join(map(re.escape, _FIELDS))})\.(?P<axis>[wxyz])",
    re.IGNORECASE,
)
_SHORTENED = re.compile(
    rf"(?P<head>.+?)([._](?P<field>{'|'.join([*_FIELDS, *_SHORT])}))?"
    r"[._\[]*(?P<axis>[wxyz]|\d\d?|roll|pitch|yaw)\]?",
    re.IGNORECASE,
)
_UNNUMBERED = "", "q", "force", "torque"  # numbers after these fields are joint numbers
_ANGLES = dict(zip("xyz", ANGLES, strict=True))
_LINKS = re.compile(r"trunk|torso|pelvis", re.IGNORECASE)  # joints may have such names
_CONTACT = re.compile(r"(?P<frame>.+?)[./](?:in_)?contact(?:_state)?", re.IGNORECASE)


def mapped_meaning(name: str, column: str, unit: str | None, gain: float) -> Meaning:
    """Return the meaning of a column that a mapping assigns to geodrake's own name.

    Raises:
        ArgumentError: The name is none of these, or the unit is unknown.
    """
    quantities = [q for w in name.split(".") for q in [_QUANTITIES.get(w.rpartition("_")[2])] if q]
    if _floating_name(name) != name or not quantities:
        raise ArgumentError(
            f"{name!r} is no quantity of a base or of its feet.",
            advice="Write base.position.x, base.orientation.w, imu.angular_velocity.x, "
            "LINK.force.x, LINK.contact or the like.",
        )
    found = unit_of(unit, quantities[-1]) if unit else None
    return Meaning(column, name, unit=found, style=MAPPED, gain=gain)


@lru_cache(maxsize=10_000)
def floating_meaning(column: str) -> Meaning | None:
    """Return the meaning of a column of a floating base or a contact; None otherwise."""
    if (name := _floating_name(column)) is not None:
        return Meaning(column, name)
    for quantity in dict.fromkeys(_QUANTITIES.values()):
        plain, unit = without_unit(column, quantity)
        cut = column.rpartition("_")[0]  # for units with dots
        name = None if unit is None else _floating_name(plain) or _floating_name(cut)
        if name and quantity in (_QUANTITIES.get(w) for w in re.split(r"[._]", name)):
            return Meaning(column, name, unit=unit)
    return None


def _floating_name(column: str) -> str | None:
    """Return geodrake's own name of a column without a unit; None for other columns."""
    if (match := _CONTACT.fullmatch(column)) is not None:
        return f"{match['frame']}{FLAG}"
    plain = re.sub(r"(?<=\w)/(?=\w)", ".", column.strip("/"))
    match, is_of_base = _VECTOR.fullmatch(plain), IS_BASE.search(plain)
    if match is None and (is_of_base or _IMU.search(plain)):
        match = _SHORTENED.fullmatch(plain)
    if match is None:
        return None
    head = re.sub(r"(\.|^)(pose|twist|wrench)$", "", match["head"].strip("."))
    field, axis = (match["field"] or "").lower(), match["axis"].lower()
    is_bare = not field and (axis not in ANGLES or _LINKS.search(plain))
    if is_bare or (axis.isdigit() and field in _UNNUMBERED):
        return None
    quantity = _FIELDS[_SHORT.get(field, field)] if field else "angles"
    if quantity in ("force", "torque"):
        return f"{head}.{quantity}.{axis}" if head and axis != "w" else None
    if quantity == "angular_velocity":
        quantity = f"imu.{quantity}" if _IMU.search(head) else f"base.{quantity}"
    if quantity == "angles":
        quantity, axis = "base.orientation", _ANGLES.get(axis, axis)
    is_turn = quantity == "base.orientation"
    is_matching = _IMU.search(head) if quantity.startswith("imu.") else is_of_base
    if is_matching is None or (axis == "w") > is_turn or (is_turn and _IMU.search(head)):
        return None
    return f"{quantity}.{axis}"


def numbered_axes(names: Iterable[str]) -> dict[str, str]:
    """Return new names for those that end with the number of an axis.

    Three numbers become x, y and z, or roll, pitch and yaw; others are counted from 0.
    """
    heads, found = dict[str, list[str]](), dict[str, str]()
    for name in names:
        head, _, axis = name.rpartition(".")
        if axis.isdigit():
            heads.setdefault(head, []).append(axis)
    for head, axes in heads.items():
        labels = ANGLES if head.endswith("orientation") else AXES
        news = labels if len(axes) == len(labels) else map(str, range(len(axes)))
        found |= {f"{head}.{a}": f"{head}.{new}" for a, new in zip(sorted(axes), news, strict=True)}
    return found
