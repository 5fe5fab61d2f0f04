"""What moves and what resists the joints of a robot whose servos follow commands, by its motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from geodrake.effects import FittedEffect
from geodrake.effects.base import JointEffect
from geodrake.identification.logs.servo_fit import PARAMETERS, ServoFit, motions_of
from geodrake.identification.logs.signal_calibration import (
    servo_by_motion,
    sharp_trajectories,
    signal_by_motion,
    signals_as_efforts,
)
from geodrake.logs.motion import JointLog
from geodrake.logs.preparation import prepare_logs
from geodrake.model.effort_signal import COMMAND, EFFORT
from geodrake.model.file_terms import Damping, DryFriction, LoadFriction, Offset, Rotor
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import servos_of

BESIDE: Mapping[str, type[JointEffect]] = {
    "damping": Damping,
    "coulomb": DryFriction,
    "armature": Rotor,
    "offset": Offset,
    "load": LoadFriction,
}
"""Parameters of a `ServoFit` that are effects of the joint."""


def with_servo_motions(
    model: RobotModel, logs: Sequence[JointLog]
) -> tuple[RobotModel, dict[str, ServoFit]]:
    """Return the model with servos and friction by which its joints move as in logs.

    Each joint with a servo is simulated alone, under its commands; see `fit_servo`. Its friction,
    rotor inertia and offset are those of the simulation; joints that are simulated no better stay
    as they are. How well a stiffness is known stays the share of it that it was.

    Args:
        model: The model, which knows its servos.
        logs: Logs with commands, their joints in the model's order.

    Returns:
        The model, and what was found by the joint.
    """
    servos = servos_of(model)
    kinds = [EFFORT if servo is None else COMMAND for servo in servos]
    known = signals_as_efforts(logs, kinds)
    sharp = sharp_trajectories(known, prepare_logs(known))
    moved = [j for j, servo in enumerate(servos) if servo is not None]
    signals = {signal.joint: signal for signal in model.effort_signals}
    fits = dict[str, ServoFit]()
    for j, motions in motions_of(replace(model, effects=()), logs, sharp, moved).items():
        joint = model.joints[j]
        signal = signals[joint]
        fit = servo_by_motion(model, logs, motions, signal)
        if fit is not None:
            fits[joint] = fit
            deviation = signal.uncertainty * fit.parameters[0]
            signals[joint] = replace(signal_by_motion(signal, fit), deviation=deviation)
    kept = [f for f in model.effects if not (isinstance(f.effect, _KINDS) and _at(f) in fits)]
    found = [effect for joint, fit in fits.items() for effect in _beside(joint, fit)]
    effects = (*kept, *found)
    return replace(model, effects=effects, effort_signals=tuple(signals.values())), fits


_KINDS = tuple(BESIDE.values())


def _at(fitted: FittedEffect) -> str:
    return fitted.effect.where[0]


def _beside(joint: str, fit: ServoFit) -> list[FittedEffect]:
    """Return the effects of a joint beside its servo that are not zero."""
    found = []
    for name, kind in BESIDE.items():
        at = PARAMETERS.index(name)
        value, deviation = float(fit.parameters[at]), float(fit.deviations[at])
        if value:
            effect = kind.shaped(joint)[0]
            found.append(FittedEffect(effect, np.array([value]), np.array([deviation])))
    return found
