"""A small fleet from its file to its findings, with interruptions and workers."""

import gc
import io
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import fsspec
import numpy as np
import pytest
from distributed import Client, KilledWorker, LocalCluster
from processes import limited
from small_fleet import (
    DRY,
    FROM,
    HEAVY,
    MASS,
    PENDULUM,
    ROBOTS,
    SHARE,
    STICKY,
    DayOf,
    date_of,
    write_file,
    write_fleet,
)

from geodrake.effects import CoulombFriction, FittedEffect, StribeckFriction
from geodrake.errors import ArgumentError, FleetError, LogError
from geodrake.fleet import FleetWork, read_fleet, run_fleet
from geodrake.fleet.fleet_logs import DIGESTS, digest_task, find_tasks, read_records
from geodrake.fleet.history import DAY, MOST_TIMES, HistoryTask, read_history, time_cells
from geodrake.fleet.log_places import (
    check_date_pattern,
    date_in_path,
    date_text,
    find_logs,
    fits,
    local_log,
)
from geodrake.fleet.settings import read_settings
from geodrake.fleet.workers import Workers, workers
from geodrake.logs import write_log
from geodrake.model import load_model, save_model
from geodrake.report.json_output import to_json
from geodrake.report.views import numbers_of

HERE = FleetWork(workers=0)
FEW = (ROBOTS[0], HEAVY)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the logs of the fleet, which no test changes."""
    here = tmp_path_factory.mktemp("fleet")
    write_fleet(here)
    return here


@pytest.fixture(scope="module")
def whole(folder):
    """Return the results of the whole fleet."""
    return run_fleet(read_fleet(folder / "fleet.yaml"), HERE)


def copy_logs(folder, to, robots=FEW, days=(0, 1)):
    for name in robots:
        (to / name).mkdir()
        for day in days:
            shutil.copy2(folder / name / f"{date_of(day)}.csv", to / name)


@pytest.fixture
def own(folder, tmp_path):
    """Return a folder of a test's own with some of the logs."""

    def make(robots=FEW):
        copy_logs(folder, tmp_path, robots)
        return write_file(tmp_path, robots)

    return make


def text_of(result):
    return to_json(numbers_of(result))


def digests(folder):
    """Return the time of each digest, which shows whether it was made again."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in Path(folder).glob("**/digests/*.digest")
    }


def test_robots_that_change_are_named(whole):
    result, seen = whole
    assert (seen.made, seen.failed) == (32, ())
    assert [robot.robot for robot in result.robots][:2] == [HEAVY, STICKY]
    load, rise = result.findings
    assert (load.robot, load.effect, load.where, load.kind) == (
        *(HEAVY, "payload", "lower_link", "step"),
    )
    (mass, *_, hz) = load.parameters
    assert abs(mass.size - MASS) < 4 * mass.deviation < 0.2
    assert abs(hz.size + 0.4 * MASS) < 4 * hz.deviation < 0.02
    assert (rise.robot, rise.effect, rise.where) == (STICKY, "coulomb_friction", "elbow")
    (dry,) = rise.parameters
    assert dry.share == pytest.approx(SHARE, abs=0.1)
    for finding in (load, rise):
        assert date_text(finding.date)[:10] == date_of(FROM)
        assert finding.interval[0] <= finding.date <= finding.interval[1]
        assert finding.false_alarm_probability < result.false_alarms * 8 / 30  # of eight days
    assert [robot.state for robot in result.robots] == ["changed"] * 2 + ["steady"] * 2


def test_parameters_over_time_hold_the_truth(whole):
    result, _ = whole
    robot = next(robot for robot in result.robots if robot.robot == STICKY)
    (course,) = (
        each
        for each in robot.histories
        if (each.parameter.effect, each.parameter.where) == ("coulomb_friction", "elbow")
    )
    before, after = course.values[:FROM].mean(), course.values[FROM:].mean()
    assert after / before == pytest.approx(1 + SHARE, abs=0.1)
    assert before == pytest.approx(DRY[1], rel=0.2)
    assert course.shown.all()
    assert (course.deviations < 0.1 * course.values).all()
    for each in robot.own:
        assert each.deviation >= 0.0
        assert np.isfinite([each.value, each.common, each.spread]).all()


def test_what_is_there_is_not_made_again(folder, whole):
    before = digests(folder)
    result, seen = run_fleet(read_fleet(folder / "fleet.yaml"), HERE)
    assert seen.made == 0
    assert digests(folder) == before
    assert len(before) == 32
    assert text_of(result) == text_of(whole[0])


@pytest.fixture(scope="module")
def undisturbed(folder, tmp_path_factory):
    """Return the folder of a run of four logs, its digests and findings."""
    here = tmp_path_factory.mktemp("undisturbed")
    copy_logs(folder, here)
    result, seen = run_fleet(read_fleet(write_file(here, FEW)), HERE)
    assert seen.made == 4
    return here, text_of(result)


def test_a_run_that_was_killed_goes_on(own, tmp_path, undisturbed):
    path = own()
    command = [sys.executable, "-m", "geodrake", "fleet", str(path), "--workers", "0", "-q"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        limited(run, 120)
        while len(digests(tmp_path)) < 2 and run.poll() is None:
            time.sleep(0.002)
    finally:
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
    left = digests(tmp_path)
    assert len(left) >= 2
    result, _ = run_fleet(read_fleet(path), HERE)
    assert left.items() <= digests(tmp_path).items()  # none was made again
    assert len(digests(tmp_path)) == 4
    assert text_of(result) == undisturbed[1].replace(str(undisturbed[0]), str(tmp_path))


def test_logs_in_other_places_have_the_same_digests(undisturbed, tmp_path):
    here, _ = undisturbed
    memory = fsspec.filesystem("memory")
    for name in FEW:
        for day in (0, 1):
            content = (here / name / f"{date_of(day)}.csv").read_bytes()
            memory.pipe(f"/fleet/{name}/{date_of(day)}.csv", content)
    shutil.copytree(here / "results", tmp_path / "results")
    before = digests(tmp_path)
    fleet = read_fleet(write_file(tmp_path, FEW, logs="memory://fleet/{}/*.csv"))
    _, seen = run_fleet(fleet, HERE)
    assert seen.made == 4  # they were read, and had their digests
    assert digests(tmp_path) == before
    assert run_fleet(fleet, HERE)[1].made == 0
    with pytest.raises(FleetError, match="in the memory of this process"):
        run_fleet(fleet, FleetWork(workers=2))


def test_a_log_that_fails_is_a_row(own, tmp_path):
    path = own()
    (tmp_path / HEAVY / "2026-05-09.csv").write_text("time,x\n1,2\n", encoding="utf-8")
    (tmp_path / HEAVY / "undated.csv").write_text("time,x\n1,2\n", encoding="utf-8")
    shutil.copy(tmp_path / HEAVY / f"{date_of(0)}.csv", tmp_path / HEAVY / "2026-05-10.csv")
    result, seen = run_fleet(read_fleet(path), HERE)
    assert seen.made == 5
    reasons = {Path(unused.address).name: unused.reason for unused in result.unused}
    assert "position" in reasons["2026-05-09.csv"]
    assert "no date like %Y-%m-%d" in reasons["undated.csv"]
    assert "the same content as" in reasons["2026-05-10.csv"]
    assert {robot.robot: robot.logs for robot in result.robots} == dict.fromkeys(FEW, 2)
    tasks, known = find_tasks(read_fleet(path), seen.failed)
    assert (tasks, sum(map(len, known.values()))) == ([], 7)
    (tmp_path / HEAVY / "2026-05-09.csv").chmod(0o600)
    assert [task.place.name for task in find_tasks(read_fleet(path), seen.failed)[0]] == [
        "2026-05-09.csv"
    ]
    assert len(find_tasks(read_fleet(path))[0]) == 2  # a run of its own tries all of them


def test_a_log_that_could_not_be_fetched_is_tried_again(tmp_path):
    memory = fsspec.filesystem("memory")
    memory.pipe("/fetched/2026-05-01.csv", b"x")
    fleet = read_fleet(write_file(tmp_path, FEW[:1], logs="memory://fetched/*.csv"))
    (task,), _ = find_tasks(fleet)
    memory.rm("/fetched/2026-05-01.csv")
    (fleet.folder / "pendulum" / "digests").mkdir(parents=True)
    record = digest_task(task)
    assert "cannot be read: FileNotFoundError" in record.reason
    memory.pipe("/fetched/2026-05-01.csv", b"x")
    assert len(find_tasks(fleet, [record])[0]) == 1


def test_a_damaged_digest_is_a_row_and_made_again(own, tmp_path):
    path = own([HEAVY])
    text = text_of(run_fleet(read_fleet(path), HERE)[0])
    here = tmp_path / "results" / "pendulum"
    (record, _) = read_records(here, *read_fleet(path).robots).values()
    damaged = here / "digests" / record.digest
    good = damaged.read_bytes()
    damaged.write_bytes(good[:2000] + b"\xff" * 100 + good[2100:])
    result, seen = run_fleet(read_fleet(path), HERE)
    (unused,) = result.unused
    assert (seen.made, unused.robot, unused.address) == (0, HEAVY, record.address)
    assert "damaged" in unused.reason
    assert {robot.robot: robot.logs for robot in result.robots} == {HEAVY: 1}
    again, seen = run_fleet(read_fleet(path), HERE)
    assert (seen.made, text_of(again)) == (1, text)
    assert damaged.read_bytes() == good
    shutil.rmtree(tmp_path / HEAVY)  # what was digested stays when its logs are deleted
    result, seen = run_fleet(read_fleet(path), HERE)
    assert (seen.made, text_of(result)) == (0, text)
    for each in (here / "digests").glob("*.digest"):
        each.write_bytes(b"")
    result, _ = run_fleet(read_fleet(path), HERE)
    assert [robot.state for robot in result.robots] == ["no logs"]


def test_a_model_of_its_own_need_not_have_the_effects_of_its_type(tmp_path):
    """Nor an elbow that moves, which these logs lack."""
    for name in FEW:
        (tmp_path / name).mkdir()
        for day in (0, 1):
            log = DayOf(name, day).log().select(("shoulder",))
            write_log(log, tmp_path / name / f"{date_of(day)}.csv")
    plain = load_model(PENDULUM)
    fading = FittedEffect(StribeckFriction("shoulder", 0.1), np.array([0.05]))
    dry = FittedEffect(CoulombFriction("shoulder"), np.array([0.3]))
    for file, effects in {"type.yaml": (fading,), "own.yaml": (dry,)}.items():
        save_model(replace(plain, effects=effects), tmp_path / file)
    path = write_file(tmp_path, FEW)
    text = path.read_text(encoding="utf-8").replace(str(PENDULUM), "type.yaml")
    path.write_text(text.replace("dates:", "model: own.yaml, dates:", 1), encoding="utf-8")
    result, _ = run_fleet(read_fleet(path), HERE)
    said = {
        robot.robot: {each.parameter.effect: each.of_model for each in robot.own}
        for robot in result.robots
    }
    own, other = said[FEW[0]], said[HEAVY]
    assert (own["coulomb_friction"], other["coulomb_friction"]) == (0.3, 0.0)
    assert np.isnan(own["stribeck_friction"])
    assert other["stribeck_friction"] == 0.05
    assert own["bodies"] == other["bodies"]


@pytest.mark.parametrize(
    ("of", "changed", "says"),
    [
        (str(PENDULUM), "pipe.urdf", "file of type pendulum .*pipe.urdf is a pipe"),
        (str(PENDULUM), "none.urdf", "file of type pendulum .*none.urdf does not exist"),
        ("dates:", "model: other.urdf, dates:", "joints shoulder, knee, but its type 'pendulum'"),
        (
            "dates:",
            "payloads: [{body: hand, mass: 1}], dates:",
            "'first' has invalid payloads: .*hand",
        ),
        ("first/*.csv", "none/*.csv", r"none/\*\.csv' of robot 'first' matches no log"),
        ("first/*.csv", f"{HEAVY}/*.csv", f"belongs to both robots 'first' and '{HEAVY}'"),
    ],
)
def test_fleets_that_cannot_be_are_refused(own, tmp_path, of, changed, says):
    path = own()
    os.mkfifo(tmp_path / "pipe.urdf")
    other = PENDULUM.read_text(encoding="utf-8").replace("elbow", "knee")
    (tmp_path / "other.urdf").write_text(other, encoding="utf-8")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(of, changed, 1), encoding="utf-8")
    with pytest.raises(FleetError, match=says):
        run_fleet(read_fleet(path), HERE)
    assert not list((tmp_path / "results").glob("**/*.digest"))


@pytest.mark.parametrize(
    ("path", "pattern", "date"),
    [
        ("arm_20260501.csv", "%Y%m%d", "2026-05-01T00:00:00"),
        ("arm_2020101203.csv", "%Y%m%d", "2020-10-12T00:00:00"),  # and not the 3rd of December
        ("2026-05-01/2026-05-02.csv", "%Y-%m-%d", "2026-05-02T00:00:00"),
        ("arm_26121_1530.csv", "%y%j_%H%M", "2026-05-01T15:30:00"),
        ("arm7/20260501.csv", "arm7/%Y%m%d", "2026-05-01T00:00:00"),
        ("arm_720260501.csv", "%Y%m%d", None),
    ],
)
def test_dates_in_paths(path, pattern, date):
    check_date_pattern(pattern)
    if date is None:
        with pytest.raises(ArgumentError, match="has no date like"):
            date_in_path(path, pattern)
    else:
        assert date_text(date_in_path(path, pattern)) == f"{date}+00:00"


def test_a_scheduler_that_does_not_answer_is_said(own, monkeypatch):
    monkeypatch.setattr("geodrake.fleet.workers._TIMEOUT", 0.5)
    fleet, there = read_fleet(own()), FleetWork(scheduler="tcp://127.0.0.1:9")
    with pytest.raises(FleetError, match=r"tcp://127\.0\.0\.1:9 cannot be reached"):
        run_fleet(fleet, there)
    assert not fleet.folder.exists()


@pytest.mark.parametrize("address", ["tls://127.0.0.1:9", "inproc://9"])
def test_a_client_that_reaches_no_scheduler_is_closed(address):
    """Otherwise a later one may hold the lock that its finalizer waits for."""
    others = _clients()
    with (
        pytest.raises(FleetError, match=f"{address} cannot be reached") as caught,
        workers(1, scheduler=address),
    ):
        pass
    own = [client for client in _clients() if all(client is not other for other in others)]
    assert [client.status for client in own] == ["closed"]
    assert caught.value.__cause__ is not None


def _clients():
    return [each for each in gc.get_objects() if isinstance(each, Client)]


TYPES = "types:\n  arm: {model: arm.urdf}\n"
ROBOT = "robots:\n- {name: a, logs: 'a/*.csv'}\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("- 1", "expected a table"),
        ("to: [", "not valid YAML"),
        (f"to: {'[' * 1000}{']' * 1000}", "not valid YAML"),
        (f"{TYPES}{ROBOT}", "lacks its to"),
        (f"to: ~nobody-here/x\n{TYPES}{ROBOT}", "home folder of an unknown user"),
        (f"to: x\n{TYPES}{ROBOT}more: 1\n", "unknown field 'more'"),
        (f"to: x\n{TYPES}{ROBOT}- {{name: a, logs: b}}\n", "robot 'a' occurs twice"),
        (f"to: x\n{TYPES}  arm: {{model: b.urdf}}\n{ROBOT}", "'arm' twice, again"),
        (f"to: x\n{TYPES}  leg: {{model: b.urdf}}\n{ROBOT}", "has the unknown type ''"),
        (f"to: x\n{TYPES}robots:\n- {{name: a, type: leg, logs: b}}\n", "the unknown type 'leg'"),
        (f"to: x\n{TYPES}robots:\n- {{name: a}}\n", "robots[0] lacks its logs"),
        (f"to: x\n{TYPES}robots:\n- {{name: a, logs: []}}\n", "robot 'a' has no logs"),
        (f"to: x\n{TYPES}robots:\n- {{name: a, logs: b, dates: '%Y%Y%m%d'}}\n", "invalid pattern"),
        (f"to: x\n{TYPES}robots:\n- {{name: a, logs: b, log: c}}\n", "(was logs meant?)"),
        ("to: x\ntypes:\n  ../a: {model: m}\n" + ROBOT, "a name that a folder cannot have"),
        ("to: x\ntypes:\n  a: {model: m, blocks: 1}\n" + ROBOT, "blocks must be"),
        ("to: x\ntypes:\n  a: {model: m, payload: 0}\n" + ROBOT, "payload of type 'a' must be"),
        ("to: x\ntypes:\n  a: {model: m, floating: 3}\n" + ROBOT, "floating = 3: expected true"),
        (
            f"to: x\n{TYPES}robots:\n- {{name: a, logs: b, payloads: [{{body: h, mass: -1}}]}}\n",
            "mass of -1 kg",
        ),
    ],
)
def test_fleet_files_that_are_wrong(text, says, tmp_path):
    path = tmp_path / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FleetError) as caught:
        read_fleet(path)
    assert says in str(caught.value)


def test_patterns_fit_what_they_find(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    for name in ("1.csv", "a/2.csv", "a/b/3.csv", "a/b/4.txt", "a/.5.csv"):
        (tmp_path / name).write_text("", encoding="utf-8")
    (tmp_path / "a" / "gone.csv").symlink_to("nowhere")
    every = [str(path) for path in tmp_path.rglob("*")]
    for pattern in ("*.csv", "a/*.csv", "**/*.csv", "a/b/[0-3].*", "a/?/4.txt", "a?2.*", "a/*"):
        whole = f"{tmp_path}/{pattern}"
        found = {place.address for place in find_logs(whole)}
        fitting = {address for address in every if fits(address, whole)}
        assert bool(found) == (pattern != "a?2.*")
        assert found == fitting - {f"{tmp_path}/a/{name}" for name in (".5.csv", "gone.csv")}


def test_logs_in_archives_and_by_caches_have_addresses_of_their_own():
    memory = fsspec.filesystem("memory")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("logs/1.csv", "x")
    memory.pipe({"/packed/all.zip": packed.getvalue(), "/packed/2.csv": b"x"})
    for pattern, name in {
        "zip://logs/*.csv::memory://packed/all.zip": "1.csv",
        "simplecache::memory://packed/*.csv": "2.csv",
    }.items():
        (place,) = find_logs(pattern)
        assert place.name == name
        assert fits(place.address, pattern)
        with local_log(place) as path:
            assert path.read_text(encoding="utf-8") == "x"


@pytest.fixture(scope="module")
def carrier(folder, tmp_path_factory):
    """Return the folder of a robot of three logs with digests."""
    here = tmp_path_factory.mktemp("carrier")
    copy_logs(folder, here, [HEAVY], range(3))
    fleet = read_fleet(write_file(here, [HEAVY]))
    return fleet.folder / "pendulum", run_fleet(fleet, HERE)[1].records[HEAVY]


@pytest.fixture
def task(carrier, tmp_path):
    """Return a copy of it in a folder of the test."""
    folder = shutil.copytree(carrier[0], tmp_path / "pendulum")
    return HistoryTask(HEAVY, carrier[1], folder, read_settings(folder / DIGESTS), np.arange(5))


def test_logs_of_one_time_count_as_one(task, monkeypatch):
    """Two equal logs tell no more than one, by their mean."""
    one = replace(task, records=task.records[:1])
    later = replace(one.records[0], date=one.records[0].date + DAY)
    monkeypatch.setattr("geodrake.fleet.history.MOST_TIMES", 1)
    single = read_history(one)[0].read()
    twice = read_history(replace(one, records=[*one.records, later]))[0]
    assert (twice.logs, len(twice.days)) == (2, 1)
    for a, b in zip(single.joints, twice.read().joints, strict=True):
        np.testing.assert_allclose(b.grams[:, :-1], a.grams[:, :-1])


def test_many_logs_are_few_times():
    rng = np.random.default_rng(1)
    dates = 1.7e9 + np.sort(rng.uniform(0.0, 400 * DAY, 5000))
    cells = time_cells(dates)
    assert cells[0] == 0
    assert (np.diff(cells) >= 0).all()
    assert (np.diff(cells) <= 1).all()
    assert MOST_TIMES / 2 < cells[-1] + 1 <= MOST_TIMES
    more = time_cells(np.append(dates, dates[-1] + 1.0))
    assert (more[:-1] == cells).all()
    assert (time_cells(dates[:MOST_TIMES]) == np.arange(MOST_TIMES)).all()


def same_history(one, other):
    assert len(one.joints) == len(other.joints)
    for a, b in zip(one.joints, other.joints, strict=True):
        assert np.array_equal(a.columns, b.columns)
        assert np.array_equal(a.grams, b.grams)
    assert np.array_equal(one.days, other.days)
    assert np.array_equal(one.temperature, other.temperature, equal_nan=True)


def test_a_digest_under_the_name_of_another_log_is_not_believed(task):
    first, second = (task.folder / "digests" / record.digest for record in task.records[:2])
    second.write_bytes(first.read_bytes())
    ((record, problem),) = read_history(task)[1]
    assert record == task.records[1]
    assert "has the digest of another log" in problem


def test_a_history_is_without_a_digest_that_is_damaged(task):
    """Whoever reads it, and as long as it is."""
    whole = read_history(task)[0].read()
    damaged = task.folder / DIGESTS / task.records[1].digest
    content = damaged.read_bytes()
    damaged.write_bytes(b"x")
    ((record, _),) = read_history(task)[1]
    assert record == task.records[1]
    rest = read_history(task)[0]
    task.file.unlink()
    assert np.array_equal(rest.read().days, whole.days[[0, 2]])
    damaged.write_bytes(content)
    same_history(read_history(task)[0].read(), whole)


@pytest.mark.parametrize("gone", [1, 3])
def test_digests_that_go_while_their_history_is_used_are_said(task, gone):
    """Results of the robot are then of other logs."""
    kept = read_history(task)[0]
    task.file.unlink()
    for record in task.records[:gone]:
        (task.folder / DIGESTS / record.digest).unlink()
    with pytest.raises(FleetError, match="of robot carrier changed while"):
        kept.read()


@pytest.fixture
def cluster():
    """Return a scheduler with a worker, both in this process."""
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
    with workers(20, scheduler=cluster.scheduler_address, report=told.append) as team:
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
    """Many pieces of work go to a worker in one packet."""
    with workers(100, scheduler=cluster.scheduler_address) as team:
        done = dict(team.each(die_of_thirty, range(100)))
    assert done == {k: None if k == 30 else -k for k in range(100)}


class OneDies(Workers):
    """Work in parallel, of which the second piece kills its workers."""

    def each(self, work, pieces):
        done = [(at, None if at == 1 else work(piece)) for at, piece in enumerate(pieces)]
        return reversed(done)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 10])
def test_results_are_in_order_also_of_work_that_kills(count):
    pieces = [-k for k in range(count)]
    assert OneDies().in_order(abs, pieces) == list(range(count))
