"""The command `geodrake identify`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.input_options import split_effects
from geodrake.cli.options import IdentifyOptions
from geodrake.diagnosis.add import check_places
from geodrake.effects import Effect, effect_class, make_effect
from geodrake.errors import ArgumentError
from geodrake.excitation.tell_apart import every_place
from geodrake.identification.models import (
    IdentificationSettings,
    ModelIdentification,
    identify_model,
)
from geodrake.model.export import check_export, export_model
from geodrake.model.robot_model import RobotModel


def run_identify(options: IdentifyOptions) -> None:
    """Run `geodrake identify`: fit a model's inertias and effects."""
    files, names = split_effects(options.effects)
    settings = IdentificationSettings(
        regularizer=options.regularizer,
        gamma=options.gamma,
        residual_ratio=options.residual_bound,
        total_mass=options.total_mass,
        compare=options.compare,
        bandwidth=options.bandwidth,
        blocks=options.blocks,
        hold_resting=options.hold_resting,
    )

    def identified(given: Input) -> ModelIdentification:
        effects = named_effects(names, given.model, given.extra)
        found = identify_model(
            given.model, given.logs, settings, effects=effects, progress=given.progress
        )
        if options.export is None:
            return found
        return replace(found, notes=(*found.notes, *export_model(found.model).notes))

    def check(model: RobotModel) -> None:
        if options.export is not None:
            check_export(model, options.export)

    command = Command(
        "identify",
        "Identifying",
        identified,
        outputs={
            "export": Output(
                "model file with the identified inertias",
                (".urdf", ".sdf", ".xml", ".mjcf", ".world"),
                lambda found, path: export_model(found.model).content,
            ),
            "ellipsoids": Output("ellipsoids", (".png", ".pdf", ".svg"), _figure),
            "meshcat": Output("page of ellipsoids", make=_page),
        },
        check=check,
    )
    run(command, replace(options, effects=files))


def named_effects(
    names: Sequence[str], model: RobotModel, extra: Sequence[type[Effect]] = ()
) -> tuple[Effect, ...]:
    """Return effects by name, at a place (`payload@hand`, `coupled_friction@a+b`) or everywhere.

    "Everywhere" means all joints with one degree of freedom, or all pairs of neighbouring joints,
    without the effect.
    """
    taken = {(fitted.effect.name, fitted.effect.where) for fitted in model.effects}
    found: dict[Effect, None] = {}
    for name in names:
        kind, _, place = name.strip().partition("@")
        effect = effect_class(kind, extra)
        if place:
            places = [tuple(place.split("+"))]
            check_places(model, places[0], kinds=["body" if effect.places == "body" else "joint"])
        else:
            places = every_place(effect, model)
        try:
            made = [make_effect(kind, where, extra=extra) for where in places]
        except ArgumentError as error:
            raise ArgumentError(
                f"{kind} has a shape parameter that must be fitted first.",
                advice=f"Run geodrake add {kind} MODEL LOG --save model.yaml, and identify "
                "model.yaml.",
            ) from error
        found |= dict.fromkeys(e for e in made if place or (e.name, e.where) not in taken)
    return tuple(found)


def _figure(found: ModelIdentification, path: Path) -> bytes:
    from geodrake.report.ellipsoids import ellipsoid_figure, identification_sets
    from geodrake.report.style import figure_bytes

    figure = ellipsoid_figure(found.model.plant, identification_sets(found))
    return figure_bytes(figure, path.suffix.lower().lstrip("."))


def _page(found: ModelIdentification, path: Path) -> str:
    del path
    from geodrake.report.ellipsoids import ellipsoid_page, identification_sets

    return ellipsoid_page(found.model.plant, identification_sets(found))
