"""What scripts share: options, draws that are kept, charts."""

import math

import pytest

from diagrams.harness import run_draws, script_parser, write


@pytest.mark.parametrize("wrong", [["--seed", "-1"], ["--jobs", "0"], ["--jobs", "two"]])
def test_numbers_that_make_no_sense_are_told_of(wrong, capsys):
    with pytest.raises(SystemExit):
        script_parser("A study.", draws=True).parse_args(wrong)
    assert wrong[0] in capsys.readouterr().err


def test_draws_of_two_processes_are_kept_and_not_done_again(tmp_path):
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
