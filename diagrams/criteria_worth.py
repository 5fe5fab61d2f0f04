"""What the numbers that decide what is found are worth: each halved and doubled.

Logs of the benchmark of hidden effects, one effect or two in each, are explained with every number
of `geodrake.identification.logs.criteria` at half its value, as it is, and at twice, each alone. A
number that changes no answer was not fitted to a log.

    python diagrams/criteria_worth.py --seed 91 --json criteria_worth.json
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from inspect import isfunction
from typing import Any

import numpy as np
from adaptive.options import make_parser, positive_number, run_draws, show, write_json
from hidden.draws import ONE, TWO, Draw, all_draws
from hidden.scoring import score_draw
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Console

from geodrake.identification.logs import criteria
from geodrake.identification.logs.criteria import Criteria
from geodrake.report import style

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


def shown(value: Any) -> str:
    """A number, or several, in three digits; nothing for none."""
    several = value if isinstance(value, tuple) else () if value is None else (value,)
    return ", ".join(f"{v:.3g}" for v in several)


@contextmanager
def with_number(name: str, factor: float) -> Iterator[None]:
    """A criterion multiplied by a factor, wherever it was imported."""
    if not name:
        yield
        return
    value = numbers()[name]
    new = changed(value, factor)
    geodrakes = [module for key, module in list(sys.modules.items()) if key.startswith("geodrake.")]
    init: Any = Criteria.__init__
    before, own = init.__defaults__, [field.name for field in fields(Criteria)]
    if name in own:
        k = own.index(name)
        init.__defaults__ = (*before[:k], new, *before[k + 1 :])
        setattr(Criteria, name, new)
    modules = [m for m in geodrakes if name in own or getattr(m, name, None) == value]
    _exchange(modules, name, value, new)
    try:
        yield
    finally:
        _exchange(modules, name, new, value)
        init.__defaults__ = before
        if name in own:
            setattr(Criteria, name, value)


def _exchange(modules: Sequence[Any], name: str, old: Any, new: Any) -> None:
    """Another value in modules that have it, and where it is the default of an argument there."""
    for module in modules:
        if hasattr(module, name):
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


def trials(seed: int, logs: int, *, quick: bool) -> list[Trial]:
    """All of them, those with the numbers as they are first, of so many logs drawn at random."""
    short = {"robot": "double_pendulum", "duration": 8.0, "rate": 100.0} if quick else {}
    more = {"effects": ("coulomb_friction", "payload"), "outside": ()} if quick else {}
    draws = [d for d in all_draws(1, seed, **more, **short) if d.case in (ONE, TWO)]
    order = np.random.default_rng(seed).permutation(len(draws))
    draws = [draws[k] for k in order[: 1 if quick else logs]]
    names = _QUICK if quick else tuple(numbers())
    shifts = [(n, f) for n in names for f in FACTORS if not (n in _SHARES and f > 1.0)]
    return [Trial(name, factor, draw) for name, factor in [("", 1.0), *shifts] for draw in draws]


def table(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line a number: how many logs are right, and how many answers are others."""
    found = {(row["name"], row["factor"], str(row["draw"])): row for row in rows}
    values, lines = numbers(), []
    for name in dict.fromkeys(row["name"] for row in rows):
        line: dict[str, Any] = {"number": name or "as they are", "value": shown(values.get(name))}
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
    parser.add_argument("--logs", type=positive_number, default=14, metavar="N", help="logs")
    options = parser.parse_args()
    wanted = trials(options.seed, options.logs, quick=options.quick)
    rows = run_draws(parser, options, run_trial, wanted)
    lines = table(rows)
    columns = {"number": "", "value": "", "× 1": ""}
    columns |= {key: "" for f in FACTORS for key in (f"× {f:g}", f"others at × {f:g}")}
    show(Console(width=120), "What the criteria are worth: logs that are right", columns, lines)
    write_json(options.json, {"lines": lines, "rows": rows})
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        changes_figure(lines).savefig(options.figures / "criteria_worth.png")


def changes_figure(lines: Sequence[dict[str, Any]]) -> Figure:
    """How many answers each number changes, halved and doubled."""
    named = [line for line in lines if line["value"]]
    figure = style.new_figure(1.1 + 0.27 * len(named))
    axes = figure.subplots()
    for k, (factor, colour) in enumerate(zip(FACTORS, (style.AFTER, style.BEFORE), strict=True)):
        counts = [line.get(f"others at × {factor:g}", 0) for line in named]
        places = np.arange(len(named)) + 0.4 * (k - 0.5)
        axes.barh(places, counts, height=0.36, color=colour, label=f"× {factor:g}")
    axes.set_yticks(range(len(named)), [f"{line['number']} = {line['value']}" for line in named])
    axes.set_ylim(len(named) - 0.4, -0.6)
    most = max((max(p.get_width() for p in bars) for bars in axes.containers), default=0)
    axes.set_xlim(0, max(1, most))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.polish(axes, grid="x")
    axes.legend(frameon=False)
    title = "Logs whose answer changes with a criterion"
    axes.set_title(title, loc="left", **style.plain(fontweight="bold"))
    return figure


if __name__ == "__main__":
    main()
