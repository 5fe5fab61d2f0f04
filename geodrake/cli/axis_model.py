"""A model of one axis without any file of it: `--axis prismatic --mass 70` writes MODEL."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from xml.sax.saxutils import quoteattr

from geodrake.boundary.whole_files import write_whole
from geodrake.cli.reading_options import ReadingOptions
from geodrake.errors import ArgumentError, OutputError

_KINDS = ("prismatic", "revolute")
_RADIUS = 0.1  # m, of gyration of what turns: a guess, as is the mass
_URDF = """<?xml version="1.0"?>
<!-- One horizontal {kind} axis, written by geodrake: nothing is known of it but its mass. -->
<robot name="axis">
  <link name="base"/>
  <link name="moving">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name={joint} type="{kind}">
    <parent link="base"/>
    <child link="moving"/>
    <axis xyz="1 0 0"/>
  </joint>
</robot>
"""


@dataclass(frozen=True, kw_only=True)
class AxisOptions(ReadingOptions):
    """A single axis in place of a model file.

    Attributes:
        axis (prismatic|revolute): Without any model file: one horizontal axis with --mass, which is
            written as MODEL, a .urdf that is not there yet.
        mass (KG): About what the --axis moves, kg; the fit corrects it.
    """

    PANEL: ClassVar = "models"

    axis: str | None = None
    mass: float | None = None


@contextmanager
def written_axis(options: AxisOptions, model: Path, log: Path) -> Iterator[None]:
    """Write MODEL if options ask for an axis; what fails takes it away again."""
    if options.axis is None:
        if options.mass is not None:
            raise ArgumentError("--mass is for --axis.", advice="Add --axis prismatic.")
        yield
        return
    write_whole(model, _text(options, model, log))
    try:
        yield
    except BaseException:
        model.unlink(missing_ok=True)
        raise


def _text(options: AxisOptions, model: Path, log: Path) -> str:
    """Return the URDF, its joint named as that of the first log."""
    from geodrake.logs.files import read_log

    kind, mass = options.axis, options.mass
    if kind not in _KINDS:
        raise ArgumentError(f"--axis is {kind!r}.", advice=f"It is {' or '.join(_KINDS)}.")
    if mass is None or not (math.isfinite(mass) and mass > 0):
        raise ArgumentError(
            f"--axis needs a positive --mass; got {mass}.", advice="About how many kg move?"
        )
    if model.exists() or model.is_symlink():
        raise OutputError(
            f"--axis writes MODEL, and {model} is there.",
            advice="Name a new file, or leave --axis out to use this one.",
            path=model,
        )
    if model.suffix.lower() != ".urdf":
        raise OutputError(
            f"--axis writes MODEL, and {model} does not end in .urdf.",
            advice=f"Name it {model.stem or 'axis'}.urdf.",
        )
    joints = read_log(log, reading=options.reading).joints
    if len(joints) > 1:
        raise ArgumentError(
            f"--axis is for one joint; {log} has {len(joints)}: {', '.join(joints)}.",
            advice="Give a model file.",
        )
    inertia = mass * _RADIUS**2
    return _URDF.format(
        kind=kind,
        mass=mass,
        inertia=inertia,
        joint=quoteattr(joints[0]),
    )
