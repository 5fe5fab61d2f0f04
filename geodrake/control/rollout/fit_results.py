"""What a fit of rollouts finds."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.showing import Short, Shown
from geodrake.control.rollout.results import Rollout
from geodrake.model.effort_signal import COMMAND, SERVO
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True)
class FittedValue(Short):
    """A value of an effect, or of a servo, that rollouts were fitted by.

    Attributes:
        effect: Name of the effect; "servo".
        name: Name of the value; of a servo as in `EffortSignal`.
        before: The model's value, where the fit began, SI.
        deviation: Its standard deviation, for what else the model has.
    """

    effect: str
    joint: str
    name: str
    before: float
    after: float
    deviation: float


@dataclass(frozen=True, eq=False)
class RolloutFit(Shown):
    """What a model's soft joints, their play, servos and motors are by its simulated motion.

    `before` and `after` say what they are under: logged efforts, or logged commands.

    Attributes:
        model: The model with what was fitted, or as it was if that was not taken.
        before: The rollout of the model as it was, over all windows.
        after: That with what was fitted, taken or not.
        tested: Which windows the fit did not see.
        chance: Chance that it is truly no better in those.
        taken: Whether it predicts those better, by more than chance.
    """

    model: RobotModel
    values: tuple[FittedValue, ...]
    before: Rollout
    after: Rollout
    tested: tuple[bool, ...]
    chance: float
    taken: bool

    @property
    def held_out(self) -> tuple[Rollout, Rollout]:
        """Before and after, over the windows that the fit did not see."""
        return self.before.part(self.tested), self.after.part(self.tested)

    @property
    def fitted(self) -> tuple[Rollout, Rollout]:
        """Before and after, over the windows that it saw."""
        seen = [not tested for tested in self.tested]
        return self.before.part(seen), self.after.part(seen)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the logs, noticed about the model, and assumed in the simulation."""
        return (*self.after.notes, *self._unsure_servos())

    def _unsure_servos(self) -> list[str]:
        """A note on servos of other joints, which are taken for what they were found to be."""
        fitted = {value.joint for value in self.values if value.effect == SERVO}
        unsure = [
            signal.joint
            for signal in self.model.effort_signals
            if signal.kind == COMMAND
            and (signal.deviation or signal.damping_deviation or signal.integral_deviation)
            and signal.joint not in fitted
        ]
        if not (unsure and self.after.commands):
            return []
        words = "soft joints and play make up for what they are off by"
        return [f"servos of {', '.join(unsure)} are not known exactly: {words}"]
