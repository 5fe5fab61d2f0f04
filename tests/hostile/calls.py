"""Calls of everything that the packages export, made from signatures, with one wrong argument each.

A call gets good values by the names and types in its signature, as `good_values` has them; then one
argument at a time is spoiled, in every way that its kind can be.
"""

import importlib
import inspect
import pathlib
import pkgutil
import re
import traceback
import types
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass, replace
from functools import cache

import numpy as np
from good_values import BY_CALL, BY_KIND, BY_NAME, BY_TYPE, PHI, Fresh, pendulum
from hostile import HangError, limited
from pydrake.systems.framework import DiagramBuilder, System

import geodrake
from geodrake.errors import GeodrakeError

SECONDS = 20  # of the processor, for a call
HELD = ("own error", "accepted")
INSIDE = (TypeError, IndexError, AttributeError, KeyError)
APART = ("cli", "demo", "boundary", "report", "scenes")
"""Packages without calls: pages are shown what geodrake made, scenes come from files."""
BASES = ("Effect", "JointEffect", "JointPairEffect", "BodyEffect", "RobotEffect", "Manifold")
BASES += ("Transmission", "AdaptiveController", "UpdateLaw", "Regularizer", "MotionFamily")
BASES += ("ConvexSet",)
MORE_METHODS = (
    *("BaseParameters.labels", "EffectForce.AddToBuilder", "Ellipsoid.random_points"),
    *("Ellipsoid.scaled", "ExcitationTrajectory.log", "LinearTransmission.from_ratios"),
    *("MotionLimits.scaled", "Polyhedron.violation", "RobotModel.positions", "RobotModel.with_fit"),
    *("Safeguards.of_plant", "LinearTransmission.joint_motion", "LinearTransmission.jacobian"),
    *("LinearTransmission.joint_positions", "LinearTransmission.jacobian_rate"),
    *("FunctionTransmission.joint_motion", "FunctionTransmission.jacobian"),
)
"""Methods that a user calls, though none of their arguments is ArrayLike, the mark of a door."""
ONE_JOINT = ("Cylinder", "FourBar", "PolynomialTransmission", "TableTransmission")
"""Transmissions whose methods are those of the others."""
UNCALLED = {
    **dict.fromkeys(("Proposer", "Role", "Array"), "names to choose from, or a type"),
    **dict.fromkeys(("case_rollout", "rest_correlates", "source_of"), "a part of what has a door"),
    **dict.fromkeys(("RobotMotion", "JointMotion"), "what effects are shown, made here alone"),
    "WrongInertia": "it has no instance",
    "log_of": "of a table that a reader of files made",
    "PositionServo.set_gains": "its arguments have no names",
    "DcMotor.set_constants": "its arguments have no names",
    "EffectForce.set_effect_parameters": "of the effects in the force: tests/control has its calls",
    "EffectForce.set_hidden_states": "of the effects in the force: tests/control has its calls",
    "RobotModel.add_to_scene": "of a builder with the robot in it: tests/control has its calls",
}
"""What is exported and not called here, and why."""
INFINITE = ("longest_step", "mirror_line", "zero_moment_point", "value", "objective")
"""Functions that may return infinity or NaN, as they document."""
SLOW = {"logs", "log", "seeds", "fleet", "separation", "A", "first"}
"""Arguments of functions that take long: only what cannot be right is tried there."""


@dataclass(frozen=True)
class Call:
    """A good call: a function by the name that users know, and its arguments."""

    name: str
    function: Callable[..., object]
    arguments: Mapping[str, object]

    @property
    def is_slow(self):
        return not SLOW.isdisjoint(inspect.signature(self.function).parameters)


@dataclass(frozen=True)
class Wrong:
    """A wrong value of an argument; `must` is whether it cannot be right."""

    words: str
    value: object
    must: bool = True


class Anything:
    """An object that is nothing that a function could want."""

    def __repr__(self):
        return "Anything()"


class MissingError(Exception):
    """No good value is known."""


@cache
def exports():
    """Name -> what the packages export, each once."""
    found = {}
    for each in pkgutil.walk_packages(geodrake.__path__, "geodrake."):
        if each.ispkg and not {*each.name.split(".")} & {*APART}:
            module = importlib.import_module(each.name)
            found |= {name: getattr(module, name) for name in getattr(module, "__all__", ())}
    found |= {name: getattr(geodrake, name) for name in geodrake.__all__}
    return {name: found[name] for name in sorted(found) if callable(found[name])}


def is_plain(value):
    """Whether a class only holds what a function made: it checks nothing."""
    own = vars(value)
    checks = "__post_init__" in own or ("__init__" in own and not is_dataclass(value))
    return not checks and not any("__post_init__" in vars(base) for base in value.__mro__)


def methods(name, value):
    """Names of the methods of a class that check arguments."""
    for method in dir(value):
        found = getattr(value, method)
        if method.startswith(("_", "calc_")) or not callable(found):
            continue
        if not str(getattr(found, "__module__", "")).startswith("geodrake"):
            continue
        given = (str(p.annotation) for p in inspect.signature(found).parameters.values())
        if f"{name}.{method}" in MORE_METHODS or any("ArrayLike" in each for each in given):
            yield method


def is_bound(value, method):
    return not isinstance(inspect.getattr_static(value, method), classmethod | staticmethod)


@cache
def good_calls():
    """Name -> good call of every function, class and method; why there is none of the others."""
    found, none = {}, {}
    for name, value in exports().items():
        if name in BASES:
            continue
        todo = {}
        if inspect.isclass(value) and name not in ONE_JOINT:
            todo = {f"{name}.{method}": method for method in methods(name, value)}
        if not inspect.isclass(value) or not is_plain(value):
            todo[name] = None
        for full, method in todo.items():
            if full in UNCALLED:
                continue
            try:
                function = value if method is None else getattr(value, method)
                if method is not None and is_bound(value, method):
                    if (owner := made(name)) is None:
                        raise MissingError(name)
                    function = getattr(plain(owner), method)
                function = IN_DIAGRAMS.get(full, function)
                found[full] = Call(full, function, good_arguments(full, function))
            except (MissingError, GeodrakeError) as error:
                none[full] = str(error)
    return found, none


def good_arguments(name, function):
    """Good values of the arguments of a function that have any."""
    found, own = {}, BY_CALL.get(name, {})
    for key, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        with_default = parameter.default is not parameter.empty
        known = {**BY_NAME, **special(name, function), **own}
        typed = f"{key}: {parameter.annotation}"
        if typed in known:
            value = known[typed]
        elif key in own or (key in known and fits(known[key], str(parameter.annotation))):
            value = known[key]
        elif with_default and type(parameter.default) in (int, float, str):
            value = parameter.default
        else:
            try:
                value = by_type(str(parameter.annotation))
            except MissingError:
                if with_default:
                    continue
                value = by_kind(str(parameter.annotation))
        if value is not None:
            found[key] = value
    return found


FITTING = {
    "float": "float|ArrayLike|ByJoint|Scalars",
    "int": "int",
    "str": "str",
    "dict": "Mapping",
    "Fresh": "Path|path|Context",
    "ndarray": r"Array|Scalars|\bfloat \|",
    "tuple": "Sequence|tuple|ArrayLike",
}
"""Class of a value that a name stands for -> words of the annotations that it fits."""


def fits(value, annotation):
    return re.search(FITTING.get(type(value).__name__, "$^"), annotation) is not None


def special(name, function):
    """Points of a manifold or law, which has its own dimension: x, y, v, b, rows and gradients."""
    owner = getattr(function, "__self__", None)
    if owner is None or inspect.isclass(owner):
        return {}
    if isinstance(owner, System):
        return {"context": Fresh(owner.CreateDefaultContext)}
    kind, method = name.split(".")[0], name.partition(".")[2]
    if hasattr(owner, "calc_gradient") and hasattr(owner, "calc_metric"):
        x = PHI if "Inertia" in kind else np.array([[0.3, 0.4], [0.5, 0.6]])
        if kind == "Product":
            x = np.stack([BY_NAME["parameters"], 1.1 * BY_NAME["parameters"]])
        single = method in ("frame", "mirror_line", "mirror_span", "point_of_gradient")
        first = x[0] if single else x
        near = {"gradient": owner.calc_gradient(x[1]), "near": x[0], "rows": 0.01 * x}
        return {"x": first, "y": x[::-1], "v": 0.01 * x, "b": 0.01 * first, **near}
    if kind.endswith("Law"):
        p = BY_NAME["parameters"]
        return {"parameters": p, "truth": p, "b": 0.01 * p, "rows": np.eye(len(p))[:2]}
    return {}


def plain(value):
    """A value, made anew if it must be."""
    return value.make() if isinstance(value, Fresh) else value


def by_type(annotation):
    """A good value of an annotated type."""
    if annotation.startswith("ForwardRef"):
        raise MissingError(annotation)
    annotation = re.sub(r"<class '(.*)'>", r"\1", annotation)
    for each in re.split(r" \| (?![^\[]*\])", annotation):
        kind = re.sub(r"^(?:geodrake|collections|pathlib)[\w.]*\.", "", each)
        outer, _, inner = kind.partition("[")
        if kind in BY_TYPE:
            return BY_TYPE[kind]()
        if outer == "Callable":
            return BY_TYPE["Callable"]()
        if outer in ("Sequence", "Iterable", "tuple") and inner:
            try:
                one = by_type(inner.rstrip("]").removesuffix(", ..."))
            except MissingError:
                continue
            return Fresh(lambda one=one: (plain(one),)) if isinstance(one, Fresh) else (one,)
        if (found := made(kind)) is not None:
            return found
    raise MissingError(annotation)


def by_kind(annotation):
    """A value of a number, words or an array, of whatever size."""
    for words, value in BY_KIND.items():
        if re.search(words, annotation):
            return value
    raise MissingError(annotation)


@cache
def made(kind):
    """What an exported class or function makes of good arguments; None if none can."""
    if kind in BY_TYPE:
        return BY_TYPE[kind]()
    if not re.fullmatch(r"(?!None$|Array)[A-Z]\w+", kind) or kind in _MAKING:
        return None
    functions = {name: f for name, f in exports().items() if inspect.isroutine(f)}
    makers = [n for n, f in functions.items() if inspect.signature(f).return_annotation == kind]
    if inspect.isclass(exports().get(kind)):
        makers.append(f"{kind}.of" if hasattr(exports()[kind], "of") else kind)
    _MAKING.add(kind)
    try:
        for maker in makers:
            function = functions.get(maker, exports().get(kind))
            function = function.of if maker.endswith(".of") else function
            with suppress(MissingError):
                arguments = good_arguments(maker, function)
                return function(**{key: plain(value) for key, value in arguments.items()})
    finally:
        _MAKING.discard(kind)
    return None


_MAKING = set()


def _in_diagram(function, *, gains=False, time_step=0.0):
    """A function of a builder and the plant in it."""

    def call(builder, **more):
        plant = pendulum(time_step, gains=gains)
        if isinstance(builder, DiagramBuilder):
            builder.AddSystem(plant)
        return function(builder=builder, plant=plant, **more)

    own = [p for k, p in inspect.signature(function).parameters.items() if k != "plant"]
    call.__signature__ = inspect.Signature(own)
    return call


IN_DIAGRAMS = {
    "add_adaptive_loop": _in_diagram(exports()["add_adaptive_loop"]),
    "EffectForce.AddToBuilder": _in_diagram(exports()["EffectForce"].AddToBuilder),
    "add_tracking_drives": _in_diagram(
        exports()["add_tracking_drives"], gains=True, time_step=1e-3
    ),
}


def wrong_things(*but):
    """Things of a wrong kind."""
    found = {"a text": "text", "an object": Anything(), "a dict": {"a": 1.0}, "a function": len}
    found["bytes"] = b"1.0"
    return [Wrong(words, value) for words, value in found.items() if words not in but]


def wrongs(must, pairs) -> Iterator[Wrong]:
    return (Wrong(words, value, must) for words, value in pairs.items())


def spoiled(array, value):
    """An array with a value in its last place."""
    found = np.array(array, float)
    found[(-1,) * found.ndim] = value
    return found


def wrong_arrays(array) -> Iterator[Wrong]:
    yield from wrong_things()
    is_mask = array.dtype == bool
    if not array.size:
        return
    yield from wrongs(True, {
        "NaN at one place": spoiled(array, np.nan), "complex": array + 1j,
        "complex without an imaginary part": array + 0j, "texts": array.astype(str),
        "objects": np.full(array.shape, None),
        "truth values or numbers": 1.0 * array if is_mask else array > 0,
        "a mask": np.ma.masked_invalid(spoiled(array, np.nan)),
        "a generator": (row for row in np.atleast_1d(array)),
        "dates": np.zeros(array.shape, "M8[s]"), "ragged": [array.tolist(), [0.0]],
        "a number beyond floats": np.full(array.shape, 10**400, object).tolist(),
    })  # fmt: skip
    if array.ndim:
        yield Wrong("nothing", None)
    for axis in range(array.ndim):
        yield from wrongs(False, {
            f"one more along axis {axis}": np.concatenate([array, array.take([0], axis)], axis),
            f"one less along axis {axis}": array.take(range(1, array.shape[axis]), axis),
            f"none along axis {axis}": array.take([], axis),
        })  # fmt: skip
    if array.ndim > 1 and array.shape[-1] == array.shape[-2]:
        skewed = array.astype(float)
        skewed[..., 0, -1] += 1.0 + np.abs(array).max()
        yield Wrong("not symmetric", skewed, must=False)
    yield from wrongs(False, {
        "infinity at one place": spoiled(array, np.inf), "a scalar": 1.0,
        "its first row": array[0] if array.ndim else array, "a further axis": array[None],
        "a further last axis": array[..., None], "negative": -1.0 * array, "zero": 0.0 * array,
        "huge": 1e200 * np.where(array == 0, 1.0, array), "a list": array.tolist(),
        "whole numbers": np.round(array).astype(int),
        "single precision": array.astype(np.float32),
    })  # fmt: skip


def wrong_numbers(number, *, whole) -> Iterator[Wrong]:
    yield from wrong_things()
    yield from wrongs(True, {
        "NaN": np.nan, "complex": complex(number, 1.0), "a number as text": str(number),
        "two numbers": [number, number], "true": True, "beyond floats": 10**400, "nothing": None,
    })  # fmt: skip
    if whole:
        yield Wrong("between whole numbers", number + 0.5)
        yield Wrong("beyond machine integers", 10**30)
        yield Wrong("of NumPy", np.int64(number), must=False)
    else:
        more = {"huge": 1e300, "tiny": 1e-300, "single": np.float32(number)}
        yield from wrongs(False, more)
    yield Wrong("infinity", np.inf, must=whole)
    yield from wrongs(False, {"negative": -1 - number, "zero": 0, "minus infinity": -np.inf})


def wrong_sequences(values) -> Iterator[Wrong]:
    yield from wrong_things()
    nothings = (None,) * max(len(values), 1)
    objects = {"of objects": (Anything(),), "of nothings": nothings}
    yield from wrongs(True, {"a number": 3, "nothing": None, **objects})
    generator = (value for value in values)
    yield from wrongs(False, {"empty": (), "a list": list(values), "a generator": generator})
    if values and all(isinstance(value, str) for value in values):
        unknown = tuple(f"no {value}" for value in values)
        yield from wrongs(False, {"unknown names": unknown, "a name twice": values[:1] + values})
    if values and all(type(value) in (float, int) for value in values):
        yield from wrongs(True, {
            "complex": tuple(value + 1j for value in values), "NaN": (np.nan,) * len(values),
            "texts": tuple(map(str, values)),
        })  # fmt: skip
        yield Wrong("negative", tuple(-1 - value for value in values), must=False)


def wrong_values(value) -> Iterator[Wrong]:
    """Wrong values in the place of a good one."""
    if isinstance(value, np.ndarray):
        yield from wrong_arrays(value)
    elif isinstance(value, bool):
        return
    elif isinstance(value, int | float | np.number):
        yield from wrong_numbers(value, whole=isinstance(value, int | np.integer))
    elif isinstance(value, tuple | list):
        yield from wrong_sequences(value)
    elif isinstance(value, str):
        yield from wrong_things("a text")
        yield from (Wrong("a number", 3), Wrong("a list of words", [value]), Wrong("nothing", None))
        yield Wrong("an unknown word", "no such thing", must=False)
        yield Wrong("an empty word", "", must=False)
    elif isinstance(value, pathlib.Path):
        yield from wrong_things("a text", "bytes")
        yield from (Wrong("a number", 3), Wrong("nothing", None))
        yield Wrong("no such file", value.parent / "no" / "such.file", must=False)
    elif isinstance(value, dict):
        yield from (*wrong_things("a dict"), Wrong("a number", 3), Wrong("nothing", None))
        if value:
            yield Wrong("unknown names", {f"no {key}": each for key, each in value.items()})
            yield Wrong("objects", dict.fromkeys(value, Anything()))
    else:
        yield from wrong_things(*(("a function",) if callable(value) else ()))
        yield from (Wrong("a number", 3), Wrong("nothing", None))
        yield Wrong("an empty list", [], must=False)


MAY = {  # words of wrong values -> what an annotation says where they are right
    "nothing": "None|Any|ByJoint",
    "a text": r"\bstr\b",
    "two numbers": "ArrayLike|Array|Sequence|ByJoint|Scalars",
    "a number": "ArrayLike|ByJoint|Scalars",
    "a list of words": r"Sequence\[str|Sequence\[type",
    "a dict": "Mapping|ByJoint",
    "of nothings": "None",
    "an empty list": "Sequence|Iterable",
}


def wrong_calls(call) -> Iterator[tuple[str, Wrong]]:
    """Every argument with every wrong value."""
    parameters = inspect.signature(call.function).parameters
    for argument, value in call.arguments.items():
        annotation = str(parameters[argument].annotation)
        for wrong in wrong_values(plain(value)):
            may = re.search(MAY.get(wrong.words, "$^"), annotation)
            if may and wrong.words == "nothing":
                continue
            must = wrong.must and not may
            if must or not call.is_slow:
                yield argument, replace(wrong, must=must)


def run(call, arguments):
    """What a call returns for arguments by name."""
    parameters = inspect.signature(call.function).parameters
    starred = [k for k in arguments if parameters[k].kind is inspect.Parameter.VAR_POSITIONAL]
    more = {key: value for key, value in arguments.items() if key not in starred}
    return call.function(*(arguments[key] for key in starred), **more)


def ended(call, argument="", wrong=None):
    """How a call ends, with one argument wrong or none: a class and words."""
    arguments = {k: copied(v) for k, v in call.arguments.items()}
    if wrong is not None:
        arguments[argument] = wrong.value
    before = {k: v.copy() for k, v in arguments.items() if type(v) is np.ndarray}
    try:
        with warnings.catch_warnings(), limited(call.name, SECONDS):
            warnings.simplefilter("error")
            result = run(call, arguments)
            if isinstance(result, types.GeneratorType):
                result = tuple(result)
    except GeodrakeError as error:
        end, told = "own error", f"{type(error).__name__}: {error}"
    except Warning as error:
        end, told = "warning", _where(error)
    except INSIDE as error:
        end, told = "inside", _where(error)
    except (Exception, HangError) as error:
        end, told = type(error).__name__, _where(error)
    else:
        end = "believed" if wrong is not None and wrong.must else "accepted"
        told = str(result)[:80].replace("\n", " ")
        if end == "accepted" and not (call.name.endswith(INFINITE) or finite(result)):
            end = "not finite"
    for key, value in before.items():
        if not np.array_equal(value, arguments[key], equal_nan=value.dtype.kind in "fc"):
            return "changed", f"{key} was changed"
    return end, told


def copied(value):
    """A value as a call gets it: a copy, so that what it changes can be seen."""
    value = plain(value)
    return value.copy() if isinstance(value, np.ndarray) else value


def finite(result):
    """Whether numbers that are returned are some; fields of objects may be infinite bounds."""
    if isinstance(result, np.ndarray | float | complex | np.number):
        array = np.asarray(result)
        return array.dtype.kind not in "fc" or bool(
            np.isrealobj(array) and np.isfinite(array).all()
        )
    return all(map(finite, result)) if isinstance(result, tuple | list) else True


def _where(error):
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/geodrake/" in f.filename]
    at = f"{pathlib.Path(frames[-1].filename).name}:{frames[-1].lineno} " if frames else ""
    return f"{at}{type(error).__name__}: {str(error)[:150]}"


def outcomes(call) -> Iterator[tuple[str, str, str, str]]:
    """Argument, wrong value, end and words of every wrong call of a function."""
    for argument, wrong in wrong_calls(call):
        yield argument, wrong.words, *ended(call, argument, wrong)
