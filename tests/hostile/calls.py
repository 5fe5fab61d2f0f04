"""Calls of everything that the packages export, with one wrong argument each.

Arguments get good values by the names and types in a signature, from `good_values`. Then one
argument at a time is replaced in every way that its kind allows.
"""

import importlib
import inspect
import pkgutil
import re
import traceback
import types
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from good_values import BY_CALL, BY_KIND, BY_NAME, BY_TYPE, PHI, Fresh
from processes import HangError, time_limit
from pydrake.systems.framework import System

import geodrake
from geodrake.errors import GeodrakeError

SECONDS = 20  # CPU time of a call
HELD = ("own error", "accepted")
INSIDE = (TypeError, IndexError, AttributeError, KeyError)
TABLES = yaml.safe_load((Path(__file__).parent / "calls.yaml").read_text("utf-8"))
"""Lists of what is called and what is not."""
UNCALLED = TABLES["uncalled"]


@dataclass(frozen=True)
class Call:
    """A good call: a function by the name that users know, and its arguments."""

    name: str
    function: Callable[..., object]
    arguments: Mapping[str, object]

    @property
    def is_slow(self):
        return not {*TABLES["slow"]}.isdisjoint(inspect.signature(self.function).parameters)


class Anything:
    """An object that no function accepts."""

    def __repr__(self):
        return "Anything()"


class MissingError(Exception):
    """Raised if no good value is known."""


@cache
def exports():
    """Return what the packages export, by name."""
    found = {}
    for each in pkgutil.walk_packages(geodrake.__path__, "geodrake."):
        if each.ispkg and not {*each.name.split(".")} & {*TABLES["apart"]}:
            module = importlib.import_module(each.name)
            found |= {name: getattr(module, name) for name in getattr(module, "__all__", ())}
    found |= {name: getattr(geodrake, name) for name in geodrake.__all__}
    return {name: found[name] for name in sorted(found) if callable(found[name])}


def is_plain(value):
    """Return whether a class only holds values, without checking any."""
    own = vars(value)
    checks = "__post_init__" in own or ("__init__" in own and not is_dataclass(value))
    return not checks and not any("__post_init__" in vars(base) for base in value.__mro__)


def methods(name, value):
    """Yield the names of the methods of a class that check arguments."""
    for method in dir(value):
        found = getattr(value, method)
        if method.startswith(("_", "calc_")) or not callable(found):
            continue
        if not str(getattr(found, "__module__", "")).startswith("geodrake"):
            continue
        given = (str(p.annotation) for p in inspect.signature(found).parameters.values())
        if f"{name}.{method}" in TABLES["methods"] or any("ArrayLike" in each for each in given):
            yield method


@cache
def good_calls():
    """Return the good calls by name, and by name why others have none."""
    found, none = {}, {}
    for name, value in exports().items():
        if name in TABLES["bases"]:
            continue
        todo = {}
        if inspect.isclass(value):
            todo = {f"{name}.{method}": method for method in methods(name, value)}
        if not inspect.isclass(value) or not is_plain(value):
            todo[name] = None
        for full, method in todo.items():
            if full in UNCALLED:
                continue
            try:
                function = value if method is None else getattr(value, method)
                static = method and inspect.getattr_static(value, method)
                if method and not isinstance(static, classmethod | staticmethod):
                    if (owner := made(name)) is None:
                        raise MissingError(name)
                    function = getattr(plain(owner), method)
                found[full] = Call(full, function, good_arguments(full, function))
            except (MissingError, GeodrakeError) as error:
                none[full] = str(error)
    return found, none


def good_arguments(name, function):
    """Return good values of the arguments of a function."""
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
            value = by_type(str(parameter.annotation))
            if value is None and not with_default:
                value = by_kind(str(parameter.annotation))
        if value is not None:
            found[key] = value
    return found


def fits(value, annotation):
    return re.search(TABLES["fitting"].get(type(value).__name__, "$^"), annotation) is not None


def special(name, function):
    """Return points of a manifold or law, which has a dimension of its own."""
    owner = getattr(function, "__self__", None)
    if owner is None or inspect.isclass(owner):
        return {}
    if isinstance(owner, System):
        return {"context": Fresh(owner.CreateDefaultContext)}
    kind = name.split(".")[0]
    if hasattr(owner, "calc_gradient") and hasattr(owner, "calc_metric"):
        x = PHI if "Inertia" in kind else np.array([[0.3, 0.4], [0.5, 0.6]])
        if kind == "Product":
            x = np.stack([BY_NAME["parameters"], 1.1 * BY_NAME["parameters"]])
        return {"x": x, "y": x[::-1], "v": 0.01 * x, "b": 0.01 * x}
    if kind.endswith("Law"):
        p = BY_NAME["parameters"]
        return {"parameters": p, "truth": p, "b": 0.01 * p, "rows": np.eye(len(p))[:2]}
    return {}


def plain(value):
    """Return a value, which is created first if each call needs a new one."""
    return value.make() if isinstance(value, Fresh) else value


def by_type(annotation):
    """Return a good value of an annotated type; None if none is known."""
    annotation = re.sub(r"<class '(.*)'>", r"\1", annotation)
    for each in re.split(r" \| (?![^\[]*\])", annotation):
        kind = re.sub(r"^(?:geodrake|collections|pathlib)[\w.]*\.", "", each)
        outer, _, inner = kind.partition("[")
        if kind in BY_TYPE:
            return BY_TYPE[kind]()
        if outer == "Callable":
            return BY_TYPE["Callable"]()
        one = None
        if outer in ("Sequence", "Iterable", "tuple") and inner:
            one = by_type(inner.rstrip("]").removesuffix(", ..."))
        if one is not None:
            return Fresh(lambda one=one: (plain(one),)) if isinstance(one, Fresh) else (one,)
        if (found := made(kind)) is not None:
            return found
    return None


def by_kind(annotation):
    """Return a number, words or an array of any size."""
    for words, value in BY_KIND.items():
        if re.search(words, annotation):
            return value
    raise MissingError(annotation)


@cache
def made(kind):
    """Return what an exported class or function creates from good arguments; None if none does."""
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


THINGS = {
    **{"a text": "text", "an object": Anything(), "a dict": {"a": 1.0}, "a function": len},
    **{"bytes": b"1.0", "nothing": None, "a number": 3},
}
"""Values that are wrong for most arguments."""


def spoiled(array, value):
    """Return an array with another value in its last place."""
    found = np.array(array, float)
    found[(-1,) * found.ndim] = value
    return found


def of_array(array):
    must = {
        "NaN at one place": spoiled(array, np.nan), "complex": array + 1j,
        "complex without an imaginary part": array + 0j, "texts": array.astype(str),
        "objects": np.full(array.shape, None),
        "truth values or numbers": 1.0 * array if array.dtype == bool else array > 0,
        "a mask": np.ma.masked_invalid(spoiled(array, np.nan)),
        "a generator": (row for row in np.atleast_1d(array)),
        "dates": np.zeros(array.shape, "M8[s]"), "ragged": [array.tolist(), [0.0]],
        "a number beyond floats": np.full(array.shape, 10**400, object).tolist(),
    }  # fmt: skip
    may = {
        "infinity at one place": spoiled(array, np.inf), "a scalar": 1.0,
        "its first row": array[0] if array.ndim else array, "a further axis": array[None],
        "a further last axis": array[..., None], "negative": -1.0 * array, "zero": 0.0 * array,
        "huge": 1e200 * np.where(array == 0, 1.0, array), "a list": array.tolist(),
        "whole numbers": np.round(array).astype(int), "single precision": array.astype(np.float32),
    }  # fmt: skip
    for axis in range(array.ndim):
        more = np.concatenate([array, array.take([0], axis)], axis)
        may |= {
            f"one more along axis {axis}": more,
            f"one less along axis {axis}": array.take(range(1, array.shape[axis]), axis),
            f"none along axis {axis}": array.take([], axis),
        }
    if array.ndim > 1 and array.shape[-1] == array.shape[-2]:
        may["not symmetric"] = skewed = array.astype(float)
        skewed[..., 0, -1] += 1.0 + np.abs(array).max()
    return must, may


def of_number(number):
    whole = isinstance(number, int | np.integer)
    must = {"NaN": np.nan, "complex": complex(number, 1.0), "a number as text": str(number)}
    must |= {"two numbers": [number, number], "true": True, "beyond floats": 10**400}
    may = {"negative": -1 - number, "zero": 0, "minus infinity": -np.inf}
    if whole:
        must |= {"between whole numbers": number + 0.5, "beyond machine integers": 10**30}
        must["infinity"], may["of NumPy"] = np.inf, np.int64(number)
    else:
        may |= {"huge": 1e300, "tiny": 1e-300, "single": np.float32(number), "infinity": np.inf}
    return must, may


def of_sequence(values):
    nothings = (None,) * max(len(values), 1)
    must = {"of objects": (Anything(),), "of nothings": nothings}
    may = {"empty": (), "a list": list(values), "a generator": (value for value in values)}
    kinds = {type(value) for value in values}
    if kinds == {str}:
        unknown = tuple(f"no {value}" for value in values)
        may |= {"unknown names": unknown, "a name twice": values[:1] + values}
    elif kinds and kinds <= {float, int}:
        must["complex"] = tuple(value + 1j for value in values)
        must |= {"NaN": (np.nan,) * len(values), "texts": tuple(map(str, values))}
        may["negative"] = tuple(-1 - value for value in values)
    return must, may


def of_text(text):
    return {"a list of words": [text]}, {"an unknown word": "no such thing", "an empty word": ""}


def of_path(path):
    return {}, {"no such file": path.parent / "no" / "such.file"}


def of_names(names):
    unknown = {f"no {key}": value for key, value in names.items()}
    objects = dict.fromkeys(names, Anything())
    return ({"unknown names": unknown, "objects": objects} if names else {}), {}


WRONG = (
    (np.ndarray, of_array, ("a number",)),
    (int | float | np.number, of_number, ("a number",)),
    (tuple | list, of_sequence, ()),
    (str, of_text, ("a text",)),
    (Path, of_path, ("a text", "bytes")),
    (dict, of_names, ("a dict",)),
    (Callable, lambda _: ({}, {"an empty list": []}), ("a function",)),
    (object, lambda _: ({}, {"an empty list": []}), ()),
)
"""Class of a good value, a function that returns wrong ones, and things that are good there."""


def wrong_values(value):
    """Yield words, a wrong value, and whether a call must refuse it."""
    _, make, but = next(each for each in WRONG if isinstance(value, each[0]))
    if isinstance(value, bool):
        return
    must, may = ({}, {}) if isinstance(value, np.ndarray) and not value.size else make(value)
    yield from ((w, each, True) for w, each in (THINGS | must).items() if w not in but)
    yield from ((w, each, False) for w, each in may.items())


def wrong_calls(call):
    """Yield argument, words and value of each wrong call, and whether it must be refused."""
    parameters = inspect.signature(call.function).parameters
    for argument, value in call.arguments.items():
        annotation = str(parameters[argument].annotation)
        for words, wrong, must in wrong_values(plain(value)):
            may = re.search(TABLES["may be"].get(words, "$^"), annotation)
            if not (may and words == "nothing") and ((must and not may) or not call.is_slow):
                yield argument, words, wrong, must and not may


def run(call, arguments):
    """Return the result of a call."""
    parameters = inspect.signature(call.function).parameters
    starred = [k for k in arguments if parameters[k].kind is inspect.Parameter.VAR_POSITIONAL]
    more = {key: value for key, value in arguments.items() if key not in starred}
    return call.function(*(arguments[key] for key in starred), **more)


def ended(call, wrong=types.MappingProxyType({}), *, must=False):
    """Return how a call ends, as a class and words."""
    arguments = {k: copied(v) for k, v in call.arguments.items()} | {**wrong}
    before = {k: v.copy() for k, v in arguments.items() if type(v) is np.ndarray}
    try:
        with warnings.catch_warnings(), time_limit(call.name, SECONDS):
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
        end = "believed" if must else "accepted"
        told = str(result)[:80].replace("\n", " ")
        if end == "accepted" and not (
            call.name.endswith(tuple(TABLES["infinite"])) or finite(result)
        ):
            end = "not finite"
    for key, value in before.items():
        if not np.array_equal(value, arguments[key], equal_nan=value.dtype.kind in "fc"):
            return "changed", f"{key} was changed"
    return end, told


def copied(value):
    """Return a copy, so that changes by the call can be seen."""
    value = plain(value)
    return value.copy() if isinstance(value, np.ndarray) else value


def finite(result):
    """Return whether numbers are finite; fields of objects may be infinite."""
    if isinstance(result, np.ndarray | float | complex | np.number):
        array = np.asarray(result)
        return array.dtype.kind not in "fc" or bool(
            np.isrealobj(array) and np.isfinite(array).all()
        )
    return all(map(finite, result)) if isinstance(result, tuple | list) else True


def _where(error):
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/geodrake/" in f.filename]
    at = f"{Path(frames[-1].filename).name}:{frames[-1].lineno} " if frames else ""
    return f"{at}{type(error).__name__}: {str(error)[:150]}"


def outcomes(call) -> Iterator[tuple[str, str, str, str]]:
    """Yield argument, wrong value, end and words of every wrong call of a function."""
    for argument, words, wrong, must in wrong_calls(call):
        yield argument, words, *ended(call, {argument: wrong}, must=must)
