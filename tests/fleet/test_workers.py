"""Workers of a scheduler: all work comes back, and what goes wrong is told."""

import pytest
from distributed import LocalCluster

from geodrake.errors import FleetError, LogError
from geodrake.fleet.workers import workers


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
        done = {each.at: each.result for each in team.each(abs, [-k for k in range(20)])}
        assert done == {k: k for k in range(20)}
        with pytest.raises(LogError, match=r"Log 3 is none\. Correct it\."):
            list(team.each(refuse_three, range(9)))
    assert "Dashboard" in told[0]


def test_a_scheduler_that_is_lost_is_told(cluster, capfd):
    with (
        workers(50, scheduler=cluster.scheduler_address) as team,
        pytest.raises(FleetError, match="does not answer any more"),
    ):
        for _ in team.each(abs, range(50)):
            cluster.close()
    assert "Traceback" not in capfd.readouterr().err
