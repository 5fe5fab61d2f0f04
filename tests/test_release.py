"""What a release consists of says the same everywhere."""

import re
import tomllib
from pathlib import Path

import yaml

import geodrake

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_is_that_of_the_changelog_and_the_recipe():
    released = re.findall(r"^## \[(\d[\d.]*)\] - \d{4}-\d\d-\d\d$", text_of("CHANGELOG.md"), re.M)
    assert released[0] == PROJECT["version"]
    assert yaml.safe_load(text_of("conda/recipe.yaml"))["context"]["version"] == PROJECT["version"]


def test_the_recipe_needs_what_the_package_needs():
    run = yaml.safe_load(text_of("conda/recipe.yaml"))["requirements"]["run"]
    recipe = {
        re.split(r"[ >=]", each)[0].removesuffix("-base").removesuffix("-python") for each in run
    }
    package = {re.split(r"[>=\[]", each)[0] for each in PROJECT["dependencies"]}
    assert recipe - {"python"} == package - {"drake"}


def test_entries_of_the_changelog_are_one_sentence():
    entries = re.findall(r"^- (.*(?:\n  .*)*)", text_of("CHANGELOG.md"), re.M)
    assert len(entries) > 20
    for entry in entries:
        assert entry.endswith(".") and not re.search(r"(?<!e\.g)\. [A-Z]", entry), entry


def test_extras_name_extras_that_are_there():
    extras = PROJECT["optional-dependencies"]
    for needs in extras.values():
        for group in re.findall(r"geodrake\[([\w,]+)\]", " ".join(needs)):
            assert set(group.split(",")) <= set(extras)


def test_types_are_marked():
    assert (Path(geodrake.__file__).parent / "py.typed").is_file()
