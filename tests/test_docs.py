"""Pages of docs/ have valid links, code that runs, and options that commands take."""

import re
import shlex
import warnings
from importlib import import_module
from pathlib import Path
from runpy import run_path

import pytest
import typer.main
import yaml

from geodrake.cli.app import app
from geodrake.effects import catalogue

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))
WITH_PYTHON = [page for page in PAGES if "```python" in page.read_text(encoding="utf-8")]


def text_of(page):
    return page.read_text(encoding="utf-8")


def cli_commands():
    return typer.main.get_command(app).commands


def blocks(page, language):
    found = re.findall(r"^```(\w*)\n(.*?)^```", text_of(page), re.M | re.S)
    return [block for own, block in found if own == language]


def anchors(page):
    """Return the anchors of the headings of a page."""
    titles = re.findall(r"^#+ (.+)$", text_of(page), re.M)
    words = (re.sub(r"[^\w\s-]", "", title.lower()) for title in titles)
    return {re.sub(r"[-\s]+", "-", word.strip()) for word in words}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", text_of(page)):
        path, _, anchor = target.partition("#")
        to = page.parent / path if path else page
        assert to.is_file(), target
        assert to.suffix != ".png" or PAGES[0].parent in to.resolve().parents, target
        assert not anchor or anchor in anchors(to), target


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.stem)
def test_lines_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": page.stem}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for code in blocks(page, "python"):
            exec(compile(code, page.name, "exec"), names)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_commands_take_the_options_that_they_are_given(page):
    commands = cli_commands()
    lines = [line for block in blocks(page, "") for line in block.splitlines()]
    for line in lines:
        words = shlex.split(line.split("&&")[-1])
        if words[:1] == ["geodrake"]:
            options = {o for p in commands[words[1]].params for o in p.opts}
            assert {word for word in words[2:] if word.startswith("--")} <= options, line
            if words[1] == "export":  # the folder comes last, after the logs
                assert "." not in Path(words[-1]).name, line
        elif words[:2] == ["python", "-m"]:
            assert (ROOT / f"{words[2].replace('.', '/')}.py").is_file(), line


def test_every_page_is_in_the_navigation():
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    sections = [pages for section in yaml.safe_load(site)["nav"] for pages in section.values()]
    named = {page for pages in sections for entry in pages for page in entry.values()}
    assert named == {page.name for page in PAGES}


def test_limits_are_said_on_one_page():
    assert len(text_of(ROOT / "docs" / "limits.md").splitlines()) <= 80


def test_pages_of_the_site_have_all_that_help_and_packages_say():
    """Those that are made from the package when the site is built."""
    pytest.importorskip("mkdocs")
    made, commands = run_path(str(ROOT / "tools" / "site_pages.py")), cli_commands()
    pages = made["command_pages"]()
    assert set(pages) == {f"commands/{name}.md" for name in commands}
    for name, command in commands.items():
        page = pages[f"commands/{name}.md"]
        assert command.help in page
        for param in command.params:
            assert param.param_type_name == "argument" or param.opts[0] in page
            assert (param.help or "").replace("|", "\\|").split("\n")[0] in page
    assert {"geodrake.diagnosis", "geodrake.control"} <= set(made["PACKAGES"])
    pages = made["package_pages"]()
    for package in made["PACKAGES"]:
        page = pages[f"api/{package}.md"]
        for name in made["package_names"](package):
            assert f".{name}\n" in page or f"## {name}\n" in page
    results = pages["api/geodrake.diagnosis.md"].partition("## Results")[2]
    for parts in (".JointError\n", ".Certificate\n", ".FittedRival\n"):  # of what is returned
        assert parts in results and ".Explanation\n" not in results


def test_names_to_look_up_are_those_that_packages_export():
    rows = re.findall(r"^\| `(geodrake[.\w]*)` \| (.*)", text_of(ROOT / "docs" / "api.md"), re.M)
    named = {package: re.findall(r"`(\w+)`", words) for package, words in rows}
    assert len(named) > 10 and all(named.values())
    for package, names in named.items():
        assert set(names) <= {*import_module(package).__all__}, package


def test_every_effect_has_its_picture():
    page = text_of(ROOT / "docs" / "effects.md")
    for effect in catalogue():
        assert f"### `{effect.name}`" in page
        assert f"figures/effects/{effect.name}.png" in page


ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in text_of(ROOT / "docs" / "source.md").splitlines()
    if re.match(r"\| [1-6AB]\.\d", line)
]
# How many subsections every section of a chapter has.
SECTIONS = {
    "1": [0, 0],
    "2": [0, 2, 2],
    "3": [0, 2, 4, 2, 1, 3, 0, 0],
    "4": [0, 3, 3, 0, 2, 3, 0],
    "5": [0, 1, 2, 2, 2, 0, 0],
    "6": [0, 0, 0],
    "A": [0] * 11,
    "B": [0, 0, 2, 0],
}


class TestSource:
    """The table of the source's sections names existing modules, and every section."""

    def test_every_section_is_there(self):
        expected = []
        for chapter, counts in SECTIONS.items():
            for number, count in enumerate(counts, 1):
                section = f"{chapter}.{number}"
                expected += [section, *(f"{section}.{k}" for k in range(1, count + 1))]
        expected += [f"{of}.{k}" for of in ("3.6.2", "5.2.1") for k in (1, 2)]
        found = [row[0].split()[0] for row in ROWS]
        assert sorted(found) == sorted(expected)

    def test_modules_tests_and_studies_exist(self):
        for section, modules, tests, studies, done in ROWS:
            for name in re.findall(r"`([\w.]+)`", modules):
                import_module(f"geodrake.{name}")
            for path in re.findall(r"`([\w./]+)`", tests):
                assert (ROOT / "tests" / path).is_file(), f"{section}: {path}"
            for path in re.findall(r"`([\w./]+)`", studies):
                assert [*(ROOT / "diagrams").glob(f"*/{path}")], f"{section}: {path}"
            nothing = not (modules or tests or studies)
            assert not nothing or "nothing" in done or "our own" in done, section

    def test_every_study_of_the_source_is_named(self):
        named = {path for row in ROWS for path in re.findall(r"`([\w./]+)`", row[3])}
        citing = {
            path.name
            for path in (ROOT / "diagrams").glob("*/*.py")
            if "[Lee2019]" in path.read_text(encoding="utf-8")
        }
        assert citing <= named
