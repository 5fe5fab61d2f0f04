"""Wrong calls of every public function: they end in an error of geodrake, or in a finite result."""

import numpy as np
import pytest
from good_calls import NO_DOOR, Call, good_calls, public_callables
from wrong_calls import HELD, ended, given, outcomes

from geodrake.boundary.arguments import instances, integer, number, one_or_each, real_array
from geodrake.errors import ArgumentError
from geodrake.model import EffortSignal

CALLS = good_calls()


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", CALLS)
def test_good_call(name):
    call = CALLS[name]
    end, told = ended(call, {k: given(v) for k, v in call.arguments.items()}, must=False)
    assert end == "accepted", told


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", CALLS)
def test_wrong_calls(name):
    wrong = [str(outcome) for outcome in outcomes(name, CALLS[name]) if outcome.end not in HELD]
    assert not wrong, "\n".join(wrong)


def test_every_public_callable_has_a_row():
    names = {name for name, _ in public_callables()}
    assert not names - set(CALLS) - set(NO_DOOR), "give it a good call, or a reason"
    assert not set(NO_DOOR) - names, "these are no longer public"


def test_a_call_that_is_believed_is_noticed():
    found = list(outcomes("halved", Call(lambda x: 0.5 * np.asarray(x, float), {"x": np.ones(2)})))
    ends = {outcome.words: outcome.end for outcome in found}
    assert ends["complex"] == "warning"
    assert ends["NaN at one place"] == "not finite"
    assert ends["texts"] == "believed"
    assert ends["a text"] == "ValueError"
    assert ends["an object"] == "inside"


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
        (lambda: EffortSignal("a", "command", 1.0, limit="5"), "limit of a must be .* type <U1"),
    ],
)
def test_messages_name_what_is_expected_and_what_came(check, message):
    with pytest.raises(ArgumentError, match=message):
        check()
