"""Check the columns of the same log once.

Most files here hold the log of one pendulum in another format or under another name, and each
command first searches its columns for mistakes.
"""

import pickle
from dataclasses import fields, replace

import pytest
from hostile import PENDULUM, fill

from geodrake.cli import command, progress

_FOUND = {}
_SEARCH = command.found_columns


def found_once(model, logs, settings):
    """Return the findings of `found_columns`, kept for the same model, numbers and settings."""
    if model.path.read_bytes() != PENDULUM.read_bytes():
        return _SEARCH(model, logs, settings)
    known = [getattr(model, f.name) for f in fields(model) if f.name not in ("plant", "path")]
    numbers = [replace(log, name="log") for log in logs]
    key = pickle.dumps((known, numbers, settings))
    if key not in _FOUND:
        _FOUND[key] = _SEARCH(model, logs, settings)
    return _FOUND[key]


@pytest.fixture(autouse=True)
def columns_are_checked_once(monkeypatch):
    monkeypatch.setattr(command, "found_columns", found_once)


@pytest.fixture(autouse=True)
def no_word_of_progress_on_a_busy_machine(monkeypatch):
    monkeypatch.setattr(progress, "_SILENT", 600.0)


@pytest.fixture
def filled(tmp_path, monkeypatch):
    """Change to a folder of good files."""
    fill(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path
