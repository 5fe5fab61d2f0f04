"""Options with values that they cannot have."""

import pytest
from hostile import Row

ROWS = [
    Row("no such effect", "add friction robot.urdf log.csv", ("no effect 'friction'",)),
    Row("all is well", "compare robot.urdf log.csv --json new.json", code=0, writes=("new.json",)),
]


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
