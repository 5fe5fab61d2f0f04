"""Pages of the site that are made when it is built: one a command, from its help; one a package.

`mkdocs.yml` names this file as a hook.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from inspect import isclass, isfunction
from pathlib import Path
from typing import Any

import typer.main
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from geodrake.cli.app import app
from geodrake.effects import catalogue

ROOT = Path(__file__).resolve().parents[1]
API = ROOT / "docs" / "api.md"
PACKAGES = tuple(
    re.findall(r"^\| `(geodrake[.\w]*)` \|", API.read_text(encoding="utf-8"), flags=re.M)
)
"""Those that the table of `docs/api.md` names."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages into the navigation, each under the page that lists its kind."""
    below = {"commands.md": command_pages(), "api.md": package_pages()}
    for section in config.nav or []:
        for entries in section.values():
            for place, entry in enumerate(entries if isinstance(entries, list) else ()):
                ((title, target),) = entry.items() if isinstance(entry, dict) else ((None, entry),)
                if target in below:
                    entries[place] = {title: [target, *below[target]]}
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, and the notebooks beside them."""
    for path, text in {**command_pages(), **package_pages()}.items():
        files.append(File.generated(config, path, content=text))
    for path in (ROOT / "diagrams" / "examples").glob("*.ipynb"):
        files.append(File.generated(config, f"notebooks/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files) -> str:
    """Link each command and package, in the table of its kind, with its page; and notebooks."""
    markdown = markdown.replace("../diagrams/examples/", "notebooks/")
    for path in command_pages() if page.file.src_path == "commands.md" else ():
        name = path.removeprefix("commands/").removesuffix(".md")
        markdown = re.sub(
            rf"^\| (`geodrake {name}[ `].*?) \|", rf"| [\1]({path}) |", markdown, flags=re.M
        )
    for path in package_pages() if page.file.src_path == "api.md" else ():
        name = path.removeprefix("api/").removesuffix(".md")
        markdown = markdown.replace(f"| `{name}` |", f"| [`{name}`]({path}) |")
    return markdown


def command_pages() -> dict[str, str]:
    """Return path -> text of the page of each command."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return {f"commands/{name}.md": _command_page(name, each) for name, each in commands.items()}


def _command_page(name: str, command: Any) -> str:
    arguments = [param for param in command.params if _is_argument(param)]
    usage = " ".join(_metavar(param) for param in arguments)
    lines = (command.epilog or "").splitlines()
    examples = [line for line in lines if line.startswith("geodrake ")]
    text = f"# geodrake {name}\n\n{command.help}\n\n```\ngeodrake {name} [OPTIONS] {usage}\n```\n\n"
    if examples:
        text += "For example:\n\n```\n" + "\n".join(examples) + "\n```\n\n"
    panels: dict[str, list[str]] = {}
    for param in command.params:
        panel = getattr(param, "rich_help_panel", None)
        title = "Arguments" if _is_argument(param) else panel or "Options"
        panels.setdefault(title, []).append(_row(param))
    for title, rows in sorted(panels.items(), key=lambda panel: panel[0] != "Arguments"):
        text += f"## {title}\n\n| | meaning |\n|---|---|\n" + "\n".join(rows) + "\n\n"
    return text


def _row(param: Any) -> str:
    """Return a parameter as a row of a table."""
    if _is_argument(param):
        words = _metavar(param)
    else:
        value = "" if param.is_flag else f" {_metavar(param)}"
        words = ", ".join([*param.opts, *param.secondary_opts]) + value
    default = ""
    if param.default not in (None, False, ()) and not callable(param.default):
        default = f" Default: `{param.default}`."
    cells = (f"`{words}`", f"{param.help or ''}{default}")
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _is_argument(param: Any) -> bool:
    return bool(param.param_type_name == "argument")


def _metavar(param: Any) -> str:
    words = str(param.metavar or (param.name or "").upper())
    several = "" if param.nargs != -1 or words.endswith(("…", "...")) else "…"
    return f"[{words}{several}]" if _is_argument(param) and not param.required else words + several


def package_pages() -> dict[str, str]:
    """Return path -> text of the page of each package."""
    return {f"api/{name}.md": _package_page(name) for name in PACKAGES}


def package_names(package: str) -> list[str]:
    """Return the public names of a package; effects of the catalogue have a page of their own."""
    module = import_module(package)
    found = [(name, getattr(module, name)) for name in module.__all__]
    kinds = [name for name, value in found if value not in catalogue()]
    return sorted(kinds, key=str.lower)


@cache
def result_types() -> dict[str, list[type]]:
    """Return package -> what its functions return, and parts of that, where nothing exports it.

    A type that functions of several packages return is on the page of the first.
    """
    exported = {package: set(import_module(package).__all__) for package in PACKAGES}
    listed = set().union(*exported.values())
    pages = {}
    for package, names in exported.items():
        module, found = import_module(package), dict[str, type]()
        todo = [value for name in names if isfunction(value := getattr(module, name))]
        while todo:
            for each in _named_types(todo.pop()):
                name = each.__name__
                if name not in found and (name not in listed or name in names):
                    found[name] = each
                    todo.append(each)  # type: ignore[arg-type]
        pages[package] = [found[name] for name in sorted(found) if name not in listed]
        listed |= set(found)
    return pages


def _named_types(value: Any) -> Iterator[type]:
    """Yield classes of geodrake that a function returns, or that fields of a class are."""
    if isclass(value):
        texts = [*vars(value).get("__annotations__", {}).values()]
    else:
        texts = [value.__annotations__.get("return", "")]
    for word in re.findall(r"\b[A-Z]\w+", " ".join(map(str, texts))):
        found = getattr(import_module(value.__module__), word, None)
        if isclass(found) and found.__module__.startswith("geodrake."):
            yield found


def _package_page(package: str) -> str:
    module, names = import_module(package), package_names(package)
    text = f"# {package}\n\n{(module.__doc__ or '').partition(chr(10) * 2)[0]}\n\n"
    text += f"    from {package} import …\n\n"
    for name in names:
        value = getattr(module, name)
        home = getattr(value, "__module__", None)
        if home is None or not home.startswith("geodrake") or not hasattr(value, "__qualname__"):
            text += f"## {name}\n\nA constant: `{type(value).__name__}`.\n\n"
            continue
        text += _entry(value, 2)
    if results := result_types()[package]:
        text += "## Results\n\nFunctions above return these; nothing needs to import them.\n\n"
        text += "".join(_entry(each, 3) for each in results)
    return text


def _entry(value: Any, level: int) -> str:
    place = f"{value.__module__}.{value.__qualname__}"
    options = f"heading_level: {level}\n      show_root_full_path: false"
    return f"::: {place}\n    options:\n      {options}\n\n"
