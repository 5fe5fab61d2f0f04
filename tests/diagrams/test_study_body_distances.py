"""The study of distances between bodies shows what its figures are there to show."""

import json

import numpy as np
import pytest
from scripts import call

GEOMETRIC = ("pullback", "entropic", "riemannian")
EUCLIDEAN = ("euclidean, kg-m", "euclidean, inch-pound")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Numbers and figures of a short run."""
    folder = tmp_path_factory.mktemp("study")
    options = ["--json", folder / "table.json", "--figures", folder / "figures"]
    call("body_distances", "--quick", "--seed", 3, *options)
    return json.loads((folder / "table.json").read_text(encoding="utf-8")), folder / "figures"


def test_figures(study):
    _, figures = study
    names = {path.stem for path in figures.glob("*.png")}
    assert names == {f"body_distances_{name}" for name in ("geodesic", "pose", "size")}


def test_only_the_euclidean_distance_knows_frames_and_units(study):
    spread = study[0]["frames_and_units"]["largest_over_smallest_less_1"]
    assert all(spread[name] < 1e-9 for name in GEOMETRIC)
    assert spread["euclidean"] > 1e3


def test_curves_differ_by_unit_for_the_euclidean_distance(study):
    curves = study[0]["curves"]
    for name in ("position", "orientation", "volume"):
        metric, imperial = (np.array(curves[name][key]) for key in EUCLIDEAN)
        assert np.abs(metric - imperial).max() > 0.1


def test_nearest_along_the_long_axis(study):
    table = study[0]
    assert all(angle in (0.0, 180.0) for angle in table["direction_of_shortest_deg"].values())
    ratio = table["shortest_over_longest_by_direction"]
    assert all(ratio[name] < 0.2 for name in GEOMETRIC)
    assert all(ratio[name] > 0.8 for name in EUCLIDEAN)
    # Moved by d along x: m d² / Σxx with Σxx = m a²/5, against a ninth of it across.
    assert ratio["entropic"] == pytest.approx(1 / 9)


def test_geometric_distances_do_not_grow_with_mass(study):
    ratio = study[0]["largest_over_smallest_by_mass"]
    assert all(ratio[name] < 1.5 for name in GEOMETRIC)  # which is the noise of 200 samples
    assert all(ratio[name] == pytest.approx(40**2, rel=0.4) for name in EUCLIDEAN)


def test_riemannian_and_entropic_distance_keep_growing_as_a_body_shrinks(study):
    curves = study[0]["curves"]["volume"]
    volume = np.array(curves["x"])
    small = volume < 1e-3

    def steepness(name):
        """Slope over log volume at the smallest body, over that of a thousandth's volume."""
        slope = np.diff(np.array(curves[name])[small]) / np.diff(np.log(volume[small]))
        assert (slope < 0).all()
        return slope[0] / slope[-1]

    assert steepness("riemannian") > 1.2  # log² of the volume
    assert 0.8 < steepness("entropic") < 1.0  # log of it
    assert all(steepness(name) < 0.2 for name in ("pullback", *EUCLIDEAN))  # finite
