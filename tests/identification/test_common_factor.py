"""Bodies that all become heavier, as efforts that are no N·m make them."""

import numpy as np
import pytest

from geodrake.identification.models.bodies import common_factor_notes
from geodrake.identification.models.results import BodyChange


def change(name, before, after):
    return BodyChange(name, (before, after), np.zeros((2, 3)), 0.1, np.zeros(3), False, 0.5)


@pytest.mark.parametrize("factor", [2.2, 1 / 2.2])
def test_the_factor_of_the_efforts_is_said(factor):
    bodies = [change("arm", 10.0, 10.0 * factor), change("hand", 3.3, 3.3 * factor)]
    (note,) = common_factor_notes(bodies)
    assert f"{13.3 * factor:.3g} kg, and 13.3 kg before" in note
    assert f"{1 / factor:.3g} times as large" in note


def test_nothing_is_said_of_bodies_as_far_off_as_files_may_be():
    assert common_factor_notes([change("arm", 10.0, 15.0), change("hand", 1.0, 0.5)]) == []
    assert common_factor_notes([]) == []
