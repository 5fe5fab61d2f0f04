"""Programs with handlers of their own: files are written, and children reaped elsewhere."""

import signal

import numpy as np
import pytest

from geodrake.boundary.arguments import integers
from geodrake.boundary.whole_files import write_together
from geodrake.errors import ArgumentError
from geodrake.identification.solvers import in_subprocess


@pytest.fixture
def handler():
    """Sets a handler of a signal for the time of a test."""
    before = {}

    def handle(number, function):
        before[number] = signal.signal(number, function)

    yield handle
    for number, function in before.items():
        signal.signal(number, function)


def test_files_are_written_where_the_handler_returns(tmp_path, handler):
    came = []
    handler(signal.SIGINT, lambda number, _: came.append(number))

    def content(file):
        file.write(b"new")
        if not came:
            signal.raise_signal(signal.SIGINT)

    write_together({tmp_path / "one": content, tmp_path / "two": "new"})
    assert came == [signal.SIGINT]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(
        ("one", "two"), "new"
    )


def test_an_answer_is_kept_where_children_are_reaped_elsewhere(handler):
    handler(signal.SIGCHLD, signal.SIG_IGN)
    assert in_subprocess(lambda: 42, seconds=30.0) == 42


def test_the_signals_of_the_caller_stay_as_they_were():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    in_subprocess(lambda: None, seconds=30.0)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def test_integers_of_numpy_are_integers():
    assert integers(np.arange(3), "seeds") == (0, 1, 2)
    for wrong in ([1.0], [True], "12", 3):
        with pytest.raises(ArgumentError, match="seeds must be"):
            integers(wrong, "seeds")
