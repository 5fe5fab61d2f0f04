"""Results in a notebook, as files of samples, and as JSON with its schema."""

import csv
import inspect
import json
import sys
from dataclasses import is_dataclass, replace
from functools import cache
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from runpy import run_path

import numpy as np
import pandas
import pyarrow.parquet
import pytest
import yaml
from commands import refused, told
from matplotlib.figure import Figure
from pendulum_logs import PENDULUM, friction, pendulum_log
from report_results import explanation, joint_names

from geodrake import load_model
from geodrake.boundary.showing import Short, Shown
from geodrake.control import roll_out
from geodrake.control.rollout import FittedValue, RolloutFit
from geodrake.diagnosis import add, compare, diagnose
from geodrake.effects import FittedEffect, JointElasticity
from geodrake.errors import ArgumentError
from geodrake.excitation import DesignOptions, FourierMotion, design_excitation, log_identifiability
from geodrake.identification import identify_model
from geodrake.logs import write_log
from geodrake.report.json_output import NoNumber, record, schema, to_json
from geodrake.report.views import numbers_of

MODEL = str(PENDULUM)
PACKAGES = (
    "inertia", "manifolds", "logs", "robot", "effects", "model", "identification",
    "identification.models", "diagnosis", "excitation",
    "control", "control.rollout",
)  # fmt: skip


@cache
def recorded():
    """Return a log with friction that the model lacks."""
    return pendulum_log(1, friction((0.3, 0.2), (0.2, 0.1)), seconds=16.0, rate=100.0)


def designed():
    return design_excitation(
        load_model(MODEL),
        trajectory=FourierMotion(4.0, 2),
        options=DesignOptions(samples=40, iterations=2, sharpness=(8.0,)),
        seeds=1,
    )


def soft():
    """Return a fit of an elastic elbow that was not adopted."""
    model = load_model(MODEL)
    spring = FittedEffect(JointElasticity("elbow"), np.array([1e-3]))
    model = replace(model, effects=(*model.effects, spring))
    motion = roll_out(model, [recorded()], horizon=0.1, most=3)
    value = FittedValue("joint_elasticity", "elbow", "compliance", 1e-3, 1e-4, 1e-5)
    return RolloutFit(model, (value,), motion, motion, (False, True, True), 1.0)


MAKERS = {
    "model": lambda: load_model(MODEL),
    "log": recorded,
    "Comparison": lambda: compare(load_model(MODEL), [recorded()]),
    "Diagnosis": lambda: diagnose(load_model(MODEL), [recorded()]),
    "Explanation": lambda: add(
        "coulomb_friction", load_model(MODEL), [recorded()], where=["elbow"]
    ),
    "ModelIdentification": lambda: identify_model(load_model(MODEL), [recorded()]),
    "ExcitationResult": designed,
    "LogIdentifiability": lambda: log_identifiability(load_model(MODEL), [recorded()]),
    "Rollout": lambda: roll_out(load_model(MODEL), [recorded()], horizon=0.1, most=3),
    "RolloutFit": soft,
}


@pytest.fixture(scope="module")
def results():
    made = {}

    def get(name):
        if name not in made:
            made[name] = MAKERS[name]()
        return made[name]

    return get


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    write_log(recorded(), path)
    return path


def parts(value, seen):
    """Yield a value and all values in it."""
    if id(value) in seen:
        return
    seen[id(value)] = value
    yield value
    if is_dataclass(value) and not isinstance(value, type):
        for held in vars(value).values():
            yield from parts(held, seen)
    elif isinstance(value, tuple | list):
        for held in value[:3]:
            yield from parts(held, seen)


@pytest.mark.parametrize("name", MAKERS)
def test_results_have_short_reprs_tables_figures_and_frames(results, name):
    result = results(name)
    for part in parts(result, {}):
        if type(part).__module__.startswith("geodrake"):
            assert len(repr(part)) < 1000, type(part)
    if name[0].islower():
        return
    assert isinstance(result, Shown)
    page = result._repr_html_()
    assert page.startswith("<div><p>") and page.count("<table>") == page.count("</table>") >= 1
    assert isinstance(result.plot(), Figure)
    assert isinstance(result.to_dataframe(), pandas.DataFrame)
    if name == "LogIdentifiability":
        with pytest.raises(ArgumentError, match="LogIdentifiability has no samples"):
            result.to_dataframe(series=True)
        return
    frame = result.to_dataframe(series=True)
    assert len(frame) > 30 and frame["time"].notna().all()


def test_public_results_with_arrays_have_a_short_repr():
    for package in PACKAGES:
        public = import_module(f"geodrake.{package}")
        for name in public.__all__:
            kind = getattr(public, name)
            if inspect.isclass(kind) and is_dataclass(kind) and kind.__dataclass_params__.repr:
                fields = kind.__dataclass_fields__.values()
                arrays = [f for f in fields if str(f.type).startswith(("Array", "NDArray"))]
                assert not arrays or issubclass(kind, Short), f"geodrake.{package}.{name}"


def test_frame_has_the_numbers_of_the_result(results):
    found = results("Comparison")
    frame = found.to_dataframe().set_index("joint")
    assert frame["rms"].to_dict() == found.errors.by_joint()
    samples = found.to_dataframe(series=True)
    for joint, rms in found.errors.by_joint().items():
        residual = samples[f"{joint}.residual"].dropna()
        assert np.sqrt((residual**2).mean()) == pytest.approx(rms)


def test_missing_packages_are_named_with_their_installation(results, monkeypatch, file):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ArgumentError, match=r'pip install "geodrake\[notebook\]"'):
        results("Comparison").to_dataframe()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    said = refused("compare", MODEL, file, "--series", file.with_suffix(".parquet"))
    assert 'pip install "geodrake[logs]"' in said


class TestSeriesFile:
    def test_csv_and_parquet_agree(self, tmp_path, file):
        table, parquet = tmp_path / "s.csv", tmp_path / "s.parquet"
        for target in (table, parquet):
            said = told("compare", MODEL, file, "--series", target, "-q")
            assert f"Saved the samples: {target}" in said
        with table.open(newline="", encoding="utf-8") as opened:
            rows = list(csv.DictReader(opened))
        columns = pyarrow.parquet.read_table(parquet).to_pydict()
        assert list(rows[0]) == list(columns)
        for name in ("time", "elbow.measured", "elbow.residual"):
            read = [float(row[name] or "nan") for row in rows]
            np.testing.assert_allclose(read, columns[name], rtol=1e-8)
        assert set(columns["log"]) == {"log"}

    def test_before_and_after_of_an_addition(self, tmp_path, file):
        target = tmp_path / "s.csv"
        told("add", "coulomb_friction@elbow", MODEL, file, "--series", target, "-q")
        frame = pandas.read_csv(target)
        before, after = (frame[f"elbow.residual{end}"] for end in ("_before", ""))
        assert (after**2).sum() < 0.5 * (before**2).sum()

    def test_rollout_of_two_models(self, tmp_path, file):
        target = tmp_path / "s.csv"
        windows = ("--windows", 2, "--horizon", 0.05, "--before", MODEL)
        told("rollout", MODEL, file, *windows, "--series", target, "-q")
        frame = pandas.read_csv(target)
        assert set(frame["window"]) == {0, 1}
        assert (frame["shoulder.residual"] == frame["shoulder.residual_before"]).all()


SCHEMA = run_path(str(Path(__file__).parents[2] / "tools" / "result_schema.py"))


def test_numbers_that_are_not_finite_are_null_with_a_reason():
    result = {"a/b": [1.0, np.nan], "c~": {"x": np.array([np.inf, 2.0])}, "d": None, "e": "nan"}
    found = json.loads(to_json(result), parse_constant=lambda name: 1 / 0)
    assert found["a/b"] == [1.0, None]
    assert found["c~"] == {"x": [None, 2.0]}
    assert found["nulls"] == {
        "/a~1b/1": "was not determined",
        "/c~0/x/0": "is infinite",
        "/d": "does not apply here",
    }


def test_known_reasons_of_nulls_are_given():
    found = json.loads(to_json({"x": NoNumber("nobody looked"), "y": 1.0}))
    assert found == {"x": None, "y": 1.0, "nulls": {"/x": "nobody looked"}}
    assert json.loads(to_json({"a": [np.float64(1.5), 2, True, "x"]})) == {"a": [1.5, 2, True, "x"]}
    found = json.loads(to_json(numbers_of(explanation(joint_names(2), ()))))
    assert found["certificate"] is None and found["steps"] == []
    assert found["nulls"]["/certificate"] == "the model stays as it is"


def test_published_schema_is_that_of_the_tables():
    published = SCHEMA["PAGE"].read_text(encoding="utf-8")
    assert published == SCHEMA["published"]()
    kinds = json.loads(published)["$defs"]
    assert kinds["Failing"]["properties"]["rms"]["description"] == "N·m or N"
    assert {kind["$ref"].split("/")[-1] for kind in json.loads(published)["anyOf"]} <= set(kinds)


def test_the_schema_is_the_same_without_libyaml():
    text = (files("geodrake.report") / "schema.yaml").read_text(encoding="utf-8")
    assert yaml.load(text, yaml.SafeLoader) == schema()


def test_an_object_has_the_keys_of_its_kind():
    """They come from arguments and attributes, also in nested objects."""
    rest = SCHEMA["Closed"]()
    known = {"time": 1.0, "seconds": 2.0}
    assert record("Gap", rest, **known) == known
    log = record("DigestedLog", log="a.csv", status="made", reason="", seconds=3.0)
    assert list(log) == ["log", "status", "reason", "seconds"]
    with pytest.raises(KeyError, match="Gap has no metres"):
        record("Gap", rest, **known, metres=3.0)
    with pytest.raises(AttributeError, match="seconds"):
        record("Gap", rest, time=1.0)
