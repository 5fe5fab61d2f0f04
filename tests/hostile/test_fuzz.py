"""A fuzzer of the command line: files that were right once, changed at random places.

    FUZZ_CASES=250 pytest tests/hostile/test_fuzz.py -m "" --hypothesis-seed 5301 \
        --hypothesis-show-statistics

Hypothesis draws the changes and the command, shrinks what breaks, and counts how cases end. Each
runs in a process of its own. None may be called a bug of geodrake, end by a signal, take longer
than 30 s, print or write a number that is none, or change a file after it failed.
"""

import os
import tempfile
from pathlib import Path

import hypothesis
import pytest
from fuzz_cases import COMMANDS, FILES, cases, words
from hostile import KEPT, Row
from hypothesis import strategies as st

CASES = int(os.environ.get("FUZZ_CASES", "3"))
WRITES = ("kept.json", "kept.yaml")


@pytest.fixture(scope="module", autouse=True)
def everything_is_imported(tmp_path_factory):
    """Run every command once, so that copies of this process find all modules imported."""
    for command in dict.fromkeys(COMMANDS):
        row = Row(command, words("CSV log", command), code=0, writes=WRITES)
        row.check(tmp_path_factory.mktemp("good"))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", FILES)
@hypothesis.settings(
    max_examples=CASES,
    derandomize="FUZZ_CASES" not in os.environ,
    suppress_health_check=list(hypothesis.HealthCheck),
)
@hypothesis.given(drawn=st.data())
def test_nothing_breaks(kind, drawn):
    data, command = drawn.draw(cases(kind))
    with tempfile.TemporaryDirectory() as name:
        make = {FILES[kind]: data}
        row = Row(command, command, make=make, code=None, writes=WRITES, apart=True)
        row.check(Path(name))
        kept = Path(name, "kept.json").read_text(encoding="utf-8")
    hypothesis.event("refused" if kept == KEPT["kept.json"] else "a result")
