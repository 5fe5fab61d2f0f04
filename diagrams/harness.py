"""One frame for all scripts: options, draws that go on where they broke off, times, tables, charts.

Scripts are started from the folder above: python -m diagrams.benchmarks.hidden_effects --quick
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
"""Of what a draw is; one more when kept draws of older versions must not be used."""
JOBS = min(2, os.cpu_count() or 1)

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
    """Return a whole number from zero on, of the command line."""
    number = int(text)
    if number < least:
        raise argparse.ArgumentTypeError(f"{number} is below {('zero', 'one')[least]}")
    return number


positive_number = partial(whole_number, least=1)


def script_parser(
    doc: str, quick: str = "a few seconds, for a first look", *, draws: bool = False
) -> argparse.ArgumentParser:
    """Return a parser with the options that all scripts have.

    Args:
        draws: Whether there are draws, which processes share and a file keeps.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--seed", type=whole_number, default=0)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for figures")
    if draws:
        jobs = f"processes ({JOBS}; 1 with --quick)"
        parser.add_argument("--jobs", "--workers", type=positive_number, help=jobs)
        parser.add_argument("--cache", type=Path, help="file of draws (beside that of --json)")
    return parser


def write(
    options: argparse.Namespace, table: Any, **figures: Callable[[], Figure | Mapping[str, Figure]]
) -> None:
    """Write the numbers and the figures, by name, that were asked for."""
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(plain(table), indent=1) + "\n", encoding="utf-8")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        for name, draw in figures.items():
            drawn = draw()
            several = drawn if isinstance(drawn, Mapping) else {name: drawn}
            for each, figure in several.items():
                figure.savefig(options.figures / f"{each}.png")


def tell(
    options: argparse.Namespace, table: Any, **figures: Callable[[], Figure | Mapping[str, Figure]]
) -> None:
    """Print the numbers, and write what was asked for."""
    print(json.dumps(plain(table), indent=2))
    write(options, table, **figures)


def plain(table: Any) -> Any:
    """Return a table without dataclasses and arrays, as JSON has it."""
    if is_dataclass(table) and not isinstance(table, type):
        return asdict(table)
    if isinstance(table, Mapping):
        return {str(name): plain(value) for name, value in table.items()}
    if isinstance(table, np.ndarray | np.generic):
        return table.tolist()
    return [plain(each) for each in table] if isinstance(table, list | tuple) else table


def show(title: str, lines: Sequence[Mapping[str, Any]], *names: str) -> None:
    """Print the numbers and words of lines, and of tables in them; or columns of some names."""
    flat = [_flat(line) for line in lines]
    names = names or tuple(dict.fromkeys(name for line in flat for name in line))
    table = Table(*names, title=title, title_justify="left")
    for line in flat:
        table.add_row(*(_shown(line.get(name)) for name in names))
    Console(width=max(120, Console().width, 14 * len(names))).print(table)


def show_values(title: str, values: Mapping[str, Any]) -> None:
    """Print values, or tables of them, by name."""
    lines = ((k, v if isinstance(v, Mapping) else {"value": v}) for k, v in values.items())
    show(title, [{"figure": name, **line} for name, line in lines])


def _flat(line: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers and words of a line, and those of tables in it."""
    found: dict[str, Any] = {}
    for name, value in plain(line).items():
        inside = value.items() if isinstance(value, dict) else ((None, value),)
        for key, one in inside:
            if one is None or isinstance(one, str | int | float):
                found[name if key is None else f"{name} {key}"] = one
    return found


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def first_samples(log: JointLog, count: int) -> JointLog:
    """Return the first samples of a log."""
    names = ("time", "position", "velocity", "effort", "acceleration")
    given = {name: getattr(log, name) for name in names}
    return replace(log, **{name: x[:count] for name, x in given.items() if x is not None})


def sines(
    time: np.ndarray, size: np.ndarray, rate: np.ndarray, phase: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Σ size sin(rate t + phase) (N, n) of (k, n) sines each, and its two derivatives."""
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
    """Return what a task makes of all draws; `key` is what else than the seed tells runs apart."""
    cache = options.cache or (options.json and options.json.with_suffix(".draws.jsonl"))
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
    study = Path(parser.prog).stem.rpartition(".")[2]
    own = {"version": VERSION, "study": study, "seed": options.seed, **key}
    jobs = options.jobs or (1 if options.quick else JOBS)
    try:
        return results_of(task, draws, key=own, cache=cache, workers=jobs)
    except KeyboardInterrupt:
        where = f"Finished draws are in {cache}; the same command goes on." if cache else ""
        parser.exit(130, f"Interrupted. {where}\n")


def results_of(
    task: Callable[[Any], Any],
    draws: Sequence[Any],
    *,
    key: Mapping[str, Any],
    cache: Path | None,
    workers: int,
) -> list[Any]:
    """Return what a task makes of every draw, from the cache as far as it is there.

    Args:
        task: A function that can be pickled; its results can be written as JSON.
        key: What else a kept result must have been made with.
        cache: A JSON-lines file, which need not exist; None to keep nothing.
    """
    done = kept(cache, key)
    missing = [draw for draw in draws if name_of(draw) not in done]
    found = finished(task, missing, workers)
    for draw, result in track(found, description="draws", total=len(missing), transient=True):
        # As it would be read again, so that a resumed run gives the same in every digit.
        line = json.dumps({"key": dict(key), "draw": plain(draw), "rows": result})
        done[name_of(draw)] = json.loads(line)["rows"]
        if cache is not None:
            with cache.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
    return [done[name_of(draw)] for draw in draws]


def kept(cache: Path | None, key: Mapping[str, Any]) -> dict[str, Any]:
    """Return results in a cache by name; a last line cut short by an interruption is left out."""
    done: dict[str, Any] = {}
    if cache is None or not cache.is_file():
        return done
    wanted = json.loads(json.dumps(dict(key)))
    for line in cache.read_text(encoding="utf-8").splitlines():
        try:
            found = json.loads(line)
        except json.JSONDecodeError:
            continue
        if found["key"] == wanted:
            done[name_of(found["draw"])] = found["rows"]
    return done


def name_of(draw: Any) -> str:
    """Return a draw in writing."""
    return json.dumps(plain(draw), sort_keys=True)


def finished(
    task: Callable[[Any], Any], draws: Sequence[Any], workers: int
) -> Iterator[tuple[Any, Any]]:
    """Yield draws as they are done, in processes of their own."""
    if workers < 2:
        yield from ((draw, task(draw)) for draw in draws)
        return
    os.environ.update(ONE_THREAD)  # processes that are spawned read it before numpy is there
    quietly = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_DFL)}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), **quietly) as pool:
        futures = {pool.submit(task, draw): draw for draw in draws}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


# Times, memory, and bars of them


def cpu_clock() -> float:
    """Return the CPU time of this process and of those that it waited for, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def cpu_time(work: Callable[[], object]) -> float:
    """Return the CPU time of a call, s."""
    begin = cpu_clock()
    work()
    return cpu_clock() - begin


def cpu_times(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Return CPU times of calls, s, that take turns, after one call each to warm up."""
    for work in works.values():
        work()
    rounds = [{name: cpu_time(work) for name, work in works.items()} for _ in range(repeats)]
    return {name: [times[name] for times in rounds] for name in works}


def medians(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the medians of `cpu_times`."""
    return {name: float(np.median(times)) for name, times in cpu_times(works, repeats).items()}


def peak_memory(code: str, *arguments: object) -> tuple[float, list[str]]:
    """Return the largest memory, bytes, of a process of some code, and lines that it prints.

    It has Python and all libraries in it, on one thread.
    """
    command = [sys.executable, "-c", code + _PEAK, *map(str, arguments)]
    here = os.pathsep.join([str(MODELS.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": here}
    run = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    *said, peak = run.stdout.splitlines()
    return float(peak), said


def titled(ax: Axes, title: str, grid: str = "both") -> Axes:
    """Give axes the common look and a title."""
    style.polish(ax, grid=grid)
    ax.set_title(title, loc="left", **style.plain(fontweight="bold"))
    return ax


def panels(
    height: float,
    titles: Sequence[str],
    *,
    x: str = "",
    y: str = "",
    grid: str = "both",
    **how: Any,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each title, side by side; `how` is that of subplots."""
    figure = style.new_figure(height)
    axes = figure.subplots(1, len(titles), squeeze=False, **how)[0]
    for ax, title in zip(axes, titles, strict=True):
        titled(ax, title, grid)
        ax.set_xlabel(x, **style.plain(style.SMALL, style.QUIET))
    axes[0].set_ylabel(y, **style.plain())
    return figure, list(axes)


def draw_lines(
    ax: Axes, lines: Mapping[str, tuple[Any, ...]], colors: Mapping[str, str], **look: Any
) -> None:
    """Draw lines (x, y) by name, or with errors of y in third place."""
    for name, (x, y, *error) in lines.items():
        own = {"color": colors[name], "linewidth": 1.2, "label": name, **look}
        if error:
            ax.errorbar(x, y, *error, capsize=2, **own)
        else:
            ax.plot(x, y, **own)


def dots(
    height: float,
    names: Sequence[str],
    columns: Mapping[str, Sequence[float]],
    colors: Sequence[str],
) -> Figure:
    """Draw a row of dots for each name, a panel for each column."""
    figure, axes = panels(height, list(columns), sharey=True)
    for ax, values in zip(axes, columns.values(), strict=True):
        ax.scatter(values, range(len(names)), color=list(colors), s=28)
        style.log_scale(ax, "x")
        ax.tick_params(axis="x", labelrotation=60)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    return figure


def draw_bars(
    ax: Axes,
    groups: Sequence[str],
    heights: Mapping[str, Sequence[float | None]],
    colors: Mapping[str, str],
    errors: Mapping[str, Sequence[float | None]] | None = None,
) -> None:
    """Draw bars by name, side by side in every group, with errors; None is left out."""
    width = 0.8 / len(heights)
    for k, (name, own) in enumerate(heights.items()):
        height = np.array(own, float)
        at = np.arange(len(groups)) + width * (k - 0.5 * (len(heights) - 1))
        look: dict[str, Any] = {"color": colors[name], "label": name}
        if errors is not None:
            error = np.nan_to_num(np.array(errors[name], float))
            look |= {"yerr": [np.minimum(error, 0.9 * height), error], "ecolor": style.INK}
            look["error_kw"] = {"elinewidth": 0.8, "capsize": 1.5}
        ax.bar(at, height, 0.9 * width, **look)
    ax.set_xticks(range(len(groups)), groups)


def bars(panels: Mapping[str, Mapping[str, float]], unit: str) -> Figure:
    """Draw numbers by name, a panel for each title."""
    figure = style.new_figure(0.8 + 0.35 * max(map(len, panels.values())))
    axes = np.ravel(figure.subplots(1, len(panels)))
    for ax, (title, values) in zip(axes, panels.items(), strict=True):
        drawn = ax.barh(list(values), list(values.values()), color=style.AFTER, height=0.6)
        ax.bar_label(drawn, [f"{value:.3g} {unit}" for value in values.values()], padding=4)
        ax.invert_yaxis()
        ax.margins(x=0.3)
        titled(ax, title, grid="x")
    return figure
