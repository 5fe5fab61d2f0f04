"""Workers of a scheduler: all work comes back, and what goes wrong is told."""

from types import SimpleNamespace

import pytest
from distributed import KilledWorker, LocalCluster

from geodrake.errors import FleetError, LogError
from geodrake.fleet.workers import Workers, workers


@pytest.fixture
def cluster():
    """A scheduler with a worker, both in this process."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield cluster


def refuse_three(piece):
    if piece == 3:
        raise LogError(f"Log {piece} is none.", advice="Correct it.")
    return -piece


def test_all_work_comes_back(cluster):
    told = []
    with workers(20, scheduler=cluster.scheduler_address, told=told.append) as team:
        done = dict(team.each(abs, [-k for k in range(20)]))
        assert done == {k: k for k in range(20)}
        with pytest.raises(LogError, match=r"Log 3 is none\. Correct it\."):
            list(team.each(refuse_three, range(9)))
    assert "Dashboard" in told[0]


def test_a_scheduler_that_is_lost_is_told(cluster, capfd):
    with (
        workers(50, scheduler=cluster.scheduler_address) as team,
        pytest.raises(FleetError, match="no longer responds"),
    ):
        for _ in team.each(abs, range(50)):
            cluster.close()
    assert "Traceback" not in capfd.readouterr().err


def die_of_thirty(piece):
    if piece == 30:
        raise KilledWorker("die_of_thirty", SimpleNamespace(address="here"), 3)
    return -piece


def test_work_that_kills_its_workers_takes_no_other_with_it(cluster):
    """Though many pieces go to a worker in one packet."""
    with workers(100, scheduler=cluster.scheduler_address) as team:
        done = dict(team.each(die_of_thirty, range(100)))
    assert done == {k: None if k == 30 else -k for k in range(100)}


class OneDies(Workers):
    """Several at a time, of which the second piece of work kills its workers."""

    def each(self, work, pieces):
        done = [(at, None if at == 1 else work(piece)) for at, piece in enumerate(pieces)]
        return reversed(done)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 10])
def test_results_are_in_order_also_of_work_that_kills(count):
    pieces = [-k for k in range(count)]
    assert OneDies().in_order(abs, pieces) == list(range(count))
