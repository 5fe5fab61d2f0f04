"""An export as tables and a sentence: what it lacks, and how far simulators are from the model."""

from __future__ import annotations

from geodrake.control.export_proof.export import ProvenExport
from geodrake.model.exporting.held import Lost
from geodrake.model.exporting.joints import exported_joints
from geodrake.model.robot_model import RobotModel
from geodrake.report.numbers import Units, number, percent
from geodrake.report.tables import Table, cells, effect_cell

_NAMED = 3  # effects, at most, that a sentence names


def proof_table(found: ProvenExport, units: Units) -> Table:
    """How far each simulator is from the model."""
    rows = []
    for each in found.proof.differences:
        unit = units.at(each.joint, "N·m" if each.what == "effort" else "rad")
        part = "" if each.compared == 1.0 else f", {percent(each.compared)} of samples"
        left = ", ".join(each.without) or "nothing"
        rows.append(
            cells(
                each.engine,
                f"{each.what}{part}",
                left,
                each.joint,
                f"{number(each.largest, 2)} {unit}",
                f"{number(each.typical)} {unit}",
            )
        )
    head = ("loaded by", "compared", "without", "worst joint", "largest difference", "of RMS")
    return Table(head, tuple(rows), words=4)


def holds_table(found: ProvenExport, units: Units) -> Table:
    """Damping, dry friction, rotors and springs in the files, by joint."""
    rows = []
    for joint, values in exported_joints(found.held).items():
        terms = {
            "N·m·s/rad": values.damping,
            "N·m": values.friction,
            "kg·m²": values.armature,
            "N·m/rad": values.stiffness,
        }
        if any(terms.values()):
            rows.append(
                cells(
                    joint,
                    *(
                        f"{number(value)} {units.at(joint, unit)}" if value else "0"
                        for unit, value in terms.items()
                    ),
                    f"{number(values.rest)} {units.at(joint, 'rad')}" if values.stiffness else "",
                )
            )
    head = ("joint", "damping", "dry friction", "rotor inertia", "spring", "at rest")
    return Table(head, tuple(rows))


def lacks_table(found: ProvenExport, units: Units) -> Table:
    """The effects that the files cannot hold, and what each costs."""
    rows = []
    for cost in found.lacks:
        into = " and ".join(cost.lost.into)
        rows.append(
            cells(
                effect_cell(cost.lost.effect, units),
                _places(cost.lost, found.held),
                f"fitted into {into}" if into else "left out",
                *([] if cost.nrms is None else [number(cost.nrms)]),
            )
        )
    costed = found.costs is not None
    head = ("effect", "where", "in the files", *(("nrms",) if costed else ()))
    return Table(head, tuple(rows), words=3)


def _places(lost: Lost, model: RobotModel) -> str:
    everywhere = not lost.where or set(lost.where) == set(model.joints)
    return "all" if everywhere else ", ".join(lost.where)


def export_verdict(found: ProvenExport) -> str:
    """What an export holds, and what that means, in a sentence or two."""
    names = [cost.lost.effect for cost in found.lacks]
    lacks = ", ".join(names) if len(names) <= _NAMED else f"{len(names)} effects"
    words = f"the files hold the model but for {lacks}" if lacks else "the files hold the model"
    if found.costs is not None:
        words += f"; nrms {number(found.costs.whole)} of the model"
        if lacks:
            words += f", {number(found.costs.held)} of the files"
    if found.proof.ignored:
        engine = found.proof.differences[0].engine.partition(" ")[0]
        words += f". {engine} does not act on {', '.join(found.proof.ignored)} in them"
        if found.costs is not None and found.costs.ignored is not None:
            words += f": nrms {number(found.costs.ignored)} there"
    off = [difference for difference in found.proof.differences if not difference.is_rounding]
    if off:
        words += f". {off[0].engine} differs from geodrake by more than rounding"
    elif found.proof.differences:
        words += ". Simulators that load them agree with geodrake to rounding"
    return f"{words}."
