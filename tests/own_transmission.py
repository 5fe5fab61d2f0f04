"""A transmission of a user's own, by functions."""

from collections.abc import Callable
from dataclasses import dataclass

from geodrake.inertia import Array
from geodrake.robot import Transmission


@dataclass(frozen=True, eq=False)
class OwnTransmission(Transmission):
    shape: tuple[int, int] = (1, 1)
    position: Callable[[Array], Array] = None
    derivative: Callable[[Array], Array] = None

    def joint_positions(self, q):
        return self.position(q)

    def jacobian(self, q):
        return self.derivative(q)
