"""Smallest repairs of unphysical inertias in model files."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from geodrake.errors import ModelError
from geodrake.inertia import (
    Array,
    from_pseudo_inertia,
    from_spatial_inertia,
    is_physical,
    pseudo_inertia,
    to_mass_com_inertia,
    to_spatial_inertia,
)
from geodrake.inertia.bodies import LumpedBody, lumped_bodies
from geodrake.inertia.kernels import calc_change_frame
from geodrake.robot.files import ModelDescription
from geodrake.robot.joints import joints_of

TOLERANCE = 1e-6  # ratio of P's eigenvalues, as of a link 1 m long and 1 mm thick
ROUNDING = 1e-12  # relative to P's largest eigenvalue
LEAST_MASS = 1e-12  # kg, largest negligible mass
LEAST_SIZE = 1e-15  # m, largest size of a point
LEAST_LENGTH = 0.01  # m, least radius of gyration of a repaired body
LENGTH_PER_SIZE = 0.05  # the same, as a share of the body's size
MASS_BETWEEN = 1e-12  # mass of a body between joints of one body, as a share of the robot's
SIZE_BETWEEN = 0.1  # m, its radius of gyration, which MuJoCo accepts, too
MASS_PER_TOTAL = 1e-3  # mass of all massless bodies together, as a share of the robot's


@dataclass(frozen=True)
class Repair:
    """A body of a model file whose inertia was replaced, in general or only in fits."""

    body: str
    problem: str  # predicate of the body's name in a sentence
    before: Array  # (10,) inertial parameters of the file
    after: Array  # (10,) inertial parameters of the plant, or of the prior
    is_thin: bool = False  # the body has no volume, and the plant keeps the file's inertia

    def __str__(self) -> str:
        mass, _, inertia = to_mass_com_inertia(self.after)
        moments = ", ".join(f"{x:.3g}" for x in np.linalg.eigvalsh(inertia))
        how = "fits, designs, controllers and exports use" if self.is_thin else "it is set to"
        return (
            f"{self.body} {self.problem}; {how} {mass:.3g} kg with principal moments "
            f"{moments} kg·m² about its centre of mass."
        )


def repair_inertias(
    description: ModelDescription, plant: MultibodyPlant, *, keep_thin: bool = True
) -> tuple[tuple[Repair, ...], tuple[str, ...], bool]:
    """Repair inertias of a description, whose plant lacks the inertias in `set_aside`.

    Return the repairs, notes on ignored links, and whether the text changed. If `keep_thin`, bodies
    without volume, such as point masses, are unchanged.
    """
    lumps, links = lumped_bodies(plant), stated_inertias(description, plant)
    stated = [_stated_parameters(links, body) for body in lumps]
    shapeless = {name for text in description.every for name in text.shapeless}
    if frames := _frames(plant, lumps, stated, shapeless):
        description.terms.between.update(m.scoped_name for body in frames for m in body.members)
        description.terms.notes.append(
            "Links without mass between joints at one point weigh nothing: "
            f"{', '.join(body.name for body in frames)}."
        )
    usable = [np.where(_counts(phi)[:, None], phi, 0.0).sum(0) for phi in stated]
    between = [
        all(member.scoped_name in description.terms.between for member in body.members)
        for body in lumps
    ]
    regular = [phi for phi, is_between in zip(usable, between, strict=True) if not is_between]
    total, massless = sum(phi[0] for phi in regular), sum(not _counts(phi) for phi in regular)
    spare_mass = float(MASS_PER_TOTAL * total / max(massless, 1)) if total > 0 else 1.0
    repairs, notes, changed = [], [], False
    for body, members, phi, is_between in zip(lumps, stated, usable, between, strict=True):
        after = phi
        if is_between:
            mass = max(2.0 * LEAST_MASS, MASS_BETWEEN * sum(pairs[0] for pairs in usable))
            after = from_pseudo_inertia(mass * np.diag([*[SIZE_BETWEEN**2] * 3, 1.0]))
        elif not (is_physical(phi, tolerance=TOLERANCE) and _counts(phi)) or (
            # All of the mass is in one point, the body's origin.
            np.diagonal(pseudo_inertia(phi))[:3].max() <= LEAST_SIZE**2 * phi[0]
        ):
            after = nearest_physical(phi, points=_joint_points(plant, body), spare_mass=spare_mass)
            before = members.sum(0)
            thin = keep_thin and _is_thin(phi)
            problem = _problem(before if len(members) == 1 or not _counts(phi) else phi, thin=thin)
            repairs.append(Repair(body.name, problem, before, after, thin))
            after = phi if thin else after
        else:
            pairs = zip(body.members, members, strict=True)
            names = [m.name for m, x in pairs if x.any() and not _counts(x)]
            if names:
                notes.append(f"{', '.join(names)}: no positive mass, so ignored.")
        scoped = {member.scoped_name for member in body.members}
        if after is not phi or scoped & description.terms.set_aside.keys():
            changed = True
            description.terms.set_aside |= {name: links[name] for name in scoped}
            _write(description, body, after)
    return tuple(repairs), tuple(notes), changed


def _frames(
    plant: MultibodyPlant,
    lumps: Sequence[LumpedBody],
    stated: Sequence[Array],
    shapeless: Container[str],
) -> list[LumpedBody]:
    """Return bodies without inertia and shape that are frames between joints at one point.

    Each carries one body, which has a mass or is such a frame.
    """
    owner = {int(m.index): k for k, body in enumerate(lumps) for m in body.members}
    carried = dict[int, list[int]]()
    for joint in (joint for joint in joints_of(plant) if joint.num_velocities()):
        parent, child = (int(b.index()) for b in (joint.parent_body(), joint.child_body()))
        carried.setdefault(owner.get(parent, -1), []).append(owner.get(child, -1))
    heavy = [bool(_counts(phi).any()) for phi in stated]
    empty = [
        not phi.any()
        and all(member.scoped_name in shapeless for member in body.members)
        and not np.ptp(_joint_points(plant, body), axis=0).any()
        for body, phi in zip(lumps, stated, strict=True)
    ]

    def has_end(k: int) -> bool:
        return heavy[k] or (empty[k] and len(on := carried.get(k, [])) == 1 and has_end(on[0]))

    return [body for k, body in enumerate(lumps) if not heavy[k] and has_end(k)]


def nearest_physical(phi: Array, *, points: Array, spare_mass: float) -> Array:
    """Return a physical body (10,) with mass and centre of mass of an unphysical φ (10,).

    Central second moments below m ℓ² are raised to it. A body without mass becomes a small ball of
    the spare mass, kg, at the mean of its joints' points (k, 3), m.
    """
    mass, com = phi[0], points.mean(0)
    second_moment = np.zeros((3, 3))
    if _counts(phi):
        com = phi[1:4] / mass
        second_moment = pseudo_inertia(phi)[:3, :3] - mass * np.outer(com, com)
    else:
        mass = spare_mass
    ends = np.vstack([points, com])
    size = np.linalg.norm(ends[:, None] - ends, axis=-1).max()
    length = max(LEAST_LENGTH, LENGTH_PER_SIZE * size)
    values, axes = np.linalg.eigh(second_moment)
    matrix = np.empty((4, 4))
    matrix[:3, :3] = (axes * np.maximum(values, mass * length**2)) @ axes.T
    matrix[:3, :3] += mass * np.outer(com, com)
    matrix[:3, 3] = matrix[3, :3] = mass * com
    matrix[3, 3] = mass
    return from_pseudo_inertia(matrix)


def _counts(phi: Array) -> NDArray[np.bool_]:
    """Return whether parameters (..., 10) are finite with a usable mass."""
    return np.asarray(np.isfinite(phi).all(-1) & (phi[..., 0] > LEAST_MASS))


def stated_inertias(description: ModelDescription, plant: MultibodyPlant) -> dict[str, Array]:
    """Return scoped name -> inertia (10,) of links in a file, physical or not."""
    links = map(plant.get_body, map(BodyIndex, range(1, plant.num_bodies())))
    inertias = {
        link.scoped_name().get_full(): from_spatial_inertia(link.default_spatial_inertia())
        for link in links
    }
    return inertias | description.terms.set_aside


def _stated_parameters(links: Mapping[str, Array], body: LumpedBody) -> Array:
    """Return the file's parameters of each member (k, 10), in the representative's frame."""
    rows = []
    for member in body.members:
        phi = links[member.scoped_name]
        R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
        usable = np.isfinite(phi).all()
        rows.append(calc_change_frame(phi, R_RB, p_RoBo_R) if usable else phi)
    return np.array(rows)


def _joint_points(plant: MultibodyPlant, body: LumpedBody) -> Array:
    """Return origins of the moving joints of a body, in its frame, m; shape (k, 3)."""
    context = plant.CreateDefaultContext()
    indices = {int(member.index) for member in body.members}
    frame = plant.get_body(body.body_index).body_frame()
    points = [np.zeros(3)]
    for joint in joints_of(plant):
        if joint.num_velocities() and int(joint.parent_body().index()) in indices:
            X_RJ = plant.CalcRelativeTransform(context, frame, joint.frame_on_parent())
            points.append(X_RJ.translation())
    return np.array(points)


def _is_thin(phi: Array) -> bool:
    """Return whether a body (10,) has no volume, but is valid in Drake."""
    possible = bool(_counts(phi)) and to_spatial_inertia(phi).IsPhysicallyValid()
    least = np.linalg.eigvalsh(pseudo_inertia(phi))[0] if possible else -np.inf
    return bool(least > -ROUNDING * np.trace(pseudo_inertia(phi)))


def _problem(phi: Array, *, thin: bool = False) -> str:
    if not np.isfinite(phi).all():
        return "has a mass or inertia that is not a number"
    if phi[0] <= LEAST_MASS:
        return f"has a mass of {phi[0]:g} kg"
    mass, _, inertia = to_mass_com_inertia(phi)
    moments = np.linalg.eigvalsh(inertia)
    if np.abs(moments).max() < TOLERANCE**2 * mass:
        return f"has {mass:.3g} kg but no rotational inertia about its centre of mass"
    stated = ", ".join(f"{x:.3g}" for x in moments)
    if thin:
        return f"has principal moments of inertia {stated} kg·m², and no thickness"
    if moments[0] < 0:
        why = "one is negative"
    elif moments[0] + moments[1] < (1 - TOLERANCE) * moments[2]:
        why = "one exceeds the sum of the others"
    else:
        why = "it has no thickness"
    return f"has principal moments of inertia {stated} kg·m², which are not physical ({why})"


def _write(description: ModelDescription, body: LumpedBody, phi: Array) -> None:
    """Assign a body's inertia to its representative, and zero to the links welded to it."""
    for k, member in enumerate(body.members):
        if not description.set_inertia(member.scoped_name, phi if k == 0 else None):
            raise ModelError(
                f"{body.name} has an inertia that is not physical, in a file that "
                f"{description.path} includes.",
                advice="Correct the included file, or load it on its own.",
            )
