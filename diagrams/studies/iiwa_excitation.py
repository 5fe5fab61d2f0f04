"""Motions of a KUKA iiwa designed in four base representations with three normalizations.

[Lee2019] §4.6.2 and table 4.2: Fourier motions of 10 s by E-optimality. With the geometric
normalization the choice of base parameters does not matter, but rounding may lead the solver
different ways. Errors are expected ones, from the covariance of least squares. The iiwa is read
from the folder --shared; without it, or with --quick, an arm of this project is used instead.
Finished designs are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.iiwa_excitation --json iiwa.json
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.harness import MODELS, run_draws, script_parser, show, show_values, write
from diagrams.public_data import add_folder_option
from geodrake.excitation import (
    DesignOptions,
    ExcitationTrajectory,
    FourierMotion,
    IdentifiableParameters,
    MotionLimits,
    Objective,
    Target,
    design_excitation,
    identifiable_parameters,
    make_target,
    measurement_factor,
    motion_limits,
)
from geodrake.excitation.objective import NORMALIZATIONS
from geodrake.inertia import Array, perturb
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_description
from geodrake.robot import BaseParameters, inverse_dynamics_regressor
from geodrake.robot.base_parameters import pushforward_metric

# Errors to be expected of least squares, from its covariance: exact, and without drawing noise.
#
# With changes δ of parameters whose covariance is D Λ Dᵀ — `IdentifiableParameters` has D and Λ —
# a linear function y = Y δ has the covariance Y D Λ Dᵀ Yᵀ.

_DENSE = 1000  # samples that stand for those of a motion sampled more often


def identified_by(
    target: Target, trajectory: ExcitationTrajectory, samples: int
) -> IdentifiableParameters:
    """Return what a motion identifies from `samples` measurements at equal intervals."""
    count = trajectory.family.count if not trajectory.family.timed else min(samples, _DENSE)
    motion = trajectory.motion(trajectory.family.times(count))
    share = samples / len(motion)
    factor = np.sqrt(share) * measurement_factor(target, motion)
    return identifiable_parameters(target, factor, threshold=np.inf)


def root_covariance(found: IdentifiableParameters) -> Array:
    """Return R (p, n_B), R Rᵀ the covariance of parameters without unidentifiable directions."""
    return np.asarray(found.directions * np.sqrt(found.variances))


def parameter_error(found: IdentifiableParameters, truth: Array) -> float:
    """Return √(E⟨δ, δ⟩/n_B) in the pushforward metric at the truth (nb, 10), [Lee2019] §4.6.2."""
    B = found.target.base.matrix
    H = pushforward_metric(B, truth)
    R = B @ root_covariance(found)
    return float(np.sqrt(np.einsum("ia,ij,ja->", R, H, R) / len(B)))


def effort_errors(
    found: IdentifiableParameters, regressor: Array, mass: Array
) -> tuple[Array, ...]:
    """Return (nv,) RMS errors of efforts (N·m) and of accelerations M⁻¹(τ − τ̂) (rad/s²).

    The regressor (N, nv, p) and mass matrices (N, nv, nv) are those of the validation samples.
    """
    effort = regressor @ root_covariance(found)
    acceleration = np.linalg.solve(mass, effort)
    pair = [np.square(x).sum(axis=2).mean(axis=0) for x in (effort, acceleration)]
    return tuple(np.sqrt(pair))


IIWA = Path("reference") / "iiwa14.sdf"
NOISE = 0.1  # N·m
FREQUENCY = 0.3 * np.pi  # rad/s
DURATION, RATE = 10.0, 1000  # s, 1/s
GROUPS = {"1,2": [0, 1], "3,4": [2, 3], "5,6": [4, 5], "7": [6]}
"""Joints of table 4.2."""
_UNCERTAINTY = 0.3  # of the prior's masses
_ACCELERATION = 10.0  # rad/s², of validation, where the model file limits none


@dataclass(frozen=True, eq=False)
class RepresentedTarget(Target):
    """A target with another representation of its base parameters."""

    change: Array | None = None  # (n_B, n_B) S, nonsingular; the base parameters are S φ_B

    @cached_property
    def base(self) -> BaseParameters:
        """S B instead of B."""
        own = super().base
        return own if self.change is None else replace(own, matrix=self.change @ own.matrix)


def manipulator(shared: Path | None) -> RobotModel:
    """Return the iiwa of the folder `shared`, or this project's seven-joint arm if None."""
    path = MODELS / "arm7.urdf" if shared is None else shared / IIWA
    return replace(load_description(path), effects=())


def represented_target(model: RobotModel, base: int, seed: int) -> Target:
    """Return all inertias of an arm, with a random prior, in a base representation.

    Number one is that of geodrake; the others are random matrices times it.
    """
    rng = np.random.default_rng([seed, 0])
    prior = perturb(model.phi, 1, rng=rng, mass_uncertainty=_UNCERTAINTY).phi[0]
    target = make_target(replace(model, phi=prior), noise=NOISE, effects=[])
    values = {field.name: getattr(target, field.name) for field in fields(target)}
    size = target.base.rank
    change = np.random.default_rng([seed, base]).normal(size=(size, size)) if base > 1 else None
    return RepresentedTarget(**values, change=change)


def family(modes: int) -> FourierMotion:
    """Return motions of [Lee2019] Eq. (4.6.62)."""
    return FourierMotion(DURATION, modes, FREQUENCY, offset=False)


def limits(model: RobotModel) -> MotionLimits:
    """Return limits of positions and speeds alone, as in the source."""
    return motion_limits(model, acceleration=np.inf, effort=np.inf)


@dataclass(frozen=True, eq=False)
class Validation:
    """Random samples within limits, at which efforts are predicted."""

    model: RobotModel
    regressor: Array  # (N, nv, p)
    mass: Array  # (N, nv, nv) mass matrices

    @classmethod
    def of(cls, model: RobotModel, count: int, seed: int) -> Validation:
        """Return uniform samples."""
        rng, bounds = np.random.default_rng([seed, 99]), motion_limits(model)
        fastest = np.where(np.isfinite(bounds.acceleration), bounds.acceleration, _ACCELERATION)
        shape = (count, len(model.joints))
        q = rng.uniform(bounds.lower, bounds.upper, shape)
        v, vd = (rng.uniform(-most, most, shape) for most in (bounds.velocity, fastest))
        context, mass = model.plant.CreateDefaultContext(), []
        for one in q:
            model.plant.SetPositions(context, one)
            mass.append(model.plant.CalcMassMatrix(context))
        return cls(model, inverse_dynamics_regressor(model.tree, q, v, vd), np.array(mass))

    def errors(self, target: Target, trajectory: ExcitationTrajectory) -> dict[str, object]:
        """Return expected errors of least squares for a motion at 1 kHz, as in table 4.2."""
        found = identified_by(target, trajectory, round(DURATION * RATE))
        effort, acceleration = effort_errors(found, self.regressor, self.mass)
        by_group = [
            {name: float(np.sqrt(np.mean(x[joints] ** 2))) for name, joints in GROUPS.items()}
            for x in (effort, acceleration)
        ]
        error = parameter_error(found, self.model.phi)
        return {"error": error, "effort": by_group[0], "acceleration": by_group[1]}


@dataclass(frozen=True)
class Plan:
    """Settings of all designs."""

    shared: str | None  # folder with the iiwa; None for our own arm
    modes: int = 5
    samples: int = 300
    iterations: int = 150  # most iterations of the solver, in each of its two stages
    validation: int = 2000  # number of random samples at which efforts are predicted
    seed: int = 0

    @property
    def robot(self) -> RobotModel:
        """The arm."""
        return manipulator(None if self.shared is None else Path(self.shared))


@dataclass(frozen=True)
class Cell:
    """A line of the table."""

    normalization: str  # one of `NORMALIZATIONS`
    base: int = 1  # number of the base representation, from one


def design(cell: Cell, *, plan: Plan) -> dict[str, Any]:
    """Return the best motion in one representation, with its criterion and its errors."""
    model = plan.robot
    target = represented_target(model, cell.base, plan.seed)
    trajectory = design_excitation(
        target,
        limits(model),
        normalization=cell.normalization,
        trajectory=family(plan.modes),
        options=DesignOptions(
            samples=plan.samples, rest=False, iterations=plan.iterations, quick=False
        ),
        seeds=[plan.seed],
    ).trajectory
    motion = trajectory.motion(trajectory.family.times(plan.samples))
    return {
        **asdict(cell),
        "coefficients": trajectory.coefficients.tolist(),
        "geometric_e": Objective(target).value(motion),
        **Validation.of(model, plan.validation, plan.seed).errors(target, trajectory),
    }


def values_by_base(found: dict[str, Any], bases: int, plan: Plan) -> list[float]:
    """Return the criterion of a motion, normalized as in its design, in every representation."""
    model = plan.robot
    motion = family(plan.modes).basis(np.linspace(0.0, DURATION, plan.samples))
    q, v, vd = motion @ np.array(found["coefficients"])
    targets = (represented_target(model, base + 1, plan.seed) for base in range(bases))
    way = found["normalization"]
    return [Objective(one, normalization=way).value(Motion(q, v, vd)) for one in targets]


def ratio_less_1(values: Iterable[float]) -> float:
    """Return the largest value over the smallest, less 1."""
    numbers = list(values)
    return max(numbers) / min(numbers) - 1.0


def apart(rows: Sequence[dict[str, Any]]) -> float:
    """Return distances of motions' coefficients from those of the first one."""
    motions = np.array([row["coefficients"] for row in rows])
    return float(np.abs(motions - motions[0]).max())


def spread(rows: Sequence[dict[str, Any]], name: str, bases: int, plan: Plan) -> dict[str, float]:
    """Return the spread of errors, criteria and motions over base representations."""
    own = [row for row in rows if row["normalization"] == name]
    values = {
        "error": [row["error"] for row in own],
        "value": [row["geometric_e"] for row in own],
        "criterion": values_by_base(own[0], bases, plan),
    }
    ratios = {f"{key}_largest_over_smallest_less_1": ratio_less_1(x) for key, x in values.items()}
    return {**ratios, "coefficients_apart": apart(own)}


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    add_folder_option(parser, "with the iiwa")
    options = parser.parse_args()
    own = options.quick or not (options.shared / IIWA).is_file()
    plan = Plan(None if own else str(options.shared), seed=options.seed)
    if options.quick:
        plan = replace(plan, modes=3, samples=60, iterations=5, validation=200)
    bases = 2 if options.quick else 4
    cells = [Cell(name, base + 1) for name in NORMALIZATIONS for base in range(bases)]
    key = {**asdict(plan), "shared": not own}
    rows = run_draws(parser, options, partial(design, plan=plan), cells, plan=key)
    best = min(row["geometric_e"] for row in rows if row["normalization"] == "geometric")
    spreads = {name: spread(rows, name, bases, plan) for name in NORMALIZATIONS}
    for row in rows:
        del row["coefficients"]
        row["criterion_over_best_geometric"] = row["geometric_e"] / best
    show("Errors by normalization and base representation", rows)
    show_values("Differences between representations", spreads)
    write(options, {"plan": key, "rows": rows, "spread": spreads})


if __name__ == "__main__":
    main()
