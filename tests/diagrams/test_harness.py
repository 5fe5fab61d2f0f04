"""What scripts share: options, draws that are kept, charts."""

import math

import pytest

from diagrams.harness import chart, run_draws, script_parser, write


@pytest.mark.parametrize(("largest", "lowest"), [(0.3, 0.0), (30.0, 0.002)])
def test_whiskers_are_cut_at_logarithms_alone(largest, lowest):
    """A share of 2 % whose interval begins at zero; beside large values the axis is logarithmic."""
    values = {1: (0.02, (0.02, 0.05)), 2: (largest, (0.01, 0.01))}
    rows = [{"x": x, "share": y, "share_deviation": off} for x, (y, off) in values.items()]
    (ax,) = chart(rows, "x", "share").axes
    whiskers = [bar for container in ax.containers for bar in container[2]]
    ends = [y for bar in whiskers for segment in bar.get_segments() for _, y in segment]
    assert min(ends) == pytest.approx(lowest, abs=1e-12)
    assert ax.get_yscale() == ("log" if lowest else "linear")


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
