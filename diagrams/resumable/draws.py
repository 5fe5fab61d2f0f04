"""Draws of a study, done in parallel and kept in a file, so that an interrupted run goes on."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, is_dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.progress import track

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def results_of(
    task: Callable[[Any], Any],
    draws: Sequence[Any],
    *,
    key: Mapping[str, Any],
    cache: Path | None,
    workers: int,
) -> list[Any]:
    """What a task makes of every draw, from the cache as far as it is there, with a progress bar.

    Args:
        task: A function that can be pickled; its results can be written as JSON.
        draws: Numbers, names or dataclasses.
        key: What else a kept result must have been made with.
        cache: A JSON-lines file, which need not exist; None to keep nothing.
        workers: Number of processes.
    """
    done = kept(cache, key)
    missing = [draw for draw in draws if name_of(draw) not in done]
    found = finished(task, missing, workers)
    for draw, result in track(found, description="draws", total=len(missing), transient=True):
        # As it would be read again, so that a resumed run gives the same in every digit.
        line = json.dumps({"key": dict(key), "draw": _plain(draw), "rows": result})
        done[name_of(draw)] = json.loads(line)["rows"]
        if cache is not None:
            with cache.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
    return [done[name_of(draw)] for draw in draws]


def kept(cache: Path | None, key: Mapping[str, Any]) -> dict[str, Any]:
    """Results in a cache by name; a last line cut short by an interruption does not count."""
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
    """A draw in writing."""
    return json.dumps(_plain(draw), sort_keys=True)


def _plain(draw: Any) -> Any:
    return asdict(draw) if is_dataclass(draw) and not isinstance(draw, type) else draw


def finished(
    task: Callable[[Any], Any], draws: Sequence[Any], workers: int
) -> Iterator[tuple[Any, Any]]:
    """Draws as they are done, in processes of their own."""
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
