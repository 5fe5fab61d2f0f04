"""What drives the joints of a model, as simulators' files state it: motors, servos and delays."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of


@dataclass(frozen=True)
class Actuator:
    """What drives a joint.

    Attributes:
        joint: Name of the joint.
        stiffness: Of a servo that is told positions, N·m/rad or N/m; 0 for a motor that is told
            efforts.
        damping: Of a servo, on its velocity, N·m·s/rad or N·s/m.
        limit: Largest effort, N·m or N; infinite where there is none.
        delay: By how much what it is told acts late, s.
        measured_late: By how much measured efforts are late, s.
    """

    joint: str
    stiffness: float
    damping: float
    limit: float
    delay: float
    measured_late: float

    @property
    def is_servo(self) -> bool:
        """Whether it is told positions."""
        return self.stiffness > 0.0


def actuators_of(model: RobotModel) -> tuple[Actuator, ...]:
    """The actuators of all joints of one degree of freedom.

    A delay of efforts that are logged late is one of their measurement. Efforts that are logged
    ahead act late, as commands do.

    Args:
        model: The model, without a transmission.
    """
    limits, delays = model.known_effort_limits.tolist(), model.delays.tolist()
    found = []
    columns = zip(model.joints, servos_of(model), limits, delays, strict=True)
    for joint, servo, limit, delay in columns:
        if joint not in model.single_joints:
            continue
        found.append(
            Actuator(
                joint,
                stiffness=servo.gain if servo else 0.0,
                damping=servo.damping if servo else 0.0,
                limit=limit,
                delay=max(-delay, 0.0) + (servo.delay if servo else 0.0),
                measured_late=max(delay, 0.0),
            )
        )
    return tuple(found)
