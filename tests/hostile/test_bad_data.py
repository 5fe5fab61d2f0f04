"""Logs in order as tables, with measurements that no sensor in order makes."""

from dataclasses import replace

import numpy as np
import pytest
from hostile import HEADER, Row, table, write_log

from geodrake.control.rollout import simulation

FASTER = HEADER.replace("shoulder.effort", "shoulder.velocity,elbow.velocity,shoulder.effort")
ALL, BOTH, EFFORTS = slice(None), slice(1, 3), slice(3, 5)
POSITION, EFFORT, VELOCITY = 1, 3, 3  # of the shoulder; velocities stand before the efforts
COMPARE = "compare robot.urdf x.csv"
ROLLOUT = "rollout robot.urdf x.csv --json new.json"


def bad(name, says, *changes, code=2, command=COMPARE, velocity=False, rows=2400):
    """A row of a log that was changed.

    Args:
        name: What is bad.
        says: Parts of the message, with "; " between them.
        changes: (rows, columns, what stands there: a number, or a function of what stood there).
        code: Exit code.
        command: What reads the log.
        velocity: Whether the log has velocities.
        rows: How many rows are left.
    """

    def write(path):
        data = table()[:rows]
        if velocity:
            speed = np.gradient(data[:, BOTH], data[:, 0], axis=0)
            data = np.column_stack([data[:, :3], speed, data[:, 3:]])
        for where, column, new in changes:
            data[where, column] = new(data[where, column]) if callable(new) else new
        write_log(path, data, FASTER if velocity else HEADER)

    return Row(name, command, tuple(says.split("; ")), {"x.csv": write}, code)


def times(factor):
    return lambda values: factor * values


def plus(value):
    return lambda values: values + value


def first(values):
    return values[0]


def random_walk(values):
    return 1e10 * np.cumsum(np.sin(values * 99), 0)


def noise(values):
    return np.random.default_rng(0).normal(size=values.shape)


def turned(low, turn):
    return lambda values: (values - low) % turn + low


SPIKE, NONE = "jumps and comes back", "no robot in SI units has that"
SPIKES = [
    bad("uint32 of -1", f"{SPIKE}; 4.295e+09; t = 10.00 s", (1000, POSITION, 2.0**32 - 1), code=0),
    bad("10.5 rad in 12 s", SPIKE, (600, POSITION, 10.5), rows=1200, code=0),
    bad("three rows", f"{SPIKE}; 3 rows in all", ([100, 900, 901], POSITION, 1e5), code=0),
    bad("both joints", "of shoulder jumps; of elbow jumps", (1000, BOTH, -1e5), code=0),
    bad("the first row", f"{SPIKE}; t = 0.00 s", (0, POSITION, 1e6), code=0),
    bad("beside an empty cell", SPIKE, (999, 1, np.nan), (1000, 1, 1e6), code=0),
    bad("an effort of a million", f"{SPIKE}; effort of shoulder", (1000, EFFORT, 1e6), code=0),
    bad("a velocity of 10^200", SPIKE, (500, VELOCITY, 1e200), velocity=True, code=0),
    bad("a jump that stays", "and stays there", (slice(1200, None), 1, plus(50.0)), code=0),
    bad("10^30 from the middle on", f"Row 1201 ; {NONE}", (slice(1200, None), POSITION, 1e30)),
    bad("positions of 10^30", f"position of shoulder; {NONE}", (ALL, BOTH, times(1e30))),
    bad("efforts of 10^160", f"effort of shoulder; {NONE}", (ALL, EFFORTS, times(1e160))),
    bad("efforts of 10^12, simulated", NONE, (ALL, EFFORTS, times(1e12)), command=ROLLOUT),
    bad("velocities of 10^200", NONE, (ALL, VELOCITY, times(1e200)), velocity=True),
    bad("a walk of 10^9", NONE, (ALL, slice(1, 5), random_walk)),
]

WRAP, FROZEN, DEGREES = "unwrapped", "while the joint moves: left out", times(np.degrees(1.0))
TURN = turned(-np.pi, 2 * np.pi)
TURNS = [
    bad("0 to 2π", f"turn of 6.283; {WRAP}", (ALL, BOTH, turned(0, 2 * np.pi)), code=0),
    bad("±π", WRAP, (ALL, BOTH, plus(np.pi)), (ALL, BOTH, TURN), code=0),
    bad("0 to 360", "turn of 360; in degrees", (ALL, BOTH, DEGREES), (ALL, BOTH, turned(0, 360)),
        code=0),
    bad("degrees", "in degrees", (ALL, BOTH, DEGREES), code=0),
    bad("a frozen position", f"4 s from t = 8.00 s; {FROZEN}", (slice(800, 1201), POSITION, first),
        velocity=True, code=0),
    bad("frozen, then a jump", f"position of elbow; {FROZEN}", (slice(800, 1200), 2, first),
        code=0),
    bad("frozen throughout", "stays at; locked", (ALL, POSITION, first), velocity=True),
    bad("a frozen effort", f"effort of shoulder; {FROZEN}", (slice(800, 1200), EFFORT, first),
        code=0),
    bad("an effort frozen for most of it", "Has the sensor failed?", (slice(500, None), 3, first)),
    bad("a frozen velocity", "velocities are not used", (slice(800, 1200), VELOCITY, first),
        velocity=True, code=0),
    bad("a joint that stands", "", (ALL, POSITION, first), code=0),
    bad("velocities backwards", "200 % off", (ALL, slice(3, 5), times(-1)), velocity=True, code=0),
    bad("no velocity", "empty cells", (ALL, VELOCITY, np.nan), velocity=True, code=0),
]  # fmt: skip

EVERY_OTHER, THE_OTHERS = (slice(0, None, 2), 1, np.nan), (slice(1, None, 2), 2, np.nan)
EMPTY = [
    bad("a position never", "no position of shoulder", (ALL, POSITION, np.nan)),
    bad("an effort never", "no effort of elbow", (ALL, 4, np.nan)),
    bad("time never", "no time in any", (ALL, 0, np.nan)),
    bad("nothing ever", "0 rows without empty cells", (ALL, ALL, np.nan)),
    bad("every other row", "no 8 rows in a row", EVERY_OTHER),
    bad("every tenth row", "32 samples in a row", (slice(0, None, 10), 1, np.nan)),
    bad("joints in turns", "0 rows without empty cells", EVERY_OTHER, THE_OTHERS),
    bad("efforts of zero", "never changes", (ALL, EFFORTS, 0.0)),
    bad("still", "still throughout", (ALL, BOTH, 0.1)),
    bad("noise", "not in the order of time", (ALL, slice(1, 5), noise)),
    bad("efforts in N·mm", "in other units", (ALL, EFFORTS, times(1e3)), code=0),
]

TIMES = [
    bad("in ms", "too rarely; ms, µs or ns", (ALL, 0, times(1e3))),
    bad("at 1 MHz", "more often than", (ALL, 0, times(1e-4))),
    bad("that grows like e^t", "too rarely", (ALL, 0, np.exp)),
    bad("in ns since 1970, called s", "Time is constant", (ALL, 0, plus(1.7e18))),
    bad("of too few digits", "numbers are", (ALL, 0, plus(1.7e13))),
    bad("that jumps to 10^300", "reaches 1e+300 s", (-1, 0, 1e300)),
    bad("backwards", "runs backwards", (ALL, 0, times(-1.0))),
    bad("that repeats", "Time repeats", (slice(999, 1001), 0, first)),
    bad("that starts again", "runs backwards; row 1201", (slice(1200, None), 0, plus(-12.0))),
    bad("an hour later", "split into 2 pieces", (slice(1200, None), 0, plus(3600.0)), code=0),
    bad("before zero", "", (ALL, 0, plus(-1e4)), code=0),
    bad("at random", "split into", (ALL, 0, lambda t: np.cumsum(abs(noise(t)) / 80)), code=0),
    bad("missing once", "split into 2 pieces", (100, 0, np.nan), code=0),
    bad("thirty rows", "32 samples", rows=30),
    bad("half a second", "too short", rows=50),
]


MISSED = {
    "a joint that stands": "the bandwidth that is chosen leaves no samples of so short a log",
}
"""What is refused and should be read -> why."""


def with_marks(row):
    known = [pytest.mark.xfail(strict=True, reason=MISSED[row.name])] if row.name in MISSED else ()
    return pytest.param(row, marks=known, id=row.name)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", [*map(with_marks, [*SPIKES, *TURNS, *EMPTY, *TIMES])])
def test_row(row, tmp_path):
    row.check(tmp_path)


def test_efforts_in_other_units_are_simulated(tmp_path, monkeypatch):
    """The robot flies apart, in ever smaller steps, of which there are fewer here."""
    monkeypatch.setattr(simulation, "_STEPS", 500)
    monkeypatch.setattr(simulation, "_TIMES", 1)
    change = (ALL, EFFORTS, times(1e3))
    row = bad("in N·mm", "in other units; breaks off", change, command=ROLLOUT, code=0)
    replace(row, writes=("new.json",)).check(tmp_path)
