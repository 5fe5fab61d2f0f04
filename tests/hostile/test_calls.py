"""Wrong calls of all exports end in an error of geodrake, or in a finite result."""

import pytest
from calls import HELD, TABLES, UNCALLED, ended, exports, good_calls, outcomes

ALLOWED = {f"{which} = {words})" for words, all_ in TABLES["allowed"].items() for which in all_}
PARTS = 5  # of the calls


def held(call):
    """Yield the ends of wrong calls that are not allowed."""
    for argument, words, end, told in outcomes(call):
        what = f"{call.name}({argument} = {words})"
        asked = call.name.endswith(".contains") and words == "NaN at one place"
        if end not in HELD and not asked and what not in ALLOWED:
            yield f"{what}: {end}: {told}"


def dealt_out(part, *, slow):
    """Return the calls of a part."""
    return [call for call in good_calls()[0].values() if call.is_slow == slow][part::PARTS]


SLOW = pytest.param(True, marks=pytest.mark.thorough)


@pytest.mark.sampled(PARTS)
@pytest.mark.parametrize("slow", [False, SLOW])
@pytest.mark.parametrize("part", range(PARTS))
def test_good_and_wrong_calls(part, slow):
    calls = dealt_out(part, slow=slow)
    bad = {call.name: told for call in calls for end, told in [ended(call)] if end != "accepted"}
    assert not bad
    wrong = [line for call in calls for line in held(call)]
    assert not wrong, "\n".join(wrong)


def test_everything_exported_is_called():
    calls, unknown = good_calls()
    assert not unknown, "give its arguments good values, or a reason in UNCALLED"
    called = {name.split(".")[0] for name in calls} | set(UNCALLED)
    assert len(called) > 150 and called <= {*exports(), *UNCALLED}
    assert {each.partition("(")[0] for each in ALLOWED} <= set(calls)
