"""All parts of a release agree."""

import re
import tomllib
from pathlib import Path

import pytest
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


CONDA = {"matplotlib": "matplotlib-base", "mujoco": "mujoco-python"}


def test_the_recipe_needs_what_the_package_needs():
    """Packages and versions are the same; Drake, which conda lacks, comes by pip."""
    stated = yaml.safe_load(text_of("conda/recipe.yaml"))
    needed = {}
    for each in (*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"):
        name, least = re.fullmatch(r"([\w-]+)(?:\[\w+\])?(>=[\d.]+)", each).groups()
        needed[CONDA.get(name, name)] = least
    drake = needed.pop("drake")
    assert dict(each.split(" ") for each in stated["requirements"]["run"]) == needed
    *_, by_pip = yaml.safe_load(text_of("conda/environment.yml"))["dependencies"]
    assert by_pip["pip"] == [f"drake{drake}", "-e .."]
    scripts = [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]
    assert stated["build"]["python"]["entry_points"] == scripts
    assert stated["about"]["summary"] == PROJECT["description"]


def test_the_recipe_is_one_for_rattler_build():
    rattler = pytest.importorskip("rattler_build")
    (package,) = rattler.Stage0Recipe.from_file(ROOT / "conda" / "recipe.yaml").render()
    told = package.recipe.package
    assert (told.name, told.version) == (PROJECT["name"], PROJECT["version"])


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
