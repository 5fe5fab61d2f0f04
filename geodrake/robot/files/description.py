"""A model file of any format, ready to be added to a plant.

Drake refuses some files that are sufficient for dynamics (with a missing mesh, or a mimic joint
without a leader), and silently replaces inertias it finds unphysical by a 1 kg ball. Therefore
geometry and loop closures are removed from the text first, and unphysical inertias are set aside
for `geodrake.robot.plant` to repair.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.multibody.parsing import (
    FlattenModelDirectives,
    LoadModelDirectivesFromString,
    ModelDirective,
    ModelDirectives,
    PackageMap,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import typed
from geodrake.boundary.input_files import regular_file
from geodrake.boundary.yaml_text import yaml_text
from geodrake.errors import GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import drop
from geodrake.robot.files.includes import Includes, add_packages, named_packages
from geodrake.robot.files.load_options import Given
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.model_edits import DRAKES_SPRINGS
from geodrake.robot.files.texts import (
    ModelText,
    SdfText,
    UrdfText,
    drop_friction,
)
from geodrake.robot.files.xacro_file import is_xacro, read_expanded
from geodrake.robot.files.xml_text import (
    LARGEST_FILE,
    SUPPORTED_FORMATS,
    numbered_text,
    parse_xml_bytes,
)
from geodrake.robot.stated import FileTerms
from geodrake.robot.transmission.schema import Coupled, Gear, renamed

Where = Callable[[str], Path]
"""Mesh references of URDF or SDF -> files, or a ModelError if not found."""

_MOST_LINKS = 2000  # the time is quadratic, 3 s for these
_LINE = re.compile(r"\S*?/(\d+)\.\w+:(\d+): ")


@dataclass(frozen=True)
class ModelDescription:
    """A model file: one simplified text, or directives that combine several."""

    path: Path
    texts: tuple[ModelText, ...]  # simplified; one for each `add_model` of the directives, in order
    directives: ModelDirectives | None = None  # flattened; None for a URDF, SDF or MJCF file
    given: Given = field(default_factory=Given)

    @cached_property
    def every(self) -> list[ModelText]:
        """Return the texts, and those of included files."""
        return [each for text in self.texts for each in text.every()]

    @cached_property
    def terms(self) -> FileTerms:
        """Return the terms removed from the texts; without gravity if no link has it."""
        terms = FileTerms.joined([text.terms for text in self.every])
        heavy, carried = {n for text in self.every for n in text.heavy}, terms.carried
        if heavy and heavy <= carried.keys() and {*carried.values()} == {1.0} and not terms.acting:
            terms.gravity, terms.carried = np.zeros(3), {}
        return terms

    def motors(self) -> tuple[Gear | Coupled, ...]:
        """Return the transmissions of motors in the files, with scoped names."""
        parts = list[Gear | Coupled]()
        for text in self.every:
            scoped = f"{text.scope}::{{}}".format
            parts += (renamed(part, scoped, scoped) for part in text.motors())
        return tuple(parts)

    def add_every_package(self, packages: PackageMap) -> None:
        """Register all packages, geometry's included, and folders above the file by name."""
        files = {self.path, *(text.path for text in self.every)}
        texts = (read_expanded(file, self.given).decode(errors="replace") for file in files)
        names = {name for text in texts for name in named_packages(text)}
        add_packages(packages, self.path, names, self.given.packages)
        for folder in self.path.resolve().parents:
            if folder.name and not packages.Contains(folder.name):
                packages.Add(folder.name, str(folder))

    def set_inertia(self, link: str, phi: Array | None) -> bool:
        """Set inertial parameters (10,) of a link, or none; return whether a text has the link."""
        return any(text.set_inertia(link, phi) for text in self.every)

    def add_to(
        self,
        plant: MultibodyPlant,
        *,
        simplified: bool = True,
        prepare: Callable[[Element, Where], None] = lambda root, where: None,
    ) -> None:
        """Add the models to a plant, simplified or as in their files.

        In the latter case `prepare` modifies URDFs and SDFs first, and Drake's errors propagate.
        """
        parser, places = Parser(plant), list[list[str]]()
        if not simplified:
            self.add_every_package(parser.package_map())
        errors = drake_errors(self.path, places) if simplified else nullcontext()
        with errors, TemporaryDirectory() as folder:
            files = {text: Path(folder) / f"{k}.{text.kind}" for k, text in enumerate(self.every)}
            for text in self.every:
                if simplified or text.kind != "xml":
                    root = text.root
                    if not simplified:
                        root = self._original_root(text)
                        prepare(root, partial(_file_of, parser.package_map(), text.path))
                    text.link_includes(root, files)
                    lines, where = numbered_text(root)
                    files[text].write_text(lines, encoding="utf-8")
                    places.append(where)
                else:  # its meshes are beside it
                    files[text] = text.path
                    places.append([])
            if self.directives is None:
                parser.AddModels(str(files[self.texts[0]]))
            else:
                models = [d.add_model for d in self.directives.directives if d.add_model]
                for model, text in zip(models, self.texts, strict=True):
                    model.file = files[text].resolve().as_uri()
                ProcessModelDirectives(self.directives, parser)
            for link, X_WB in self.terms.floating.items():
                model, _, name = link.rpartition("::")
                body = plant.GetBodyByName(name, plant.GetModelInstanceByName(model))
                if plant.GetDefaultFloatingBaseBodyPose(body).IsExactlyIdentity():
                    plant.SetDefaultFloatingBaseBodyPose(body, X_WB)
            if self.terms.gravity is not None:
                plant.mutable_gravity_field().set_gravity_vector(self.terms.gravity)

    def _original_root(self, text: ModelText) -> Element:
        """Return the root of a text's file, without elements that Drake refuses."""
        root = parse_xml_bytes(read_expanded(text.path, self.given), text.path)
        Includes(text.path, self.given.packages).drop_absent(root)
        # Drake cannot remove joints of plants with springs, and rejects included files on warnings.
        drop(root, "spring_stiffness", "mimic", *DRAKES_SPRINGS)
        drop_friction(root)
        for model in root.iter("model"):
            for joint in model.findall("joint[@type='gearbox']"):
                model.remove(joint)
        return root


def _file_of(packages: PackageMap, path: Path, place: str) -> Path:
    """Return the path of a mesh named in a file, as Drake does not know the text's origin."""
    url = place if "://" in place else f"file://{path.resolve().parent / place}"
    try:
        return Path(packages.ResolveUrl(url))
    except RuntimeError as error:
        reason = str(error).strip().partition("\n")[0].rpartition("error: ")[2]
        raise ModelError(reason.rpartition(" refers to ")[2]) from error


@typed
def read_description(path: Path, given: Given | None = None) -> ModelDescription:
    """Read a model file of any supported format."""
    regular_file(path, "model file", ModelError, largest=LARGEST_FILE)
    given = given or Given()
    if path.suffix.lower() in (".yaml", ".yml"):
        description = _read_directives(path, given)
    else:
        description = ModelDescription(path, (read_model_text(path, given),), given=given)
    files = (text.path for text in description.texts)
    if given.xacro and not any(is_xacro(file) for file in files):
        raise ModelError(
            f"{path} is not a xacro file, so argument {next(iter(given.xacro))!r} cannot be used.",
            advice="Omit it.",
        )
    count = sum(len(text.links) for text in description.every)
    if count > _MOST_LINKS:
        raise ModelError(
            f"{path} has {count} links; geodrake reads up to {_MOST_LINKS}.",
            advice="Remove links that do not move with the robot.",
        )
    return description


def read_model_text(path: Path, given: Given, scope: str | None = None) -> ModelText:
    """Read and simplify a URDF, SDF or MJCF file; a xacro file is expanded first."""
    return model_text_of(read_expanded(path, given), path, given, scope)


def model_text_of(
    data: bytes, path: Path, given: Given | None = None, scope: str | None = None
) -> ModelText:
    """Read and simplify the contents of a file; the root element determines the format."""
    root = parse_xml_bytes(data, path)
    kinds: dict[str, type[ModelText]] = {"robot": UrdfText, "sdf": SdfText, "mujoco": MjcfText}
    if root.tag not in kinds:
        raise ModelError(
            f"{path} is not a robot description: its root element is <{root.tag}>.",
            advice=SUPPORTED_FORMATS,
        )
    return kinds[root.tag](root, path, scope, (given or Given()).packages)


def _read_directives(path: Path, given: Given) -> ModelDescription:
    includes = Includes(path, given.packages)
    loaded, files = _load_directives(path, includes, (path.resolve(),))
    with drake_errors(path):
        directives = FlattenModelDirectives(loaded, includes.packages)
    models = [d.add_model for d in directives.directives if d.add_model]
    if not models:
        raise ModelError(f"The directives {path} do not add a model.", advice=SUPPORTED_FORMATS)
    texts = list[ModelText]()
    for model, file in zip(models, files, strict=True):
        texts.append(read_model_text(includes.checked(file), given, model.name))
        model.file = f"file://{file.resolve()}"
    return ModelDescription(path, tuple(texts), directives, given)


def _load_directives(
    path: Path, includes: Includes, chain: tuple[Path, ...]
) -> tuple[ModelDirectives, list[Path]]:
    """Return the directives of a file, without circular ones, and the files of all their models.

    Paths are relative to the folder of their file. Packages that they name are registered in
    `includes`.
    """
    files, parts = list[Path](), list[ModelDirective]()
    with drake_errors(path):
        loaded = LoadModelDirectivesFromString(yaml_text(path))
    for each in loaded.directives:
        expanded = [each]
        if each.add_model:
            files.append(includes.resolve(each.add_model.file, path.parent))
        if each.add_directives:
            file = includes.resolve(each.add_directives.file, path.parent).resolve()
            inner, more = _load_directives(file, includes, includes.enter(chain, file))
            files += more
            each.add_directives.file = f"file://{file}"
            expanded = expanded if each.add_directives.model_namespace else inner.directives
        parts += expanded
    loaded.directives = parts
    return loaded, files


@contextmanager
def drake_errors(
    path: Path,
    places: Sequence[Sequence[str]] = (),
    *,
    how: str = "",
    advice: str = f"Correct the file there. {SUPPORTED_FORMATS}",
) -> Iterator[None]:
    """Convert Drake's exceptions about a model file to a `ModelError` with their first line.

    A violated precondition in Drake is a SystemExit in Python.

    Args:
        places: For each text that Drake reads instead, the location of each of its lines.
        how: Suffix of the file's name in the message.
    """
    try:
        yield
    except (GeodrakeError, OSError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        line = str(error).strip().partition("\n")[0]
        reason = line.rpartition("error: ")[2].removeprefix("ERROR: ")[:300].rstrip(".")
        place, match = "", _LINE.match(line)
        if match:
            text, at = int(match[1] or 0), int(match[2]) - 1
            place = places[text][at] if text < len(places) and at < len(places[text]) else ""
        raise ModelError(
            f"Drake cannot read {place or path}{how}: {reason}.", advice=advice
        ) from error


@contextmanager
def drake_messages() -> Iterator[list[str]]:
    """Collect Drake's log messages, which would otherwise be printed."""
    messages: list[str] = []

    def collect(record: logging.LogRecord) -> bool:
        messages.append(record.getMessage())
        return False

    logger = logging.getLogger("drake")
    logger.addFilter(collect)
    try:
        yield messages
    finally:
        logger.removeFilter(collect)
