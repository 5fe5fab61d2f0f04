"""Known payloads as temporary bodies of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.effects import FittedEffect, Role
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.lookup import effect_of
from geodrake.errors import ArgumentError, nearest
from geodrake.inertia import Array, change_frame
from geodrake.inertia.bodies import LumpedBody, lumped_bodies
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.ground_contacts import contact_frames
from geodrake.model.robot_model import RobotModel

Payloads = tuple[KnownPayload, ...]


def carried_phi(model: RobotModel, payloads: Payloads) -> Array:
    """Return (nb, 10) inertial parameters that known payloads add to the bodies of a model."""
    phi = np.zeros_like(model.phi)
    for payload in payloads:
        index, parameters = _in_frame_of_body(lumped_bodies(model.plant), payload)
        phi[index] += parameters
    return phi


def carrying(model: RobotModel, payloads: Payloads) -> RobotModel:
    """Return the model with known payloads."""
    phi = carried_phi(model, payloads)
    carried = [
        FittedEffect(payload, parameters)
        for body, parameters in zip(model.bodies, phi, strict=True)
        if parameters.any()
        for payload in effect_of(Role.BODY).shaped(body)
    ]
    return replace(model, effects=(*model.effects, *carried)) if carried else model


def joints_with_known_gain(
    model: RobotModel, logs: Sequence[Payloads], frames: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return joints whose gain is identifiable from known payloads or ground forces.

    Payloads must differ between logs: the bodies could absorb one that all logs share, at any gain.
    Where `frames` may touch the ground, forces there load the joints up to the base. These forces
    are measured, or follow from the motion of the base and the other joints, independently of the
    bodies of the limb.
    """
    phi = np.array([carried_phi(model, payloads) for payloads in logs])
    changes = np.any(phi != phi[0], axis=(0, 2))
    names = [body for body, changed in zip(model.bodies, changes, strict=True) if changed]
    known = {*_joints_of(model, names), *joints_on_ground(model, frames)}
    return tuple(joint for joint in model.joints if joint in known)


def joints_on_ground(model: RobotModel, frames: Sequence[str]) -> tuple[str, ...]:
    """Return joints loaded by ground forces at frames, including those of a free base."""
    return _joints_of(model, [frame.body for frame in contact_frames(model, frames)])


def _joints_of(model: RobotModel, bodies: Sequence[str]) -> tuple[str, ...]:
    """Return the joints that move some bodies."""
    motions = RobotBodies(model.tree, np.zeros((1, model.tree.num_positions)), model.total_phi)
    moving = {dof for body in bodies for dof in motions.motion(body).dofs}
    return tuple(joint for dof, joint in enumerate(model.joints) if dof in moving)


def payload_notes(model: RobotModel, logs: Sequence[JointLog]) -> list[str]:
    """Return notes on known payloads."""
    notes = [
        f"{log.name}: the effort of the known payload of {payload.mass:g} kg at "
        f"{payload.body} is subtracted from the measured one"
        for log in logs
        for payload in log.payloads
    ]
    known = joints_with_known_gain(model, [log.payloads for log in logs]) if notes else ()
    if notes and not known and model.information is None:
        notes.append(
            "known payloads do not identify effort gains, as all logs have the same and the "
            "bodies could compensate; add a log without them"
        )
    return notes


def _in_frame_of_body(bodies: Sequence[LumpedBody], payload: KnownPayload) -> tuple[int, Array]:
    """Return the index of the body of a payload's link, and its parameters (10,) there."""
    for index, body in enumerate(bodies):
        for member in body.members:
            if member.name == payload.body:
                X = member.X_RB
                return index, change_frame(payload.phi, X.rotation().matrix(), X.translation())
    names = [member.name for body in bodies for member in body.members]
    raise ArgumentError(
        f"The model has no moving body {payload.body!r} to carry the known payload of "
        f"{payload.mass:g} kg.",
        advice=f"{nearest(payload.body, names)}Bodies are {', '.join(names)}.",
    )
