"""Fitted models as YAML files, read and written through Drake's `yaml_load_typed`."""

# Drake reads the schema from the annotations themselves, so they must not be strings here.
import dataclasses as dc
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from geodrake.effects import Effect, EffortDelay, make_effect
from geodrake.errors import GeodrakeError, ModelError, OutputError
from geodrake.model import FittedEffect, RobotModel, load_description
from geodrake.whole_files import write_whole

FORMAT = "geodrake model 1"


@dataclass
class SavedEffect:
    """One effect: its name, place, shape and parameters."""

    name: str = ""
    where: list[str] = dc.field(default_factory=list)
    shape: dict[str, float] = dc.field(default_factory=dict)
    parameters: list[float] = dc.field(default_factory=list)
    deviations: list[float] = dc.field(default_factory=list)


@dataclass
class SavedModel:
    """Schema of `model.yaml`.

    Attributes:
        format: Name and version of the format.
        base_model: Path of the model file, relative to this one.
        base_sha256: Digest of the model file when the model was saved.
        floating: Whether free roots float.
        inertial_parameters: Body -> [m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx].
        effects: The effects.
        information: Information matrix of the inertial parameters, then of the effects'.
        effort_noise: Joint -> held-out RMS that the fit left, N·m or N.
        fading_speed: Joint -> speed below which dry friction fades, rad/s or m/s.
        fitted_to: Fingerprints of the logs that the model was fitted to.
    """

    format: str = FORMAT
    base_model: str = ""
    base_sha256: str = ""
    floating: bool = False
    inertial_parameters: dict[str, list[float]] = dc.field(default_factory=dict)
    effects: list[SavedEffect] = dc.field(default_factory=list)
    effort_noise: dict[str, float] = dc.field(default_factory=dict)
    fading_speed: dict[str, float] = dc.field(default_factory=dict)
    fitted_to: list[str] = dc.field(default_factory=list)
    information: list[list[float]] = dc.field(default_factory=list)


def load_model(
    path: str | Path, *, floating: bool = False, extra: Sequence[type[Effect]] = ()
) -> RobotModel:
    """Load a robot model: a URDF, SDF, MJCF or Drake directives file, or a saved model.

    Args:
        path: The file.
        floating: Leave roots free that the file does not attach to the world (a saved model
            remembers).
        extra: Effect classes of the user's own that a saved model may name.

    Raises:
        ModelError: The file cannot be read or does not describe a robot; or the file that a saved
            model is based on is gone or has other joints or bodies.
    """
    path = Path(path)
    if is_saved_model(path):
        return _read(path, extra)
    return load_description(path, floating=floating)


def is_saved_model(path: Path) -> bool:
    """Whether a file is one that `save_model` wrote."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return path.suffix in {".yaml", ".yml"} and FORMAT in file.read(200)
    except OSError:
        return False


def save_model(model: RobotModel, path: str | Path) -> None:
    """Write a model; the file appears whole or not at all.

    Raises:
        OutputError: The target cannot be written.
    """
    write_whole(path, saved_text(model, path))


def saved_text(model: RobotModel, path: str | Path) -> str:
    """What `save_model` writes.

    Args:
        model: The model.
        path: Where it is to be written; the model file is named from there.

    Raises:
        OutputError: The model file is gone, or its path is none that YAML can hold.
    """
    base = _base_of(model)
    saved = SavedModel(
        base_model=os.path.relpath(base, Path(path).resolve().parent),
        base_sha256=hashlib.sha256(base.read_bytes()).hexdigest(),
        floating=model.floating,
        inertial_parameters={
            b: phi.tolist() for b, phi in zip(model.bodies, model.phi, strict=True)
        },
        effects=[_saved_effect(fitted) for fitted in model.effects],
        effort_noise=_by_joint(model, model.effort_noise),
        fading_speed=_by_joint(model, model.fading_speed),
        fitted_to=list(model.fitted_to),
        information=[] if model.information is None else model.information.tolist(),
    )
    return str(yaml_dump_typed(saved, schema=SavedModel))


def _base_of(model: RobotModel) -> Path:
    """Path of the model file, which the saved model needs to be read again."""
    base = model.path.resolve()
    if not base.is_file():
        raise OutputError(
            f"Cannot save the model: its file {base} is gone.", advice="Put it back.", path=base
        )
    try:
        str(base).encode()
    except UnicodeEncodeError as error:
        raise OutputError(
            f"Cannot save the model: the path of its file {base} is not UTF-8.",
            advice="Rename the file or its folder.",
            path=base,
        ) from error
    return base


def _by_joint(model: RobotModel, values: NDArray[np.float64] | None) -> dict[str, float]:
    return {} if values is None else dict(zip(model.joints, values.tolist(), strict=True))


def _of_joints(model: RobotModel, values: dict[str, float]) -> NDArray[np.float64] | None:
    return np.array([values[joint] for joint in model.joints]) if values else None


def _checked_speed(speed: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    if speed is not None and not np.all(np.isfinite(speed) & (speed >= 0.0)):
        raise ModelError(f"dry friction cannot fade below {speed} rad/s or m/s.")
    return speed


def _saved_effect(fitted: FittedEffect) -> SavedEffect:
    effect = fitted.effect
    shape = {name: float(value) for name, value in effect.shape.items() if value is not None}
    deviations = [] if fitted.deviations is None else fitted.deviations.tolist()
    return SavedEffect(
        effect.name, list(effect.where), shape, fitted.parameters.tolist(), deviations
    )


def _read(path: Path, extra: Sequence[type[Effect]]) -> RobotModel:
    try:
        saved = yaml_load_typed(schema=SavedModel, filename=str(path))
    except Exception as error:  # Drake raises RuntimeError and others, depending on the fault
        reason = str(error).splitlines()[0]
        raise ModelError(
            f"{path} is no geodrake model: {reason}", advice="Save the model again.", path=path
        ) from error
    base = path.resolve().parent / saved.base_model
    if not base.is_file():
        raise ModelError(
            f"{path} is based on {saved.base_model}, which is not at {base}.",
            advice="Move it back, or change base_model in the saved model.",
            base=base,
        )
    model = load_description(base, floating=saved.floating)
    try:
        return _with_parameters(model, saved, base, extra)
    except (KeyError, ValueError, GeodrakeError) as error:
        raise ModelError(
            f"{path} does not fit its base model {base}: {error}",
            advice="Fit and save the model again.",
        ) from error


def _with_parameters(
    model: RobotModel, saved: SavedModel, base: Path, extra: Sequence[type[Effect]]
) -> RobotModel:
    phi = np.array([saved.inertial_parameters[body] for body in model.bodies])
    for e in saved.effects:
        for place in set(e.where).difference(model.joints, model.bodies):
            raise ModelError(f"it has {e.name} at {place!r}, which the robot does not have.")
    effects = tuple(
        FittedEffect(
            make_effect(e.name, e.where, e.shape, extra),
            np.array(e.parameters),
            np.array(e.deviations) if e.deviations else None,
        )
        for e in saved.effects
    )
    p = phi.size + sum(
        len(f.effect.parameters) for f in effects if not isinstance(f.effect, EffortDelay)
    )
    information = np.array(saved.information) if saved.information else None
    if information is not None and information.shape != (p, p):
        raise ModelError(f"its information matrix is {information.shape}, and {p} are fitted.")
    notes = model.notes
    if hashlib.sha256(base.read_bytes()).hexdigest() != saved.base_sha256:
        notes += (f"{base.name} has changed since the model was saved.",)
    return replace(
        model,
        phi=phi,
        effects=effects,
        information=information,
        effort_noise=_of_joints(model, saved.effort_noise),
        fading_speed=_checked_speed(_of_joints(model, saved.fading_speed)),
        fitted_to=tuple(saved.fitted_to),
        notes=notes,
    )
