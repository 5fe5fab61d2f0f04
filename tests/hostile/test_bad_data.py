"""Logs in order as tables, with measurements that no sensor in order makes."""

import numpy as np
import pytest
from hostile import HEADER, Row, table, write_log

from geodrake.control.rollout import simulation

COMPARE, EXPLAIN = "compare robot.urdf x.csv", "explain robot.urdf x.csv"
ROLLOUT = "rollout robot.urdf x.csv --json new.json"
IDENTIFY = "identify robot.urdf x.csv"
FASTER = HEADER.replace("shoulder.effort", "shoulder.velocity,elbow.velocity,shoulder.effort")
POSITION, EFFORT, BOTH, EFFORTS = 1, 3, slice(1, 3), slice(3, 5)
ALL = slice(None)


def with_velocity(rows):
    """The rows with velocities: columns 3 and 4."""
    velocity = np.gradient(rows[:, 1:3], rows[:, 0], axis=0)
    return np.column_stack([rows[:, :3], velocity, rows[:, 3:]])


def log(change, **settings):
    """Makes a log of changed rows."""

    def make(folder):
        rows = table(**settings)
        changed = change(rows)
        write_log(folder / "x.csv", rows if changed is None else changed)

    return make


def moving(change=lambda rows: None):
    """Makes a log with velocities of changed rows."""

    def make(folder):
        rows = with_velocity(table())
        change(rows)
        write_log(folder / "x.csv", rows, FASTER)

    return make


def put(where, column, value):
    """Other numbers in some rows of a column."""

    def change(rows):
        rows[where, column] = value

    return change


def scaled(column, factor):
    def change(rows):
        rows[:, column] *= factor

    return change


def held(first, last, column):
    """Rows of a column that stay as the first of them."""

    def change(rows):
        rows[first:last, column] = rows[first, column]

    return change


def wrapped(low, turn, factor=1.0):
    def change(rows):
        rows[:, BOTH] = (factor * rows[:, BOTH] - low) % turn + low

    return change


def one_by_one(*changes):
    def change(rows):
        for each in changes:
            each(rows)

    return change


def later(seconds):
    def change(rows):
        rows[1200:, 0] += seconds

    return change


SPIKE, NONE = "jumps and comes back", "no robot in SI units has that"
SPIKES = [
    Row("uint32 of -1", COMPARE, (SPIKE, "4.295e+09"), log(put(1000, 1, 2.0**32 - 1)), code=0),
    Row("a million", COMPARE, (SPIKE, "t = 10.00 s"), log(put(1000, 1, 1e6)), code=0),
    Row("10.5 rad in 12 s", COMPARE, (SPIKE,), log(put(600, 1, 10.5), seconds=12), code=0),
    Row("three rows", COMPARE, (SPIKE, "3 rows in all"), log(put([100, 900, 901], 1, 1e5)), code=0),
    Row("both joints", COMPARE, ("of shoulder jumps", "of elbow jumps"), log(
        put(1000, BOTH, -1e5)), code=0),
    Row("the first row", COMPARE, (SPIKE, "t = 0.00 s"), log(put(0, 1, 1e6)), code=0),
    Row("beside an empty cell", COMPARE, (SPIKE,), log(one_by_one(
        put(999, 1, np.nan), put(1000, 1, 1e6))), code=0),
    Row("an effort of a million", COMPARE, (SPIKE, "effort of shoulder"), log(
        put(1000, EFFORT, 1e6)), code=0),
    Row("an effort of 10^308", COMPARE, (SPIKE,), log(put(1000, EFFORT, 1e308)), code=0),
    Row("a velocity of 10^200", COMPARE, (SPIKE,), moving(put(500, 3, 1e200)), code=0),
    Row("a jump that stays", COMPARE, ("and stays there",), log(
        lambda rows: put(slice(1200, None), 1, rows[1200:, 1] + 50.0)(rows)), code=0),
    Row("10^30 from the middle on", COMPARE, ("Row 1201 ", NONE), log(
        put(slice(1200, None), 1, 1e30))),
    Row("positions of 10^30", COMPARE, ("position of shoulder", NONE), log(scaled(BOTH, 1e30))),
    Row("efforts of 10^160", COMPARE, ("effort of shoulder", NONE), log(scaled(EFFORTS, 1e160))),
    Row("efforts of 10^12, simulated", ROLLOUT, (NONE,), log(scaled(EFFORTS, 1e12))),
    Row("velocities of 10^200", COMPARE, ("velocity of shoulder", NONE), moving(scaled(3, 1e200))),
    Row("a walk of 10^9", COMPARE, (NONE,), log(lambda rows: np.column_stack([
        rows[:, 0], 1e10 * np.cumsum(np.sin(rows[:, [1, 2, 3, 4]] * 99), 0)]))),
]  # fmt: skip

WRAP, FROZEN = "unwrapped", "while the joint moves: left out"
TURNS = [
    Row("0 to 2π", COMPARE, ("turn of 6.283", WRAP), log(wrapped(0, 2 * np.pi)), code=0),
    Row("±π", COMPARE, (WRAP,), log(lambda rows: wrapped(-np.pi, 2 * np.pi)(
        put(ALL, BOTH, rows[:, BOTH] + np.pi)(rows) or rows)), code=0),
    Row("0 to 360", COMPARE, ("turn of 360", "in degrees"), log(
        wrapped(0, 360, np.degrees(1.0))), code=0),
    Row("degrees", COMPARE, ("in degrees",), log(scaled(BOTH, np.degrees(1.0))), code=0),
    Row("a frozen position", COMPARE, ("4 s from t = 8.00 s", FROZEN), moving(
        held(800, 1201, 1)), code=0),
    Row("frozen to the end", COMPARE, (FROZEN,), moving(held(1800, 2400, 1)), code=0),
    Row("a frozen position that jumps on", COMPARE, ("position of elbow", FROZEN), log(
        held(800, 1200, 2)), code=0),
    Row("frozen throughout", COMPARE, ("stays at", "locked"), moving(held(0, 2400, 1))),
    Row("a frozen effort", COMPARE, ("effort of shoulder", FROZEN), log(
        held(800, 1200, EFFORT)), code=0),
    Row("an effort frozen for most of it", COMPARE, ("Has the sensor failed?",), log(
        held(500, 2400, EFFORT))),
    Row("a frozen velocity", COMPARE, ("velocities are not used",), moving(
        held(800, 1200, 3)), code=0),
    Row("a joint that stands", COMPARE, (), log(held(0, 2400, 1)), code=0),
    Row("velocities backwards", COMPARE, ("200 % off",), moving(scaled(slice(3, 5), -1)), code=0),
    Row("no velocity", COMPARE, ("empty cells",), moving(put(ALL, 3, np.nan)), code=0),
]  # fmt: skip

EMPTY = [
    Row("a position never", COMPARE, ("no position of shoulder",), log(put(ALL, 1, np.nan))),
    Row("an effort never", COMPARE, ("no effort of elbow",), log(put(ALL, 4, np.nan))),
    Row("time never", COMPARE, ("no time in any",), log(put(ALL, 0, np.nan))),
    Row("nothing ever", EXPLAIN, ("0 rows without empty cells",), log(put(ALL, ALL, np.nan))),
    Row("every other row", COMPARE, ("no 8 rows in a row",), log(
        put(slice(0, None, 2), 1, np.nan))),
    Row("every tenth row", COMPARE, ("32 samples in a row",), log(
        put(slice(0, None, 10), 1, np.nan))),
    Row("joints in turns", COMPARE, ("0 rows without empty cells",), log(one_by_one(
        put(slice(0, None, 2), 1, np.nan), put(slice(1, None, 2), 2, np.nan)))),
    Row("efforts of zero", COMPARE, ("never changes",), log(scaled(EFFORTS, 0.0))),
    Row("efforts of 10^-160", COMPARE, ("never changes",), log(scaled(EFFORTS, 1e-160))),
    Row("still", COMPARE, ("still throughout",), log(put(ALL, BOTH, 0.1))),
    Row("noise", COMPARE, ("still throughout",), log(lambda rows: np.column_stack([
        rows[:, :1], np.random.default_rng(0).normal(size=(len(rows), 4))]))),
    Row("efforts in N·mm", COMPARE, ("in other units",), log(scaled(EFFORTS, 1e3)), code=0),
]  # fmt: skip

OFTEN, RARELY, DIGITS = "more often than", "too rarely", "numbers are"
TIMES = [
    Row("in ms", COMPARE, (RARELY, "ms, µs or ns"), log(scaled(0, 1e3))),
    Row("in ns", EXPLAIN, (RARELY,), log(scaled(0, 1e9))),
    Row("at 1 MHz", COMPARE, (OFTEN,), log(scaled(0, 1e-4))),
    Row("that grows like e^t", COMPARE, (RARELY,), log(lambda rows: put(
        ALL, 0, np.exp(rows[:, 0]))(rows))),
    Row("in ns since 1970, called s", COMPARE, ("Time is constant",), log(lambda rows: put(
        ALL, 0, rows[:, 0] + 1.7e18)(rows))),
    Row("of too few digits", COMPARE, (DIGITS,), log(lambda rows: put(
        ALL, 0, rows[:, 0] + 1.7e13)(rows))),
    Row("that jumps to 10^300", COMPARE, (DIGITS,), log(put(-1, 0, 1e300))),
    Row("backwards", COMPARE, ("runs backwards",), log(scaled(0, -1.0))),
    Row("that repeats", COMPARE, ("Time repeats",), log(lambda rows: put(
        1000, 0, rows[999, 0])(rows))),
    Row("that stands", COMPARE, ("is constant",), log(put(ALL, 0, 5.0))),
    Row("that starts again", COMPARE, ("runs backwards", "row 1201"), log(later(-12.0))),
    Row("an hour later", COMPARE, ("split into 2 pieces",), log(later(3600.0)), code=0),
    Row("before zero", COMPARE, (), log(lambda rows: put(ALL, 0, rows[:, 0] - 1e4)(rows)), code=0),
    Row("at random", COMPARE, ("split into",), log(lambda rows: put(
        ALL, 0, np.sort(np.random.default_rng(0).uniform(0, 24, len(rows))))(rows)), code=0),
    Row("missing once", COMPARE, ("split into 2 pieces",), log(put(100, 0, np.nan)), code=0),
    Row("thirty rows", COMPARE, ("32 samples",), log(lambda rows: rows[:30])),
    Row("half a second", COMPARE, ("too short",), log(lambda rows: rows[:50])),
]  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", [*SPIKES, *TURNS, *EMPTY, *TIMES], ids=str)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


def test_efforts_in_other_units_are_simulated(tmp_path, monkeypatch):
    """The robot flies apart, in ever smaller steps, of which there are fewer here."""
    monkeypatch.setattr(simulation, "_STEPS", 500)
    monkeypatch.setattr(simulation, "_TIMES", 1)
    make = log(scaled(EFFORTS, 1e3))
    says = ("in other units", "breaks off")
    Row("in N·mm", ROLLOUT, says, make, 0, ("new.json",)).check(tmp_path, monkeypatch)
