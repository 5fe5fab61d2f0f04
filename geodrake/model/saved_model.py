"""Fitted models as YAML files, read and written through Drake's `yaml_load_typed`."""

# Drake reads the schema from the annotations themselves, so they must not be strings here.
import dataclasses as dc
import os
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional, TypeVar

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from pydrake.common.yaml import yaml_dump, yaml_dump_typed, yaml_load, yaml_load_typed

from geodrake.boundary.arguments import file_path, instance, instances, typed
from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import open_regular, regular_file
from geodrake.boundary.whole_files import write_whole
from geodrake.boundary.yaml_text import yaml_text
from geodrake.effects import Effect, FittedEffect, effect_class, make_effect
from geodrake.effects.column_checks import of_geodrake
from geodrake.errors import ArgumentError, GeodrakeError, ModelError
from geodrake.model.admissible import check_model
from geodrake.model.base_file import digest, existing_base, find_base, is_file
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.holding import held_notes, holding
from geodrake.model.robot_model import RobotModel, load_description
from geodrake.model.transmission_file import (
    NONE,
    OF_FILE,
    drives_of,
    file_beside,
    read_transmission,
    stated_of,
)
from geodrake.robot.files import Given, read_description
from geodrake.robot.transmission.drive import Drive
from geodrake.robot.transmission.statements import Stated

T = TypeVar("T")
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # those of LibYAML, where it is
_Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_INFORMATION = "information:"
FORMAT = "geodrake model 1"
_HEAD = re.compile(rb"^(?:\xef\xbb\xbf)?format: *['\"]?geodrake model\b", re.MULTILINE)
_DIGEST = re.compile(r"[0-9a-f]{64}")


@dataclass
class SavedEffect:
    """One effect: its name, place, shape and parameters; one of the user's own, its file and class.

    Attributes:
        file: Path of the Python file that defines it, relative to this one; empty for geodrake's.
        class_name: Its class there.
    """

    name: str = ""
    file: str = ""
    class_name: str = ""
    where: list[str] = dc.field(default_factory=list)
    shape: dict[str, float] = dc.field(default_factory=dict)
    parameters: list[float] = dc.field(default_factory=list)
    deviations: list[float] = dc.field(default_factory=list)


@dataclass
class SavedEffortSignal:
    """What stands for the efforts of a joint; see `EffortSignal`."""

    joint: str = ""
    kind: str = ""
    gain: float = 1.0
    deviation: float = 0.0
    damping: float = 0.0
    damping_deviation: float = 0.0
    delay: float = 0.0
    limit: float = float("inf")
    integral: float = 0.0
    integral_deviation: float = 0.0
    no_load_speed: float = float("inf")


@dataclass
class SavedModel:
    """Schema of `model.yaml`.

    Attributes:
        format: Name and version of the format.
        base_model: Path of the model file, relative to this one, so that both may move together.
        base_absolute: Its absolute path when the model was saved, if only this file has moved.
        base_sha256: Digest of the model file when the model was saved.
        floating: Whether free roots float.
        robot: Name of the robot, where the model file has several and one was chosen.
        held: Joint that is held -> where, rad or m.
        xacro: Arguments of a xacro file.
        packages: Package of ROS -> its folder, relative to this file, for those that were given.
        leading: Names of joints that are free in closed loops, before those that motors drive.
        transmission: What moves joints in their place, if anything does.
        inertial_parameters: Body -> [m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx].
        effects: The effects.
        information: Information matrix of the inertial parameters, then of the effects'.
        effort_signals: What stands for efforts in logs, where these are not measured.
        effort_noise: Joint -> held-out RMS that the fit left, N·m or N.
        fading_speed: Joint -> speed below which dry friction fades, rad/s or m/s.
        fitted_to: Fingerprints of the logs that the model was fitted to.
        bandwidths: Fingerprint of each of them -> bandwidths of efforts and of the motion, Hz.
    """

    format: str = FORMAT
    base_model: str = ""
    base_absolute: str = ""
    base_sha256: str = ""
    floating: bool = False
    robot: str = ""
    held: dict[str, float] = dc.field(default_factory=dict)
    xacro: dict[str, str] = dc.field(default_factory=dict)
    packages: dict[str, str] = dc.field(default_factory=dict)
    leading: list[str] = dc.field(default_factory=list)
    transmission: Optional[Stated] = None  # noqa: UP045 - Drake reads no other spelling
    inertial_parameters: dict[str, list[float]] = dc.field(default_factory=dict)
    effects: list[SavedEffect] = dc.field(default_factory=list)
    effort_signals: list[SavedEffortSignal] = dc.field(default_factory=list)
    effort_noise: dict[str, float] = dc.field(default_factory=dict)
    fading_speed: dict[str, float] = dc.field(default_factory=dict)
    fitted_to: list[str] = dc.field(default_factory=list)
    bandwidths: dict[str, list[float]] = dc.field(default_factory=dict)
    information: list[list[float]] = dc.field(default_factory=list)


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
        path: The file.
        floating: Leave roots free that the file does not attach to the world (a saved model
            remembers).
        extra: Effect classes of the user's own that a saved model may name.
        lock: Joint -> where it is held, rad or m, as in `geodrake.model.holding`.
        given: Which of several robots, folders of ROS packages, arguments of a xacro file (a saved
            model remembers).
        transmission: What moves joints in their place (a saved model remembers): a transmission
            file, its parts, `file` for what the model file itself states of motors, or `none`. If
            None, the file beside the model file, arm.transmission.yaml beside arm.urdf, if there is
            one.

    Raises:
        ModelError: The file cannot be read or does not describe a robot; the file that a saved
            model is based on is gone or has other joints or bodies; a joint cannot be held; or the
            transmission does not fit.
    """
    instances(extra, "extra", type)
    given = given or Given()
    path = regular_file(file_path(path), "model file", ModelError)
    if is_saved_model(path):
        if transmission is not None:
            raise ModelError(
                f"{path} is a saved model, which cannot take a transmission: it was made with its "
                "own, or with none.",
                advice="Give it with the model file.",
                path=path,
            )
        return holding(_read(path, extra, given), lock or {})
    drives, notes = _transmission(path, transmission, given)
    model = load_description(path, floating=floating, given=given, transmission=drives)
    if lock and all(drive.is_loop for drive in model.transmission):
        model = load_description(path, floating=floating, held=lock, given=given)
        return replace(model, notes=(*model.notes, *notes, *held_notes(model.held)))
    return holding(replace(model, notes=(*model.notes, *notes)), lock or {})


def _transmission(
    path: Path, given: str | Path | Sequence[Drive] | None, how: Given
) -> tuple[tuple[Drive, ...], list[str]]:
    """Return the drives that a model file is to have, and notes on where they come from."""
    if given == OF_FILE:
        parts = read_description(path, how).motors()
        if not parts:
            raise ModelError(
                f"{path} states no transmissions of motors.",
                advice="Write a transmission file: --transmission FILE.yaml.",
                path=path,
            )
        return drives_of([(f"part {k} of {path}", part) for k, part in enumerate(parts)]), []
    if given is None:
        beside = file_beside(path)
        if not beside.is_file() or beside == path:
            return (), []
        return read_transmission(beside), [
            f"The transmission is that of {beside.name} beside the model file; --transmission "
            f"{NONE} leaves it out."
        ]
    if isinstance(given, (str, Path)):
        return (() if given == NONE else read_transmission(given)), []
    return instances(given, "transmission", Drive), []


def is_saved_model(path: Path) -> bool:
    """Return whether a file is one that `save_model` wrote, of whatever version."""
    try:
        with open_regular(path, "model file", ModelError) as file:
            return path.suffix in {".yaml", ".yml"} and _HEAD.search(file.read(1000)) is not None
    except ModelError:
        return False


def save_model(model: RobotModel, path: str | Path) -> None:
    """Write a model; the file appears whole or not at all.

    Args:
        model: The model.
        path: Target, a YAML file. The base model's path is written relative to it, so that both can
            be moved together; it is also looked for beside it, and where it was.

    Raises:
        OutputError: The target cannot be written.
    """
    path = file_path(path)
    write_whole(path, saved_text(model, path))


def saved_text(model: RobotModel, path: str | Path) -> str:
    """Return what `save_model` writes.

    Args:
        model: The model.
        path: Where it is to be written; the model file is named from there.

    Raises:
        OutputError: The model file is gone, or its path is none that YAML can hold.
    """
    base = existing_base(instance(model, "model", RobotModel).path)
    folder = Path(path).resolve().parent
    own = [drive for drive in model.transmission if not drive.is_loop]
    saved = SavedModel(
        base_model=os.path.relpath(base, folder),
        base_absolute=str(base),
        base_sha256=digest(base),
        floating=model.floating,
        robot=model.given.robot or "",
        held={joint: float(value) for joint, value in model.held.items()},
        xacro=dict(model.given.xacro),
        packages={
            name: os.path.relpath(place, folder) for name, place in model.given.packages.items()
        },
        leading=list(model.given.leading),
        transmission=stated_of(own) if own else None,
        inertial_parameters={
            b: phi.tolist() for b, phi in zip(model.bodies, model.phi, strict=True)
        },
        effects=[_saved_effect(fitted, folder) for fitted in model.effects],
        effort_signals=[SavedEffortSignal(**dc.asdict(each)) for each in model.effort_signals],
        effort_noise=_by_joint(model, model.effort_noise),
        fading_speed=_by_joint(model, model.fading_speed),
        fitted_to=list(model.fitted_to),
        bandwidths={log: list(both) for log, both in model.bandwidths.items()},
    )
    text = str(yaml_dump_typed(saved, schema=SavedModel))
    if model.information is None:
        return text
    rows = yaml.dump(model.information.tolist(), Dumper=_Dumper, default_flow_style=None)
    return text.removesuffix(f"{_INFORMATION} []\n") + f"{_INFORMATION}\n{rows}"


def _by_joint(model: RobotModel, values: NDArray[np.float64] | None) -> dict[str, float]:
    return {} if values is None else dict(zip(model.joints, values.tolist(), strict=True))


def _saved_effect(fitted: FittedEffect, folder: Path) -> SavedEffect:
    effect, kind = fitted.effect, type(fitted.effect)
    own = {} if of_geodrake(kind) else {"class_name": kind.__name__, "file": _file_of(kind, folder)}
    shape = {name: float(value) for name, value in effect.shape.items() if value is not None}
    deviations = [] if fitted.deviations is None else fitted.deviations.tolist()
    return SavedEffect(
        name=effect.name,
        where=list(effect.where),
        shape=shape,
        parameters=fitted.parameters.tolist(),
        deviations=deviations,
        **own,
    )


def _file_of(kind: type[Effect], folder: Path) -> str:
    """Path of the file that defines a class, from a folder; nothing if that cannot be told."""
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    relative = "" if file is None else os.path.relpath(Path(file).resolve(), folder)
    return relative if relative.isprintable() else ""


def _read(path: Path, extra: Sequence[type[Effect]], given: Given) -> RobotModel:
    text = yaml_text(path)
    try:
        saved = _fields(text)
    except Exception as error:  # Drake raises RuntimeError and others, depending on the fault
        field = _odd_field(text)
        what = f"{path} is no geodrake model" + (f", by its field {field!r}" if field else "")
        raise ModelError(
            f"{what}: {one_line(error)}.", advice="Save the model again.", path=path
        ) from error
    if saved.format != FORMAT:
        raise ModelError(
            f"{path} has the format {saved.format!r}; this version of geodrake reads {FORMAT!r}.",
            advice="Use the version that saved it, or save the model again.",
            path=path,
        )
    _check_effects(path, saved, extra)
    base = _base_of_saved(path, saved)
    given = _given_with(path, saved, given)
    model = load_description(base, floating=saved.floating, held=saved.held, given=given)
    try:
        if saved.transmission is not None:
            drives = drives_of(list(saved.transmission.parts()))
            model = load_description(
                base, floating=saved.floating, held=saved.held, given=given, transmission=drives
            )
        loaded = _with_parameters(model, saved, base, extra)
        check_model(loaded)
    except GeodrakeError as error:
        raise ModelError(
            f"{path} does not fit its base model {base}, or any robot: {error}",
            advice="Fit and save the model again.",
            path=path,
        ) from error
    return loaded


def _fields(text: str) -> SavedModel:
    """Return what a saved model states; its information apart, if that is the last of it.

    That is nearly all of the text, and Drake's reader, in Python, takes its time.
    """
    start = text.rfind(f"\n{_INFORMATION}") + 1
    with suppress(yaml.YAMLError, RecursionError):
        last = yaml.load(text[start:], Loader=_Loader) if start else None
        rows = last["information"] if isinstance(last, dict) and len(last) == 1 else None
        if isinstance(rows, list) and all(_is_numbers(row) for row in rows):
            saved: SavedModel = yaml_load_typed(schema=SavedModel, data=text[:start])
            return dc.replace(saved, information=[[float(x) for x in row] for row in rows])
    whole: SavedModel = yaml_load_typed(schema=SavedModel, data=text)
    return whole


def _is_numbers(row: object) -> bool:
    return isinstance(row, list) and all(type(x) in (float, int) for x in row)


def _given_with(path: Path, saved: SavedModel, given: Given) -> Given:
    """How a saved model's file is to be read: as it remembers, packages from where they are now."""
    robot, folder = saved.robot or None, path.resolve().parent
    if given.robot not in (None, robot) or given.xacro:
        what = "arguments of a xacro file" if given.xacro else f"robot {given.robot!r}"
        raise ModelError(
            f"{path} is a saved model, which cannot take {what}: it was made with its own.",
            advice=f"Give them with the model file {saved.base_model}.",
            path=path,
        )
    remembered = {name: folder / where for name, where in saved.packages.items()}
    there = {name: where for name, where in remembered.items() if where.is_dir()}
    packages = {**there, **given.packages}
    return Given(robot, packages, saved.xacro, given.trust_xacro, tuple(saved.leading))


def _check_effects(path: Path, saved: SavedModel, extra: Sequence[type[Effect]]) -> None:
    """Refuse effects that neither the catalogue nor the user's own files have."""
    for effect in saved.effects:
        try:
            effect_class(effect.name, extra)
        except ArgumentError as error:
            near = error.evidence.get("nearest")
            own = f", of the class {effect.class_name}" if effect.class_name else ""
            raise ModelError(
                f"{path} has the effect {effect.name!r}{own}, which geodrake does not know.",
                advice=f"{_how_to_give(path, effect)} (from Python: load_model(path, extra=…))."
                + (f" Or was {', '.join(near)} meant?" if near and not effect.file else ""),
                path=path,
            ) from error


def _how_to_give(path: Path, effect: SavedEffect) -> str:
    """Return how to give the file of an effect of the user's own."""
    if not effect.file:
        return "If it is one of your own, give its file: --effects FILE.py"
    file = path.parent / effect.file
    if is_file(file):
        return f"Give its file: --effects {shlex.quote(os.path.relpath(file))}"
    return f"Give its file, which was {file.name!r}: --effects FILE.py"


def _odd_field(text: str) -> str:
    """Return the first field that is not of its type; nothing if that cannot be told."""
    with suppress(Exception):
        for name, value in yaml_load(data=text).items():
            try:
                yaml_load_typed(schema=SavedModel, data=yaml_dump({name: value}))
            except Exception:  # whatever it is, it is told of already
                return str(name)
    return ""


def _base_of_saved(path: Path, saved: SavedModel) -> Path:
    """Return the model file that a saved model is based on, wherever it is now."""
    if not _DIGEST.fullmatch(saved.base_sha256):
        raise ModelError(
            f"{path} has base_sha256 = {saved.base_sha256[:80]!r}, which is no SHA-256 digest.",
            advice="Save the model again.",
            path=path,
        )
    base = find_base(path, saved.base_model, saved.base_absolute, saved.base_sha256)
    if is_saved_model(base):
        raise ModelError(
            f"{path} is based on {saved.base_model!r}, which is a saved model itself.",
            advice="Change base_model to the URDF, SDF, MJCF or directives file.",
            base=base,
        )
    return base


def _with_parameters(
    model: RobotModel, saved: SavedModel, base: Path, extra: Sequence[type[Effect]]
) -> RobotModel:
    bodies = _ordered("inertial_parameters", saved.inertial_parameters, model.bodies)
    phi = np.array([_numbers(f"inertial_parameters of {b!r}", x, 10) for b, x in bodies.items()])
    effects = tuple(_fitted_effect(model, effect, extra) for effect in saved.effects)
    p = phi.size + sum(len(f.effect.parameters) for f in effects)
    information = None
    if saved.information:
        rows = [_numbers("rows of its information matrix", row, p) for row in saved.information]
        if len(rows) != p:
            raise ModelError(f"its information matrix has {len(rows)} rows, and {p} are fitted.")
        information = np.array(rows)
    notes = (*model.notes, *held_notes(model.held))
    if digest(base) != saved.base_sha256:
        notes += (f"{base.name} has changed since the model was saved.",)
    return replace(
        model,
        phi=phi,
        effects=effects,
        information=information,
        effort_signals=_effort_signals(model, saved.effort_signals),
        effort_noise=_of_joints(model, "effort_noise", saved.effort_noise),
        fading_speed=_of_joints(model, "fading_speed", saved.fading_speed),
        fitted_to=tuple(saved.fitted_to),
        bandwidths=_bandwidths(saved.bandwidths),
        notes=notes,
    )


def _bandwidths(saved: dict[str, list[float]]) -> dict[str, tuple[float, float]]:
    pairs = {log: _numbers("bandwidths", both, 2).tolist() for log, both in saved.items()}
    return {log: (efforts, motion) for log, (efforts, motion) in pairs.items()}


def _fitted_effect(
    model: RobotModel, saved: SavedEffect, extra: Sequence[type[Effect]]
) -> FittedEffect:
    effect = make_effect(saved.name, saved.where, saved.shape, extra)
    places = model.bodies if effect.places == "body" else (*model.joints, *model.joints_behind)
    for place in saved.where:
        if place not in places:
            raise ModelError(
                f"it has {saved.name} at {place!r}, which the robot does not have.",
                advice=f"It has {', '.join(places)}.",
            )
    count, what = len(effect.parameters), f"of {saved.name} at {effect.place}"
    return FittedEffect(
        effect,
        _numbers(f"parameters {what}", saved.parameters, count),
        _numbers(f"deviations {what}", saved.deviations, count) if saved.deviations else None,
    )


def _effort_signals(
    model: RobotModel, saved: Sequence[SavedEffortSignal]
) -> tuple[EffortSignal, ...]:
    found: dict[str, EffortSignal] = {}
    for each in saved:
        if each.joint not in model.joints:
            raise ModelError(
                f"it has a signal for efforts of {each.joint!r}, which the robot does not have.",
                advice=f"It has {', '.join(model.joints)}.",
            )
        if each.joint in found:
            raise ModelError(f"it has two signals for efforts of {each.joint!r}.")
        found[each.joint] = EffortSignal(**dc.asdict(each))
    return tuple(found.values())


def _numbers(what: str, values: Sequence[float], count: int) -> NDArray[np.float64]:
    if len(values) != count:
        raise ModelError(f"{what} are {len(values)} numbers instead of {count}.")
    return np.array(values, float)


def _of_joints(
    model: RobotModel, field: str, values: dict[str, float]
) -> NDArray[np.float64] | None:
    return np.array([*_ordered(field, values, model.joints).values()]) if values else None


def _ordered(field: str, values: dict[str, T], names: Sequence[str]) -> dict[str, T]:
    """Return the values in the order of some names, when there is one for each and no other."""
    odd = [name for name in values if name not in names]
    missing = [name for name in names if name not in values]
    if odd or missing:
        reason = f"has {odd[0]!r}, which the robot does not" if odd else f"lacks {missing[0]!r}"
        raise ModelError(f"{field} {reason}.", advice=f"It has {', '.join(names)}.")
    return {name: values[name] for name in names}
