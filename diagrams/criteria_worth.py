"""What the numbers that decide what is found are worth: each halved and doubled.

Logs of the benchmark of hidden effects, one effect or two in each, are explained with every number
of `geodrake.identification.logs.criteria` at half its value, as it is, and at twice. A number that
changes no answer is no number that was fitted to a log; one that changes many is said to be so.

    python diagrams/criteria_worth.py --seed 91 --json criteria_worth.json
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from inspect import isfunction
from typing import Any

from adaptive.options import make_parser, run_draws, show, write_json
from hidden.draws import ONE, TWO, Draw, all_draws
from hidden.scoring import score_draw
from rich.console import Console

from geodrake.identification.logs import criteria
from geodrake.identification.logs.criteria import Criteria

FACTORS = (0.5, 2.0)
_QUICK = ("PENALTY", "agreement")
_SHARES = ("agreement", "MORE_THAN_HALF")  # twice as much would be more than all


@dataclass(frozen=True)
class Trial:
    """One log with one number changed.

    Attributes:
        name: The number; empty for none.
        factor: What it is multiplied by.
        draw: The log.
    """

    name: str
    factor: float
    draw: Draw


def numbers() -> dict[str, Any]:
    """All criteria with their values."""
    found = {field.name: field.default for field in fields(Criteria)}
    return found | {name: value for name, value in vars(criteria).items() if name.isupper()}


def changed(value: Any, factor: float) -> Any:
    """A number, or each of several, times a factor."""
    return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value


@contextmanager
def with_number(name: str, factor: float) -> Iterator[None]:
    """A criterion multiplied by a factor, wherever it was imported."""
    if not name:
        yield
        return
    value = numbers()[name]
    new = changed(value, factor)
    if name.islower():
        init: Any = Criteria.__init__
        before = init.__defaults__
        at = [field.name for field in fields(Criteria)].index(name)
        init.__defaults__ = (*before[:at], new, *before[at + 1 :])
        try:
            yield
        finally:
            init.__defaults__ = before
        return
    modules = [
        module
        for key, module in list(sys.modules.items())
        if key.startswith("geodrake.") and getattr(module, name, None) == value
    ]
    _exchange(modules, name, value, new)
    try:
        yield
    finally:
        _exchange(modules, name, new, value)


def _exchange(modules: Sequence[Any], name: str, old: Any, new: Any) -> None:
    """Another value in modules that have it, and where it is the default of an argument there."""
    for module in modules:
        setattr(module, name, new)
        for function in filter(isfunction, vars(module).values()):
            if function.__module__ == module.__name__:
                defaults, by_name = function.__defaults__, function.__kwdefaults__
                if defaults:
                    function.__defaults__ = tuple(new if d is old else d for d in defaults)
                if by_name:
                    by_name.update({k: new for k, d in by_name.items() if d is old})


def run_trial(trial: Trial, *, seed: int) -> dict[str, Any]:
    """What is found, and whether it is right."""
    del seed
    with with_number(trial.name, trial.factor):
        row = score_draw(trial.draw)
    return {
        "name": trial.name,
        "factor": trial.factor,
        "draw": asdict(trial.draw),
        "found": sorted([step["effect"], *step["where"]] for step in row["steps"]),
        "right": bool(row["in_set"]) and row["placed"] is not False,
        "extra": bool(row["extra"]),
    }


def trials(seed: int, *, quick: bool) -> list[Trial]:
    """All of them, those with the numbers as they are first."""
    short = {"robot": "double_pendulum", "duration": 12.0, "rate": 100.0} if quick else {}
    more = {"effects": ("coulomb_friction", "payload"), "outside": ()} if quick else {}
    draws = [d for d in all_draws(1, seed, **more, **short) if d.case in (ONE, TWO)]
    draws = draws[:2] if quick else draws
    names = _QUICK if quick else tuple(numbers())
    shifts = [(n, f) for n in names for f in FACTORS if not (n in _SHARES and f > 1.0)]
    return [Trial(name, factor, draw) for name, factor in [("", 1.0), *shifts] for draw in draws]


def table(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line a number: how many logs are right, and how many answers are others."""
    found = {(row["name"], row["factor"], str(row["draw"])): row for row in rows}
    values, lines = numbers(), []
    for name in dict.fromkeys(row["name"] for row in rows):
        line: dict[str, Any] = {"number": name or "as they are", "value": str(values.get(name, ""))}
        for factor in FACTORS if name else (1.0,):
            own = [row for key, row in found.items() if key[:2] == (name, factor)]
            if own:
                others = [row["found"] != found["", 1.0, str(row["draw"])]["found"] for row in own]
                line[f"× {factor:g}"] = f"{sum(row['right'] for row in own)} of {len(own)}"
                line[f"others at × {factor:g}"] = sum(others)
        lines.append(line)
    return lines


def main() -> None:
    """Run the study from the command line."""
    parser = make_parser(__doc__)
    options = parser.parse_args()
    rows = run_draws(parser, options, run_trial, trials(options.seed, quick=options.quick))
    lines = table(rows)
    columns = {"number": "", "value": "", "× 1": ""}
    columns |= {key: "" for f in FACTORS for key in (f"× {f:g}", f"others at × {f:g}")}
    show(Console(width=120), "What the criteria are worth: logs that are right", columns, lines)
    write_json(options.json, {"lines": lines, "rows": rows})


if __name__ == "__main__":
    main()
