"""MJCFs among the models of directives, put into a plant as MuJoCo means them.

Drake reads the tree that MuJoCo compiled (`geodrake.robot.files.mjcf_tree`) in the place of each,
and its geoms are added to the plant afterwards. Without MuJoCo, Drake reads the files themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydrake.geometry import AddContactMaterial, ProximityProperties
from pydrake.multibody.parsing import ModelDirectives
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant

from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_source import mujoco_or_none
from geodrake.robot.files.reading import read_model_text
from geodrake.robot.mjcf_shapes import WORLD, is_mjcf, mjcf_geoms


def plain_mjcfs(
    directives: ModelDirectives, includes: Includes, given: Given, folder: Path
) -> Mapping[str, Path]:
    """Name plain files in the place of MJCFs; return the MJCFs by the names of their models.

    Args:
        directives: Flattened directives; changed.

    Raises:
        ModelError: MuJoCo refuses one.
    """
    found = dict[str, Path]()
    if mujoco_or_none() is None:
        return found
    for model in (each.add_model for each in directives.directives if each.add_model):
        file = includes.checked(includes.resolve(model.file, Path()))
        if is_mjcf(file, given):
            text = read_model_text(file, given, model.name)
            plain = folder / f"{len(found)}.xml"
            plain.write_text(text.text()[0], encoding="utf-8")
            model.file, found[model.name] = plain.as_uri(), file
    return found


def add_geoms(plant: MultibodyPlant, name: str, file: Path, given: Given) -> None:
    """Add the geoms of an MJCF to a model of a plant: what MuJoCo shows, and what touches others.

    Args:
        plant: A plant that is not finalized and has a SceneGraph.

    Raises:
        ModelError: A mesh for collisions is not there.
    """
    shown, _ = mjcf_geoms(file, given, scope=name) or ({}, ())
    solid, _ = mjcf_geoms(file, given, hulls=True, scope=name) or ({}, ())
    index = plant.GetModelInstanceByName(name)
    for link in dict.fromkeys((*shown, *solid)):
        world = link == WORLD
        own = plant.world_body() if world else plant.GetBodyByName(link.rpartition("::")[2], index)
        label = f"{name}_" if world else ""
        for geom in (each for each in (solid if world else shown).get(link, ()) if each.shown):
            plant.RegisterVisualGeometry(
                own, geom.X_BG, geom.shape, label + geom.name, geom.color.rgba
            )
        for geom in (each for each in solid.get(link, ()) if each.collides):
            touch = ProximityProperties()
            AddContactMaterial(
                friction=CoulombFriction(geom.friction, geom.friction), properties=touch
            )
            plant.RegisterCollisionGeometry(own, geom.X_BG, geom.shape, label + geom.name, touch)
