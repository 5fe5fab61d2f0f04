"""Wrong calls of everything exported: they end in an error of geodrake, or in a finite result."""

import numpy as np
import pytest
from calls import HELD, TABLES, UNCALLED, Call, ended, exports, good_calls, outcomes

ALLOWED = {f"{which} = {words})" for words, all_ in TABLES["allowed"].items() for which in all_}
CALLS, _UNKNOWN = good_calls()


def held(call):
    """The ends of wrong calls that may not be."""
    for argument, words, end, told in outcomes(call):
        what = f"{call.name}({argument} = {words})"
        asked = call.name.endswith(".contains") and words == "NaN at one place"
        if end not in HELD and not asked and what not in ALLOWED:
            yield f"{what}: {end}: {told}"


NAMES = [
    pytest.param(name, marks=pytest.mark.thorough if call.is_slow else ())
    for name, call in CALLS.items()
]


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", NAMES)
def test_wrong_calls(name):
    wrong = list(held(CALLS[name]))
    assert not wrong, "\n".join(wrong)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", NAMES)
def test_good_call(name):
    end, told = ended(CALLS[name])
    assert end == "accepted", told


def test_everything_exported_is_called():
    assert not _UNKNOWN, "give its arguments good values, or a reason in UNCALLED"
    called = {name.split(".")[0] for name in CALLS} | set(UNCALLED)
    assert len(called) > 150 and called <= {*exports(), *UNCALLED}
    assert {each.partition("(")[0] for each in ALLOWED} <= set(CALLS)


def test_a_call_that_is_believed_is_noticed():
    def halved(x):
        return 0.5 * np.asarray(x, float)

    found = outcomes(Call("halved", halved, {"x": np.ones(2)}))
    ends = {words: end for _, words, end, _ in found}
    assert ends["complex"] == "warning"
    assert ends["NaN at one place"] == "believed"
    assert ends["infinity at one place"] == "not finite"
    assert ends["texts"] == "believed"
    assert ends["a text"] == "ValueError"
    assert ends["an object"] == "inside"
