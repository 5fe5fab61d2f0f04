"""Logs of measurements, motions, and trajectories prepared for identification."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import (
    Array,
    Shape,
    instance,
    instances,
    number,
    one_or_each,
    real_array,
)
from geodrake.boundary.optional_packages import optional_package
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.filtering import ZeroPhaseFilter
from geodrake.logs.floating import ContactFlags
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motors import Motor
from geodrake.logs.smoothing import Stretch
from geodrake.logs.temperatures import Temperatures
from geodrake.logs.time_stamps import check_time

MEMORY = 20_000
"""Number of samples before the first one that effects with a memory use."""

QUANTITIES = ("position", "velocity", "acceleration", "effort", "command", "temperature")
"""Quantities of each joint in a log."""

PARTIAL = ("command", "temperature")
"""Quantities that may be missing at some joints."""

SIGNAL_KINDS = ("current", "voltage", "pwm")
"""Motor signals that may replace efforts."""

PASSIVE = "passive"
"""Kind of the efforts of a joint without a motor: zero and not measured."""

GROUND = "ground"
"""Kind of the efforts of a floating base: external wrenches as far as they are measured."""

UNMEASURED = "unmeasured"
"""Kind of the efforts of a joint with a motor that are not measured, or constant."""

NOT_MEASURED = (PASSIVE, GROUND, UNMEASURED)
"""Kinds of efforts that no sensor measures."""

EFFORT_KINDS = ("effort", *SIGNAL_KINDS, PASSIVE)
"""Kinds of efforts: N·m or N, A, V, a fraction of the supply voltage, or none."""

USUAL_GAIN_DEVIATION = 0.05
"""Default relative uncertainty of effort gains, such as torque constants."""

_ROWS = 100_000  # copied at once


@dataclass(frozen=True, eq=False)
class JointLog(Short):
    """Measurements at the joints of a robot, with NaN for missing ones.

    Attributes:
        name: Name of the log in messages.
        joints: Names of the n joints.
        time: (N,) time stamps, s, increasing, not necessarily uniform.
        position: (N, n) joint positions, rad or m.
        effort: (N, n) joint efforts, N·m or N, or signals of `effort_kinds` in their place; NaN at
            joints without measured efforts.
        velocity: (N, n) joint velocities, rad/s or m/s, if measured.
        acceleration: (N, n) joint accelerations, rad/s² or m/s², if measured.
        notes: Observations made while reading.
        payloads: Bodies of known mass that the robot carried all the time, and its model lacks.
        effort_uncertainty: Relative standard deviation of the effort gains, of all joints or (n,)
            of each: by default 5 %, typical of torque constants; 0 for calibrated torque sensors.
        standing: Other joint, with positions only -> its constant position, rad or m; NaN if it
            moves.
        alone: Such a joint -> its positions (N,), rad or m, if they are kept.
        command: (N, n) commanded positions of servos, rad or m; NaN at joints without commands.
        effort_kinds: Joint -> kind of its efforts, one of `EFFORT_KINDS`; by default "effort".
        temperature: (N, n) temperatures of motors or gears, °C; NaN at joints without sensors.
        origin: Zero of the time stamps, ns since 1970, if the file has dates; None if it is
            unknown, or stamps are themselves since 1970.
        floating: Measurements of a free base and its contacts, (N,) each, by the names in
            `geodrake.logs.floating`.
        measured: Joints whose measured accelerations are used instead of derived ones.
        ground: (N, n) contribution of measured wrenches to the efforts of motors, N·m or N.
        contacts: Possible contacts of a free base, unless its wrenches were measured.
        motors: Joint -> its motor, whose data sheet gives the expected gains of its signals.
        left_out: Joints of the file that are left out, as the model lacks them.
        assumed: The notes on columns without names of joints, which results begin with.
    """

    name: str
    joints: tuple[str, ...]
    time: Array
    position: Array
    effort: Array
    velocity: Array | None = None
    acceleration: Array | None = None
    notes: tuple[str, ...] = ()
    payloads: tuple[KnownPayload, ...] = ()
    effort_uncertainty: float | Array = USUAL_GAIN_DEVIATION
    standing: Mapping[str, float] = field(default_factory=dict)
    alone: Mapping[str, Array] = field(default_factory=dict, kw_only=True)
    command: Array | None = None
    effort_kinds: Mapping[str, str] = field(default_factory=dict)
    temperature: Array | None = None
    origin: int | None = None
    floating: Mapping[str, Array] = field(default_factory=dict, kw_only=True)
    measured: tuple[str, ...] = field(default=(), kw_only=True)
    ground: Array | None = field(default=None, kw_only=True)
    contacts: ContactFlags | None = field(default=None, kw_only=True)
    motors: Mapping[str, Motor] = field(default_factory=dict, kw_only=True)
    left_out: tuple[str, ...] = field(default=(), kw_only=True)
    assumed: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        instance(self.name, "name", str)
        object.__setattr__(self, "joints", instances(self.joints, "joints", str))
        if len(set(self.joints)) != len(self.joints):
            raise ArgumentError(f"Log {self.name!r} has duplicate joint names: {self.joints}.")
        sizes: dict[str, tuple[int, ...]] = {"n": (len(self.joints),)}
        for quantity in ("time", *QUANTITIES):
            values, shape = getattr(self, quantity), ("N",) if quantity == "time" else ("N", "n")
            if values is not None or quantity in ("time", "position", "effort"):
                name = f"{quantity} of log {self.name!r}"
                values = real_array(values, name, shape, sizes, finite=False)
                object.__setattr__(self, quantity, values)
        for name, values in instance(self.floating, "floating", Mapping).items():
            real_array(values, f"{name} of log {self.name!r}", ("N",), sizes, finite=False)
        instances(self.payloads, "payloads", KnownPayload)
        for share in one_or_each(self.effort_uncertainty, "effort_uncertainty", len(self.joints)):
            number(share, "effort_uncertainty", upper=1.0)
        for joint, kind in instance(self.effort_kinds, "effort_kinds", Mapping).items():
            if joint not in self.joints or kind not in (*EFFORT_KINDS, GROUND, UNMEASURED):
                raise ArgumentError(
                    f"Log {self.name!r} has the unknown kind of efforts {kind!r} for {joint!r}.",
                    advice=f"Joints are {', '.join(self.joints)}; kinds {', '.join(EFFORT_KINDS)}.",
                )
        check_time(self.name, self.time)

    @property
    def passive(self) -> tuple[str, ...]:
        """Joints without a motor, whose total effort is zero."""
        return tuple(j for j in self.joints if self.effort_kinds.get(j) == PASSIVE)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Joints with motors whose efforts are not measured, or constant."""
        return tuple(j for j in self.joints if self.effort_kinds.get(j) == UNMEASURED)

    @property
    def gain_deviations(self) -> Array:
        """(n,) relative standard deviations of the effort gains."""
        return np.broadcast_to(np.asarray(self.effort_uncertainty, float), (len(self.joints),))

    @property
    def motor_effort(self) -> Array:
        """(N, n) efforts without the contribution of measured wrenches."""
        return self.effort if self.ground is None else self.effort - self.ground

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, kept: NDArray[np.bool_]) -> JointLog:
        """Return the log of selected rows (N,); itself if all are selected."""
        if kept.all():
            return self
        names = ("time", *QUANTITIES)
        parts: dict[str, Any] = {n: x[kept] for n in names if (x := getattr(self, n)) is not None}
        for name in ("alone", "floating"):
            parts[name] = {column: x[kept] for column, x in getattr(self, name).items()}
        return replace(self, **parts)

    def columns(self) -> dict[str, Array]:
        """Return the measurements, (N,) each, by their names in log files.

        Empty columns of efforts, commands and temperatures are left out.
        """
        columns = {"time": self.time}
        for quantity in QUANTITIES:
            if (values := getattr(self, quantity)) is None:
                continue
            for j, (joint, column) in enumerate(zip(self.joints, values.T, strict=True)):
                kinds = self.effort_kinds if quantity == "effort" else {}
                commanded = self.command is not None and not np.isnan(self.command[:, j]).all()
                optional = quantity in PARTIAL or (quantity == "effort" and commanded)
                missing = kinds.get(joint) == UNMEASURED or (optional and np.isnan(column).all())
                if not missing:
                    columns[f"{joint}.{kinds.get(joint, quantity)}"] = column
        return {**columns, **self.floating}

    def to_dataframe(self) -> Any:
        """Return a DataFrame of pandas with the columns of a log file, `time` first."""
        pandas = optional_package("pandas", "logs", "data frames", LogError)
        return pandas.DataFrame(self.columns())

    @property
    def fingerprint(self) -> str:
        """Digest of the measurements, independent of the order of the joints."""
        order = np.argsort(self.joints)
        digest = hashlib.sha256(np.ascontiguousarray(self.time).data)
        commands = () if self.command is None else (self.command,)
        for values in (self.position, self.effort, *commands):
            for first in range(0, len(self), _ROWS):
                digest.update(np.ascontiguousarray(values[first : first + _ROWS, order]).data)
        for name in sorted(self.floating):
            digest.update(np.ascontiguousarray(self.floating[name]).data)
        return digest.hexdigest()[:16]

    def select(self, joints: Sequence[str]) -> JointLog:
        """Return the log of the given joints, in their order; itself if unchanged."""
        for joint in joints:
            if joint not in self.joints:
                raise _missing(self.name, joint, self.joints)
        if tuple(joints) == self.joints:
            return self
        order = [self.joints.index(joint) for joint in joints]
        fields: dict[str, Any] = {
            quantity: values[:, order]
            for quantity in QUANTITIES
            if (values := getattr(self, quantity)) is not None
        }
        fields["effort_uncertainty"] = self.gain_deviations[order]
        fields["effort_kinds"] = {j: k for j, k in self.effort_kinds.items() if j in joints}
        fields["ground"] = None if self.ground is None else self.ground[:, order]
        fields["measured"] = tuple(joint for joint in self.measured if joint in joints)
        return replace(self, joints=tuple(joints), **fields)


_SHAPES: Mapping[str, Shape | None] = {
    "q": ("N", "nq"),
    "v": ("N", "nv"),
    "vd": ("N", "nv"),
    "time": ("N",),
    "before": ("M", "nq"),
    "temperature": None,
}


@dataclass(frozen=True, eq=False)
class Motion(Short):
    """Positions, velocities and accelerations in Drake's order, sample by sample.

    Attributes:
        q: (N, nq) generalized positions.
        v: (N, nv) generalized velocities.
        vd: (N, nv) generalized accelerations.
        time: (N,) instants, s, if needed.
        before: (M, nq) positions just before the first sample; None for unordered samples.
        temperature: (N, nv) temperatures, °C, NaN where unknown; None if all are.
    """

    q: Array
    v: Array
    vd: Array
    time: Array | None = None
    before: Array | None = None
    temperature: Array | None = None

    def __post_init__(self) -> None:
        sizes: dict[str, tuple[int, ...]] = {}
        for name, shape in _SHAPES.items():
            if (values := getattr(self, name)) is not None or name in ("q", "v", "vd"):
                finite = name != "temperature"  # may be NaN
                values = real_array(values, name, shape, sizes, finite=finite)
                object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, samples: slice) -> Motion:
        time = None if self.time is None else self.time[samples]
        before = self.before
        if before is not None:
            before = np.concatenate([before, self.q[: samples.indices(len(self))[0]]])[-MEMORY:]
        temperature = None if self.temperature is None else self.temperature[samples]
        return Motion(self.q[samples], self.v[samples], self.vd[samples], time, before, temperature)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One log, prepared for identification."""

    name: str
    joints: tuple[str, ...]  # names of the n joints, in the log's order
    segments: tuple[Stretch, ...]  # stretches without gaps, in the order of time
    filter: ZeroPhaseFilter  # for the efforts and regressors of every segment
    speed_noise: Array  # (n,) noise deviations of the smoothed velocities, rad/s or m/s
    acceleration_noise: Array  # (n,) those of accelerations filtered as efforts, rad/s² or m/s²
    notes: tuple[str, ...] = ()  # on the preparation of the log
    began: float = 0.0  # its first time stamp, s
    payloads: tuple[KnownPayload, ...] = ()  # carried by the robot
    gain_deviations: Array | float = 0.0  # (n,) relative deviations of the effort gains
    # Requested bandwidths of efforts and regressors, and of the motion, Hz.
    bandwidths: tuple[float, float] = (0.0, 0.0)
    temperatures: Temperatures | None = None
    passive: tuple[str, ...] = ()
    # Possible contacts of a free base, unless its wrenches were measured.
    contacts: ContactFlags | None = None
    left_out: str = ""  # note on unused data; "" if they are negligible
    force_sensors: tuple[str, ...] = ()  # frames whose measured forces count as efforts
    unmeasured: tuple[str, ...] = ()  # joints with motors without measured efforts

    @property
    def output_counts(self) -> tuple[int, ...]:
        """Number of filtered and decimated samples of each segment."""
        return tuple(self.filter.output_count(len(segment)) for segment in self.segments)

    @property
    def has_unknown_forces(self) -> bool:
        """Whether equations must eliminate unknown forces of the ground or motors."""
        return self.contacts is not None or bool(self.unmeasured)

    @property
    def is_grounded(self) -> bool:
        """Whether ground forces act, so that only motor efforts show the loads of joints."""
        return self.contacts is not None or any(s[:1].ground is not None for s in self.segments)

    @property
    def ground_frames(self) -> tuple[str, ...]:
        """Frames at which ground forces may act."""
        return self.force_sensors if self.contacts is None else tuple(self.contacts.frames)

    def temperature(self, time: Array) -> Array | None:
        """Return temperatures (N, n) at time stamps (N,), s; NaN where unknown, or None."""
        courses = self.temperatures
        return None if courses is None else courses.at(time - self.began, self.joints)


def check_joints(
    name: str, joints: Sequence[str], model_joints: Sequence[str], *, partial: bool = False
) -> None:
    """Raise a LogError unless a log has the joints of the model, in any order."""
    if joints and set(joints).isdisjoint(model_joints) and len(joints) > 1:
        raise LogError(
            f"Log {name!r} has the joints {', '.join(joints[:8])}, of which the model has none; it "
            f"has {', '.join(model_joints[:8])}.",
            advice="Is it the log of another robot? Rename its columns, or say which is which in a "
            "mapping.",
        )
    for joint in joints:
        if joint not in model_joints:
            raise LogError(
                f"Log {name!r} has joint {joint!r}, but the model does "
                f"not{_nearest(joint, model_joints)}.",
                advice="Rename the log's columns, or remove that joint's columns.",
            )
    for joint in model_joints:
        if joint not in joints and not partial:
            raise _missing(name, joint, joints)


def _missing(name: str, joint: str, joints: Sequence[str]) -> LogError:
    return LogError(
        f"Log {name!r} has no joint {joint!r}{_nearest(joint, joints)}.",
        advice="Rename the log's columns, record that joint too, or fix it: --lock "
        f"{joint}=POSITION.",
    )


def _nearest(name: str, others: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, others, n=3, cutoff=0.4) or others
    return f" (nearest: {', '.join(map(repr, close))})" if close else ""
