"""The harness of scripts, and the page of benchmarks."""

import json
import math
import re

import pytest
from scripts import SCRIPTS

from diagrams import benchmarks_page
from diagrams.harness import run_draws, script_parser, write


@pytest.mark.parametrize("wrong", [["--seed", "-1"], ["--jobs", "0"], ["--jobs", "two"]])
def test_invalid_numbers_are_refused(wrong, capsys):
    with pytest.raises(SystemExit):
        script_parser("A study.", draws=True).parse_args(wrong)
    assert wrong[0] in capsys.readouterr().err


def test_draws_of_two_processes_are_cached(tmp_path):
    parser = script_parser("A study.", draws=True)
    table = tmp_path / "new" / "table.json"
    options = parser.parse_args(["--quick", "--jobs", "2", "--json", str(table)])
    assert run_draws(parser, options, math.factorial, [4, 3]) == [24, 6]
    write(options, {})
    assert table.is_file()
    cache = table.with_suffix(".draws.jsonl")
    assert len(cache.read_text(encoding="utf-8").splitlines()) == 2
    with cache.open("a", encoding="utf-8") as file:
        file.write('{"key": {"versi')
    assert run_draws(parser, options, math.isqrt, [3, 4]) == [6, 24]
    assert run_draws(parser, options, math.isqrt, [4], plan="another") == [2]


RUNS = json.loads(benchmarks_page.FIGURES.read_text(encoding="utf-8"))
TEMPLATE = (benchmarks_page.HERE / "benchmarks.md.jinja").read_text(encoding="utf-8")


def test_page_is_what_the_command_makes():
    assert benchmarks_page.PAGE.read_text(encoding="utf-8") == benchmarks_page.made_page(RUNS)


def test_every_figure_is_on_the_page_and_of_a_script():
    whole = TEMPLATE
    for short, name in re.findall(r"{%-? set (\w+) = (\w+)", TEMPLATE):
        whole = re.sub(rf"\b{short}\.", f"{name}.", whole)
    for name, run in RUNS.items():
        script = re.fullmatch(r"python -m (diagrams\.\w+\.\w+)( .*)?", run["command"])
        assert script[1] in SCRIPTS.values()
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", run["measured"])
        for figure in run["figures"]:
            assert re.search(rf"\b{name}\.{figure}\b", whole), f"{name}.{figure}"


def test_figures_are_read_from_what_a_script_writes():
    lines = [{"figure": "named", "value": 0.95, "logs": 20, "kind": k} for k in "ab"]
    figures = {
        "named": "it.lines | where('figure', 'named', 'kind', 'b') | first | hits",
        "middle": "it.times | median",
    }
    run = {"command": "x", "from": figures}
    found = benchmarks_page.read(run, {"lines": lines, "times": [3.0, 1.0, 2.0]})
    assert found["figures"] == {"named": 19, "middle": 2.0}
    with pytest.raises(SystemExit, match="x wrote no middle"):
        benchmarks_page.read(run, {"lines": lines})
    assert benchmarks_page.of(19, 20).startswith("19 of 20 (76–99 %)")
