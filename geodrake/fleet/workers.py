"""Workers for many equal tasks: this process, processes of this machine, or a cluster.

Processes and clusters are those of Dask. What a worker that dies had begun is begun again by
another one, and a piece of work that kills three of them is given up.
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

_AHEAD = 4  # packets at least for each thread, as long as pieces are left
_TOGETHER = 8  # pieces of work in a packet, at most
_SECONDS = 20.0  # until a scheduler, and a worker of it, must have answered
_SETTINGS = {
    # A piece of work may hold all that is known of a robot: Dask warns of such.
    "distributed.admin.large-graph-warning-threshold": "4 GiB",
    # Dask has workers give memory back at once: arrays then cost more than what is computed.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
_FEW = 4  # pieces of work for which no process is started


@dataclass(frozen=True)
class Workers:
    """The workers of a Dask client, or this process without one."""

    client: Any = None

    def each(self, work: Callable[[T], R], pieces: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield numbers and results of tasks as they finish; None for one that killed its workers.

        What is not begun is given up if one raises.
        """
        if self.client is None:
            yield from ((at, work(piece)) for at, piece in enumerate(pieces))
            return
        dask: Any = optional_package("distributed", "fleet", "workers", FleetError)
        threads = max(1, sum(self.client.nthreads().values()))
        futures, done = dict[Any, dict[int, T]](), dask.as_completed()

        def begin(packet: dict[int, T]) -> None:
            content = pickle.dumps((work, list(packet.values())))
            future = self.client.submit(_done, content, pure=False)
            futures[future.key] = packet
            done.add(future)

        try:
            for packet in _packets(pieces, threads):
                begin(packet)
            for future in done:
                packet = futures.pop(future.key)
                try:
                    yield from zip(packet, pickle.loads(future.result()), strict=True)
                except dask.KilledWorker:
                    if len(packet) == 1:
                        yield from dict.fromkeys(packet).items()
                    else:  # one by one, as it is not known which of them it was
                        for at, piece in packet.items():
                            begin({at: piece})
        except (CancelledError, dask.comm.CommClosedError) as error:
            raise FleetError(
                f"The scheduler {self.client.scheduler.address} no longer responds.",
                advice="Start it, and run the command again: finished digests are kept.",
            ) from error
        finally:
            self.client.cancel(list(done.futures))

    def in_order(self, work: Callable[[T], R], pieces: Sequence[T]) -> list[R]:
        """Return results in the order of the tasks; this process does those that kill workers."""
        found = dict(self.each(work, pieces))
        results = (found[at] for at in range(len(pieces)))
        return [work(p) if r is None else r for p, r in zip(pieces, results, strict=True)]


HERE = Workers()
"""This process, which does one after the other."""


def _packets(pieces: Sequence[T], threads: int) -> Iterator[dict[int, T]]:
    """Yield pieces by their numbers, several together as long as many are left: a packet costs."""
    at = 0
    while at < len(pieces):
        size = max(1, min(_TOGETHER, (len(pieces) - at) // (2 * _AHEAD * threads)))
        yield dict(enumerate(pieces[at : at + size], start=at))
        at += size


def _done(packet: bytes) -> bytes:
    """Run tasks in a worker; many small arrays are slow in Dask unless sent as one packet."""
    work, pieces = pickle.loads(packet)
    return pickle.dumps([work(piece) for piece in pieces])


@contextmanager
def workers(
    pieces: int,
    *,
    count: int | None = None,
    scheduler: str | None = None,
    told: Callable[[str], None] = lambda words: None,
) -> Iterator[Workers]:
    """Yield workers for some tasks.

    Args:
        count: Processes of this machine, or 0 for this one; None for one on each core, and for
            this one where Dask is not installed.
        scheduler: Address of a scheduler of the user's own, such as `tcp://10.0.0.5:8786`.
    """
    if scheduler is None:
        if count is None and find_spec("distributed"):
            count = optional_package("dask.system", "fleet", "workers", FleetError).CPU_COUNT
        count = count or 0
        if count == 0 or pieces == 0 or (pieces <= _FEW and count > 1):
            yield HERE
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
            log = logging.getLogger("distributed.client")  # has a traceback of a lost scheduler
            stack.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)
            client = stack.enter_context(_remote(dask, scheduler))
        shown = "" if find_spec("bokeh") else " (it needs: pip install bokeh)"
        told(f"Dashboard of the workers: {client.dashboard_link}{shown}")
        yield Workers(client)


def _remote(dask: Any, scheduler: str) -> Any:
    """Return a client of a cluster of the user's own."""
    client = object.__new__(dask.Client)
    try:
        client.__init__(scheduler, timeout=_SECONDS)
    except (OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
        # The garbage collector must not close it later: if another client starts at that moment,
        # each waits for the other's lock.
        client.close(timeout=_SECONDS)
        raise FleetError(
            f"The scheduler {scheduler} cannot be reached: {one_line(error)}.",
            advice="Check its address, such as tcp://10.0.0.5:8786; or omit --scheduler.",
        ) from error
    try:
        client.wait_for_workers(1, timeout=_SECONDS)
    except TimeoutError as error:
        client.close()
        raise FleetError(
            f"The scheduler {scheduler} has no workers.",
            advice=f"Start some: dask worker {scheduler}",
        ) from error
    return client
