"""Names and units of columns of a floating base, its IMU and its contacts.

They are geodrake's own (`geodrake.logs.floating`), ROS's of the fields of Odometry, PoseStamped,
Imu and WrenchStamped, and such as `base_quat_w`, `imu_gyro_x [deg/s]` or `FL_foot.force.z_kgf`.
"""

from __future__ import annotations

import re
from functools import lru_cache

from geodrake.logs.files.name_rules import Meaning, without_unit
from geodrake.logs.floating import FLAG

_FIELDS = {
    "position": "base.position",
    "orientation": "base.orientation",
    "translation": "base.position",
    "rotation": "base.orientation",
    "linear_velocity": "base.linear_velocity",
    "twist.linear": "base.linear_velocity",
    "twist.angular": "base.angular_velocity",
    "angular_velocity": "angular_velocity",
    "linear_acceleration": "imu.linear_acceleration",
    "force": "force",
    "torque": "torque",
    "moment": "torque",
}
_SHORT = {
    "pos": "position",
    "quaternion": "orientation",
    "quat": "orientation",
    "rot": "orientation",
    "q": "orientation",
    "lin_vel": "linear_velocity",
    "ang_vel": "angular_velocity",
    "gyroscope": "angular_velocity",
    "gyro": "angular_velocity",
    "acceleration": "linear_acceleration",
    "accelerometer": "linear_acceleration",
    "accel": "linear_acceleration",
    "acc": "linear_acceleration",
}
_QUANTITIES = {  # of units, by what a column has
    "position": "position",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "force": "effort",
    "torque": "effort",
    FLAG[1:]: "pwm",
}
IS_BASE = re.compile(r"odom|base|pose|mocap|floating|root|trunk|torso|pelvis", re.IGNORECASE)
_IMU = re.compile(r"imu", re.IGNORECASE)
_VECTOR = re.compile(
    rf"(?P<head>.*?)[./]?(?P<field>{'|'.join(map(re.escape, _FIELDS))})\.(?P<axis>[wxyz])",
    re.IGNORECASE,
)
_UNDERSCORED = re.compile(
    rf"(?P<head>.+?)[._](?P<field>{'|'.join([*_FIELDS, *_SHORT])})[._]?(?P<axis>[wxyz])",
    re.IGNORECASE,
)
_CONTACT = re.compile(r"(?P<frame>.+?)[./](?:in_)?contact(?:_state)?", re.IGNORECASE)


@lru_cache(maxsize=10_000)
def floating_meaning(column: str) -> Meaning | None:
    """Return the meaning of a column of a floating base or a contact; None otherwise."""
    if (name := _floating_name(column)) is not None:
        return Meaning(column, name)
    for quantity in dict.fromkeys(_QUANTITIES.values()):
        plain, unit = without_unit(column, quantity)
        cut = column.rpartition("_")[0]  # with its own points
        name = None if unit is None else _floating_name(plain) or _floating_name(cut)
        if name and quantity in (_QUANTITIES.get(w) for w in re.split(r"[._]", name)):
            return Meaning(column, name, unit=unit)
    return None


def _floating_name(column: str) -> str | None:
    """Return geodrake's own name of a column without a unit; None if it is something else."""
    if (found := _CONTACT.fullmatch(column)) is not None:
        return f"{found['frame']}{FLAG}"
    plain = re.sub(r"(?<=\w)/(?=\w)", ".", column.strip("/"))
    short = _UNDERSCORED.fullmatch(plain) if _IMU.search(plain) or IS_BASE.search(plain) else None
    found = _VECTOR.fullmatch(plain) or short
    if found is None:
        return None
    head = re.sub(r"(\.|^)(pose|twist|wrench)$", "", found["head"].strip("."))
    field, axis = found["field"].lower(), found["axis"].lower()
    what = _FIELDS[_SHORT.get(field, field)]
    if what in ("force", "torque"):
        return f"{head}.{what}.{axis}" if head and axis != "w" else None
    if what == "angular_velocity":
        what = f"imu.{what}" if _IMU.search(head) else f"base.{what}"
    is_its = _IMU.search(head) if what.startswith("imu.") else IS_BASE.search(column)
    if is_its is None or (axis == "w") > (what == "base.orientation"):
        return None
    if what == "base.orientation" and _IMU.search(head):
        return None
    return f"{what}.{axis}"
