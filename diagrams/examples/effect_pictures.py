"""Draw the residual that each effect leaves, and write the page `docs/effects.md`.

The demo's arm moves for twenty seconds, and each effect has a usual size at one of its joints. The
pictures show its effort over time, over the speed and over the position of that joint.

    python -m diagrams.examples.effect_pictures --figures docs/figures/effects \
        --page docs/effects.md
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from diagrams.harness import script_parser, sines, tell
from geodrake import effects, load_model
from geodrake.boundary.whole_files import write_whole
from geodrake.effects import Effect, RobotMotion, catalogue
from geodrake.effects.lookup import table_rows
from geodrake.inertia import Array, from_mass_com_inertia
from geodrake.logs.motion import Motion
from geodrake.model import RobotModel
from geodrake.report import style

PERIOD = 0.004  # s
DURATION = 20.0  # s
SHOWN = 8.0  # s of the motion that the first panel shows
SHOULDER, ELBOW, ROLL, PITCH = "shoulder_pitch", "elbow_pitch", "wrist_roll", "wrist_pitch"
PUSH = (10.0, 0.0, -25.0, 0.0, 0.0, 0.0)  # N, N·m
INTRODUCTION = """# Effects

Look up the effort that each effect of the catalogue needs, and how to recognize it in a residual.
To add one to a model:

```
geodrake add coulomb_friction@elbow robot.urdf log.csv
```

You can also [write an effect of your own](how_to.md#write-an-effect-of-your-own). Model files may
have [further effects](models.md#mjcf).

| effect | needed effort | place |
|---|---|---|
"""
PICTURES = """
## Residuals

An arm moves for 20 s, and its model lacks one effect. The text and the pictures describe the
residual of one joint: over time, over the joint's speed and over its position. The panel that shows
a curve instead of a cloud usually identifies the effect.
"""


@dataclass(frozen=True)
class Example:
    """An effect of usual size."""

    effect: Effect
    values: Sequence[float] | Array  # its parameters, SI
    joint: str = ELBOW

    def residual(self, motion: RobotMotion) -> Array:
        """Return (N,) effort of the effect at the pictured joint."""
        own = self.effect.effort(motion, np.array(self.values))
        return np.asarray(own[:, motion.index(self.joint)])


def phi_of(mass: float, *center: float, radius: float = 0.05) -> Array:
    """Return inertial parameters of a ball about a centre (3,), m."""
    return from_mass_com_inertia(mass, np.array(center), 0.4 * mass * radius**2 * np.eye(3))


def examples() -> list[Example]:
    """Return one example of every effect whose effort is linear in its parameters."""
    return [
        Example(effects.ViscousFriction(ELBOW), (4.0,)),
        Example(effects.CoulombFriction(ELBOW), (6.0,)),
        Example(effects.FrictionOvercompensation(ELBOW), (6.0,)),
        Example(effects.AsymmetricFriction(ELBOW), (7.0, 3.0, 3.0, 1.0)),
        Example(effects.StribeckFriction(ELBOW, 0.15, 2.0), (5.0,)),
        Example(effects.NonlinearViscousFriction(ELBOW, 0.5), (6.0,)),
        Example(effects.LoadDependentFriction(ELBOW), (0.12,)),
        Example(effects.GearEfficiency(ELBOW), (0.25, 0.1)),
        Example(effects.CoupledFriction((ROLL, PITCH), -1), (2.0, 1.0), PITCH),
        Example(effects.FrictionDrift(ELBOW, 6.0), (6.0, 2.0)),
        Example(effects.ThermalFriction(ELBOW, 30.0), (-0.5, -0.2)),
        Example(effects.Hysteresis(ELBOW, 0.2), (6.0,)),
        Example(effects.EffortOffset(ELBOW), (3.0,)),
        Example(effects.WrenchOffset("flange"), (4.0, 0.0, -8.0, 0.0, 0.0, 0.0)),
        Example(effects.ThermalOffset(ELBOW, 30.0), (0.0, 0.5)),
        Example(effects.EffortScale(ELBOW), (0.1,)),
        Example(effects.JointSpring(ELBOW, 1, 0.0), (8.0, 0.0)),
        Example(effects.GravityCompensator(ELBOW), (0.0, 12.0)),
        Example(effects.TorqueRipple(ELBOW, 12.0), (1.5, 1.0)),
        Example(effects.RotorInertia(ELBOW), (0.8,)),
        Example(effects.CoupledRotorInertia((ROLL, PITCH)), (0.05,), PITCH),
        Example(effects.JointElasticity(ELBOW), (1.0 / 4000.0,)),
        Example(effects.Backlash(ELBOW, 2e-3), (1.0,)),
        Example(effects.Payload("flange"), phi_of(2.0, 0.02, 0.0, 0.08)),
        Example(effects.TemporaryPayload("flange", 3.0), phi_of(2.0, 0.02, 0.0, 0.08)),
        Example(effects.GravityTilt(), (0.05, 0.03), SHOULDER),
        Example(effects.Contact("flange", 2.5, 5.0, 0.2, 0, 0.1), PUSH),
        Example(effects.AerodynamicDrag("flange"), (1.5, 0.0, 0.0, 0.0)),
    ]


def motion_of(model: RobotModel) -> RobotMotion:
    """Return a fast motion of all joints within their limits."""
    t = np.arange(0.0, DURATION, PERIOD)
    rates = np.array([0.9, 0.8, 1.1, 1.5, 1.7, 2.1])
    sizes = np.array([0.9, 0.6, 0.8, 1.0, 0.9, 1.2])
    waves = np.outer([1.0, 0.25], sizes), np.outer([1.0, 2.3], rates)
    q, v, vd = sines(t, *waves, np.outer([1.0, 0.0], np.arange(6.0)))
    q += np.array([0.0, 0.3, -1.0, 0.0, 0.0, 0.0])
    warmth = 30.0 + 12.0 * np.sin(0.4 * t[:, None] + np.arange(6))
    return model.motion(Motion(q, v, vd, t, q[:0], warmth), sign_width=np.full(6, 0.01))


def delayed(motion: RobotMotion) -> Array:
    """Return (N,) the elbow's residual if efforts are logged 12 ms late."""
    own, late = motion.load[:, motion.index(ELBOW)], round(0.012 / PERIOD)
    return np.concatenate([np.zeros(late), own[:-late] - own[late:]])


def heavier(motion: RobotMotion) -> Array:
    """Return (N,) the elbow's residual if the forearm is 1.5 kg heavier than its model."""
    columns = motion.body_columns("forearm")[:, motion.index(ELBOW)]
    return np.asarray(columns @ phi_of(1.5, 0.15, 0.0, 0.0))


BY_THEMSELVES: dict[type[Effect], Callable[[RobotMotion], Array]] = {
    effects.EffortDelay: delayed,
    effects.WrongInertia: heavier,
}
"""Effects whose effort is that of the bodies themselves."""


def draw(residual: Array, motion: RobotMotion, joint: str, path: Path) -> None:
    """Draw the residual over time, speed and position of its joint."""
    j = motion.index(joint)
    t, q, v = np.asarray(motion.time), motion.q[:, j], motion.v[:, j]
    figure = Figure(figsize=(7.2, 1.7), dpi=100, layout="constrained")
    first, *clouds = figure.subplots(1, 3, sharey=True, width_ratios=(1.6, 1, 1))
    shown = t <= SHOWN
    first.plot(t[shown], residual[shown], color=style.AFTER, lw=0.9)
    first.set_ylabel("residual, N·m", fontsize=7)
    for axes, x in zip(clouds, (v, q), strict=True):
        axes.plot(x, residual, color=style.AFTER, lw=0, marker=".", markersize=0.8)
    words = "time, s", f"speed of {joint}, rad/s", f"position of {joint}, rad"
    for axes, word in zip((first, *clouds), words, strict=True):
        axes.set_xlabel(word, fontsize=7)
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
        axes.axhline(0.0, color=style.RULE, lw=0.6, zorder=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, style.figure_bytes(figure))


def page(drawn: dict[type[Effect], Path], folder: Path) -> str:
    """Return the page of all effects, with paths of pictures relative to a folder."""
    rows = [(f"`{name}`", law.replace("|", "\\|"), place) for name, law, place in table_rows()]
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    parts = [INTRODUCTION + table + PICTURES]
    for effect, path in drawn.items():
        parameters = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
        lines = [f"### `{effect.name}`", f"{effect.signature[0].upper()}{effect.signature[1:]}."]
        if parameters:
            lines.append(f"Parameters: {parameters}.")
        picture = Path(os.path.relpath(path, folder)).as_posix()
        lines.append(f"![{effect.name}]({picture})")
        parts.append("\n\n".join(lines) + "\n")
    return "\n".join(parts)


def main() -> None:
    """Draw, and write what was asked for."""
    parser = script_parser(__doc__, "three pictures", figures=True)
    parser.add_argument("--page", type=Path, help="Markdown file of all effects and pictures")
    options = parser.parse_args()
    with as_file(files("geodrake") / "demo") as demo:
        motion = motion_of(load_model(demo / "demo.urdf"))
    left = {type(e.effect): (e.residual(motion), e.joint) for e in examples()}
    left |= {effect: (made(motion), ELBOW) for effect, made in BY_THEMSELVES.items()}
    tell(options, {e.name: float(np.sqrt(np.mean(left[e][0] ** 2))) for e in catalogue()})
    if options.figures:
        drawn = {e: options.figures / f"{e.name}.png" for e in catalogue()}
        for effect, path in list(drawn.items())[: 3 if options.quick else None]:
            draw(left[effect][0], motion, left[effect][1], path)
        if options.page:
            write_whole(options.page, page(drawn, options.page.parent))


if __name__ == "__main__":
    main()
