"""Charts of the scripts show what they are given."""

import pytest

from diagrams.harness import chart


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
