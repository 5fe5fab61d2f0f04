"""What known payloads are to a model: bodies that it has while a log lasts, and no longer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.bodies import LumpedBody, lumped_bodies
from geodrake.effects import Payload
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError
from geodrake.inertia import change_frame
from geodrake.known_payload import KnownPayload
from geodrake.model import FittedEffect, RobotModel
from geodrake.motion import JointLog

Array = NDArray[np.float64]
Payloads = tuple[KnownPayload, ...]


def held_phi(model: RobotModel, payloads: Payloads) -> Array:
    """(nb, 10) inertial parameters that known payloads add to the bodies of a model.

    Raises:
        ArgumentError: The model has no such body, or it does not move.
    """
    phi = np.zeros_like(model.phi)
    for payload in payloads:
        index, own = _in_frame_of_body(lumped_bodies(model.plant), payload)
        phi[index] += own
    return phi


def holding(model: RobotModel, payloads: Payloads) -> RobotModel:
    """The model of the robot while it holds known payloads; itself if there are none."""
    phi = held_phi(model, payloads)
    held = [
        FittedEffect(Payload(body), own)
        for body, own in zip(model.bodies, phi, strict=True)
        if own.any()
    ]
    return replace(model, effects=(*model.effects, *held)) if held else model


def joints_told(model: RobotModel, logs: Sequence[Payloads]) -> tuple[str, ...]:
    """Joints whose gain known payloads tell: those that bear what not all logs have alike.

    What the robot holds in all of them its bodies can take in, with any gain.

    Args:
        model: The model.
        logs: Known payloads of every log.
    """
    phi = np.array([held_phi(model, payloads) for payloads in logs])
    changes = np.any(phi != phi[0], axis=(0, 2))
    bodies = RobotBodies(model.tree, np.zeros((1, model.plant.num_positions())), model.total_phi)
    names = [body for body, changed in zip(model.bodies, changes, strict=True) if changed]
    told = {dof for name in names for dof in bodies.motion(name).dofs}
    return tuple(joint for at, joint in enumerate(model.joints) if at in told)


def payload_notes(model: RobotModel, logs: Sequence[JointLog]) -> list[str]:
    """What is done about known payloads, in words.

    Raises:
        ArgumentError: The model has no such body, or it does not move.
    """
    notes = [
        f"{log.name}: the effort of {payload.mass:g} kg known at {payload.body} is taken off the "
        "measured one"
        for log in logs
        for payload in log.payloads
    ]
    told = joints_told(model, [log.payloads for log in logs]) if notes else ()
    if notes and not told and model.information is None:
        notes.append(
            "known payloads tell no gain of efforts, as all logs have the same: the bodies could "
            "take it in; give a log without them too"
        )
    return notes


def _in_frame_of_body(bodies: Sequence[LumpedBody], payload: KnownPayload) -> tuple[int, Array]:
    """Index of the body that a payload's link belongs to, and its parameters (10,) there."""
    for index, body in enumerate(bodies):
        for member in body.members:
            if member.name == payload.body:
                X = member.X_RB
                return index, change_frame(payload.phi, X.rotation().matrix(), X.translation())
    names = [member.name for body in bodies for member in body.members]
    raise ArgumentError(
        f"The model has no body {payload.body!r} that moves, to hold a known payload of "
        f"{payload.mass:g} kg.",
        advice=f"Bodies are: {', '.join(names)}.",
    )
