"""The studies of adaptive control of the WAM-like arm: their parts, and what they must show."""

import json

from scripts import call

from diagrams.studies.adaptive import laws


def test_controllers_are_compared(tmp_path):
    table = tmp_path / "table.json"
    call("wam_adaptation", "--quick", "--controllers", "--json", table)
    rows = json.loads(table.read_text(encoding="utf-8"))["summary"]
    found = {(row["controller"], row["noise"] > 0.0, row["law"]) for row in rows}
    assert len(found) == len(rows) == 16
    assert not any(row["lost"] for row in rows if row["law"] != laws.EUCLIDEAN)
