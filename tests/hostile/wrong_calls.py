"""Wrong calls of every public function: one argument at a time, of a good call, is spoiled.

    python tests/hostile/wrong_calls.py [--json FILE] [--only WORDS] [--show]

counts how they end. The good calls are in `good_calls.py`.
"""

import argparse
import inspect
import itertools
import json
import os
import pathlib
import signal
import sys
import traceback
import types
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, is_dataclass

import numpy as np
from good_calls import Free, Fresh, good_calls

from geodrake.errors import GeodrakeError

SECONDS = 20
CLASSES = {
    "own error": "the library's own error",
    "ValueError": "a bare ValueError",
    "inside": "a TypeError, IndexError, AttributeError or KeyError from inside",
    "ended": "the end of the process",
    "other": "any other exception",
    "not finite": "NaN or infinity in the result",
    "warning": "a warning",
    "believed": "what cannot be right was taken for something else",
    "changed": "an argument was changed",
    "accepted": "a finite result of what can be taken",
}
HELD = ("own error", "accepted")
INSIDE = (TypeError, IndexError, AttributeError, KeyError)


class Anything:
    """An object that is nothing that a function could want."""

    def __repr__(self):
        return "Anything()"


@dataclass(frozen=True)
class Wrong:
    """A wrong value of an argument; `must` is whether it cannot be right."""

    words: str
    value: object
    must: bool = True


@dataclass(frozen=True)
class Outcome:
    """How a call with a wrong argument ended."""

    call: str
    argument: str
    words: str
    end: str
    told: str

    def __str__(self):
        return f"{self.call}({self.argument} = {self.words}): {self.end}: {self.told}"


def anything_else(*but):
    """Things of a wrong kind."""
    found = {
        "a text": "text",
        "an object": Anything(),
        "a dict": {"a": 1.0},
        "a function": len,
        "bytes": b"1.0",
    }
    return [Wrong(words, value) for words, value in found.items() if words not in but]


def at_one_place(array, value):
    spoiled = np.array(array, float)
    spoiled[(-1,) * spoiled.ndim] = value
    return spoiled


def wrong_arrays(array) -> Iterator[Wrong]:
    yield from anything_else()
    if not array.size:
        return
    yield Wrong("NaN at one place", at_one_place(array, np.nan))
    yield Wrong("infinity at one place", at_one_place(array, np.inf), must=False)
    yield Wrong("complex", array + 1j)
    yield Wrong("complex without an imaginary part", array + 0j)
    yield Wrong("texts", array.astype(str))
    yield Wrong("objects", np.full(array.shape, None))
    yield Wrong("truth values", array > 0)
    yield Wrong("a mask", np.ma.masked_invalid(at_one_place(array, np.nan)))
    yield Wrong("a generator", (row for row in np.atleast_1d(array)))
    yield Wrong("dates", np.zeros(array.shape, "M8[s]"))
    yield Wrong("a number beyond floats", (np.full(array.shape, 10**400, object)).tolist())
    if array.ndim:
        yield Wrong("ragged", [array.tolist(), [0.0]])
        yield Wrong("its first row", array[0], must=False)
        yield Wrong("nothing", None)
    yield Wrong("a further axis", array[None], must=False)
    yield Wrong("a further last axis", array[..., None], must=False)
    for axis in range(array.ndim):
        more = np.concatenate([array, array.take([0], axis)], axis)
        yield Wrong(f"one more along axis {axis}", more, must=False)
        less = array.take(range(1, array.shape[axis]), axis)
        yield Wrong(f"one less along axis {axis}", less, must=False)
        yield Wrong(f"none along axis {axis}", array.take([], axis), must=False)
    if array.ndim > 1 and array.shape[-1] == array.shape[-2]:
        skewed = array.copy()
        skewed[..., 0, -1] += 1.0 + np.abs(array).max()
        yield Wrong("not symmetric", skewed, must=False)
    for words, value in (
        ("negative", -array),
        ("zero", 0.0 * array),
        ("huge", 1e200 * np.where(array == 0, 1.0, array)),
        ("a list", array.tolist()),
        ("whole numbers", np.round(array).astype(int)),
        ("single precision", array.astype(np.float32)),
        ("a scalar", 1.0),
    ):
        yield Wrong(words, value, must=False)


def wrong_numbers(number, *, whole) -> Iterator[Wrong]:
    yield from anything_else()
    yield Wrong("NaN", np.nan)
    yield Wrong("complex", complex(number, 1.0))
    yield Wrong("a number as text", str(number))
    yield Wrong("two numbers", [number, number])
    yield Wrong("true", True)
    yield Wrong("beyond floats", 10**400)
    yield Wrong("nothing", None)
    if whole:
        yield Wrong("between whole numbers", number + 0.5)
        yield Wrong("beyond machine integers", 10**30)
        yield Wrong("of NumPy", np.int64(number), must=False)
    yield Wrong("infinity", np.inf, must=whole)
    for words, value in (("negative", -1 - number), ("zero", 0), ("minus infinity", -np.inf)):
        yield Wrong(words, value, must=False)
    if not whole:
        for words, value in (("huge", 1e300), ("tiny", 1e-300), ("single", np.float32(number))):
            yield Wrong(words, value, must=False)


def wrong_sequences(values) -> Iterator[Wrong]:
    yield from anything_else()
    yield Wrong("a number", 3)
    yield Wrong("nothing", None)
    yield Wrong("empty", (), must=False)
    yield Wrong("of objects", (Anything(),))
    yield Wrong("of nothings", (None,) * max(len(values), 1))
    yield Wrong("a list", list(values), must=False)
    yield Wrong("a generator", (value for value in values), must=False)
    if values and all(isinstance(value, str) for value in values):
        yield Wrong("unknown names", tuple(f"no {value}" for value in values), must=False)
        yield Wrong("a name twice", (*values[:1], *values), must=False)
    if values and all(isinstance(value, float | int) for value in values):
        yield Wrong("complex", tuple(value + 1j for value in values))
        yield Wrong("NaN", (np.nan,) * len(values))
        yield Wrong("texts", tuple(map(str, values)))
        yield Wrong("negative", tuple(-1 - value for value in values), must=False)


def wrong_values(value) -> Iterator[Wrong]:
    """Wrong values in the place of a good one."""
    if isinstance(value, np.ndarray):
        yield from wrong_arrays(value)
    elif isinstance(value, bool):
        return
    elif isinstance(value, int | np.integer):
        yield from wrong_numbers(value, whole=True)
    elif isinstance(value, float):
        yield from wrong_numbers(value, whole=False)
    elif isinstance(value, Free):
        yield from anything_else("a text")
        yield Wrong("nothing", None)
    elif isinstance(value, str):
        yield from anything_else("a text")
        yield Wrong("an unknown word", "no such thing", must=False)
        yield Wrong("an empty word", "", must=False)
        yield Wrong("a number", 3)
        yield Wrong("a list of words", [value])
        yield Wrong("nothing", None)
    elif isinstance(value, tuple | list):
        yield from wrong_sequences(value)
    elif isinstance(value, pathlib.Path):
        yield from anything_else("a text", "bytes")
        yield Wrong("a number", 3)
        yield Wrong("no such file", value.parent / "no" / "such.file", must=False)
    elif isinstance(value, dict):
        yield from anything_else("a dict")
        yield Wrong("a number", 3)
        yield Wrong("unknown names", {f"no {key}": each for key, each in value.items()})
        yield Wrong("objects", dict.fromkeys(value, Anything()))
        yield Wrong("nothing", None)
    else:
        ways = ("a function",) if callable(value) else ()
        yield from anything_else(*ways)
        yield Wrong("a number", 3)
        yield Wrong("an empty list", [], must=False)
        yield Wrong("nothing", None)


def given(value):
    """What a call gets: a copy, so that what it changes can be seen."""
    if isinstance(value, Fresh):
        return value.make()
    if isinstance(value, Free):
        return value.text
    return value.copy() if isinstance(value, np.ndarray) else value


def finite(result, depth=0):
    """Whether every number of a result is one."""
    if isinstance(result, np.ndarray | float | complex | np.number):
        return np.asarray(result).dtype.kind not in "fc" or bool(
            np.isrealobj(result) and np.isfinite(result).all()
        )
    if isinstance(result, dict):
        parts = result.values()
    elif is_dataclass(result) and not isinstance(result, type):
        parts = [getattr(result, f.name) for f in fields(result)]
    else:
        parts = result if isinstance(result, tuple | list | types.GeneratorType) else ()
    return depth > 3 or all(finite(each, depth + 1) for each in parts)


class HangError(BaseException):
    """A call that did not end."""


def _hang(*_):
    raise HangError


def ended(call, arguments, *, must):
    """How a call ends: a class and words."""
    before = {key: value.copy() for key, value in arguments.items() if type(value) is np.ndarray}
    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = call.function(**arguments)
            sound = call.infinite or finite(result)
    except GeodrakeError as error:
        end, told = "own error", f"{type(error).__name__}: {error}"
    except Warning as error:
        end, told = "warning", repr(error)
    except INSIDE as error:
        end, told = "inside", _where(error)
    except ValueError as error:
        end, told = "ValueError" if type(error) is ValueError else "other", _where(error)
    except (Exception, HangError) as error:
        end, told = "other", _where(error)
    else:
        end = "accepted" if not must else "believed"
        told = str(result)[:80].replace("\n", " ")
        end = end if sound else "not finite"
    finally:
        signal.alarm(0)
    for key, value in before.items():
        if not _same(value, arguments[key]):
            return "changed", f"{key} was changed"
    return end, told


def _same(first, second):
    if first.dtype.kind in "fc":
        return np.array_equal(first, second, equal_nan=True)
    return first.shape == second.shape


def _where(error):
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "geodrake" in f.filename]
    at = f"{pathlib.Path(frames[-1].filename).name}:{frames[-1].lineno} " if frames else ""
    return f"{at}{type(error).__name__}: {str(error)[:150]}"


def outcomes(name, call, skipped=0) -> Iterator[Outcome]:
    """How every wrong call of a function ends, after the first ones."""
    for argument, wrong in itertools.islice(wrong_calls(call), skipped, None):
        arguments = {key: given(each) for key, each in call.arguments.items()}
        arguments[argument] = wrong.value
        must = wrong.must and wrong.words not in call.allows.get(argument, ())
        yield Outcome(name, argument, wrong.words, *ended(call, arguments, must=must))


def wrong_calls(call) -> Iterator[tuple[str, Wrong]]:
    """Every argument with every wrong value."""
    signature = inspect.signature(call.function)
    for argument, value in call.arguments.items():
        if argument in call.trusted:
            continue
        sample = value.make() if isinstance(value, Fresh) else value
        parameter = signature.parameters.get(argument)
        default = parameter.default if parameter is not None else inspect.Parameter.empty
        for wrong in wrong_values(sample):
            if call.slow and not wrong.must:
                continue
            if wrong.value is None and default is None:
                continue
            yield argument, wrong


def outcomes_apart(name, call):
    """The same in processes of their own: some calls once ended theirs."""
    found = []
    while True:
        reading, writing = os.pipe()
        sys.stdout.flush()
        child = os.fork()
        if not child:
            os.close(reading)
            with os.fdopen(writing, "w", encoding="utf-8") as pipe:
                for outcome in outcomes(name, call, len(found)):
                    print(json.dumps(asdict(outcome)), file=pipe, flush=True)
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading, encoding="utf-8") as pipe:
            found += [Outcome(**json.loads(line)) for line in pipe]
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status == 0:
            return found
        argument, wrong = next(itertools.islice(wrong_calls(call), len(found), None))
        found.append(Outcome(name, argument, wrong.words, "ended", f"exit code {status}"))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--only", default="")
    parser.add_argument("--show", action="store_true", help="every call that does not end well")
    options = parser.parse_args()
    found = []
    for name, call in good_calls().items():
        if options.only in name:
            found += outcomes_apart(name, call)
    counts = Counter(outcome.end for outcome in found)
    if options.show:
        print(*(outcome for outcome in found if outcome.end not in HELD), sep="\n")
    for end, words in CLASSES.items():
        print(f"{counts[end]:6d}  {words}")
    print(f"{len(found):6d}  wrong calls")
    if options.json:
        table = {"calls": len(found), **{end: counts[end] for end in CLASSES}}
        pathlib.Path(options.json).write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
