"""Export of identified inertias into a copy of the user's model file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import file_path, instance
from geodrake.boundary.whole_files import write_whole
from geodrake.effects import FittedEffect, Role
from geodrake.errors import ModelError, OutputError
from geodrake.inertia import Array, change_frame, from_pseudo_inertia, is_physical, pseudo_inertia
from geodrake.inertia.bodies import LumpedBody, lumped_bodies
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.description import (
    ModelDescription,
    drake_messages,
    model_text_of,
    read_description,
)
from geodrake.robot.files.model_edits import EditedFile
from geodrake.robot.files.xacro_file import is_xacro, read_expanded
from geodrake.robot.repairs import TOLERANCE, stated_inertias

_UNCHANGED = 1e-13
"""Relative change below which a link keeps its numbers in the file."""

_NEGLIGIBLE = 1e-9  # negligible mass, as a share of the robot's

_SUFFIXES = {"urdf": (".urdf",), "sdf": (".sdf", ".world"), "xml": (".xml", ".mjcf")}
_RELATIVE = re.compile(rb"""(?:filename|file|meshdir|assetdir)\s*=\s*["'](?![\w.+-]+:|/)[^"']""")


@dataclass(frozen=True, eq=False)
class Export:
    """A model file with identified inertias.

    Attributes:
        links: Names of the changed links.
        notes: Information that the file cannot contain, and how welded links share an inertia.
    """

    content: bytes
    links: tuple[str, ...]
    notes: tuple[str, ...]


def save_export(model: RobotModel, path: str | Path) -> Export:
    """Write a copy of a model's file with the model's inertias, `total_phi`, atomically.

    Raises:
        ModelError: The model's file cannot contain them.
        OutputError: The target cannot be written, or has the suffix of another format.
    """
    path = file_path(path)
    check_export(instance(model, "model", RobotModel), path)
    export = export_model(model)
    write_whole(path, export.content)
    return export


def check_export(model: RobotModel, path: Path) -> None:
    """Raise if a model cannot be exported or the target has a wrong suffix."""
    kind = file_kind(model)
    if path.suffix.lower() not in _SUFFIXES[kind]:
        raise OutputError(
            f"Cannot write --export {path}: {model.path.name} is {_FORMATS[kind]}, and so is "
            "its copy.",
            advice=f"Name it {path.stem}{_SUFFIXES[kind][0]}.",
        )
    moving = {part.scoped_name for body in lumped_bodies(model.plant) for part in body.members}
    _check_not_included(model, read_description(model.path, model.given), moving)


def _check_not_included(model: RobotModel, description: ModelDescription, links: Set[str]) -> None:
    """Raise if links are in files that the model's file includes."""
    (text,) = description.texts
    if inside := text.included(links):
        (first, *_), files = inside, ", ".join(dict.fromkeys(map(str, inside.values())))
        raise ModelError(
            f"{model.path} includes {files}, which has {', '.join(inside)}: a copy of the first "
            f"cannot hold the inertia of {first}.",
            advice="Give the included file, or copy its contents into the model.",
        )


_FORMATS = {"urdf": "a URDF", "sdf": "an SDF", "xml": "an MJCF"}


def export_model(model: RobotModel) -> Export:
    """Return a copy of a model's file with the model's inertias; only numbers of `inertial` differ.

    Welded links are identified as one body. The heaviest link gets the remainder of the identified
    body if that is physical. Otherwise the affine map from the file's body to the identified one
    changes all of them.
    """
    exported = export_bodies(instance(model, "model", RobotModel))
    before, after = list[str](), list[str]()
    names = dict.fromkeys(f.effect.name for f in model.effects if f.effect.role is not Role.BODY)
    if names:
        before += [
            f"the exported file has inertias only, not {', '.join(names)} (its damping, "
            "friction and armature are unchanged): --save keeps everything",
            *reasons(model.effects),
        ]
    if _RELATIVE.search(exported.content):
        after.append(
            f"{model.path.name} refers to other files by relative paths, so put the exported "
            "file into the same folder"
        )
    return Export(exported.content, exported.links, (*before, *exported.notes, *after))


def export_bodies(model: RobotModel) -> Export:
    """Return the export of `export_model`, with notes on bodies only."""
    kind, data = file_kind(model), read_expanded(model.path, model.given)
    file, plant = EditedFile(data, model.path), MultibodyPlant(time_step=0.0)
    with drake_messages():
        description = read_description(model.path, model.given)
        description.add_to(plant)
    stated = stated_inertias(description, plant)
    # MuJoCo's mass settings would change the exported values: drop them and write all inertias.
    writes_all, in_file = file.drop_mass_settings(), file.links.keys()
    written: dict[str, Array] = {}
    shared, absent, negligible = [], [], _NEGLIGIBLE * float(model.total_phi[:, 0].sum())
    for body, phi in zip(lumped_bodies(model.plant), model.total_phi, strict=True):
        names = [member.scoped_name for member in body.members]
        before = np.array([stated.get(name, np.zeros(10)) for name in names])
        if kind == "urdf" and not before.any() and phi[0] < negligible:
            continue  # a frame between joints
        after, note = distributed(body, before, phi)
        changed = {
            name: new
            for name, old, new in zip(names, before, after, strict=True)
            if not np.all(np.abs(new - old) <= _UNCHANGED * np.abs(new).max())  # NaN differs
            or (writes_all and new[0] > negligible)
        }
        if not changed.keys() <= in_file:
            _check_not_included(model, description, changed.keys())
        if not changed.keys() <= in_file and kind == "xml":
            absent.append(body.name)  # between several joints of one body, or from a MuJoCo macro
            changed = {name: new for name, new in changed.items() if writes_all and name in in_file}
        written |= changed
        if note and changed:
            shared.append(note)
    file.set_inertias(written)
    file.add_comments(repair_comments(model))
    content = file.content
    _check(content, model.path, written)
    links = tuple(name.rpartition("::")[2] for name in written)
    notes = [*_body_notes(model, absent), *shared]
    if is_xacro(model.path):
        notes.append(f"the exported file is the expansion of {model.path.name}, without its macros")
    elif writes_all:
        notes.append(
            f"settings of {model.path.name} with which MuJoCo changes masses are not in the "
            "exported file, which states all inertias"
        )
    return Export(content, links, tuple(notes))


def reasons(effects: Sequence[FittedEffect]) -> list[str]:
    """Return reasons why model files cannot express effects of a drive or of part of a log."""
    active, temporary = dict[str, list[str]](), list[str]()
    for effect in (fitted.effect for fitted in effects):
        if effect.by_drive:
            active.setdefault(effect.name, []).append(effect.place)
        if effect.role is Role.EPISODE:
            temporary.append(f"{effect.name} of {effect.place}")
    why = "it is an active force of the drive"
    causes = {f"{name} of {', '.join(places)}": why for name, places in active.items()}
    causes |= dict.fromkeys(temporary, "it belongs to one log, not to the robot")
    return [f"{effects_at} is not in the files: {why}" for effects_at, why in causes.items()]


def repair_comments(model: RobotModel) -> list[str]:
    """Return comments on repairs of the original file."""
    return [f"geodrake repaired {model.path.name}: {r}" for r in model.repairs]


def distributed(body: LumpedBody, stated: Array, phi: Array) -> tuple[Array, str]:
    """Return the shares (k, 10) of an identified body's k links, and a note on several.

    Args:
        stated: (k, 10) parameters in the file, each in the link's frame, as the result.
        phi: (10,) identified parameters in the frame of the representative.
    """
    frames = [(m.X_RB.rotation().matrix(), m.X_RB.translation()) for m in body.members]
    inverse = [(R_RB.T, -R_RB.T @ p_RoBo_R) for R_RB, p_RoBo_R in frames]
    has_mass = np.isfinite(stated).all(1) & (stated[:, 0] > 0)
    after = stated.copy()
    if has_mass.sum() <= 1:
        taker = int(np.argmax(has_mass))
        after[taker] = change_frame(phi, *inverse[taker])
        return after, ""
    parts = np.array([change_frame(x, *frame) for x, frame in zip(stated, frames, strict=True)])
    parts[~has_mass] = 0.0
    taker = int(np.argmax(parts[:, 0]))
    remainder = phi - parts.sum(0) + parts[taker]
    names = [member.name for member, used in zip(body.members, has_mass, strict=True) if used]
    if is_physical(remainder, tolerance=TOLERANCE):
        parts[taker] = remainder
        others = [name for name in names if name != body.members[taker].name]
        note = (
            f"{', '.join(others)}: unchanged, as welded to {body.members[taker].name}, which "
            "takes the change of both"
        )
    else:
        parts = _mapped_bodies(parts, phi)
        note = f"{', '.join(names)}: welded together; all change alike to form the identified body"
    for k in np.flatnonzero(has_mass):
        after[k] = change_frame(parts[k], *inverse[k])
    return after, note


def _mapped_bodies(parts: Array, phi: Array) -> Array:
    """Map bodies (k, 10) by P ↦ A P Aᵀ, with the triangular A that maps their sum to φ.

    This keeps physical bodies physical. Bodies whose sum has no volume share φ by mass instead.
    """
    total = parts.sum(0)
    if not is_physical(total, tolerance=TOLERANCE):
        return np.asarray(parts[:, :1] / total[0] * phi)
    A = _upper_root(phi) @ np.linalg.inv(_upper_root(total))
    return from_pseudo_inertia(A @ pseudo_inertia(parts) @ A.T)


def _upper_root(phi: Array) -> Array:
    """Return the upper triangular U with P(φ) = U Uᵀ, an affine map of [x; 1]."""
    return np.asarray(np.linalg.cholesky(pseudo_inertia(phi)[::-1, ::-1])[::-1, ::-1])


def _check(content: bytes, path: Path, written: Mapping[str, Array]) -> None:
    """Raise unless the inertias read back from the edited file, as edits may miss some XML."""
    text = model_text_of(content, path)
    for name, phi in written.items():
        read = text.stated_inertia(name)
        size = np.abs(phi).max()
        if read is None or not np.allclose(read, phi, rtol=1e-9, atol=1e-12 * size):
            raise ModelError(
                f"The inertia of {name.rpartition('::')[2]} cannot be changed in {path}, as "
                "geodrake does not understand how it is written.",
                advice="Expand entities and includes in the file first.",
            )


def _body_notes(model: RobotModel, absent: Sequence[str]) -> list[str]:
    """Return notes on payloads, and on bodies missing in the file."""
    notes = []
    carried = [f.effect.where[0] for f in model.effects if f.effect.role is Role.BODY]
    if carried:
        notes.append(f"the payload is part of {', '.join(carried)} in the exported file")
    if absent:
        notes.append(
            f"the exported file cannot hold the inertias of {', '.join(absent)}: they are "
            "between several joints of one body, or in copies or models that MuJoCo inserts"
        )
    return notes


def file_kind(model: RobotModel) -> str:
    """Return the format of a model's file: urdf, sdf, or xml for MJCF."""
    if model.path.suffix.lower() in (".yaml", ".yml"):
        raise ModelError(
            f"{model.path} combines several model files, so there is no single file to write "
            "inertias to.",
            advice="Save the model with --save instead.",
        )
    return read_description(model.path, model.given).texts[0].kind
