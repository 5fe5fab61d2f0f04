"""Workers for many similar tasks: this process, local processes, or a cluster.

Processes and clusters are managed by Dask. If a worker dies, its tasks are repeated by another one;
a task that kills three workers is given up.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, TypeVar

from geodrake.boundary.escaping import one_line
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import FleetError

T = TypeVar("T")
R = TypeVar("R")

_BATCHES_PER_THREAD = 4  # minimum
_BATCH_SIZE = 8  # maximum number of tasks in a batch
_TIMEOUT = 20.0  # s, for a scheduler and for its first worker
_SETTINGS = {
    # Dask warns of large tasks, such as a robot's data.
    "distributed.admin.large-graph-warning-threshold": "4 GiB",
    # By default Dask's workers return memory at once, which makes arrays expensive.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
_FEW = 4  # tasks for which no process is started


@dataclass(frozen=True)
class Workers:
    """The workers of a Dask client, or this process without one."""

    client: Any = None

    def each(self, work: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield indices and results of tasks as they finish; None for one that killed workers.

        If a task raises, pending tasks are cancelled.
        """
        if self.client is None:
            yield from ((k, work(task)) for k, task in enumerate(tasks))
            return
        dask: Any = optional_package("distributed", "fleet", "workers", FleetError)
        threads = max(1, sum(self.client.nthreads().values()))
        futures, done = dict[Any, dict[int, T]](), dask.as_completed()

        def submit(batch: dict[int, T]) -> None:
            content = pickle.dumps((work, list(batch.values())))
            future = self.client.submit(_run_batch, content, pure=False)
            futures[future.key] = batch
            done.add(future)

        try:
            for batch in _batches(tasks, threads):
                submit(batch)
            for future in done:
                batch = futures.pop(future.key)
                try:
                    yield from zip(batch, pickle.loads(future.result()), strict=True)
                except dask.KilledWorker:
                    if len(batch) == 1:
                        yield from dict.fromkeys(batch).items()
                    else:  # repeat one by one, as the failing task is unknown
                        for k, task in batch.items():
                            submit({k: task})
        except (CancelledError, dask.comm.CommClosedError) as error:
            raise FleetError(
                f"The scheduler {self.client.scheduler.address} no longer responds.",
                advice="Start it, and run the command again: finished digests are kept.",
            ) from error
        finally:
            self.client.cancel(list(done.futures))

    def in_order(self, work: Callable[[T], R], tasks: Sequence[T]) -> list[R]:
        """Return results in the order of tasks; tasks that kill workers run in this process."""
        by_index = dict(self.each(work, tasks))
        results = (by_index[k] for k in range(len(tasks)))
        return [work(t) if r is None else r for t, r in zip(tasks, results, strict=True)]


THIS_PROCESS = Workers()
"""Runs tasks one after the other in this process."""


def _batches(tasks: Sequence[T], threads: int) -> Iterator[dict[int, T]]:
    """Yield batches of tasks by index, smaller ones at the end."""
    start = 0
    while start < len(tasks):
        limit = (len(tasks) - start) // (2 * _BATCHES_PER_THREAD * threads)
        size = max(1, min(_BATCH_SIZE, limit))
        yield dict(enumerate(tasks[start : start + size], start=start))
        start += size


def _run_batch(content: bytes) -> bytes:
    """Run tasks in a worker. Pickled batches avoid Dask's cost for many small arrays."""
    work, tasks = pickle.loads(content)
    return pickle.dumps([work(task) for task in tasks])


@contextmanager
def workers(
    tasks: int,
    *,
    count: int | None = None,
    scheduler: str | None = None,
    report: Callable[[str], None] = lambda words: None,
) -> Iterator[Workers]:
    """Yield workers for a number of tasks.

    Args:
        count: Number of local processes, or 0 for this process; None for one per core, or this
            process without Dask.
        scheduler: Address of a user's scheduler, such as `tcp://10.0.0.5:8786`.
        report: Called with a line on the dashboard.
    """
    if scheduler is None:
        if count is None and find_spec("distributed"):
            count = optional_package("dask.system", "fleet", "workers", FleetError).CPU_COUNT
        count = count or 0
        if count == 0 or tasks == 0 or (tasks <= _FEW and count > 1):
            yield THIS_PROCESS
            return
    dask: Any = optional_package("distributed", "fleet", "workers", FleetError)
    with ExitStack() as stack:
        stack.enter_context(
            optional_package("dask", "fleet", "workers", FleetError).config.set(_SETTINGS)
        )
        if scheduler is None:
            cluster = dask.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
            client = stack.enter_context(dask.Client(stack.enter_context(cluster)))
        else:
            log = logging.getLogger("distributed.client")  # logs tracebacks of lost schedulers
            stack.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)
            client = stack.enter_context(_remote(dask, scheduler))
        hint = "" if find_spec("bokeh") else " (it needs: pip install bokeh)"
        report(f"Dashboard of the workers: {client.dashboard_link}{hint}")
        yield Workers(client)


def _remote(dask: Any, scheduler: str) -> Any:
    """Return a client of a user's cluster."""
    client = object.__new__(dask.Client)
    try:
        client.__init__(scheduler, timeout=_TIMEOUT)
    except (OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
        # Close it now: if the garbage collector did while another client starts, both would
        # deadlock.
        client.close(timeout=_TIMEOUT)
        raise FleetError(
            f"The scheduler {scheduler} cannot be reached: {one_line(error)}.",
            advice="Check its address, such as tcp://10.0.0.5:8786; or omit --scheduler.",
        ) from error
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT)
    except TimeoutError as error:
        client.close()
        raise FleetError(
            f"The scheduler {scheduler} has no workers.",
            advice=f"Start some: dask worker {scheduler}",
        ) from error
    return client
