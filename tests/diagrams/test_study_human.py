"""The human study: the source's residual, equal for all, and bodies that stay bodies."""

import json

import pytest
from scripts import call


@pytest.mark.measurements("data/human_force_plate.npz")
def test_residuals_and_bodies(tmp_path):
    table = ("--json", tmp_path / "table.json", "--figures", tmp_path)
    call("human_identification", "--quick", *table)
    rows = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    assert len(rows) == 8
    for row in rows:
        assert abs(row["mismatch"]) < 1e-5
        if row["alpha"] == 0.01:
            assert row["residual"] == pytest.approx(1331878.41, rel=1e-6)
        if row["regularizer"] == "euclidean":
            assert len(row["degenerate"]) >= 8  # as in figure 3.13
        else:
            assert not row["degenerate"] and row["least"] > 0.1
        assert row["starts_agree"] in ((True,) if row["regularizer"] == "riemannian" else (None,))
    assert len(list(tmp_path.glob("human_*.png"))) == 3
