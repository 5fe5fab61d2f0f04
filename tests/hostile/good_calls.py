"""A good call of every public function, and why some have none."""

import inspect
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

import geodrake
import geodrake.control.export_proof
from geodrake import effects, fleet, inertia
from geodrake.control.adaptation import (
    AdaptationLaw,
    FunctionSet,
    ProjectedLaw,
    mass_limits,
    parameter_manifold,
)
from geodrake.control.online_estimation import FilteredRegressor, SampleUpdate
from geodrake.control.regressor import ControlModel
from geodrake.control.systems import (
    EffectForce,
    PassivityBasedAdaptiveController,
    Safeguards,
    VaryingGains,
)
from geodrake.effects import FittedEffect
from geodrake.excitation import (
    Criterion,
    DesignOptions,
    ExcitationTrajectory,
    FourierMotion,
    Objective,
    Solid,
    make_rival,
    make_separation,
    make_target,
    measurement_factor,
    motion_limits,
)
from geodrake.excitation.design import design_objective
from geodrake.excitation.regressor_gradient import (
    base_wrench_regressor_gradient,
    inverse_dynamics_regressor_gradient,
    regressor_jacobian,
)
from geodrake.identification import BodyConstraints, PointMasses, identify
from geodrake.identification.identify import build_problem
from geodrake.identification.models import IdentificationSettings
from geodrake.identification.models.identify import with_effects
from geodrake.identification.newton import newton_sweep, solve_newton
from geodrake.identification.problem import LinearConstraints, whitened_factor
from geodrake.inertia.ellipsoids import equivalent_ellipsoid
from geodrake.logs.files import read_log, write_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog, Motion
from geodrake.manifolds import ConstrainedInertia, Interval, PhysicalInertia, Positive, Product
from geodrake.manifolds import Free as FreeManifold
from geodrake.manifolds.projections import Polyhedron
from geodrake.model.robot_model import RobotModel
from geodrake.robot.base_parameters import structural_base_parameters
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.transmission import FunctionTransmission, LinearTransmission

MODULES = (
    "excitation.identifiability",
    "control.adaptation",
    "control.export_proof",
    "control.loops",
    "control.regressor",
    "control.rollout",
    "control.systems",
    "diagnosis.drafting",
    "fleet",
    "identification.models",
    "inertia.body_distances",
    "inertia.ellipsoids",
    "inertia.perturbation",
    "inertia.positive_definite",
    "manifolds.projections",
    "model.export",
    "robot.base_parameters",
    "robot.floating_base",
    "robot.regressor",
    "robot.transmission",
    "diagnosis",
    "effects",
    "excitation",
    "fleet",
    "identification",
    "inertia",
    "manifolds",
)
"""Where the public callables are, those that are inside of others first."""

PENDULUM = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"


@dataclass(frozen=True)
class Fresh:
    """An argument that is made anew for every call."""

    make: Callable[[], object]


@dataclass(frozen=True)
class Free:
    """A text that may be any."""

    text: str


@dataclass(frozen=True)
class Call:
    """A good call.

    Attributes:
        function: What is called.
        arguments: Its arguments by name.
        allows: Argument -> words of wrong values that its documentation allows.
        infinite: Whether NaN or infinity is a documented result.
        slow: Whether a call that goes through takes long: then only what cannot be right is tried.
        trusted: Arguments that are not spoiled.
    """

    function: Callable[..., object]
    arguments: Mapping[str, object]
    allows: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    infinite: bool = False
    slow: bool = False
    trusted: tuple[str, ...] = ()


NO_DOOR = {
    "regressor.put_regressor": "a loop that trusts its arrays",
    "rollout.case_rollout": "of a case, which geodrake alone makes",
    **dict.fromkeys(
        (
            "inertia.Array",
            "effects.RobotMotion",
            "effects.JointMotion",
        ),
        "a type, or what effects are shown of a motion: made by geodrake alone",
    ),
    **dict.fromkeys(
        (
            "adaptation.ConvexSet",
            "adaptation.UpdateLaw",
            "effects.BodyEffect",
            "effects.Effect",
            "effects.JointEffect",
            "effects.JointPairEffect",
            "effects.RobotEffect",
            "excitation.MotionFamily",
            "identification.Regularizer",
            "manifolds.Manifold",
            "systems.AdaptiveController",
            "transmission.Transmission",
        ),
        "a base class",
    ),
    **dict.fromkeys(
        (
            "base_parameters.BaseParameters",
            "body_distances.DistanceParts",
            "diagnosis.Candidate",
            "diagnosis.ColumnFinding",
            "diagnosis.Comparison",
            "diagnosis.Diagnosis",
            "diagnosis.ErrorTable",
            "diagnosis.Explanation",
            "diagnosis.Failing",
            "diagnosis.JointError",
            "diagnosis.Series",
            "diagnosis.Step",
            "drafting.Correlate",
            "drafting.Draft",
            "excitation.ExcitationResult",
            "fleet.Digest",
            "fleet.DigestColumn",
            "fleet.DigestEffect",
            "fleet.DigestRow",
            "fleet.DigestRun",
            "fleet.DigestSettings",
            "fleet.DigestedLog",
            "fleet.JointDigest",
            "fleet.ChangedParameter",
            "fleet.UnusedLog",
            "fleet.Fleet",
            "fleet.FleetFinding",
            "fleet.FleetResult",
            "fleet.FleetRobot",
            "fleet.FleetType",
            "fleet.OwnParameter",
            "fleet.ParameterHistory",
            "fleet.RobotResult",
            "excitation.ExcitationTrajectory",
            "excitation.IdentifiableParameters",
            "identifiability.LogIdentifiability",
            "excitation.ReducedExcitation",
            "excitation.ReducedIdentification",
            "excitation.Separation",
            "excitation.Target",
            "export.Export",
            "fleet.ChangeRival",
            "fleet.FleetChanges",
            "fleet.LogEquations",
            "fleet.ParameterLevels",
            "fleet.RobotChange",
            "fleet.TypeModel",
            "identification.Certificate",
            "identification.FitResult",
            "identification.IdentificationResult",
            "identification.RegularizerComparison",
            "inertia.PrincipalAxes",
            "loops.AdaptiveLoop",
            "models.BodyChange",
            "models.ModelIdentification",
            "perturbation.Perturbation",
            "export_proof.ProvenExport",
            "rollout.FittedValue",
            "rollout.Rollout",
            "rollout.RolloutFit",
        ),
        "a result: a function makes it",
    ),
    **dict.fromkeys(
        (
            "drafting.rest_correlates",
            "drafting.source_of",
            "export.check_export",
            "export.export_bodies",
            "export.file_kind",
            "export.distributed",
            "floating_base.on_a_free_world",
            "loops.check_base",
            "regressor.checked_samples",
            "regressor.checked_tree",
        ),
        "a part of a public function, which has the door",
    ),
    "effects.catalogue": "it has no arguments",
    "effects.Proposer": "names to choose from",
    "effects.Role": "names to choose from",
    "effects.WrongInertia": "it has no instance",
    "inertia.pseudo_inertia_basis": "it has no arguments",
}
"""Public callables without a row of wrong calls, and why."""


def public_callables():
    """Every public callable by name, at the module of `MODULES` that it comes from."""
    seen = set()
    for path in MODULES:
        module, name = import_module(f"geodrake.{path}"), path.rpartition(".")[2]
        listed = getattr(module, "__all__", None)
        own = [
            key
            for key, value in vars(module).items()
            if not key.startswith("_") and getattr(value, "__module__", "") == module.__name__
        ]
        for key in own if listed is None else listed:
            value = getattr(module, key)
            if (inspect.isclass(value) or callable(value)) and id(value) not in seen:
                seen.add(id(value))
                yield f"{name}.{key}", value
    yield "load_model", geodrake.load_model
    yield "save_model", geodrake.save_model


def pendulum_plant(time_step=0.0, *, gains=False):
    """A finalized plant of the double pendulum with a motor at each joint."""
    plant = MultibodyPlant(time_step)
    add_pendulum(plant, gains=gains)
    return plant


def add_pendulum(plant, *, gains=False):
    Parser(plant).AddModels(str(PENDULUM))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    for index in plant.GetJointIndices():
        joint = plant.get_mutable_joint(index)
        if joint.num_velocities() == 1:
            actuator = plant.AddJointActuator(f"motor_{joint.name()}", joint, 100.0)
            if gains:
                actuator.set_controller_gains(PdControllerGains(p=100.0, d=10.0))
    plant.Finalize()


@cache
def folder():
    """A folder for what calls read and write."""
    path = Path(tempfile.mkdtemp(prefix="geodrake_calls_"))
    (path / "effect.py").write_text(
        "from dataclasses import dataclass\n"
        "from geodrake.effects import JointEffect, Parameter\n"
        "@dataclass(frozen=True)\n"
        "class Sticky(JointEffect):\n"
        '    name, parameters = "sticky", (Parameter("size", "N·m"),)\n'
        "    def columns(self, joint):\n"
        "        return (joint.q,)\n",
        encoding="utf-8",
    )
    return path


def pendulum_model():
    model = geodrake.load_model(PENDULUM)
    fitted = [FittedEffect(effects.ViscousFriction(j), np.array([0.3])) for j in model.joints]
    return replace(model, effects=tuple(fitted))


def pendulum_log(model, seconds=12.0, rate=50.0, seed=0):
    """A log that a model explains, so that a search in it soon ends."""
    time = np.arange(round(seconds * rate)) / rate
    rng = np.random.default_rng(seed)
    rates = 2 * np.pi * np.array([0.13, 0.31, 0.53])[:, None, None]
    phase, size = rng.uniform(0, 6, (3, 1, 2)), rng.uniform(0.3, 0.6, (3, 1, 2))
    waves = size * np.exp(1j * (rates * time[:, None] + phase))
    q, v, vd = ((waves * (1j * rates) ** k).sum(0).imag for k in range(3))
    effort = model.effort(Motion(q, v, vd)) + 0.01 * rng.standard_normal(q.shape)
    return JointLog("swing", ("shoulder", "elbow"), time, q, effort)


@dataclass(frozen=True, eq=False)
class Things:
    """What good calls are made of."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self):
        put = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731
        put("model", pendulum_model())
        put("plant", pendulum_plant())
        put("tree", KinematicTree.from_plant(self.plant))
        put("phi", inertia.inertial_parameters(self.plant))
        put("other", 1.2 * self.phi)
        put("P", inertia.pseudo_inertia(self.phi))
        q, v, vd = self.rng.uniform(-1, 1, (3, 5, 2))
        put("q", q)
        put("v", v)
        put("vd", vd)
        put("motion", Motion(q, v, vd))
        put("log", pendulum_log(self.model))
        put("control", ControlModel.of(self.model))
        put("manifold", parameter_manifold(self.model))
        put("law", AdaptationLaw(self.manifold))
        put("ellipsoid", equivalent_ellipsoid(self.phi[0]))
        put("quadric", self.ellipsoid.scaled(3.0).quadric)
        put("base", structural_base_parameters(self.plant))
        put("A", self.rng.normal(size=(60, 20)))
        put("b", self.A @ self.phi.ravel() + 0.01 * self.rng.normal(size=60))
        put("problem", build_problem(whitened_factor(self.A, self.b, sigma=0.01), self.phi))
        put("limits", motion_limits(self.model, velocity=2.0, acceleration=10.0, effort=50.0))
        put("target", make_target(self.model, noise=0.01))
        put("factor", measurement_factor(self.target, self.target.random_motion))
        put("points", PointMasses.of_bodies(self.phi, 12))
        put("linear", LinearTransmission.of([[1.0, 0.0], [1.0, 2.0]]))
        put("filtered", FilteredRegressor(self.control, 0.001))
        put("update", SampleUpdate(self.manifold, 0.1))
        t = np.linspace(0, 1, 11)
        put(
            "desired",
            PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, np.sin([t, 2 * t])),
        )
        put("polyhedron", mass_limits(len(self.control.prior), 0, 0.1, 50.0))


@cache
def things():
    return Things()


@cache
def good_calls():
    """Name -> good call."""
    t = things()
    found = {}
    for part in (
        _inertia,
        _geometry,
        _manifolds,
        _projections,
        _dynamics,
        _transmission,
        _adaptation,
        _systems,
        _effects,
        _identification,
        _excitation,
        _diagnosis,
        _digests,
        _fleet,
        _fleet_files,
        _files,
    ):
        found.update(part(t))
    return found


def _inertia(t):
    m = inertia
    mass, com, moment = m.to_mass_com_inertia(t.phi)
    names = {
        "central_second_moment": {"phi": t.phi},
        "change_frame": {"phi": t.phi, "R_AB": np.eye(3), "p_AoBo_A": np.array([0.1, 0.2, 0.3])},
        "change_units": {"phi": t.phi, "metre": 1000.0, "kilogram": 1000.0},
        "dual": {"covector": t.phi},
        "from_dual": {"matrix": t.P},
        "from_mass_com_inertia": {"mass": mass, "com": com, "inertia_com": moment},
        "from_point_masses": {"masses": np.ones((2, 3)), "positions": np.ones((2, 3, 3))},
        "from_pseudo_inertia": {"matrix": t.P},
        "from_spatial_inertia": {"spatial": m.to_spatial_inertia(t.phi[0])},
        "from_spatial_inertia_matrix": {"matrix": m.spatial_inertia_matrix(t.phi)},
        "inertial_parameters": {"plant": t.plant, "context": t.plant.CreateDefaultContext()},
        "principal_axes": {"phi": t.phi},
        "pseudo_inertia": {"phi": t.phi},
        "pullback_metric": {"phi": t.phi},
        "rotational_inertia": {"phi": t.phi},
        "spatial_inertia_matrix": {"phi": t.phi},
        "to_mass_com_inertia": {"phi": t.phi},
        "to_spatial_inertia": {"phi": t.phi[0]},
        "triangle_margins": {"phi": t.phi},
    }
    for name, arguments in names.items():
        yield f"inertia.{name}", Call(getattr(m, name), arguments)
    yield (
        "inertia.is_physical",
        Call(m.is_physical, {"phi": t.phi, "tolerance": 1e-9}, {"phi": ("NaN at one place",)}),
    )


def _geometry(t):
    m = geodrake.inertia.positive_definite
    P, Q = t.P, 1.5 * t.P[::-1]
    for name in ("distance", "log_det_divergence", "logarithm", "relative_logarithms"):
        yield f"positive_definite.{name}", Call(getattr(m, name), {"P1": P, "P2": Q})
    yield "positive_definite.exponential", Call(m.exponential, {"P": P, "V": 0.1 * Q})
    yield "positive_definite.inner_product", Call(m.inner_product, {"P": P, "X": Q, "Y": P})
    yield (
        "positive_definite.geodesic",
        Call(m.geodesic, {"P1": P, "P2": Q, "t": np.array([0.3, 0.6])}),
    )
    yield "positive_definite.whitening", Call(m.whitening, {"P": P})
    yield (
        "positive_definite.karcher_mean",
        Call(
            m.karcher_mean,
            {
                "matrices": P,
                "weights": np.array([1.0, 2.0]),
                "tolerance": 1e-9,
                "max_iterations": 40,
            },
        ),
    )
    m = geodrake.inertia.body_distances
    pair = {"phi1": t.phi, "phi2": t.other}
    for name in ("riemannian_distance", "entropic_divergence", "divergence_parts"):
        yield f"body_distances.{name}", Call(getattr(m, name), pair)
    yield "body_distances.metric_parts", Call(m.metric_parts, {"phi": t.phi, "step": 0.1 * t.other})
    yield (
        "body_distances.pullback_distance",
        Call(m.pullback_distance, {**pair, "reference": t.phi}),
    )
    m = geodrake.inertia.ellipsoids
    e = t.ellipsoid
    yield (
        "ellipsoids.Ellipsoid",
        Call(m.Ellipsoid, {"center": e.center, "semi_axes": e.semi_axes, "rotation": e.rotation}),
    )
    yield "ellipsoids.Ellipsoid.scaled", Call(e.scaled, {"factor": 2.0})
    yield "ellipsoids.Ellipsoid.contains", Call(e.contains, {"points": np.ones((4, 3))})
    yield "ellipsoids.Ellipsoid.uniform_body", Call(e.uniform_body, {"mass": np.array([1.0, 2.0])})
    yield (
        "ellipsoids.Ellipsoid.random_points",
        Call(e.random_points, {"rng": Fresh(lambda: np.random.default_rng(0)), "size": (4, 2)}),
    )
    yield (
        "ellipsoids.equivalent_ellipsoid",
        Call(m.equivalent_ellipsoid, {"phi": t.phi, "least_semi_axis": 0.001}),
    )
    yield "ellipsoids.ellipsoid_of_quadric", Call(m.ellipsoid_of_quadric, {"Q": t.quadric})
    for name in ("realizability", "is_realizable"):
        yield f"ellipsoids.{name}", Call(getattr(m, name), {"phi": t.phi, "Q": t.quadric})
    yield "ellipsoids.realizability_row", Call(m.realizability_row, {"Q": t.quadric})
    yield (
        "ellipsoids.bounding_ellipsoid",
        Call(
            m.bounding_ellipsoid,
            {"points": np.random.default_rng(0).normal(size=(9, 3)), "tolerance": 1e-4},
        ),
    )
    yield (
        "perturbation.perturb",
        Call(
            geodrake.inertia.perturbation.perturb,
            {
                "phi": t.phi,
                "count": 3,
                "rng": Fresh(lambda: np.random.default_rng(0)),
                "mass_uncertainty": 0.3,
                "point_masses": 5,
                "support": t.ellipsoid,
            },
        ),
    )


def _manifolds(t):
    m = geodrake.manifolds
    rows = np.eye(10)[:1]
    yield (
        "manifolds.ConstrainedInertia",
        Call(m.ConstrainedInertia, {"normals": rows, "offsets": np.array([0.1]), "weight": 1.0}),
    )
    yield "manifolds.Free", Call(m.Free, {"dimension": 2}, infinite=True)
    yield "manifolds.Positive", Call(m.Positive, {"dimension": 2}, infinite=True)
    yield "manifolds.Interval", Call(m.Interval, {"lower": (0.0, -1.0), "upper": (1.0, 2.0)})
    yield "manifolds.PhysicalInertia", Call(m.PhysicalInertia, {})
    yield (
        "manifolds.Product",
        Call(
            m.Product,
            {"manifolds": (PhysicalInertia(), Positive(2)), "weights": (1.0, 2.0)},
            infinite=True,
        ),
    )
    two = np.array([[0.3, 0.4], [0.5, 0.6]])
    together = np.hstack([t.phi, two])
    points = {
        "Interval": (Interval((0.0, -1.0), (1.0, 2.0)), two),
        "Positive": (Positive(2), two),
        "Free": (FreeManifold(2), two),
        "PhysicalInertia": (PhysicalInertia(), t.phi),
        "ConstrainedInertia": (ConstrainedInertia(rows, np.array([0.01])), t.phi),
        "Product": (Product((PhysicalInertia(), Positive(2))), together),
        "ConstantMetric": (
            geodrake.control.adaptation.ConstantMetric(2 * np.eye(2), 0.5 * np.eye(2)),
            two,
        ),
    }
    for name, (manifold, x) in points.items():
        package = "adaptation" if name == "ConstantMetric" else "manifolds"
        y, v = x[::-1], 0.01 * x
        methods = {
            "barrier": {"x": x},
            "gradient": {"x": x},
            "metric": {"x": x},
            "inverse_metric_times": {"x": x, "b": v},
            "divergence": {"x": x, "y": y},
            "longest_step": {"x": x, "v": v},
            "retract": {"x": x, "v": v},
            "frame": {"x": x[0]},
            "mirror_line": {"x": x[0], "b": v[0]},
            "mirror_span": {"x": x[0], "rows": v},
            "point_of_gradient": {"gradient": manifold.calc_gradient(y[0]), "near": x[0]},
            "natural_step": {"x": x, "b": v, "time": 0.1},
        }
        for method, arguments in methods.items():
            yield (
                f"{package}.{name}.{method}",
                Call(
                    getattr(manifold, method),
                    arguments,
                    infinite=method in ("longest_step", "mirror_line"),
                ),
            )
        yield (
            f"{package}.{name}.contains",
            Call(manifold.contains, {"x": x}, {"x": ("NaN at one place",)}),
        )


def _projections(t):
    m = geodrake.manifolds.projections
    limits = {"lower": np.array([0.5]), "upper": np.array([1.0])}
    yield (
        "projections.Polyhedron",
        Call(m.Polyhedron, {"matrix": np.array([[1.0, 1.0]]), **limits}, infinite=True),
    )
    yield (
        "projections.Polyhedron.violation",
        Call(Polyhedron(np.eye(2), np.zeros(2), np.ones(2)).violation, {"y": np.array([2.0, 0.5])}),
    )
    yield "projections.affine_set", Call(m.affine_set, {"A": np.eye(2), "b": np.ones(2)})
    yield "projections.halfspace", Call(m.halfspace, {"a": np.ones(2), "b": 1.0}, infinite=True)
    yield (
        "projections.slab",
        Call(m.slab, {"a": np.ones(2), "lower": 1.0, "upper": 2.0}, infinite=True),
    )
    yield (
        "projections.bregman_projection",
        Call(
            m.bregman_projection,
            {
                "manifold": Positive(2),
                "x": np.array([2.0, 3.0]),
                "constraints": m.slab([1.0, 1.0], 0.5, 1.0),
                "tolerance": 1e-9,
                "max_iterations": 20,
            },
        ),
    )


def _dynamics(t):
    m = geodrake.robot.regressor
    samples = {"plant": t.plant, "q": t.q, "v": t.v, "vd": t.vd}
    for name in ("inverse_dynamics_regressor", "regressor_pieces"):
        yield f"regressor.{name}", Call(getattr(m, name), samples)
    yield "regressor.body_regressor", Call(m.body_regressor, {**samples, "body": 1})
    yield "regressor.inverse_dynamics", Call(m.inverse_dynamics, {**samples, "phi": t.phi})
    m = geodrake.robot.floating_base
    wrench = np.arange(1.0, 31.0).reshape(5, 6)
    yield (
        "floating_base.base_wrench_regressor",
        Call(m.base_wrench_regressor, {**samples, "X_WP": np.eye(4)}),
    )
    yield "floating_base.wrench_map", Call(m.wrench_map, {"X_WP": np.eye(4), "count": 3})
    yield "floating_base.move_wrench", Call(m.move_wrench, {"wrench": wrench, "X_QP": np.eye(4)})
    yield (
        "floating_base.zero_moment_point",
        Call(
            m.zero_moment_point,
            {"wrench": wrench, "height": 0.1},
            {"wrench": ("NaN at one place",)},
            infinite=True,
        ),
    )
    yield "floating_base.body_poses", Call(m.body_poses, {"plant": t.plant, "q": t.q})
    m = import_module("geodrake.robot.base_parameters")
    Y = geodrake.robot.regressor.inverse_dynamics_regressor(t.plant, t.q, t.v, t.vd)
    yield (
        "base_parameters.base_parameters",
        Call(m.base_parameters, {"regressor": Y, "extra": 0, "tolerance": 1e-8}),
    )
    yield (
        "base_parameters.structural_base_parameters",
        Call(m.structural_base_parameters, {"plant": t.plant, "seed": 1, "tolerance": 1e-8}),
    )
    yield (
        "base_parameters.pushforward_metric",
        Call(
            m.pushforward_metric,
            {
                "matrix": np.hstack([t.base.matrix, np.zeros((t.base.rank, 1))]),
                "prior": t.phi,
                "extra": np.array([1.0]),
            },
        ),
    )
    yield "base_parameters.BaseParameters.regressor", Call(t.base.regressor, {"regressor": Y})
    yield "base_parameters.BaseParameters.values", Call(t.base.values, {"phi": t.phi})
    yield "base_parameters.BaseParameters.metric", Call(t.base.metric, {"prior": t.phi})
    yield (
        "base_parameters.BaseParameters.labels",
        Call(t.base.labels, {"bodies": t.model.bodies, "extra": ()}),
    )


def _transmission(t):
    m = geodrake.robot.transmission
    J = np.array([[1.0, 0.0], [1.0, 2.0], [0.5, 0.5]])
    yield (
        "transmission.LinearTransmission",
        Call(m.LinearTransmission, {"matrix": J, "offset": np.array([0.1, 0.2, 0.3])}),
    )
    yield (
        "transmission.LinearTransmission.of",
        Call(m.LinearTransmission.of, {"matrix": J, "offset": np.array([0.1, 0.2, 0.3])}),
    )
    yield (
        "transmission.LinearTransmission.from_ratios",
        Call(
            m.LinearTransmission.from_ratios,
            {
                "joints": ("a", "b"),
                "actuators": ("a",),
                "ratios": {"a": {"a": 1.0}, "b": {"a": 2.0}},
            },
        ),
    )
    own = FunctionTransmission(
        (2, 2),
        lambda q: q + 0.1 * np.sin(q),
        lambda q: (1 + 0.1 * np.cos(q))[:, :, None] * np.eye(2),
    )
    yield (
        "transmission.FunctionTransmission",
        Call(
            m.FunctionTransmission,
            {"size": (2, 2), "position": own.position, "derivative": own.derivative},
        ),
    )
    yield "transmission.gears", Call(m.gears, {"ratios": np.array([2.0, -50.0])})
    yield "transmission.rolling_joint", Call(m.rolling_joint, {"share": 0.4})
    yield (
        "transmission.PolynomialTransmission",
        Call(m.PolynomialTransmission, {"coefficients": np.array([0.1, 2.0, 0.3])}),
    )
    knots = np.linspace(-1.0, 1.0, 5)
    yield (
        "transmission.TableTransmission",
        Call(
            m.TableTransmission,
            {"actuator_points": knots, "joint_points": np.sin(knots)},
        ),
    )
    bars = {"ground": 0.3, "crank": 0.1, "coupler": 0.3, "rocker": 0.15}
    angles = {"crank_angle": 1.2, "rocker_angle": 1.5, "crossed": False}
    yield "transmission.FourBar", Call(m.FourBar, {**bars, **angles})
    cylinder = {"base": 0.4, "lever": 0.2, "length": 0.45, "angle": 1.6, "reversed": True}
    yield "transmission.Cylinder", Call(m.Cylinder, cylinder)
    yield (
        "transmission.Drive",
        Call(
            m.Drive,
            {"actuators": ("a", "b"), "joints": ("c", "d"), "map": t.linear},
        ),
    )
    yield "transmission.SideBySide", Call(m.SideBySide, {"parts": (t.linear, own)})
    yield "transmission.InSequence", Call(m.InSequence, {"stages": (t.linear, own)})
    efforts = t.v
    for name, each in (("LinearTransmission", t.linear), ("FunctionTransmission", own)):
        methods = {
            "joint_positions": {"q": t.q},
            "jacobian": {"q": t.q},
            "jacobian_rate": {"q": t.q, "v": t.v},
            "joint_motion": {"motion": t.motion},
            "actuator_motion": {"motion": t.motion, "start": np.zeros(2)},
            "actuator_efforts": {"q": t.q, "efforts": efforts},
            "joint_efforts": {"q": t.q, "efforts": efforts},
            "regressor": {"q": t.q, "regressor": np.ones((5, 2, 20))},
        }
        for method, arguments in methods.items():
            yield f"transmission.{name}.{method}", Call(getattr(each, method), arguments)


def _adaptation(t):
    m = geodrake.control.adaptation
    n, p = len(t.control.prior), t.control.prior
    yield (
        "adaptation.AdaptationLaw",
        Call(m.AdaptationLaw, {"manifold": t.manifold, "gamma": 2.0, "integrator": "geodesic"}),
    )
    yield (
        "adaptation.natural_adaptation",
        Call(m.natural_adaptation, {"manifold": t.manifold, "gamma": 2.0, "integrator": "euler"}),
    )
    yield (
        "adaptation.pullback_adaptation",
        Call(m.pullback_adaptation, {"manifold": t.manifold, "at": p, "gamma": 2.0}),
    )
    yield (
        "adaptation.euclidean_adaptation",
        Call(m.euclidean_adaptation, {"dimension": 3, "gamma": 2.0}),
    )
    yield (
        "adaptation.ConstantMetric",
        Call(m.ConstantMetric, {"matrix": 2 * np.eye(3), "inverse": 0.5 * np.eye(3)}),
    )
    yield (
        "adaptation.ConstantMetric.of",
        Call(m.ConstantMetric.of, {"manifold": Positive(2), "x": np.array([1.0, 2.0])}),
    )
    ball = FunctionSet(lambda x: x @ x - 1.0, lambda x: 2.0 * x)
    yield (
        "adaptation.FunctionSet",
        Call(m.FunctionSet, {"function": ball.function, "gradient": ball.gradient}),
    )
    yield "adaptation.LinearSet", Call(m.LinearSet, {"polyhedron": t.polyhedron})
    yield (
        "adaptation.ProjectedLaw",
        Call(m.ProjectedLaw, {"law": t.law, "constraints": t.polyhedron, "margin": 1e-6}),
    )
    yield (
        "adaptation.ProjectedLaw.project",
        Call(ProjectedLaw(t.law, t.polyhedron).project, {"parameters": p}),
    )
    rows = np.eye(10)[:1]
    yield (
        "adaptation.body_limits",
        Call(
            m.body_limits,
            {
                "size": n,
                "body": 1,
                "rows": rows,
                "lower": np.array([0.1]),
                "upper": np.array([9.0]),
            },
            infinite=True,
        ),
    )
    yield (
        "adaptation.mass_limits",
        Call(m.mass_limits, {"size": n, "body": 1, "lower": 0.1, "upper": 9.0}, infinite=True),
    )
    yield (
        "adaptation.center_of_mass_box",
        Call(
            m.center_of_mass_box,
            {"size": n, "body": 1, "lower": -np.ones(3), "upper": np.ones(3)},
            infinite=True,
        ),
    )
    yield (
        "adaptation.inside_ellipsoid",
        Call(m.inside_ellipsoid, {"size": n, "body": 1, "quadric": t.quadric}, infinite=True),
    )
    yield (
        "adaptation.parameter_limits",
        Call(
            m.parameter_limits,
            {"size": n, "indices": (1, 2), "lower": np.zeros(2), "upper": np.ones(2)},
            infinite=True,
        ),
    )
    yield (
        "adaptation.parameter_manifold",
        Call(
            m.parameter_manifold,
            {
                "model": t.model,
                "body_weight": 1.0,
                "effect_weight": 0.5,
                "weights": {t.model.bodies[0]: 2.0},
                "bodies": {t.model.bodies[0]: PhysicalInertia()},
            },
            infinite=True,
        ),
    )
    yield (
        "adaptation.adapted_parameters",
        Call(m.adapted_parameters, {"model": t.model, "names": (t.model.bodies[0],)}),
    )
    adapted = m.adapted_parameters(t.model, [t.model.bodies[0]])
    yield (
        "adaptation.PartialLaw",
        Call(
            lambda law: m.PartialLaw(law, adapted),
            {"law": AdaptationLaw(PhysicalInertia(), 2.0)},
        ),
    )
    Y = geodrake.robot.regressor.inverse_dynamics_regressor(t.plant, t.q, t.v, t.vd)
    yield (
        "adaptation.prediction_covector",
        Call(
            m.prediction_covector,
            {"regressor": Y, "parameters": t.phi.ravel(), "effort": t.v, "weight": np.ones(2)},
        ),
    )
    yield (
        "adaptation.error_weight",
        Call(m.error_weight, {"K_p": np.ones(2), "K_v": np.ones(2), "Q": np.eye(4)}),
    )
    yield (
        "adaptation.computed_torque_covector",
        Call(
            m.computed_torque_covector,
            {"regressor": Y[0], "mass_matrix": np.eye(2), "P": np.eye(4), "error": np.ones(4)},
        ),
    )
    yield (
        "adaptation.tracking_energy",
        Call(m.tracking_energy, {"mass_matrix": np.eye(2), "r": np.ones(2)}),
    )


def _intersection(first, second):
    return geodrake.control.adaptation.intersection(first, second)


def _systems(t):
    m = geodrake.control.systems
    p = t.control.prior
    both = {"time_step": 0.002, "parameters": p, "truth": p, "safeguards": Safeguards(100.0)}
    yield (
        "adaptation.intersection",
        Call(_intersection, {"first": t.polyhedron, "second": t.polyhedron}, infinite=True),
    )
    yield (
        "systems.PassivityBasedAdaptiveController",
        Call(
            m.PassivityBasedAdaptiveController,
            {"control": t.control, "law": t.law, "gains": VaryingGains(10.0), **both},
            allows={"law": ("nothing",)},
        ),
    )
    error = m.PredictionError(1.0, alone=True)
    yield (
        "systems.PredictionError",
        Call(
            m.PredictionError,
            {
                "weight": np.ones(2),
                "bandwidth": 10.0,
                "tolerance": np.zeros(2),
                "measured": True,
                "alone": False,
            },
        ),
    )
    yield (
        "systems.AdaptiveComputedTorqueController",
        Call(
            m.AdaptiveComputedTorqueController,
            {"control": t.control, "law": t.law, "rate": np.ones(2), "prediction": error, **both},
            allows={"law": ("nothing",)},
        ),
    )
    yield (
        "systems.BregmanProjectionEstimator",
        Call(
            m.BregmanProjectionEstimator,
            {
                "control": t.control,
                "update": t.update,
                "filtered": t.filtered,
                "time_step": 0.001,
                "parameters": p,
                "memory": 2.0,
                "stale_time": 0.05,
                "update_every": 2,
            },
        ),
    )
    yield (
        "systems.DelayedEffort",
        Call(m.DelayedEffort, {"delays": np.array([0.01, 0.02]), "period": 0.001}),
    )
    yield (
        "systems.PositionServo",
        Call(
            m.PositionServo,
            {
                "kp": np.array([80.0, 40.0]),
                "kd": 4.0,
                "ki": np.ones(2),
                "limit": 50.0,
                "dead_band": 1e-3,
            },
            infinite=True,
            allows=dict.fromkeys(("kd", "ki", "limit", "dead_band"), ("two numbers",)),
        ),
    )
    yield (
        "systems.DcMotor",
        Call(
            m.DcMotor,
            {
                "torque_constant": np.array([0.05, 0.04]),
                "resistance": 0.3,
                "gear_ratio": 100.0,
                "back_emf_constant": 0.05,
                "inductance": 1e-4,
                "voltage_limit": 48.0,
                "current_limit": 20.0,
            },
            infinite=True,
            allows=dict.fromkeys(
                (
                    "resistance",
                    "gear_ratio",
                    "back_emf_constant",
                    "inductance",
                    "voltage_limit",
                    "current_limit",
                ),
                ("two numbers",),
            ),
        ),
    )
    some = [(effects.ViscousFriction("shoulder"), [0.3])]
    yield (
        "systems.EffectForce",
        Call(
            m.EffectForce,
            {
                "plant": t.plant,
                "effects": some,
                "sign_width": np.full(2, 0.01),
                "phi": t.phi,
                "log": Free("swing"),
            },
        ),
    )
    friction = effects.ViscousFriction("shoulder")
    yield (
        "systems.EffectForce.effects",
        Call(lambda mu: EffectForce(t.plant, [(friction, mu)]), {"mu": np.array([0.3])}),
    )
    yield (
        "systems.EffectForce.AddToBuilder",
        Call(_force, {"builder": Fresh(DiagramBuilder), "effects": some}),
    )
    yield "systems.FixedGains", Call(m.FixedGains, {"damping": np.ones(2), "rate": np.ones(2)})
    yield "systems.VaryingGains", Call(m.VaryingGains, {"rate": 10.0})
    yield (
        "systems.Safeguards",
        Call(
            m.Safeguards,
            {"effort_limits": np.ones(2), "stale_time": 0.05, "dead_zone": np.zeros(2)},
            infinite=True,
        ),
    )
    yield (
        "systems.Safeguards.of_plant",
        Call(m.Safeguards.of_plant, {"plant": t.plant, "stale_time": 0.1}, infinite=True),
    )
    yield (
        "systems.LogSource",
        Call(m.LogSource, {"log": t.log, "joints": ("shoulder",), "largest_gap": 0.1}),
    )
    yield (
        "systems.ModelResidual",
        Call(m.ModelResidual, {"control": t.control, "filtered": t.filtered}),
    )
    controller = Fresh(lambda: PassivityBasedAdaptiveController(t.control, t.law))
    yield (
        "systems.add_tracking_drives",
        Call(
            _track,
            {"builder": Fresh(DiagramBuilder), "motion": t.desired, "controller_plant": t.plant},
        ),
    )
    yield (
        "loops.add_adaptive_loop",
        Call(
            _loop,
            {
                "builder": Fresh(DiagramBuilder),
                "controller": controller,
                "motion": t.desired,
                "effects": some,
                "sign_width": np.full(2, 0.01),
                "log_period": 0.01,
            },
            allows={"effects": ("nothing",), "log_period": ("nothing",)},
        ),
    )
    yield (
        "regressor.ControlModel",
        Call(ControlModel.of, {"model": t.model, "sign_width": np.full(2, 0.01)}),
    )
    yield (
        "online_estimation.FilteredRegressor",
        Call(
            FilteredRegressor,
            {"control": t.control, "period": 0.001, "bandwidth": 20.0, "order": 2},
        ),
    )
    yield (
        "online_estimation.SampleUpdate",
        Call(
            SampleUpdate,
            {
                "manifold": t.manifold,
                "tolerance": np.full(2, 0.1),
                "constraints": t.polyhedron,
                "relaxation": 0.5,
                "forgetting": 0.1,
                "prior": p,
            },
        ),
    )


def _force(builder, effects):
    plant = pendulum_plant()
    if isinstance(builder, DiagramBuilder):
        builder.AddSystem(plant)
    EffectForce.AddToBuilder(builder, plant, effects)


def _track(builder, motion, controller_plant):
    plant = pendulum_plant(0.001, gains=True)
    if isinstance(builder, DiagramBuilder):
        builder.AddSystem(plant)
    geodrake.control.systems.add_tracking_drives(
        builder, plant, motion, controller_plant=controller_plant
    )


def _loop(builder, controller, motion, **options):
    plant = pendulum_plant()
    if isinstance(builder, DiagramBuilder):
        builder.AddSystem(plant)
    geodrake.control.loops.add_adaptive_loop(builder, plant, controller, motion, **options)


def _effects(t):
    m = effects
    joint, pair, body = "shoulder", ("shoulder", "elbow"), t.model.bodies[0]
    shapes = {
        m.StribeckFriction: {"stribeck_velocity": 0.1, "exponent": 2.0},
        m.NonlinearViscousFriction: {"exponent": 0.5},
        m.CoupledFriction: {"sign": 1},
        m.FrictionDrift: {"time_constant": 100.0},
        m.ThermalFriction: {"reference": 30.0},
        m.Hysteresis: {"breakaway_angle": 0.01},
        m.JointSpring: {"exponent": 1, "center": 0.1},
        m.TorqueRipple: {"order": 3.0},
        m.Backlash: {"half_width": 0.01},
        m.GravityTilt: {"about_x": 0.01, "about_y": 0.02},
        m.Contact: {"start": 1.0, "end": 2.0, "rise": 0.1, "log": 0, "x": 0.1, "y": 0.1, "z": 0.1},
        m.AerodynamicDrag: {"x": 0.1, "y": 0.1, "z": 0.1},
        m.EffortDelay: {"delay": 0.01},
    }
    places = {
        "joint": {"joint": Free(joint)},
        "joint_pair": {"joints": pair},
        "body": {"body": Free(body)},
        "robot": {},
        "log": {"joint": Free(joint)},
    }
    for kind in m.catalogue():
        if kind is m.WrongInertia:  # of which there is no instance
            continue
        arguments = {**places[kind.places], **shapes.get(kind, {})}
        yield f"effects.{kind.__name__}", Call(kind, arguments)
    yield (
        "effects.Parameter",
        Call(
            m.Parameter,
            {"name": Free("size"), "unit": Free("N·m"), "lower": 0.0, "upper": 1.0, "spread": 1.0},
            infinite=True,
        ),
    )
    yield (
        "effects.Shape",
        Call(
            m.Shape,
            {"name": "width", "unit": "rad", "grid": (0.1, 0.2), "scale": "speed", "usual": 0.1},
        ),
    )
    yield "effects.effect_class", Call(m.effect_class, {"name": "payload", "extra": ()})
    yield (
        "effects.make_effect",
        Call(
            m.make_effect,
            {"name": "joint_spring", "where": (joint,), "shape": {"exponent": 3}, "extra": ()},
        ),
    )
    yield "effects.load_effect_file", Call(m.load_effect_file, {"path": folder() / "effect.py"})


def _identification(t):
    m = geodrake.identification
    data = {"A": t.A, "b": t.b, "sigma": np.full(60, 0.01)}
    fit = {**data, "prior": t.phi}
    yield (
        "identification.identify",
        Call(
            identify,
            {
                **fit,
                "regularizer": "entropic",
                "gamma": 1.0,
                "ellipsoids": np.stack(
                    [t.quadric, equivalent_ellipsoid(t.phi[1]).scaled(3.0).quadric]
                ),
                "total_mass": float(t.phi[:, 0].sum()),
            },
        ),
    )
    wide = np.hstack([t.A, t.rng.normal(size=(60, 1))])
    yield (
        "identification.identify.bound",
        Call(
            identify,
            {
                "A": wide,
                "b": t.b,
                "prior": t.phi,
                "regularizer": "pullback",
                "residual_bound": 10.0,
                "extra_bounds": np.array([[0.0, 1.0]]),
                "extra_prior": np.array([[0.5, 2.0]]),
                "certify": False,
            },
            infinite=True,
        ),
    )
    yield (
        "identification.compare_regularizers",
        Call(
            m.compare_regularizers,
            {
                **fit,
                "gamma": 1.0,
                "reference": "entropic",
                "regularizers": ("euclidean", "pullback"),
            },
            allows={"sigma": ("nothing",)},
            slow=True,
        ),
    )
    yield (
        "identification.geodesic_least_squares",
        Call(
            m.geodesic_least_squares,
            {**fit, "gamma": 1.0, "method": "newton", "tolerance": 1e-6, "max_iterations": 15},
            infinite=True,
        ),
    )
    yield "identification.least_squares", Call(m.least_squares, {**data, "bodies": 2})
    yield (
        "identification.physical_least_squares",
        Call(m.physical_least_squares, {**fit, "solver": "clarabel"}),
    )
    yield "identification.whitened_factor", Call(whitened_factor, data)
    yield "identification.build_fit", Call(m.build_fit, {"problem": t.problem}, infinite=True)
    yield (
        "identification.solve_fit",
        Call(m.solve_fit, {"problem": t.problem, "solver": "clarabel"}),
    )
    entropic = replace(t.problem, entropic={0: (t.phi[0], 1.0), 10: (t.phi[1], 1.0)})
    yield (
        "identification.solve_newton",
        Call(solve_newton, {"problem": entropic, "start": t.phi.ravel(), "weight": 1.0}),
    )
    yield (
        "identification.newton_sweep",
        Call(newton_sweep, {"problem": entropic, "weights": np.array([1.0, 2.0])}),
    )
    bounds = np.array([[0.1, 50.0], [0.1, 50.0]])
    boxes = np.tile([-1.0, 1.0], (2, 3, 1))
    yield (
        "identification.BodyConstraints",
        Call(
            lambda **values: identify(
                t.A,
                t.b,
                t.phi,
                regularizer="entropic",
                gamma=1.0,
                constraints=BodyConstraints(**values),
            ),
            {"mass_bounds": bounds, "com_bounds": boxes},
            {"mass_bounds": ("infinity at one place", "nothing"), "com_bounds": ("nothing",)},
        ),
    )
    yield (
        "identification.LinearConstraints",
        Call(
            lambda **values: replace(t.problem, constraints=LinearConstraints(**values)),
            {"matrix": np.eye(20)[:1], "lower": np.array([0.0]), "upper": np.array([9.0])},
            infinite=True,
        ),
    )
    yield (
        "identification.FitProblem",
        Call(
            m.FitProblem,
            {
                "factor": t.problem.factor,
                "inertia_blocks": (0, 10),
                "prior_mean": t.phi.ravel(),
                "prior_information": np.eye(20),
                "entropic": {0: (t.phi[0], 1.0)},
                "residual_bound": 10.0,
                "margin": 1e-4,
            },
            infinite=True,
        ),
    )
    yield "identification.FitProblem.residual", Call(t.problem.residual, {"x": t.phi.ravel()})
    yield (
        "identification.PointMasses",
        Call(
            m.PointMasses,
            {"positions": tuple(t.points.positions), "masses": tuple(t.points.masses)},
        ),
    )
    yield (
        "identification.PointMasses.of_bodies",
        Call(
            m.PointMasses.of_bodies,
            {"phi": t.phi, "counts": 12},
            allows={"counts": ("two numbers",)},
        ),
    )
    yield (
        "identification.PointMasses.within",
        Call(
            m.PointMasses.within,
            {"phi": t.phi, "ellipsoids": equivalent_ellipsoid(t.phi), "counts": 24},
            allows={"counts": ("two numbers",)},
        ),
    )
    yield "identification.PointMassEuclidean", Call(m.PointMassEuclidean, {"points": t.points})
    yield "identification.PointMassKL", Call(m.PointMassKL, {"points": t.points})
    yield (
        "identification.Riemannian",
        Call(m.Riemannian, {"starts": ("entropic",), "random_starts": 1, "seed": 0}),
    )


def _excitation(t):
    m = geodrake.excitation
    samples = {"plant": t.plant, "q": t.q, "v": t.v, "vd": t.vd}
    yield (
        "excitation.CollisionWorld",
        Call(
            m.CollisionWorld,
            {
                "model": t.model,
                "obstacles": (Solid("box", Box(1, 1, 1), RigidTransform([0, 0, 9])),),
                "links": {
                    t.model.bodies[0]: (Solid("link", Box(0.1, 0.1, 0.1), RigidTransform()),)
                },
                "clearance": 0.01,
                "seed": 0,
            },
        ),
    )
    yield (
        "excitation.Solid",
        Call(m.Solid, {"name": Free("box"), "shape": Box(1, 1, 1), "X_BG": RigidTransform()}),
    )
    yield (
        "excitation.Criterion",
        Call(m.Criterion, {"name": "e_optimality", "sharpness": 16.0, "kept": 2}, infinite=True),
    )
    yield (
        "excitation.Criterion.value",
        Call(Criterion().value, {"eigenvalues": np.array([1.0, 2.0])}, infinite=True),
    )
    yield (
        "excitation.DesignOptions",
        Call(
            m.DesignOptions,
            {
                "samples": 50,
                "start": np.zeros(2),
                "solver": "snopt",
                "iterations": 5,
                "seconds": 5.0,
            },
        ),
    )
    yield (
        "excitation.FourierMotion",
        Call(m.FourierMotion, {"duration": 5.0, "modes": 3, "frequency": 0.2}),
    )
    yield (
        "excitation.SplineMotion",
        Call(m.SplineMotion, {"duration": 5.0, "points": 12, "degree": 5}),
    )
    yield "excitation.FreeSamples", Call(m.FreeSamples, {"samples": 20})
    yield (
        "excitation.MotionLimits",
        Call(
            m.MotionLimits,
            {
                "joints": ("shoulder", "elbow"),
                "lower": -np.ones(2),
                "upper": np.ones(2),
                "velocity": np.ones(2),
                "acceleration": np.ones(2),
                "effort": np.ones(2),
            },
            infinite=True,
        ),
    )
    yield "excitation.MotionLimits.scaled", Call(t.limits.scaled, {"share": 0.5}, infinite=True)
    yield (
        "excitation.motion_limits",
        Call(
            m.motion_limits,
            {
                "model": t.model,
                "position": {"shoulder": (-1.0, 1.0)},
                "velocity": {"shoulder": 2.0},
                "acceleration": 10.0,
                "effort": 50.0,
            },
            infinite=True,
            allows={
                "velocity": ("a number",),
                "acceleration": ("two numbers",),
                "effort": ("two numbers",),
            },
        ),
    )
    yield (
        "excitation.Objective",
        Call(
            m.Objective,
            {"target": t.target, "criterion": Criterion(), "normalization": "geometric"},
        ),
    )
    yield (
        "excitation.make_target",
        Call(
            m.make_target,
            {
                "model": t.model,
                "noise": np.full(2, 0.01),
                "bodies": t.model.bodies,
                "effects": (effects.CoulombFriction("elbow"),),
                "sign_width": np.full(2, 0.01),
                "seed": 0,
            },
            infinite=True,
        ),
    )
    rival = {"model": t.model, "limits": t.limits, "where": ("shoulder",)}
    yield (
        "excitation.make_rival",
        Call(m.make_rival, {"name": "coulomb_friction", **rival}, slow=True),
    )
    pair = [make_rival(each, t.model, t.limits) for each in ("coulomb_friction", "effort_offset")]
    yield (
        "excitation.make_separation",
        Call(
            m.make_separation,
            {
                "model": t.model,
                "first": pair[0],
                "second": pair[1],
                "noise": np.full(2, 0.01),
                "spread": 0.3,
            },
            slow=True,
            infinite=True,
        ),
    )
    separation = make_separation(t.model, *pair)
    quick = DesignOptions(samples=40, iterations=3, seconds=2.0)
    design = {"limits": t.limits, "trajectory": FourierMotion(5.0, 2), "options": quick, "seeds": 1}
    yield (
        "excitation.design_excitation",
        Call(
            m.design_excitation,
            {"what": t.model, "criterion": "e_optimality", "normalization": "geometric", **design},
            slow=True,
            infinite=True,
            allows={"seeds": ("two numbers",)},
        ),
    )
    yield (
        "excitation.design_objective",
        Call(
            design_objective,
            {"objective": Objective(t.target), **design},
            slow=True,
            infinite=True,
            allows={"seeds": ("two numbers",)},
        ),
    )
    yield (
        "excitation.design_reduced_excitation",
        Call(
            m.design_reduced_excitation,
            {"target": t.target, "threshold": 0.1, **design},
            slow=True,
            infinite=True,
            allows={"seeds": ("two numbers",)},
        ),
    )
    yield (
        "excitation.design_separation",
        Call(
            m.design_separation,
            {"separation": separation, **design},
            slow=True,
            infinite=True,
            allows={"seeds": ("two numbers",)},
        ),
    )
    yield (
        "excitation.measurement_factor",
        Call(
            m.measurement_factor, {"target": t.target, "motions": (t.motion,), "measured": (t.v,)}
        ),
    )
    whole = measurement_factor(t.target, t.motion, (t.model.effort(t.motion),))
    for name, factor in (("identifiable_parameters", t.factor), ("reduced_identification", whole)):
        yield (
            f"excitation.{name}",
            Call(
                getattr(m, name),
                {"target": t.target, "factor": factor, "threshold": 0.1},
                infinite=True,
            ),
        )
    weights = np.ones((5, 2, 20))
    yield (
        "excitation.inverse_dynamics_regressor_gradient",
        Call(inverse_dynamics_regressor_gradient, {**samples, "weights": weights}),
    )
    yield (
        "excitation.base_wrench_regressor_gradient",
        Call(
            base_wrench_regressor_gradient,
            {**samples, "weights": np.ones((5, 6, 20)), "X_WP": np.eye(4)},
        ),
    )
    yield "excitation.regressor_jacobian", Call(regressor_jacobian, samples)
    family = FourierMotion(5.0, 2)
    coefficients = 0.1 * t.rng.normal(size=(family.basis([0.0]).shape[-1], 2))
    made = ExcitationTrajectory(family, coefficients, ("shoulder", "elbow"), np.arange(2))
    yield (
        "excitation.ExcitationTrajectory.motion",
        Call(made.motion, {"times": np.linspace(0, 1, 5)}),
    )
    yield (
        "excitation.ExcitationTrajectory.log",
        Call(made.log, {"model": t.model, "rate": 50.0, "name": Free("swing")}),
    )
    yield "excitation.drake_trajectory", Call(m.drake_trajectory, {"trajectory": made})
    yield (
        "excitation.ros_joint_trajectory",
        Call(m.ros_joint_trajectory, {"trajectory": made, "rate": 50.0}),
    )
    path = folder() / "motion.yaml"
    path.write_text(m.drake_trajectory(made), encoding="utf-8")
    yield "excitation.read_drake_trajectory", Call(m.read_drake_trajectory, {"path": path})
    yield (
        "excitation.write_trajectory",
        Call(
            m.write_trajectory,
            {"trajectory": made, "path": folder() / "new.yaml", "model": t.model, "rate": 50.0},
        ),
    )


def _diagnosis(t):
    m = geodrake.diagnosis
    logs = {"model": t.model, "logs": (t.log,)}
    options = {"bandwidth": 8.0, "blocks": 4}
    yield "diagnosis.compare", Call(m.compare, {**logs, **options}, slow=True, infinite=True)
    yield (
        "diagnosis.check_columns",
        Call(m.check_columns, {**logs, **options}, slow=True, infinite=True),
    )
    yield "diagnosis.corrected", Call(m.corrected, {"log": t.log, "findings": ()})
    yield (
        "diagnosis.with_motor_limits",
        Call(m.with_motor_limits, {"model": t.model, "logs": (t.log,), "findings": ()}),
    )
    sought = {"extra": (), "beliefs": m.Beliefs()}
    yield (
        "diagnosis.diagnose",
        Call(m.diagnose, {**logs, **sought, **options}, slow=True, infinite=True),
    )
    yield (
        "diagnosis.explain",
        Call(
            m.explain,
            {**logs, **sought, **options, "progress": lambda *_: None},
            slow=True,
            infinite=True,
        ),
    )
    yield (
        "diagnosis.add",
        Call(
            m.add,
            {"effect": "coulomb_friction", **logs, "where": ("shoulder",), "extra": (), **options},
            slow=True,
            infinite=True,
        ),
    )
    yield "diagnosis.Beliefs", Call(m.Beliefs, dict(vars(m.Beliefs())))
    yield (
        "drafting.draft_effects",
        Call(
            geodrake.diagnosis.drafting.draft_effects,
            {**logs, **sought, **options},
            slow=True,
            infinite=True,
        ),
    )
    m = geodrake.identification.models
    yield (
        "models.identify_model",
        Call(
            m.identify_model,
            {
                **logs,
                "settings": IdentificationSettings(),
                "effects": (effects.CoulombFriction("elbow"),),
                "progress": lambda text: None,
            },
            slow=True,
            infinite=True,
        ),
    )
    yield (
        "models.IdentificationSettings",
        Call(
            m.IdentificationSettings,
            {"regularizer": "entropic", "residual_ratio": 1.1, "total_mass": 3.0, **options},
            {"bandwidth": ("NaN",)},  # which the logs decide
            infinite=True,
        ),
    )
    yield (
        "models.with_effects",
        Call(
            with_effects,
            {"model": t.model, "effects": (effects.CoulombFriction("elbow"),)},
            infinite=True,
        ),
    )
    yield (
        "identifiability.log_identifiability",
        Call(
            geodrake.excitation.identifiability.log_identifiability,
            {
                **logs,
                "effects": (effects.CoulombFriction("elbow"),),
                "threshold": 0.01,
                "noise": 0.1,
                "progress": lambda text: None,
                **options,
            },
            slow=True,
            allows={"noise": ("two numbers",)},  # one a joint
            infinite=True,
        ),
    )
    brief = pendulum_log(t.model, seconds=3.0)  # of which all windows may be asked for
    short = {"model": t.model, "logs": (brief,)}
    yield (
        "rollout.roll_out",
        Call(
            geodrake.control.rollout.roll_out,
            {**short, "horizon": 0.2, "most": 2, "bandwidth": 8.0, "progress": lambda *_: None},
            slow=True,
            infinite=True,
            allows={"most": ("beyond floats", "beyond machine integers")},
        ),
    )
    spring = FittedEffect(geodrake.effects.JointElasticity(t.model.joints[1]), np.array([1e-3]))
    soft = replace(t.model, effects=(*t.model.effects, spring), information=None)
    yield (
        "rollout.fit_rollouts",
        Call(
            geodrake.control.rollout.fit_rollouts,
            {
                "model": soft,
                "logs": (brief,),
                "horizon": 0.2,
                "most": 4,
                "bandwidth": 8.0,
                "commands": False,
                "progress": lambda *_: None,
            },
            slow=True,
            infinite=True,
            allows={"most": ("beyond floats", "beyond machine integers")},
        ),
    )
    still = np.gradient(brief.position, brief.time, axis=0)
    command = brief.position + 0.05 * still + 0.01 * brief.effort
    told = replace(brief, effort=np.full_like(brief.effort, np.nan), command=command)
    yield (
        "rollout.command_rollout",
        Call(
            geodrake.control.rollout.command_rollout,
            {
                "model": t.model,
                "logs": (told,),
                "horizon": 0.2,
                "most": 2,
                "bandwidth": 8.0,
                "progress": lambda *_: None,
            },
            slow=True,
            infinite=True,
            allows={"most": ("beyond floats", "beyond machine integers")},
        ),
    )
    yield (
        "rollout.commanded_motions",
        Call(
            geodrake.control.rollout.commanded_motions,
            {"model": t.model, "after": t.model, "logs": (t.log,), "between": ()},
            slow=True,
            allows={"logs": ("a text",)},  # files are read where there are servos
        ),
    )


def _digests(t):
    m = geodrake.fleet
    facts = {"content": Free("0" * 64), "files": (PENDULUM,), "date": 1.7e9, "payloads": ()}
    settings = m.make_settings(t.model, t.log)
    digest = m.make_digest(t.model, t.log, settings, m.LogFacts("0" * 64, (PENDULUM,)))
    path = folder() / "digest.npz"
    path.write_bytes(m.digest_content(digest))
    write_log(t.log, folder() / "digested.csv")
    yield "fleet.Wanted", Call(m.Wanted, {"bandwidth": 5.0, "blocks": 4, "extra": ()})
    yield "fleet.LogFacts", Call(m.LogFacts, {**facts, "episode": 0})
    yield (
        "fleet.make_settings",
        Call(
            m.make_settings,
            {"model": t.model, "log": t.log, "wanted": m.Wanted()},
            slow=True,
        ),
    )
    made = {"settings": settings, "facts": m.LogFacts(**{**facts, "content": ""}), "extra": ()}
    yield (
        "fleet.make_digest",
        Call(m.make_digest, {"model": t.model, "log": t.log, **made}, slow=True, infinite=True),
    )
    yield "fleet.merge", Call(m.merge, {"digests": (digest,)}, infinite=True)
    yield (
        "fleet.digest_dataset",
        Call(m.digest_dataset, {"digest": digest, "model": t.model, "extra": ()}, infinite=True),
    )
    yield "fleet.digest_content", Call(m.digest_content, {"digest": digest})
    yield "fleet.read_digest", Call(m.read_digest, {"path": path}, infinite=True)
    yield "fleet.read_settings", Call(m.read_settings, {"folder": folder()})
    yield "fleet.digest_files", Call(m.digest_files, {"folder": folder()})
    yield "fleet.model_hash", Call(m.model_hash, {"model": t.model})
    yield (
        "fleet.digest_logs",
        Call(
            m.digest_logs,
            {
                "model": t.model,
                "logs": (folder() / "digested.csv",),
                "to": folder() / "digests",
                "wanted": m.Wanted(),
                "date": 1.7e9,
                "payloads": {folder() / "digested.csv": (KnownPayload("lower_link", 0.3),)},
            },
            slow=True,
            infinite=True,
        ),
    )


def _fleet(t):
    """Two robots of one joint with two columns, one of friction, and the joint's gain."""
    m = fleet
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(2, 4, 1, 9, 3))
    rows[..., 2] = rows[..., :2].sum(axis=-1) + 0.01 * rows[..., 2]
    grams = np.swapaxes(rows, -1, -2) @ rows
    given = {"days": np.arange(4.0), "weights": np.full((4, 1), 1e4)}
    robots = tuple(m.weighted_history(f"robot {k}", grams=grams[k], **given) for k in range(2))
    relative = np.array([False, True, False])
    spreads = m.column_spreads(("body", "dry", "gain"), (0, 1, 2), 3)
    masks = {"free": ~np.eye(3, dtype=bool)[2], "relative": relative, "course": relative}
    columns = m.TypeColumns(np.array([1.0, 1.0, 0.0]), gains=1, spreads=spreads, **masks)
    logs = tuple(robot.with_gains(np.ones(2)) for robot in robots)
    model = m.learn_type(logs, columns, rounds=2)
    fit = model.fit(0, logs[0])
    change = m.column_change("dry", "elbow", [1], 3)
    names = {
        "ChangeHypothesis": {
            "effect": Free("dry"),
            "where": Free("elbow"),
            "factor": np.ones((3, 1)),
        },
        "JointHistory": {
            "columns": [0, 1],
            "information": np.ones((4, 2, 2)),
            "right": np.ones((4, 2)),
        },
        "RobotHistory": {
            "robot": Free("a"),
            "days": np.arange(4.0),
            "joints": robots[0].joints,
            "columns": 2,
            "temperature": np.ones(4),
        },
        "Spread": {"name": Free("dry"), "factor": np.ones((3, 1))},
        "TypeColumns": {
            "prior": columns.prior,
            "gains": 1,
            "spreads": spreads,
            **masks,
        },
        "body_change": {
            "effect": Free("payload"),
            "where": Free("arm"),
            "body": 0,
            "phi": t.phi,
            "count": 25,
            "mass": 1.0,
            "radius": 0.1,
            "matrix": np.ones((4, 20)),
        },
        "body_spread": {
            "name": Free("arm"),
            "phi": t.phi,
            "columns": 25,
            "matrix": np.eye(20),
        },
        "column_change": {
            "effect": Free("dry"),
            "where": Free("elbow"),
            "columns": (1,),
            "count": 3,
            "size": 0.5,
        },
        "column_spreads": {"names": ("a", "b"), "columns": (0, 2), "count": 3},
        "find_changes": {
            "histories": robots,
            "columns": columns,
            "hypotheses": (change,),
            "false_alarms": 0.1,
            "passes": 1,
        },
        "learn_type": {"logs": logs, "columns": columns, "rounds": 1},
        "own_parameters": {"model": model, "fit": fit},
        "parameter_levels": {
            "model": model,
            "robot": 0,
            "logs": logs[0],
            "fit": fit,
            "columns": (1,),
        },
        "weighted_history": {"robot": Free("a"), "grams": grams[0], **given},
    }
    allows = {
        "body_spread": {"phi": ("NaN at one place",)},
        "RobotHistory": {"temperature": ("NaN at one place",)},
        "weighted_history": {"temperature": ("nothing",)},
    }
    for name, arguments in names.items():
        yield (
            f"fleet.{name}",
            Call(
                getattr(m, name),
                arguments,
                allows=allows.get(name, {}),
                infinite=name in ("weighted_history", "RobotHistory"),  # unknown temperatures
                trusted=("free", "relative", "course"),
            ),
        )


def _fleet_files(t):
    m, path = fleet, folder() / "fleet.yaml"
    write_log(t.log, folder() / "of_robot.csv")
    path.write_text(
        f"to: fleet\ntypes: {{arm: {{model: '{PENDULUM}'}}}}\n"
        "robots: [{name: a, logs: of_robot.csv}]\n",
        encoding="utf-8",
    )
    yield "fleet.read_fleet", Call(m.read_fleet, {"path": path}, infinite=True)
    yield (
        "fleet.FleetWork",
        Call(
            m.FleetWork,
            {"workers": 0, "scheduler": Free("tcp://127.0.0.1:8786"), "false_alarms": 0.01},
        ),
    )
    given = {"fleet": m.read_fleet(path), "work": m.FleetWork(workers=0)}
    yield "fleet.run_fleet", Call(m.run_fleet, given, slow=True, infinite=True)


def _files(t):
    write_log(t.log, folder() / "log.csv")
    geodrake.save_model(t.model, folder() / "model.yaml")
    yield (
        "load_model",
        Call(geodrake.load_model, {"path": folder() / "model.yaml", "extra": ()}, infinite=True),
    )
    yield (
        "save_model",
        Call(geodrake.save_model, {"model": t.model, "path": folder() / "saved.yaml"}),
    )
    for name in ("python_source", "cpp_source"):
        call = Call(
            getattr(geodrake.model, name), {"model": t.model, "sign_width": 0.01 * np.ones(2)}
        )
        yield f"source.files.{name}", call
    yield (
        "source.files.effort_source",
        Call(
            geodrake.model.source.effort_source,
            {"model": t.model, "language": "cpp", "sign_width": 0.01 * np.ones(2)},
        ),
    )
    yield "export.export_model", Call(geodrake.model.export.export_model, {"model": t.model})
    yield (
        "export.save_export",
        Call(geodrake.model.export.save_export, {"model": t.model, "path": folder() / "new.urdf"}),
    )
    yield (
        "export_proof.export_to",
        Call(
            geodrake.control.export_proof.export_to,
            {"to": "urdf", "model": t.model, "folder": folder() / "out", "force": True},
            allows={"force": ("0", "1", "a float", "true", "false")},
            slow=True,
        ),
    )
    yield (
        "log_files.read_log",
        Call(
            read_log, {"path": folder() / "log.csv", "joints": ("shoulder", "elbow")}, infinite=True
        ),
    )
    yield "log_files.write_log", Call(write_log, {"log": t.log, "path": folder() / "written.csv"})
    log = t.log
    yield (
        "motion.JointLog",
        Call(
            JointLog,
            {
                "name": Free("swing"),
                "joints": log.joints,
                "time": log.time,
                "position": log.position,
                "effort": log.effort,
                "velocity": log.position,
            },
            dict.fromkeys(("time", "position", "effort", "velocity"), ("NaN at one place",)),
            infinite=True,
        ),
    )
    yield (
        "motion.Motion",
        Call(
            Motion,
            {"q": t.q, "v": t.v, "vd": t.vd},
            dict.fromkeys(("q", "v", "vd"), ("NaN at one place",)),
            infinite=True,
        ),
    )
    model: RobotModel = t.model
    yield (
        "model.RobotModel.motion",
        Call(
            model.motion,
            {"motion": t.motion, "sign_width": np.full(2, 0.01), "load": t.v},
            infinite=True,
            allows={"load": ("NaN at one place",)},
        ),
    )
    yield (
        "model.RobotModel.effort",
        Call(model.effort, {"motion": t.motion, "sign_width": np.full(2, 0.01)}),
    )
    yield (
        "model.RobotModel.positions",
        Call(
            model.positions, {"by_joint": t.q}, {"by_joint": ("NaN at one place",)}, infinite=True
        ),
    )
    yield (
        "model.RobotModel.add_to_builder",
        Call(
            model.add_to_builder,
            {
                "builder": Fresh(DiagramBuilder),
                "time_step": 0.001,
                "scene_graph": Free(True),
                "name": Free("arm"),
                "sign_width": np.full(2, 0.01),
                "log": Free("swing"),
            },
        ),
    )
    yield "model.RobotModel.sign_widths", Call(model.sign_widths, {"least": np.full(2, 0.01)})
    n = model.phi.size + 2
    yield (
        "model.RobotModel.with_fit",
        Call(
            model.with_fit,
            {
                "phi": t.phi,
                "effects": model.effects,
                "information": np.eye(n),
                "effort_noise": np.full(2, 0.01),
            },
            infinite=True,
        ),
    )
    yield (
        "effects.FittedEffect",
        Call(
            FittedEffect,
            {
                "effect": effects.ViscousFriction("elbow"),
                "parameters": np.array([0.3]),
                "deviations": np.array([0.1]),
            },
            infinite=True,
            allows=dict.fromkeys(("parameters", "deviations"), ("NaN at one place",)),
        ),
    )
