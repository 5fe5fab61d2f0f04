"""Fitted models as YAML files, and the model files that they are based on."""

from __future__ import annotations

import dataclasses
import os
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, combinations
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml  # type: ignore[import-untyped]
from msgspec import to_builtins
from msgspec.structs import asdict
from numpy.typing import NDArray

from geodrake.boundary.arguments import LARGEST, file_path, instance, instances, typed
from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import open_regular, regular_file, sha256_of
from geodrake.boundary.whole_files import write_whole
from geodrake.boundary.yaml_schema import Schema, as_schema, schema_of
from geodrake.boundary.yaml_text import yaml_text
from geodrake.effects import Effect, FittedEffect, effect_class, make_effect
from geodrake.effects.column_checks import of_geodrake
from geodrake.errors import ArgumentError, GeodrakeError, ModelError, OutputError
from geodrake.model.admissible import ROUNDING, check_body, check_effect, named
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.holding import held_notes, holding
from geodrake.model.robot_model import RobotModel, load_description
from geodrake.robot.files import Given, read_description
from geodrake.robot.files.named_robots import robot_file
from geodrake.robot.joints import joint_names
from geodrake.robot.plant import load_plant, scoped_joint_names
from geodrake.robot.transmission.schema import (
    NONE,
    OF_FILE,
    Drive,
    Stated,
    drives_of,
    file_beside,
    read_transmission,
    renamed,
    stated_of,
)

T = TypeVar("T")
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # LibYAML's, if installed
FORMAT = "geodrake model 1"
_HEAD = re.compile(rb"^(?:\xef\xbb\xbf)?format: *['\"]?geodrake model\b", re.MULTILINE)
_DIGEST = re.compile(r"[0-9a-f]{64}")


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """YAML dumper that writes one key per line and lists of numbers in one line."""


_Dumper.add_representer(
    dict, lambda self, x: self.represent_mapping("tag:yaml.org,2002:map", x.items(), False)
)


class SavedEffect(Schema):
    """Schema of an effect: name, place, shape and parameters, and source of a user-defined one."""

    name: str = ""
    # Path of the Python file that defines it, relative to the saved model; empty for geodrake's.
    file: str = ""
    class_name: str = ""
    where: list[str] = []
    shape: dict[str, float] = {}
    parameters: list[float] = []
    deviations: list[float] = []


SavedEffortSignal = schema_of(EffortSignal)


class SavedModel(Schema):
    """Schema of `model.yaml`.

    Attributes:
        base_model: Path of the model file, relative to this one, so that both may move together.
        base_absolute: Absolute path of the model file at saving, in case only this file moves.
        base_sha256: Digest of the model file at saving.
        robot: Name of the chosen robot, if the model file has several.
        held: Fixed joint -> its position, rad or m.
        packages: ROS package -> its folder, relative to this file, for those given by the user.
        leading: Names of joints preferred as independent coordinates of closed loops.
        transmission: Transmission between actuators and joints, if any.
        inertial_parameters: Body -> [m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx].
        effort_signals: Signals that replace efforts in logs.
        motorless: Joints without a motor, according to logs.
        effort_noise: Joint -> RMS of the held-out residual of the fit, N·m or N.
        fading_speed: Joint -> speed below which dry friction fades, rad/s or m/s.
        fitted_to: Fingerprints of the logs that the model was fitted to.
        bandwidths: Fingerprint of a log -> bandwidths of efforts and of the motion, Hz.
        information: Information matrix of the inertial parameters, then of the effects'.
    """

    format: str = FORMAT
    base_model: str = ""
    base_absolute: str = ""
    base_sha256: str = ""
    floating: bool = False
    robot: str = ""
    held: dict[str, float] = {}
    xacro: dict[str, str] = {}
    packages: dict[str, str] = {}
    leading: list[str] = []
    transmission: Stated | None = None
    inertial_parameters: dict[str, list[float]] = {}
    effects: list[SavedEffect] = []
    effort_signals: list[SavedEffortSignal] = []  # type: ignore[valid-type]
    motorless: list[str] = []
    effort_noise: dict[str, float] = {}
    fading_speed: dict[str, float] = {}
    fitted_to: list[str] = []
    bandwidths: dict[str, tuple[float, float]] = {}
    information: list[list[float]] = []


@typed
def load_model(
    path: str | Path,
    *,
    floating: bool = False,
    extra: Sequence[type[Effect]] = (),
    lock: Mapping[str, float] | None = None,
    given: Given | None = None,
    transmission: str | Path | Sequence[Drive] | None = None,
) -> RobotModel:
    """Load a robot model: a URDF, SDF, MJCF or Drake directives file, or a saved model.

    Args:
        path: The file, or a name in robot_descriptions, such as ur5e for its URDF or xacro, or its
            MJCF if there is no other (panda_mj selects that).
        floating: Give bodies that the file does not attach to the world a floating base (a saved
            model has its own setting).
        extra: User-defined effect classes that a saved model may contain.
        lock: Joint -> position at which it is fixed, rad or m, as in `geodrake.model.holding`.
        given: Robot of several, folders of ROS packages, arguments of a xacro file (a saved model
            has its own).
        transmission: Transmission between actuators and joints (a saved model has its own): a
            file, its parts, `file` for that in the model file, or `none`. If None, the file next to
            the model file, such as arm.transmission.yaml for arm.urdf, if it exists.

    Raises:
        ModelError: The file cannot be read or does not describe a robot; the base file of a saved
            model is missing or has other joints or bodies; a joint cannot be fixed; or the
            transmission is unsuitable.
    """
    instances(extra, "extra", type)
    path, given, origin = robot_file(path, given or Given())
    path = regular_file(path, "model file", ModelError)
    if is_saved_model(path):
        if transmission is not None:
            raise ModelError(
                f"{path} is a saved model, which cannot take a transmission: it has its own, "
                "or none.",
                advice="Use --transmission with the model file.",
            )
        return holding(_read(path, extra, given), lock or {})
    drives, notes = _transmission(path, transmission, given)
    notes = [*origin, *notes]
    model = load_description(path, floating=floating, given=given, transmission=drives)
    if lock and all(drive.is_loop for drive in model.transmission):
        model = load_description(path, floating=floating, held=lock, given=given)
        return replace(model, notes=(*model.notes, *notes, *held_notes(model.held)))
    return holding(replace(model, notes=(*model.notes, *notes)), lock or {})


def _transmission(
    path: Path, given: str | Path | Sequence[Drive] | None, how: Given
) -> tuple[tuple[Drive, ...], list[str]]:
    """Return the drives of a model file, and notes on their source."""
    if given == OF_FILE:
        return _drives_of_file(path, how), []
    if given is None:
        beside = file_beside(path)
        if not beside.is_file() or beside == path:
            return (), []
        return read_transmission(beside), [
            f"The transmission is {beside.name} beside the model file; --transmission {NONE} "
            "ignores it."
        ]
    if isinstance(given, (str, Path)):
        return (() if given == NONE else read_transmission(given)), []
    return instances(given, "transmission", Drive), []


def _drives_of_file(path: Path, how: Given) -> tuple[Drive, ...]:
    """Return the drives in a model file, with the model's names of actuators and joints.

    Ambiguous actuator names get the name of their model as a prefix, as joints do.
    """
    parts = read_description(path, how).motors()
    if not parts:
        raise ModelError(
            f"{path} has no transmissions of motors.",
            advice="Write a transmission file: --transmission FILE.yaml.",
        )
    plant = load_plant(path, given=how).plant
    joints = dict(zip(scoped_joint_names(plant), joint_names(plant), strict=True))
    if how.robot is not None:  # the other robots are fixed
        parts = tuple(part for part in parts if not joints.keys().isdisjoint(part.joint_names()))
    short = {name: name.rpartition("::")[2] for part in parts for name in part.actuator_names()}
    counts = Counter(short.values())

    def actuator_of(name: str) -> str:
        return short[name] if counts[short[name]] == 1 else name.replace("::", "_")

    def joint_of(name: str) -> str:
        return joints.get(name, name.rpartition("::")[2])

    named = (renamed(part, actuator_of, joint_of) for part in parts)
    return drives_of((f"part {k} of {path}", part) for k, part in enumerate(named))


def is_saved_model(path: Path) -> bool:
    """Return whether a file was written by `save_model`, of any version."""
    try:
        with open_regular(path, "model file", ModelError) as file:
            return path.suffix in {".yaml", ".yml"} and _HEAD.search(file.read(1000)) is not None
    except ModelError:
        return False


def save_model(model: RobotModel, path: str | Path) -> None:
    """Write a model to a YAML file atomically.

    The path of the base model is relative to this file, so that both can be moved together. Loading
    also searches next to this file and at the original absolute path.
    """
    path = file_path(path)
    write_whole(path, saved_text(model, path))


def saved_text(model: RobotModel, path: str | Path) -> str:
    """Return the text that `save_model` writes."""
    base, folder = instance(model, "model", RobotModel).path.resolve(), Path(path).resolve().parent
    problem, advice = "", "Put it back."
    try:
        str(base).encode()
        problem = "" if base.is_file() else f"its file {base} is missing"
    except UnicodeEncodeError:
        problem, advice = f"the path of its file {base} is not UTF-8", "Rename it, or its folder."
    if problem:
        raise OutputError(f"Cannot save the model: {problem}.", advice=advice)
    drives = [drive for drive in model.transmission if not drive.is_loop]
    saved = SavedModel(
        base_model=os.path.relpath(base, folder),
        base_absolute=str(base),
        base_sha256=_digest(base),
        floating=model.floating,
        robot=model.given.robot or "",
        held={joint: float(value) for joint, value in model.held.items()},
        xacro=dict(model.given.xacro),
        packages={
            name: os.path.relpath(place, folder) for name, place in model.given.packages.items()
        },
        leading=list(model.given.leading),
        transmission=stated_of(drives) if drives else None,
        inertial_parameters={
            b: phi.tolist() for b, phi in zip(model.bodies, model.phi, strict=True)
        },
        effects=[_saved_effect(fitted, folder) for fitted in model.effects],
        effort_signals=[SavedEffortSignal(**dataclasses.asdict(s)) for s in model.effort_signals],
        motorless=list(model.motorless),
        effort_noise=_by_joint(model, model.effort_noise),
        fading_speed=_by_joint(model, model.fading_speed),
        fitted_to=list(model.fitted_to),
        bandwidths=dict(model.bandwidths),
        information=[] if model.information is None else model.information.tolist(),
    )
    plain = to_builtins(saved, enc_hook=lambda value: value.item())  # NumPy scalars
    stated = {name: value for name, value in plain.items() if value is not None}
    return str(yaml.dump(stated, Dumper=_Dumper, default_flow_style=None, sort_keys=False))


def _by_joint(model: RobotModel, values: NDArray[np.float64] | None) -> dict[str, float]:
    return {} if values is None else dict(zip(model.joints, values.tolist(), strict=True))


def _saved_effect(fitted: FittedEffect, folder: Path) -> SavedEffect:
    effect, kind, source = fitted.effect, type(fitted.effect), dict[str, str]()
    if not of_geodrake(kind):
        file = getattr(sys.modules.get(kind.__module__), "__file__", None)
        relative = "" if file is None else os.path.relpath(Path(file).resolve(), folder)
        file = relative if relative.isprintable() else ""
        source = {"class_name": kind.__name__, "file": file}
    return SavedEffect(
        name=effect.name,
        where=list(effect.where),
        shape={name: float(value) for name, value in effect.shape.items() if value is not None},
        parameters=fitted.parameters.tolist(),
        deviations=[] if fitted.deviations is None else fitted.deviations.tolist(),
        **source,
    )


def _read(path: Path, extra: Sequence[type[Effect]], given: Given) -> RobotModel:
    again = "Save the model again."
    try:
        saved = as_schema(yaml.load(yaml_text(path), Loader=_Loader), SavedModel)
        if saved.format.startswith("geodrake model") and not _DIGEST.fullmatch(saved.base_sha256):
            raise ArgumentError(
                f"base_sha256 = {saved.base_sha256[:80]!r} is not a SHA-256 digest."
            )
    except (ArgumentError, yaml.YAMLError, ValueError, RecursionError) as error:
        problem = error.problem if isinstance(error, ArgumentError) else f"{one_line(error)}."
        problem = f"{path} is not a geodrake model: {problem}"
        raise ModelError(problem, advice=again) from error
    if saved.format != FORMAT:
        raise ModelError(
            f"{path} has format {saved.format!r}; this version of geodrake reads {FORMAT!r}.",
            advice="Use the version that saved it, or save the model again.",
        )
    _check_effects(path, saved, extra)
    base, given = _base_of_saved(path, saved), _given_with(path, saved, given)
    how = partial(load_description, base, floating=saved.floating, held=saved.held, given=given)
    model = how()
    try:
        if saved.transmission is not None:
            model = how(transmission=drives_of(saved.transmission.parts()))
        loaded = _with_parameters(model, saved, base, extra)
        check_model(loaded)
    except GeodrakeError as error:
        raise ModelError(
            f"{path} does not match its base model {base}, or is corrupt: {error}",
            advice="Fit and save the model again.",
        ) from error
    return loaded


def _given_with(path: Path, saved: SavedModel, given: Given) -> Given:
    """Return the saved options for reading the base model, with current package folders."""
    robot, folder = saved.robot or None, path.resolve().parent
    if given.robot not in (None, robot) or given.xacro:
        what = "arguments of a xacro file" if given.xacro else f"robot {given.robot!r}"
        raise ModelError(
            f"{path} is a saved model, which cannot take {what}: it has its own.",
            advice=f"Use them with the model file {saved.base_model}.",
        )
    remembered = {name: folder / where for name, where in saved.packages.items()}
    existing = {name: where for name, where in remembered.items() if where.is_dir()}
    packages = {**existing, **given.packages}
    return Given(robot, packages, saved.xacro, given.trust_xacro, tuple(saved.leading))


def _check_effects(path: Path, saved: SavedModel, extra: Sequence[type[Effect]]) -> None:
    """Raise for effects that are neither in the catalog nor in `extra`."""
    for effect in saved.effects:
        try:
            effect_class(effect.name, extra)
        except ArgumentError as error:
            near = error.evidence.get("nearest")
            class_words = f", of the class {effect.class_name}" if effect.class_name else ""
            file = path.parent / effect.file
            how = f"Give its file, which was {file.name!r}: --effects FILE.py"
            if not effect.file:
                how = "If it is one of your own, give its file: --effects FILE.py"
            elif _is_file(file):
                how = f"Give its file: --effects {shlex.quote(os.path.relpath(file))}"
            raise ModelError(
                f"{path} has the effect {effect.name!r}{class_words}, which is unknown.",
                advice=f"{how} (from Python: load_model(path, extra=…))."
                + (f" Or was {', '.join(near)} meant?" if near and not effect.file else ""),
            ) from error


def _base_of_saved(path: Path, saved: SavedModel) -> Path:
    """Return the current path of the model file that a saved model is based on.

    Both files may have moved together or into one folder, or only the saved model moved. Of several
    files, an unchanged one, by its digest, is preferred.
    """
    folder, relative = path.resolve().parent, saved.base_model
    places = [folder / relative, folder / Path(relative).name]
    places += [Path(saved.base_absolute)] if saved.base_absolute else []
    existing = [place for place in places if _is_file(place)] or places[:1]
    alike = [p for p in existing if _digest(p) == saved.base_sha256] if existing[1:] else []
    base = [*alike, *existing][0]
    try:
        base = regular_file(base, "file", ModelError)
    except ModelError as error:
        raise ModelError(
            f"{path} is based on {relative!r}, which cannot be read. {error.problem}",
            advice="Move it back or beside the saved model, or change base_model in the saved "
            "model.",
            base=base,
        ) from error
    if is_saved_model(base):
        raise ModelError(
            f"{path} is based on {relative!r}, which is itself a saved model.",
            advice="Set base_model to the URDF, SDF, MJCF or directives file.",
        )
    return base


def _is_file(path: Path) -> bool:
    """Return whether a file exists; false for invalid names."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; "" if it cannot be read."""
    try:
        return sha256_of(path)
    except GeodrakeError:
        return ""


def _with_parameters(
    model: RobotModel, saved: SavedModel, base: Path, extra: Sequence[type[Effect]]
) -> RobotModel:
    bodies = _ordered("inertial_parameters", saved.inertial_parameters, model.bodies)
    phi = np.array([_numbers(f"inertial_parameters of {b!r}", x, 10) for b, x in bodies.items()])
    effects = tuple(_fitted_effect(model, effect, extra) for effect in saved.effects)
    p = phi.size + sum(len(f.effect.parameters) for f in effects)
    rows = [_numbers("rows of its information matrix", row, p) for row in saved.information]
    if rows and len(rows) != p:
        raise ModelError(
            f"its information matrix has {len(rows)} rows, but {p} parameters are fitted."
        )
    _check_known("motorless", saved.motorless, model.joints)
    changed = f"{base.name} has changed since the model was saved."
    return replace(
        model,
        phi=phi,
        effects=effects,
        information=np.array(rows) if rows else None,
        effort_signals=_effort_signals(model, saved.effort_signals),
        motorless=tuple(saved.motorless),
        effort_noise=_of_joints(model, "effort_noise", saved.effort_noise),
        fading_speed=_of_joints(model, "fading_speed", saved.fading_speed),
        fitted_to=tuple(saved.fitted_to),
        bandwidths=saved.bandwidths,
        notes=(
            *model.notes,
            *held_notes(model.held),
            *([] if _digest(base) == saved.base_sha256 else [changed]),
        ),
    )


def _fitted_effect(
    model: RobotModel, saved: SavedEffect, extra: Sequence[type[Effect]]
) -> FittedEffect:
    where, kind = saved.where, effect_class(saved.name, extra)
    if kind.places == "body_pair" and len(where) == 1:  # as in older files
        where = [*where, "world"]
    effect = make_effect(saved.name, where, saved.shape, extra)
    joints = (*model.joints, *model.joints_behind)
    places = model.bodies if "bod" in effect.places else joints
    places = (*places, "world") if effect.places in ("body_pair", "body_path") else places
    _check_known(f"where of {saved.name}", where, places)
    count, what = len(effect.parameters), f"of {saved.name} at {effect.place}"
    return FittedEffect(
        effect,
        _numbers(f"parameters {what}", saved.parameters, count),
        _numbers(f"deviations {what}", saved.deviations, count) if saved.deviations else None,
    )


def _effort_signals(model: RobotModel, saved: Sequence[Schema]) -> tuple[EffortSignal, ...]:
    signals = tuple(EffortSignal(**asdict(each)) for each in saved)
    joints = [signal.joint for signal in signals]
    _check_known("effort_signals", joints, model.joints)
    if twice := [joint for joint in joints if joints.count(joint) > 1]:
        raise ModelError(f"it has two signals for efforts of {twice[0]!r}.")
    return signals


def _check_known(field: str, names: Iterable[str], known: Sequence[str]) -> None:
    """Raise for a name that the robot does not have."""
    for name in names:
        if name not in known:
            what = f"{field} has {name!r}, which the robot does not have."
            raise ModelError(what, advice=f"It has {', '.join(known)}.")


def _numbers(what: str, values: Sequence[float], count: int) -> NDArray[np.float64]:
    if len(values) != count:
        raise ModelError(f"{what} are {len(values)} numbers instead of {count}.")
    return np.array(values, float)


def _of_joints(
    model: RobotModel, field: str, values: dict[str, float]
) -> NDArray[np.float64] | None:
    return np.array([*_ordered(field, values, model.joints).values()]) if values else None


def _ordered(field: str, values: dict[str, T], names: Sequence[str]) -> dict[str, T]:
    """Return the values in the order of names; raise unless there is exactly one for each."""
    _check_known(field, values, names)
    if missing := [name for name in names if name not in values]:
        what = f"{field} lacks {missing[0]!r}."
        raise ModelError(what, advice=f"It has {', '.join(names)}.")
    return {name: values[name] for name in names}


def check_model(model: RobotModel) -> None:
    """Raise for a model with invalid numbers.

    Every body needs P(φ) ⪰ 0 and a mass, parameters of effects must lie on the effect's manifold or
    its boundary, deviations and noise must not be negative, bandwidths must be positive, and the
    information matrix must be symmetric, positive semidefinite, and positive on the diagonal.
    """
    for body, phi in zip(model.bodies, model.phi, strict=True):
        check_body(f"inertial_parameters of {body!r}", phi)
    for fitted in model.effects:
        check_effect(fitted)
    for first, second in combinations(model.effects, 2):
        if first.effect == second.effect:
            raise ModelError(f"effects has {named(first)} twice.")
    for field in ("effort_noise", "fading_speed"):
        for joint, value in _by_joint(model, getattr(model, field)).items():
            if not 0.0 <= value <= LARGEST:
                what = f"{field} of {joint!r} is {value:g}"
                raise ModelError(f"{what}, which is not a number from 0 to {LARGEST:g}.")
    for bandwidth in chain.from_iterable(model.bandwidths.values()):
        if not 0.0 < bandwidth <= LARGEST:
            what = f"bandwidths have {bandwidth:g} Hz"
            raise ModelError(f"{what}, which is not a positive number up to {LARGEST:g}.")
    if model.information is not None:
        _check_information(model.information)


def _check_information(information: NDArray[np.float64]) -> None:
    size = np.abs(information).max(initial=0.0)
    if not np.isfinite(size):
        raise ModelError(f"information has an entry of {size:g}.")
    diagonal = np.diagonal(information)
    if (diagonal <= 0.0).any():
        at = int(diagonal.argmin())
        raise ModelError(
            f"information has {diagonal[at]:g} at {at}, {at}: entries on the diagonal must "
            "be positive."
        )
    # Scaled to a unit diagonal, so that units do not matter.
    scale = np.sqrt(np.maximum(diagonal, 1.0 / LARGEST))
    scaled = information / np.outer(scale, scale)
    wrong = np.abs(scaled - scaled.T)
    if wrong.max(initial=0.0) > ROUNDING:
        i, j = np.unravel_index(wrong.argmax(), wrong.shape)
        raise ModelError(
            f"information is not symmetric: {information[i, j]:g} at {i}, {j} and "
            f"{information[j, i]:g} at {j}, {i}."
        )
    least = np.linalg.eigvalsh(0.5 * (scaled + scaled.T)).min(initial=0.0)
    if least < -ROUNDING * len(scaled):
        raise ModelError(
            "information is not positive semidefinite: scaled to a unit diagonal, its "
            f"smallest eigenvalue is {least:.3g}."
        )
