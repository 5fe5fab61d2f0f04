"""Commands with bad, unlucky and malicious files, which are rows of data."""

import os

import pytest
from good_files import DIRECTIVES, SAVED
from hostile import Row, put
from makers import BODY, HEAD, damage, effect, log, npz, read_rows

from geodrake.control.rollout import stepping
from geodrake.effects import load_effect_file
from geodrake.errors import GeodrakeError, LogError
from geodrake.logs import read_log
from geodrake.logs.files import table

DAMAGED = [
    Row(f"{file}: {kind}", f"compare {file} log.csv", says, {file: content}, apart=apart)
    for file, says, apart, kinds in (
        ("bad.dmd.yaml", (), True, damage(DIRECTIVES, "arm", "directives: ")),
        ("saved.yaml", ("saved.yaml",), False, damage(SAVED, "abc", f"{HEAD}information: ")),
    )
    for kind, content in kinds.items()
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", [*read_rows(), *DAMAGED], ids=lambda row: row.name)
def test_row(row, tmp_path):
    row.check(tmp_path)
    assert not (tmp_path / "PWNED").exists()


def test_efforts_in_other_units_are_simulated(tmp_path, monkeypatch):
    """The robot diverges in ever smaller steps; the test allows fewer of them."""
    monkeypatch.setattr(stepping, "_FINEST", 1)
    command = "rollout robot.urdf x.csv --json new.json"
    says, make = ("in other units", "simulation fails"), {"x.csv": log("e *= 1e3")}
    Row("in N·mm", command, says, make, code=0, writes=("new.json",)).check(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_unreadable_files_are_refused(tmp_path):
    make = {"x.csv": lambda path: path.touch(0)}
    Row("file", "compare robot.urdf x.csv", ("Permission denied",), make).check(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "much"),
    [("x.npz", npz(), "12000 numbers"), ("x.csv", BODY, "of 5 numbers")],
)
def test_files_larger_than_memory_are_refused_before_reading(
    tmp_path, monkeypatch, name, content, much
):
    monkeypatch.setattr(table, "machine_memory", lambda: 100_000)
    put(tmp_path, {name: content})
    with pytest.raises(LogError, match=rf"{much}, which need 9\.6.*; this machine has 0\.0001 GB"):
        read_log(tmp_path / name)


ATTRIBUTES = (
    *("name", "parameters", "places", "role", "shapes", "depends_on", "complexity", "signature"),
    *("state_count", "companion", "contains", "proposer", "jumps", "shape", "candidates"),
    *("manifold", "signatrue", "depend_on"),
)
VALUES = (
    *("None", "3", "-1", "True", "np.nan", "object()", '""', '"lambda"', '"my effect"', '"../x"'),
    *('"payload"', '"\x1b[31mred"', '("width",)', "(1.0,)", '{"moon"}', '("viscous_friction",)'),
    *("Proposer.WAVES", "Proposer.WARMING", "Proposer.BENDING", "(JointEffect,)"),
    *('(Parameter("a", "N"), Parameter("a", "N"))', '(Parameter("a", "N", lower="0"),)'),
    *(f"Role.{role}" for role in ("BODY", "SCALE", "DELAY", "DEFLECTION", "EPISODE", "INERTIA")),
)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("attribute", ATTRIBUTES)
def test_invalid_attributes_of_effects_are_refused(attribute, tmp_path):
    refused = 0
    for value in VALUES:
        path = tmp_path / "own.py"
        path.write_text(effect(more=f"    {attribute} = {value}"), encoding="utf-8")
        try:
            load_effect_file(path)
        except GeodrakeError as error:
            assert "own.py" in str(error) and str(error).isprintable(), error
            refused += 1
    assert refused > len(VALUES) / 2
