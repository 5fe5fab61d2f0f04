"""Effects by name: the catalogue, users' own files, and the form effects have in saved models."""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from geodrake.arguments import file_path, instance, instances
from geodrake.effects.aerodynamic_drag import AerodynamicDrag
from geodrake.effects.asymmetric_friction import AsymmetricFriction
from geodrake.effects.backlash import Backlash
from geodrake.effects.base import Effect
from geodrake.effects.contact import Contact
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.coupled_friction import CoupledFriction
from geodrake.effects.coupled_rotor_inertia import CoupledRotorInertia
from geodrake.effects.effort_delay import EffortDelay
from geodrake.effects.effort_offset import EffortOffset
from geodrake.effects.effort_scale import EffortScale
from geodrake.effects.friction_drift import FrictionDrift
from geodrake.effects.gravity_compensator import GravityCompensator
from geodrake.effects.gravity_tilt import GravityTilt
from geodrake.effects.hysteresis import Hysteresis
from geodrake.effects.joint_elasticity import JointElasticity
from geodrake.effects.joint_spring import JointSpring
from geodrake.effects.load_dependent_friction import LoadDependentFriction
from geodrake.effects.nonlinear_viscous_friction import NonlinearViscousFriction
from geodrake.effects.payload import Payload
from geodrake.effects.rotor_inertia import RotorInertia
from geodrake.effects.stribeck_friction import StribeckFriction
from geodrake.effects.torque_ripple import TorqueRipple
from geodrake.effects.user_code import check_class
from geodrake.effects.viscous_friction import ViscousFriction
from geodrake.errors import ArgumentError, ModelError
from geodrake.input_files import regular_file

_PLACE_FIELDS = {
    "joint": "joint",
    "joint_pair": "joints",
    "body": "body",
    "robot": "",
    "log": "joint",
}


def catalogue() -> tuple[type[Effect], ...]:
    """The effects that come with geodrake, in the order in which they are usually told of."""
    return (
        ViscousFriction,
        CoulombFriction,
        AsymmetricFriction,
        StribeckFriction,
        NonlinearViscousFriction,
        LoadDependentFriction,
        CoupledFriction,
        FrictionDrift,
        Hysteresis,
        EffortOffset,
        EffortScale,
        EffortDelay,
        JointSpring,
        GravityCompensator,
        TorqueRipple,
        RotorInertia,
        CoupledRotorInertia,
        JointElasticity,
        Backlash,
        Payload,
        GravityTilt,
        Contact,
        AerodynamicDrag,
    )


def effect_class(name: str, extra: Sequence[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name.

    Args:
        name: Such as "coulomb_friction".
        extra: Effects that are not in the catalogue, such as those of `load_effect_file`.

    Raises:
        ArgumentError: There is no such effect; the message has the nearest names.
    """
    instance(name, "the name of an effect", str)
    effects = {effect.name: effect for effect in (*catalogue(), *instances(extra, "extra", type))}
    if name not in effects:
        near = difflib.get_close_matches(name, effects, cutoff=0.5)
        names = ", ".join(near or effects)
        raise ArgumentError(
            f"There is no effect {name!r}.",
            advice=f"Did you mean {names}?" if near else f"Effects are: {names}.",
            nearest=near,
        )
    return effects[name]


def make_effect(
    name: str,
    where: Sequence[str],
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Effect:
    """An effect from the form it has in a saved model: its `name`, `where` and `shape`.

    Args:
        name: Name of the effect.
        where: Names of its joints, or of its body.
        shape: Its shape parameters by name; those left out have their default.
        extra: Effects that are not in the catalogue.

    Raises:
        ArgumentError: There is no such effect, or place or shape parameters do not fit it.
    """
    cls = effect_class(name, extra)
    shape = {} if shape is None else dict(instance(shape, "shape", Mapping))
    where = where if isinstance(where, str) else instances(where, "where", str)
    place = _PLACE_FIELDS[cls.places]
    counts = {"joint_pair": (2,), "log": (0, 1), "robot": (0,)}.get(cls.places, (1,))
    if isinstance(where, str) or len(where) not in counts:
        wanted = {
            "joint_pair": "two joints",
            "log": "one joint or none",
            "robot": "no place, as it is one of the whole robot",
        }.get(cls.places, f"one {cls.places}")
        raise ArgumentError(f"{name} needs {wanted}; it got {where!r}.")
    known = [field for field in inspect.signature(cls).parameters if field != place]
    unknown = [key for key in shape if key not in known]
    if unknown:
        raise ArgumentError(
            f"{name} has no shape parameter {unknown[0]!r}.",
            advice=f"It has {', '.join(known)}." if known else "It has none.",
        )
    for field in fields(cls):  # type: ignore[arg-type]
        value = shape.get(field.name)
        if field.type in (int, "int") and isinstance(value, float):
            if not value.is_integer():
                raise ArgumentError(f"{name} needs a whole number as {field.name}; it got {value}.")
            shape[field.name] = int(value)  # which a saved model holds as a float
    if where:
        shape[place] = tuple(where) if cls.places == "joint_pair" else where[0]
    try:
        return cls(**shape)
    except TypeError as error:
        raise ArgumentError(
            f"{name} cannot be made of {shape}: {error}.",
            advice=f"Its shape parameters are {', '.join(known)}.",
        ) from error


def load_effect_file(path: str | Path) -> tuple[type[Effect], ...]:
    """Runs a Python file of a user and collects the effects that it defines.

    Args:
        path: A file such as the one in the documentation of `geodrake.effects`.

    Returns:
        Its effects in the order of definition, to be passed on as `extra`.

    Raises:
        ModelError: There is no such file, it cannot be run, or it defines no usable effect.
    """
    path = regular_file(file_path(path), "file of effects", ModelError)
    module = _import(path)
    classes = [
        value
        for value in dict.fromkeys(filter(inspect.isclass, vars(module).values()))
        if issubclass(value, Effect) and value.__module__ == module.__name__
    ]
    effects = [value for value in classes if not inspect.isabstract(value)]
    if not effects and classes:
        raise ModelError(
            f"The effect {classes[-1].__name__} of {path} lacks "
            f"{', '.join(sorted(classes[-1].__abstractmethods__))}.",
            advice="Define it as a method.",
        )
    if not effects:
        raise ModelError(
            f"{path} defines no effect.",
            advice="Derive a class from geodrake.effects.JointEffect and define its columns().",
        )
    taken = {effect.name for effect in catalogue()}
    for effect in effects:
        name = getattr(effect, "name", None)
        missing = [key for key in ("name", "parameters", "places") if not hasattr(effect, key)]
        if missing or not is_dataclass(effect):
            what = ", ".join(missing) or "the line @dataclass(frozen=True)"
            raise ModelError(f"The effect {effect.__name__} of {path} lacks {what}.")
        try:
            check_class(effect)
        except ArgumentError as error:
            raise ModelError(f"{path}: {error.problem}", advice=error.advice) from error
        place = _PLACE_FIELDS.get(str(effect.places))
        if place is None or not (
            effect.places in ("log", "robot") or place in _field_names(effect)
        ):
            raise ModelError(
                f"The effect {effect.__name__} of {path} has places = {effect.places!r} and the "
                f"fields {_field_names(effect)}.",
                advice="Derive it from JointEffect, JointPairEffect or BodyEffect, which have "
                "the field that says where the effect is.",
            )
        if name in taken:
            raise ModelError(
                f"The effect {effect.__name__} of {path} has the name {name!r} of another effect.",
                advice="Give it a name of its own.",
            )
        taken.add(effect.name)
    return tuple(effects)


def _field_names(effect: type[Effect]) -> list[str]:
    return [field.name for field in fields(effect)]  # type: ignore[arg-type]


def _import(path: Path) -> ModuleType:
    """Imports a file under a name that depends on where it is, so that files do not collide."""
    digest = hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:12]
    name = f"geodrake_user_effects_{digest}"
    spec = importlib.util.spec_from_file_location(name, path.absolute())
    if spec is None or spec.loader is None:
        raise ModelError(f"{path} is not a Python file.", advice="Give a file that ends in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up while they are made
    folder = Path.cwd()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
            spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever it raises is the file's
        del sys.modules[name]
        words = " ".join(str(error).split()).rstrip(".")
        raise ModelError(
            f"{path} cannot be run: {_line(error, path)}{type(error).__name__}: {words}.",
            advice="Run it with python to see where it fails.",
        ) from error
    if Path.cwd() != folder:
        os.chdir(folder)
        raise ModelError(
            f"{path} changes the working directory to which all other paths belong.",
            advice="Take os.chdir out of it.",
        )
    return module


def _line(error: BaseException, path: Path) -> str:
    """The innermost line of a file that an error came through, in words."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename) == path.absolute()]
    if isinstance(error, SyntaxError) and error.filename == str(path.absolute()):
        lines.append(error.lineno)
    return f"line {lines[-1]}: " if lines and lines[-1] else ""
