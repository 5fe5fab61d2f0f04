"""A model file of any format, ready to be added to a plant."""

from __future__ import annotations

import logging
from collections import ChainMap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from pydrake.multibody.parsing import (
    FlattenModelDirectives,
    LoadModelDirectives,
    ModelDirectives,
    PackageMap,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model_files.base import ModelText
from geodrake.model_files.reading import read_model_text
from geodrake.model_files.xml_text import SUPPORTED_FORMATS


@dataclass(frozen=True)
class ModelDescription:
    """A model file: one simplified text, or directives that put several together.

    Attributes:
        path: The file.
        texts: The simplified texts; one for each `add_model` of the directives, in their order.
        directives: The flattened directives, or None for a URDF, SDF or MJCF file.
    """

    path: Path
    texts: tuple[ModelText, ...]
    directives: ModelDirectives | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was taken out of the texts and matters."""
        return tuple(note for text in self.texts for note in text.notes)

    @property
    def held_back(self) -> Mapping[str, Array]:
        """Scoped link names with inertial parameters (10,) that no body can have."""
        return ChainMap(*(text.held_back for text in self.texts))

    def joint_values(self, name: str) -> Mapping[str, float]:
        """`friction`, `armature` or `effort` of the file, by scoped joint name."""
        return ChainMap(*(getattr(text, name) for text in self.texts))

    def set_inertia(self, link: str, phi: Array | None) -> bool:
        """Gives a link inertial parameters (10,), or none; False if no text has the link."""
        return any(text.set_inertia(link, phi) for text in self.texts)

    def add_to(self, plant: MultibodyPlant) -> None:
        """Adds the models to a plant.

        Raises:
            ModelError: Drake cannot parse the description; the message has Drake's reason.
        """
        parser = Parser(plant)
        add_packages(parser.package_map(), self.path)
        with drake_errors(self.path):
            if self.directives is None:
                for text in self.texts:
                    parser.AddModelsFromString(text.text(), text.kind)
                return
            with TemporaryDirectory() as folder:
                models = [d.add_model for d in self.directives.directives if d.add_model]
                for k, (model, text) in enumerate(zip(models, self.texts, strict=True)):
                    file = Path(folder) / f"{k}.{text.kind}"
                    file.write_text(text.text(), encoding="utf-8")
                    model.file = file.as_uri()
                ProcessModelDirectives(self.directives, parser)


def read_description(path: Path) -> ModelDescription:
    """Reads a model file of any supported format.

    Raises:
        ModelError: There is no such file, or it does not describe a robot.
    """
    if not path.is_file():
        what = "is a folder, not a file" if path.is_dir() else "does not exist"
        raise ModelError(f"The model file {path} {what}.", advice="Check the path.", path=path)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _read_directives(path)
    return ModelDescription(path, (read_model_text(path),))


def _read_directives(path: Path) -> ModelDescription:
    packages = PackageMap()
    add_packages(packages, path)
    with drake_errors(path):
        directives = FlattenModelDirectives(LoadModelDirectives(str(path)), packages)
        models = [d.add_model for d in directives.directives if d.add_model]
        files = [
            Path(packages.ResolveUrl(url)) if "://" in url else path.parent / url
            for url in (model.file for model in models)
        ]
    missing = [str(file) for file in files if not file.is_file()]
    if missing or not files:
        raise ModelError(
            f"The directives {path} add models that do not exist: {', '.join(missing)}."
            if missing
            else f"The directives {path} add no model.",
            advice=SUPPORTED_FORMATS,
            path=path,
        )
    texts = (read_model_text(file, model.name) for file, model in zip(files, models, strict=True))
    return ModelDescription(path, tuple(texts), directives)


def add_packages(packages: PackageMap, path: Path) -> None:
    """Makes the packages around a file known, so that package:// leads somewhere."""
    for folder in path.resolve().parents:
        if (folder / "package.xml").is_file():
            with drake_messages():
                packages.AddPackageXml(str(folder / "package.xml"))
    packages.PopulateFromRosPackagePath()


@contextmanager
def drake_errors(path: Path) -> Iterator[None]:
    """Turns Drake's exceptions about a model file into a `ModelError` with Drake's first words."""
    try:
        yield
    except RuntimeError as error:
        line = str(error).strip().partition("\n")[0]
        reason = line.rpartition("error: ")[2].removeprefix("ERROR: ")[:300].rstrip(".")
        raise ModelError(
            f"Drake cannot read {path}: {reason}.",
            advice=f"Correct the file there. {SUPPORTED_FORMATS}",
            path=path,
        ) from error


@contextmanager
def drake_messages() -> Iterator[list[str]]:
    """Collects what Drake logs, which would otherwise be printed."""
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
