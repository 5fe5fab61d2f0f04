"""Work in a process of its own, which a solver may end: what is lost is told."""

import os
import signal
import time

import numpy as np
import pytest

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.solvers import LostProcessError, in_subprocess, solved_apart


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (os.abort, "ended with signal SIGABRT"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "ended with signal SIGSEGV"),
        (lambda: os._exit(10), "ended with exit code 10"),
        (lambda: os._exit(0), "ended with exit code 0"),
        (lambda: time.sleep(10), "did not finish in 0.2 s"),
        (lambda: 1 / 0, "raised ZeroDivisionError: division by zero"),
        (lambda: (_ for _ in ()).throw(SystemExit("assertion")), "raised SystemExit: assertion"),
    ],
    ids=["abort", "segfault", "exit", "silent exit", "hang", "error", "SystemExit"],
)
def test_a_lost_process_is_told(work, words, monkeypatch):
    fork, children = os.fork, []

    def counted():
        child = fork()
        children.append(child)
        return child

    monkeypatch.setattr(os, "fork", counted)
    with pytest.raises(LostProcessError, match=words):
        in_subprocess(work, seconds=0.2 if "did not finish" in words else 20.0)
    (child,) = children
    with pytest.raises(ChildProcessError):  # it is gone, and waited for
        os.waitpid(child, os.WNOHANG)


def test_answers_of_another_process_are_whole(capfd):
    assert in_subprocess(lambda: None, seconds=20.0) is None
    values = np.arange(1e5)
    np.testing.assert_array_equal(in_subprocess(lambda: 2.0 * values, seconds=20.0), 2.0 * values)

    def refuse():
        os.write(1, b"what a solver prints")
        raise ArgumentError("No.", advice="Take another.", minimum=np.ones(2))

    with pytest.raises(ArgumentError, match=r"^No\. Take another\.$") as caught:
        in_subprocess(refuse, seconds=20.0)
    np.testing.assert_array_equal(caught.value.evidence["minimum"], np.ones(2))
    assert capfd.readouterr() == ("", "")


def test_a_solver_that_dies_is_asked_for_less_once():
    def die_first(accuracies):
        if len(accuracies) > 1:
            os.abort()
        return len(accuracies)

    assert solved_apart(die_first, "clarabel") == 1
    with pytest.raises(IdentificationError, match="its process ended with signal SIGABRT"):
        solved_apart(lambda _: os.abort(), "clarabel")


def test_an_answer_comes_whatever_handlers_the_caller_has():
    """Children may be reaped elsewhere; signals that the caller blocks stay as they were."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        assert in_subprocess(lambda: 42, seconds=30.0) == 42
    finally:
        signal.signal(signal.SIGCHLD, before)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == blocked
