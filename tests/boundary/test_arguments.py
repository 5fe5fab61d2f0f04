"""Arguments that are wrong: the message says what is expected and what came."""

import numpy as np
import pytest

from geodrake.boundary.arguments import instances, integer, number, one_or_each, real_array
from geodrake.errors import ArgumentError
from geodrake.model import EffortSignal


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: real_array(np.ones((3, 9)), "phi", ("N", 10)), r"\(N, 10\) .* shape \(3, 9\)"),
        (lambda: real_array([[1.0, np.nan]], "v", ("N", 2)), r"holds nan at \[0, 1\]"),
        (lambda: real_array([1j], "q"), "of type complex128"),
        (lambda: real_array([[1.0], [1.0, 2.0]], "q"), r"it is \[\[1.0\], \[1.0, 2.0\]\]"),
        (lambda: real_array([1e200], "q"), r"holds 1e\+200 at \[0\]"),
        (lambda: real_array(np.ones(3), "b", ("N",), {"N": (2,)}), "with N = 2"),
        (lambda: real_array(np.ones((3, 2)), "x", ("...", 2), {"...": (4,)}), r"axes \(4,\)"),
        (lambda: number("1", "tolerance"), "tolerance must be a finite real number"),
        (lambda: number(0.0, "tolerance", lower=0.0, strict=True), "above 0; it is 0"),
        (lambda: integer(1.0, "count"), "a whole number; it is 1.0"),
        (lambda: integer(True, "count", lower=0), "of at least 0; it is True"),
        (lambda: instances("elbow", "joints", str), "a tuple of str; it is 'elbow'"),
        (lambda: instances(("elbow", 2), "joints", str), "number 1 is 2"),
        (lambda: one_or_each([1.0, 2.0], "width", 3), r"one number or 3; .* \(2,\)"),
        (lambda: one_or_each(-1.0, "width", 3), "at least 0; it is -1.0"),
        (lambda: EffortSignal("a", "command", 1.0, limit="5"), "limit of a must be .* it is '5'"),
    ],
)
def test_messages_name_what_is_expected_and_what_came(check, message):
    with pytest.raises(ArgumentError, match=message):
        check()
