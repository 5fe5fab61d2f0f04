"""How far a model is from logs: errors of joints, where they are concentrated, series."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short, Shown
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN, NOISE_MARGIN

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointError:
    """Error of one joint's effort.

    Attributes:
        rms: RMS of measured − predicted effort, N·m or N.
        std: Standard deviation of the measured effort, N·m or N; of a joint at rest the effort that
            it holds, or that gravity could ask of it.
        floor: Estimated RMS of the sensor noise, N·m or N.
        knows_noise: Whether that is known whatever a model leaves.
    """

    joint: str
    rms: float
    std: float
    floor: float
    knows_noise: bool = True

    @property
    def nrms(self) -> float:
        """RMS over standard deviation."""
        return self.rms / self.std

    @property
    def shows_noise(self) -> bool:
        """Whether the floor may be that of a sensor: efforts that were filtered show none."""
        return self.floor > 0.0

    @property
    def is_noise(self) -> bool:
        """Whether no more than sensor noise is left at the joint."""
        return self.rms <= JOINT_NOISE_MARGIN * self.floor

    @property
    def removable(self) -> float:
        """Share of the squared error that some model could still remove; NaN without a floor."""
        if not self.shows_noise:
            return math.nan
        return max(0.0, 1.0 - (self.floor / self.rms) ** 2) if self.rms > 0 else 0.0


@dataclass(frozen=True)
class ErrorTable(Short):
    """Errors of all joints."""

    joints: tuple[JointError, ...]

    @property
    def nrms(self) -> float:
        """Root mean square over joints of rms / std: joints count by what they could show."""
        return float(np.sqrt(np.mean([joint.nrms**2 for joint in self.joints])))

    @property
    def floor_nrms(self) -> float:
        """The nrms of the noise floor."""
        return float(np.sqrt(np.mean([(joint.floor / joint.std) ** 2 for joint in self.joints])))

    @property
    def shows_noise(self) -> bool:
        """Whether the floor may be that of a sensor: efforts that were filtered show none."""
        return self.floor_nrms > 0.0

    @property
    def knows_noise(self) -> bool:
        """Whether the noise of all joints is known whatever a model leaves, and less than the rest.

        Where it is as large as all that the efforts show beside it, any error passes for noise.
        """
        return not self.is_mostly_noise and all(joint.knows_noise for joint in self.joints)

    @property
    def is_mostly_noise(self) -> bool:
        """Whether noise is half of the mean square of the efforts or more."""
        return self.floor_nrms**2 >= 0.5

    @property
    def is_noise(self) -> bool:
        """Whether no more than sensor noise is left, on the whole and at every joint."""
        return self.whole_is_noise and not self.above_noise

    @property
    def whole_is_noise(self) -> bool:
        """Whether no more than sensor noise is left on the whole, whatever single joints do."""
        return self.nrms <= NOISE_MARGIN * self.floor_nrms

    @property
    def above_noise(self) -> tuple[JointError, ...]:
        """Joints that err by more than noise, whatever the others do."""
        return tuple(joint for joint in self.joints if not joint.is_noise)

    @property
    def pooled_rms(self) -> float:
        """Root mean square over joints of the RMS, N·m or N."""
        return float(np.sqrt(np.mean([joint.rms**2 for joint in self.joints])))

    @property
    def pooled_floor(self) -> float:
        """Root mean square over joints of the noise floor, N·m or N."""
        return float(np.sqrt(np.mean([joint.floor**2 for joint in self.joints])))

    def by_joint(self) -> dict[str, float]:
        """RMS of each joint by name."""
        return {joint.joint: joint.rms for joint in self.joints}


@dataclass(frozen=True, eq=False)
class Series(Short):
    """One joint over one block, filtered and decimated: what figures show.

    Attributes:
        time: (K,) instants, s.
        position: (K,) rad or m.
        velocity: (K,) rad/s or m/s.
        acceleration: (K,) rad/s² or m/s².
        measured: (K,) effort, N·m or N.
        predicted: (K,) effort, N·m or N.
    """

    joint: str
    block: str
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    measured: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """(K,) measured − predicted."""
        return self.measured - self.predicted


@dataclass(frozen=True)
class Failing:
    """A circumstance in which a joint's error is larger than elsewhere.

    Attributes:
        circumstance: In words, such as "at speeds below 0.05 rad/s".
        rms: RMS of the error there, N·m or N.
        elsewhere: RMS of the error otherwise, N·m or N.
        share: Share of the joint's squared error that is made there.
        time: Share of the samples that are there.
        unit: Unit of the joint's effort, N·m or N.
    """

    joint: str
    circumstance: str
    rms: float
    elsewhere: float
    share: float
    time: float
    unit: str = "N·m"


@dataclass(frozen=True, eq=False)
class Comparison(Shown):
    """How far a model is from logs, and where.

    Attributes:
        errors: Errors of every joint.
        failing: Where the error is concentrated, worst first.
        series: What was measured and predicted.
        notes: What was done to the logs and noticed about the model.
    """

    errors: ErrorTable
    failing: tuple[Failing, ...]
    series: tuple[Series, ...]
    notes: tuple[str, ...]
