"""Numbers of JSON are finite, or null with the reason beside it; keys are those of its schema."""

import json
from importlib.resources import files
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
import yaml
from report_results import explanation, joint_names

from geodrake.report.json_output import NoNumber, record, schema, to_json
from geodrake.report.views import numbers_of

SCHEMA = run_path(str(Path(__file__).parents[2] / "tools" / "result_schema.py"))


def test_a_number_that_is_none_is_null_with_a_reason():
    result = {"a/b": [1.0, np.nan], "c~": {"x": np.array([np.inf, 2.0])}, "d": None, "e": "nan"}
    found = json.loads(to_json(result), parse_constant=lambda name: 1 / 0)
    assert found["a/b"] == [1.0, None]
    assert found["c~"] == {"x": [None, 2.0]}
    assert found["nulls"] == {
        "/a~1b/1": "was not determined",
        "/c~0/x/0": "is infinite",
        "/d": "does not apply here",
    }


def test_a_reason_that_is_known_is_told_and_nothing_where_all_are_finite():
    found = json.loads(to_json({"x": NoNumber("nobody looked"), "y": 1.0}))
    assert found == {"x": None, "y": 1.0, "nulls": {"/x": "nobody looked"}}
    assert json.loads(to_json({"a": [np.float64(1.5), 2, True, "x"]})) == {"a": [1.5, 2, True, "x"]}


def test_a_fit_that_there_was_not_has_no_certificate():
    found = json.loads(to_json(numbers_of(explanation(joint_names(2), ()))))
    assert found["certificate"] is None and found["steps"] == []
    assert found["nulls"]["/certificate"] == "the model stays as it is"


def test_published_schema_is_that_of_the_tables():
    published = SCHEMA["PAGE"].read_text(encoding="utf-8")
    assert published == SCHEMA["published"]()
    kinds = json.loads(published)["$defs"]
    assert kinds["Failing"]["properties"]["rms"]["description"] == "N·m or N"
    assert {kind["$ref"].split("/")[-1] for kind in json.loads(published)["anyOf"]} <= set(kinds)


def test_the_tables_are_read_alike_without_libyaml():
    text = (files("geodrake.report") / "schema.yaml").read_text(encoding="utf-8")
    assert yaml.load(text, yaml.SafeLoader) == schema()


def test_an_object_has_the_keys_of_its_kind():
    """From what is given and from attributes; objects in it are made likewise."""
    rest = SCHEMA["Closed"]()
    known = {"time": 1.0, "seconds": 2.0}
    assert record("Gap", rest, **known) == known
    log = record("DigestedLog", log="a.csv", status="made", reason="", seconds=3.0)
    assert list(log) == ["log", "status", "reason", "seconds"]
    with pytest.raises(KeyError, match="Gap has no metres"):
        record("Gap", rest, **known, metres=3.0)
    with pytest.raises(AttributeError, match="seconds"):
        record("Gap", rest, time=1.0)
