"""Run commands in the folder of their test, and compare their JSON with its schema."""

from pathlib import Path
from runpy import run_path

import msgspec
import pytest

from geodrake.report.json_output import to_json

WRITTEN_BY = run_path(str(Path(__file__).parents[2] / "tools" / "result_schema.py"))["written_by"]


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    """Change to an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def schema_of_numbers(monkeypatch):
    """Compare the numbers of every command with the published schema."""

    def compared(result):
        text = to_json(result)
        msgspec.json.decode(text, type=WRITTEN_BY(result["command"]))
        return text

    monkeypatch.setattr("geodrake.cli.command.to_json", compared)
    monkeypatch.setattr("geodrake.cli.fleet.to_json", compared)
