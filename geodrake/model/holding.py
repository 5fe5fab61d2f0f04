"""Models with fixed joints, whose child bodies become part of their parents.

A fixed joint merges its bodies, φ = φ_P + X φ_B, with X the change of frame from B to P at the
fixed position. The information Λ on the old parameters x yields the information on the new ones
y = A x as a Schur complement of Λ: the minimum of xᵀ Λ x subject to A x = y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from geodrake.boundary.arguments import number, typed
from geodrake.effects import FittedEffect, Role
from geodrake.effects.lookup import effect_of
from geodrake.errors import ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.inertia.kernels import calc_change_frame
from geodrake.model.robot_model import RobotModel, from_loaded_plant, is_of_file
from geodrake.robot.plant import load_plant
from geodrake.robot.transmission.schema import Drive


@typed
def holding(
    model: RobotModel, held: Mapping[str, float], *, why: str = "so that they do not move"
) -> RobotModel:
    """Return the model with joints fixed and removed from its joints.

    Inertias and payloads of their child bodies are added to the parents. Other effects at these
    joints and bodies are removed, with a note.

    Args:
        held: Joint -> position at which it is fixed, rad or m. To fix a joint elsewhere later, load
            the model file again.

    Raises:
        ModelError: A joint does not exist or cannot have its position, or no joint remains.
    """
    held = {joint: number(value, f"held[{joint!r}]") for joint, value in held.items()}
    _check_names(model, held)
    if not held:
        return model
    places, drives = _fixed_plant_joints(model, held)
    loaded = load_plant(
        model.path, floating=model.floating, held={**model.held, **places}, given=model.given
    )
    bare = replace(
        model,
        plant=loaded.plant,
        held=loaded.held,
        followers=loaded.followers,
        thin=loaded.thin,
        transmission=(*drives, *(Drive.of_loop(loop) for loop in loaded.loops if loop.actuators)),
    )
    matrix, carriers = _merged_bodies(model, bare)
    kept, lost = _effects_after(model, bare, matrix, carriers)
    if lost and model.information is None and is_of_file(model):
        stated = from_loaded_plant(loaded, floating=model.floating, transmission=drives).effects
        kept, lost = [(fitted, np.zeros((0, 0))) for fitted in stated], []
    after = replace(
        bare,
        phi=(matrix @ model.phi.ravel()).reshape(-1, PARAMETERS_PER_BODY),
        effects=tuple(fitted for fitted, _ in kept),
    )
    names = ", ".join(f"{fitted.effect.name} of {fitted.effect.place}" for fitted in lost)
    more = [f"Not used, as a joint or body that they act on is fixed: {names}."] if names else []
    information = model.information
    if information is not None:
        below = [np.zeros((0, len(information) - model.phi.size)), *(rows for _, rows in kept)]
        information = schur_complement(information, block_diag(matrix, np.concatenate(below)))
    order = [model.joints.index(joint) for joint in after.joints]
    noise, fading = model.effort_noise, model.fading_speed
    return replace(
        after,
        information=information,
        effort_noise=None if noise is None else noise[order],
        fading_speed=None if fading is None else fading[order],
        effort_signals=tuple(s for s in model.effort_signals if s.joint in after.joints),
        motorless=tuple(joint for joint in model.motorless if joint in after.joints),
        notes=(*model.notes, *held_notes(held, why), *more),
    )


def held_notes(held: Mapping[str, float], why: str = "so that they do not move") -> list[str]:
    """Return a note on fixed joints and their positions (rad or m)."""
    words = ", ".join(f"{joint} at {value:.4g}" for joint, value in held.items())
    return [f"Fixed, {why}: {words}."] if words else []


def why_no_place(model: RobotModel, name: str) -> str:
    """Return why the model lacks a joint or link of the file, or ""."""
    if name in model.held:
        return f"{name} is fixed by --lock, or because it hardly moves (--no-auto-lock keeps it). "
    for body in lumped_bodies(model.plant):
        if name in [member.name for member in body.members]:
            return f"{name} is part of {body.name}, as nothing moves between them. "
    return ""


def _check_names(model: RobotModel, held: Mapping[str, float]) -> None:
    for joint in held:
        if joint in model.held:
            raise ModelError(
                f"Joint {joint!r} is already fixed at {model.held[joint]:g}.",
                advice="Load the model file again to fix it elsewhere.",
            )
        for drive in model.transmission:
            if joint in drive.joints and joint in model.joints_behind:
                raise ModelError(
                    f"Joint {joint!r} cannot be fixed, as it follows {', '.join(drive.actuators)}.",
                    advice=f"Fix {', '.join(drive.actuators)}.",
                )


def _fixed_plant_joints(
    model: RobotModel, held: Mapping[str, float]
) -> tuple[dict[str, float], tuple[Drive, ...]]:
    """Return positions of the plant's joints for fixed model joints, and the remaining drives."""
    places, remaining = dict(held), []
    for drive in model.transmission:
        fixed = [name for name in drive.actuators if name in held]
        if drive.is_loop:  # recreated from the plant
            continue
        if not fixed:
            remaining.append(drive)
            continue
        if free := [name for name in drive.actuators if name not in held]:
            raise ModelError(
                f"Actuator {fixed[0]!r} cannot be fixed without {', '.join(free)}: they move "
                f"{', '.join(drive.joints)} together.",
                advice="Fix all of them, or none.",
            )
        q = np.array([[places.pop(name) for name in drive.actuators]])
        positions = drive.map.joint_positions(q)[0].tolist()
        places |= dict(zip(drive.joints, positions, strict=True))
    return places, tuple(remaining)


def _merged_bodies(before: RobotModel, after: RobotModel) -> tuple[Array, dict[str, int]]:
    """Return how bodies of a model are merged by fixed joints.

    Returns:
        (10 nb', 10 nb) matrix from old to new inertial parameters; and old body -> index of the new
        body that contains it, or −1 if it no longer moves.
    """
    old, new = lumped_bodies(before.plant), lumped_bodies(after.plant)
    places = {
        int(member.index): (k, member.X_RB) for k, body in enumerate(new) for member in body.members
    }
    matrix = np.zeros((len(new), PARAMETERS_PER_BODY, len(old), PARAMETERS_PER_BODY))
    carriers = {}
    for k, body in enumerate(old):
        carrier, X_RB = places.get(int(body.body_index), (-1, None))
        carriers[body.name] = carrier
        if X_RB is not None:
            unit = np.eye(PARAMETERS_PER_BODY)
            changed = calc_change_frame(unit, X_RB.rotation().matrix(), X_RB.translation())
            matrix[carrier, :, k] = changed.T
    return matrix.reshape(matrix[:, :, 0, 0].size, -1), carriers


def _effects_after(
    before: RobotModel, after: RobotModel, matrix: Array, carriers: Mapping[str, int]
) -> tuple[list[tuple[FittedEffect, Array]], list[FittedEffect]]:
    """Return the effects of the model with fixed joints, and those that are lost.

    Each kept effect has a matrix from all old parameters of effects to its own.
    """
    blocks = matrix.reshape(-1, PARAMETERS_PER_BODY, len(before.bodies), PARAMETERS_PER_BODY)
    units = np.eye(sum(len(fitted.parameters) for fitted in before.effects))
    mu = np.concatenate([np.zeros(0), *(fitted.parameters for fitted in before.effects)])
    kept: list[tuple[FittedEffect, Array]] = []
    lost, payloads, start = list[FittedEffect](), dict[int, Array](), 0
    for fitted in before.effects:
        effect, size = fitted.effect, len(fitted.parameters)
        rows, start = units[start : start + size], start + size
        if effect.role is Role.BODY:
            carrier, old = carriers[effect.where[0]], before.bodies.index(effect.where[0])
            if carrier >= 0:
                payloads[carrier] = payloads.get(carrier, 0.0) + blocks[carrier, :, old] @ rows
            continue
        at_bodies = "bod" in effect.places
        joints = (*after.joints, *after.joints_behind)
        places = (*after.bodies, "world") if at_bodies else joints
        if set(places).issuperset(effect.where):
            kept.append((fitted, rows))
        elif at_bodies or not set(after.held).issuperset(effect.where):
            lost.append(fitted)
    for carrier, rows in sorted(payloads.items()):
        (effect,) = effect_of(Role.BODY).shaped(after.bodies[carrier])
        kept.append((FittedEffect(effect, rows @ mu), rows))
    return kept, lost


def schur_complement(information: Array, A: Array) -> Array:
    """Return the information (q, q) on y = A x, A (q, p) of rank q, from Λ (p, p) ⪰ 0 on x."""
    size = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    scale = np.divide(1.0, size, out=np.ones_like(size), where=size > 0.0)  # parameters have units
    information = scale[:, None] * information * scale
    basis, triangle = np.linalg.qr((A * scale).T, mode="complete")
    along = basis[:, : len(A)] @ np.linalg.inv(triangle[: len(A)]).T  # x = along y + across z
    across = basis[:, len(A) :]
    mixed, free = across.T @ information @ along, across.T @ information @ across
    result = along.T @ information @ along - mixed.T @ np.linalg.pinv(free, hermitian=True) @ mixed
    return np.asarray(0.5 * (result + result.T))
