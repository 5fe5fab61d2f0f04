"""Common parts of all scripts: options, resumable draws, times, tables, and charts.

Run scripts from the folder above: python -m diagrams.benchmarks.hidden_effects --quick
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict, is_dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table

from geodrake.logs import JointLog
from geodrake.report import style

MODELS = Path(__file__).parents[1] / "models"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
VERSION = 2
"""Version of cached draws; increase it to invalidate those of older versions."""
JOBS = min(2, os.cpu_count() or 1)

SHADES = (style.AFTER, style.BEFORE, style.FLOOR, *(f"C{k}" for k in range(3, 10)))
_BESIDE = 3  # panels in a row

_PEAK = """
import resource, sys
from pathlib import Path
status, used = Path("/proc/self/status"), resource.getrusage
peak = used(resource.RUSAGE_SELF).ru_maxrss * (1e-3 if sys.platform == "darwin" else 1.0)
if status.exists():  # Linux hands a parent's ru_maxrss on to its children, but not its VmHWM
    peak = next(float(line.split()[1]) for line in status.open() if line.startswith("VmHWM"))
print(max(peak, used(resource.RUSAGE_CHILDREN).ru_maxrss) * 1024)
"""


# Options


def whole_number(text: str, least: int = 0) -> int:
    """Parse an integer from `least` on for the command line."""
    number = int(text)
    if number < least:
        raise argparse.ArgumentTypeError(f"{number} is below {('zero', 'one')[least]}")
    return number


positive_number = partial(whole_number, least=1)


def script_parser(
    doc: str,
    quick: str = "a few seconds, for a first look",
    *,
    draws: bool = False,
    figures: bool = False,
) -> argparse.ArgumentParser:
    """Return a parser with the options of all scripts.

    Args:
        draws: Whether the script has draws, run in several processes and cached in a file.
        figures: Whether the script makes figures.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--seed", type=whole_number, default=0)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    if figures:
        parser.add_argument("--figures", type=Path, help="folder for figures")
    if draws:
        jobs = f"processes ({JOBS}; 1 with --quick)"
        parser.add_argument("--jobs", "--workers", type=positive_number, help=jobs)
        parser.add_argument("--cache", type=Path, help="file of draws (beside that of --json)")
    return parser


def write(
    options: argparse.Namespace, table: Any, **figures: Callable[[], Figure | Mapping[str, Figure]]
) -> None:
    """Write the requested numbers and figures."""
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(plain(table), indent=1) + "\n", encoding="utf-8")
    if figures and options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        for name, draw in figures.items():
            drawn = draw()
            several = drawn if isinstance(drawn, Mapping) else {name: drawn}
            for each, figure in several.items():
                figure.savefig(options.figures / f"{each}.png")


def tell(options: argparse.Namespace, table: Any) -> None:
    """Print the numbers, and write them if requested."""
    print(json.dumps(plain(table), indent=2))
    write(options, table)


def plain(table: Any) -> Any:
    """Convert dataclasses and arrays in a table to types of JSON."""
    if is_dataclass(table) and not isinstance(table, type):
        return asdict(table)
    if isinstance(table, Mapping):
        return {str(name): plain(value) for name, value in table.items()}
    if isinstance(table, np.ndarray | np.generic):
        return table.tolist()
    return [plain(each) for each in table] if isinstance(table, list | tuple) else table


def show(title: str, lines: Sequence[Mapping[str, Any]], *names: str) -> None:
    """Print lines as a table, nested tables included; or the columns of some names."""
    flat = [_flat(line) for line in lines]
    names = names or tuple(dict.fromkeys(name for line in flat for name in line))
    table = Table(*names, title=title, title_justify="left")
    for line in flat:
        table.add_row(*(_shown(line.get(name)) for name in names))
    Console(width=max(120, Console().width, 14 * len(names))).print(table)


def show_values(title: str, values: Mapping[str, Any]) -> None:
    """Print named values, or named tables of values."""
    lines = ((k, v if isinstance(v, Mapping) else {"value": v}) for k, v in values.items())
    show(title, [{"figure": name, **line} for name, line in lines])


def _flat(line: Mapping[str, Any]) -> dict[str, Any]:
    """Return the scalars of a line and of the tables in it."""
    flat: dict[str, Any] = {}
    for name, value in plain(line).items():
        items = value.items() if isinstance(value, dict) else ((None, value),)
        for key, scalar in items:
            if scalar is None or isinstance(scalar, str | int | float):
                flat[name if key is None else f"{name} {key}"] = scalar
    return flat


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def first_samples(log: JointLog, count: int) -> JointLog:
    """Return the first samples of a log."""
    names = ("time", "position", "velocity", "effort", "acceleration")
    signals = {name: getattr(log, name) for name in names}
    return replace(log, **{name: x[:count] for name, x in signals.items() if x is not None})


def sines(
    time: np.ndarray, size: np.ndarray, rate: np.ndarray, phase: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Σ size sin(rate t + phase) (N, n) over k sines (k, n), and its two derivatives."""
    angle = rate * time[:, None, None] + phase
    q, v = (size * np.sin(angle)).sum(1), (size * rate * np.cos(angle)).sum(1)
    return q, v, -(size * rate**2 * np.sin(angle)).sum(1)


# Draws


def run_draws(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    task: Callable[[Any], Any],
    draws: Sequence[Any],
    **key: Any,
) -> list[Any]:
    """Return the results of a task for all draws, cached ones from the file of an earlier run.

    The task is picklable, and returns values of JSON. `key` has further settings of the run.
    """
    cache = options.cache or (options.json and options.json.with_suffix(".draws.jsonl"))
    study = Path(parser.prog).stem.rpartition(".")[2]
    run_key = {"version": VERSION, "study": study, "seed": options.seed, **key}
    run_key = json.loads(json.dumps(run_key))
    done = {name_of(line["draw"]): line["rows"] for line in _kept(cache) if line["key"] == run_key}
    missing = [draw for draw in draws if name_of(draw) not in done]
    results = finished(task, missing, options.jobs or (1 if options.quick else JOBS))
    try:
        for draw, rows in track(results, "draws", len(missing), transient=True):
            # Read back from JSON, so that a resumed run gives identical digits.
            line = json.dumps({"key": run_key, "draw": plain(draw), "rows": rows})
            done[name_of(draw)] = json.loads(line)["rows"]
            if cache is not None:
                cache.parent.mkdir(parents=True, exist_ok=True)
                with cache.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")
    except KeyboardInterrupt:
        where = f"Finished draws are in {cache}; run the same command to resume." if cache else ""
        parser.exit(130, f"Interrupted. {where}\n")
    return [done[name_of(draw)] for draw in draws]


def _kept(cache: Path | None) -> Iterator[dict[str, Any]]:
    """Yield the lines of a cache if it exists, without truncated ones."""
    if cache is not None and cache.is_file():
        for line in cache.read_text(encoding="utf-8").splitlines():
            with suppress(json.JSONDecodeError):
                yield json.loads(line)


def name_of(draw: Any) -> str:
    """Return a draw as text."""
    return json.dumps(plain(draw), sort_keys=True)


def finished(
    task: Callable[[Any], Any], draws: Sequence[Any], workers: int
) -> Iterator[tuple[Any, Any]]:
    """Yield draws and their results as they finish, computed by several processes."""
    if workers < 2:
        yield from ((draw, task(draw)) for draw in draws)
        return
    os.environ.update(ONE_THREAD)  # spawned processes read it before importing numpy
    quietly = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_DFL)}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), **quietly) as pool:
        futures = {pool.submit(task, draw): draw for draw in draws}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


# Times and memory


def cpu_clock() -> float:
    """Return the CPU time of this process and its finished children, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def cpu_time(work: Callable[[], object]) -> float:
    """Return the CPU time of a call, s."""
    begin = cpu_clock()
    work()
    return cpu_clock() - begin


def cpu_times(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Return CPU times, s, of alternating calls, after one call each to warm up."""
    for work in works.values():
        work()
    rounds = [{name: cpu_time(work) for name, work in works.items()} for _ in range(repeats)]
    return {name: [times[name] for times in rounds] for name in works}


def medians(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the medians of `cpu_times`."""
    return {name: float(np.median(times)) for name, times in cpu_times(works, repeats).items()}


def peak_memory(code: str, *arguments: object) -> tuple[float, list[str]]:
    """Return the peak memory, bytes, of a process that runs some code, and the lines it prints.

    The memory includes Python and all libraries, on one thread.
    """
    command = [sys.executable, "-c", code + _PEAK, *map(str, arguments)]
    here = os.pathsep.join([str(MODELS.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": here}
    run = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    *lines, peak = run.stdout.splitlines()
    return float(peak), lines


def chart(
    rows: Sequence[Mapping[str, Any]],
    x: str,
    ys: str | Sequence[str],
    by: str = "",
    *,
    panel: str = "",
    levels: Mapping[str, Mapping[str, Any]] | None = None,
    joined: bool = True,
    note: str = "",
) -> Figure:
    """Draw columns of rows over column x, in a panel for each and for each value of `panel`.

    Each value of column `by` has a color. Words in column x give bars. A list is a line of its
    own, over the list x or, without one, its indices. `NAME_deviation` gives error bars. `levels`
    are rows by name whose values are lines across a panel.
    """
    names = (ys,) if isinstance(ys, str) else tuple(ys)
    kinds, parts = (list(dict.fromkeys(row.get(key) for row in rows)) for key in (by, panel))
    has_words = bool(x) and isinstance(rows[0][x], str)
    places = list(dict.fromkeys(row[x] for row in rows)) if has_words else []
    cells = [(part, name) for part in parts for name in names]
    beside = min(len(cells), _BESIDE)
    height = 0.9 + 0.05 * len(places) * (len(kinds) + 3) if has_words else 3.4
    figure = style.new_figure(height * -(-len(cells) // beside))
    axes = figure.subplots(
        -(-len(cells) // beside), beside, squeeze=False, sharey=has_words
    ).ravel()
    for ax in axes[len(cells) :]:
        ax.set_axis_off()
    for ax, (part, name) in zip(axes, cells, strict=False):
        title = ", ".join(_word(each) for each in (name, part) if each not in (None, ""))
        style.polish(ax)
        ax.set_title(style.label(title, 60), loc="left", **style.plain(fontweight="bold"))
        ax.set_xlabel("" if has_words else _word(x), **style.plain(style.SMALL, style.QUIET))
        panel_rows = [row for row in rows if row.get(panel) == part and row.get(name) is not None]
        for k, kind in enumerate(kinds):
            look = {"color": SHADES[k % len(SHADES)], "label": _word(kind)}
            drawn = [row for row in panel_rows if row.get(by) == kind]
            if has_words:
                width = 0.8 / len(kinds)
                at = [places.index(row[x]) + width * (k + 0.5) - 0.4 for row in drawn]
                errors = [row.get(f"{name}_deviation", 0.0) for row in drawn]
                look |= {"xerr": errors, "ecolor": style.INK} if any(errors) else {}
                ax.barh(at, [row[name] for row in drawn], 0.9 * width, **look)
            else:
                _draw_lines(ax, drawn, x, name, joined=joined, **look)
        for (level, row), dashes in zip((levels or {}).items(), ("--", ":", "-."), strict=False):
            across = {"color": style.QUIET, "linestyle": dashes, "linewidth": 1.2, "label": level}
            if row.get(name) is not None:
                (ax.axvline if has_words else ax.axhline)(row[name], **across)
        _scale(ax, "x" if has_words else "y", [row.get(name) for row in rows], 50.0)
        if not has_words and x != "time":
            _scale(ax, "x", [row.get(x) for row in panel_rows], 20.0)
    if has_words:
        axes[0].set_yticks(range(len(places)), [_word(place) for place in places])
        axes[0].invert_yaxis()
    shown = {line.get_label(): line for ax in axes for line in ax.get_legend_handles_labels()[0]}
    style.legend_above(figure, [line for label, line in shown.items() if label])
    style.note_below(figure, note)
    return figure


def _draw_lines(
    ax: Axes, rows: Sequence[Mapping[str, Any]], x: str, name: str, *, joined: bool, **look: Any
) -> None:
    """Draw lists as lines, and numbers as points with error bars."""
    for row in rows:
        if isinstance(row[name], list):
            values = [np.nan if y is None else y for y in row[name]]
            ax.plot(row[x] if x else range(1, len(values) + 1), values, lw=1.1, **look)
    points = [row for row in rows if not isinstance(row[name], list)]
    if points:
        values = np.array([row[name] for row in points])
        error = np.array([row.get(f"{name}_deviation", 0.0) for row in points])
        # Logarithmic axes exclude zero.
        errors = [np.minimum(error, 0.9 * np.abs(values)), error] if error.any() else None
        marks = {"fmt": "o-" if joined else "o", "markersize": 3.5, "capsize": 2}
        ax.errorbar([row[x] for row in points], values, errors, lw=1.2, **marks, **look)


def _word(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return "" if value is None else str(value).replace("_", " ")


def _scale(ax: Axes, axis: str, values: Sequence[Any], most: float) -> None:
    """Make an axis logarithmic if values are positive, and their ratio exceeds `most`."""
    flat = np.hstack([[], *(np.array(each, float) for each in values if each is not None)])
    flat = flat[np.isfinite(flat)]
    if len(flat) and 0.0 < most * flat.min() < flat.max():
        style.log_scale(ax, axis)
    else:
        ax.locator_params(axis=axis, nbins=6)
