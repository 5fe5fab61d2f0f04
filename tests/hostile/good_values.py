"""Good values of arguments, by their names or types.

The robot is a double pendulum: 2 joints, 2 bodies, 5 samples. Other values are created by the
exported function or class that returns their type (`calls.made`).
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from adaptive_loops import pendulum_plant
from chain_logs import multisine
from good_files import EFFECT, FLEET, MAPPING
from hostile import HEADER, PENDULUM, fill, put
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial
from scipy.io import savemat

import geodrake
from geodrake import control, effects, excitation, fleet, inertia
from geodrake.control import parameter_manifold
from geodrake.control.adaptation import AdaptationLaw, ConvexSet, mass_limits
from geodrake.effects import FittedEffect
from geodrake.excitation import FourierMotion
from geodrake.excitation.trajectory import drake_trajectory
from geodrake.identification import Riemannian
from geodrake.inertia import equivalent_ellipsoid
from geodrake.logs import JointLog, KnownPayload, Motion, write_log
from geodrake.manifolds import PhysicalInertia, Positive, slab
from geodrake.robot import LinearTransmission, inverse_dynamics_regressor

JOINTS, BODIES = ("shoulder", "elbow"), ("upper_link", "lower_link")
rng = np.random.default_rng(0)
Q, V, VD = rng.uniform(-1, 1, (3, 5, 2))
SCATTER, NOISE = rng.normal(size=(60, 20)), 0.01 * rng.normal(size=60)


@dataclass(frozen=True)
class Fresh:
    """A value that is created anew for every call."""

    make: Callable[[], object]


def pendulum(time_step=0.0, **options):
    """Return a plant of the double pendulum with a motor at each joint."""
    limits = dict.fromkeys(JOINTS, 100.0)
    return pendulum_plant(time_step, limits=limits, damping=0.0, **options)


_PLANTS = []


def builder():
    """Return a builder with a plant in it, which becomes the last of the plants."""
    found = DiagramBuilder()
    _PLANTS.append(found.AddSystem(pendulum(1e-3)))
    return found


IN_BUILDER = {"builder": Fresh(builder), "plant": Fresh(lambda: _PLANTS[-1])}


@cache
def model():
    loaded = geodrake.load_model(PENDULUM)
    fitted = [FittedEffect(effects.ViscousFriction(j), np.array([0.3])) for j in JOINTS]
    return replace(loaded, effects=tuple(fitted))


@cache
def log(seconds=12.0):
    """Return a log that the model explains, so that searches soon end."""
    time, random = np.arange(round(50.0 * seconds)) / 50.0, np.random.default_rng(0)
    motion = Motion(*multisine(time, random, reach=0.5))
    effort = model().effort(motion) + 0.01 * random.standard_normal(motion.q.shape)
    return JointLog("swing", JOINTS, time, motion.q, effort)


@cache
def folder():
    """Return a folder with a file of each kind that is read."""
    path = Path(tempfile.mkdtemp(prefix="geodrake_calls_"))
    fill(path)
    put(path, {"effect.py": EFFECT, "fleet.yaml": FLEET, "mapping.yaml": MAPPING})
    write_log(log(), path / "log.csv")
    geodrake.save_model(model(), path / "model.yaml")
    arrays = {"time": log().time, "position": log().position, "effort": log().effort}
    savemat(path / "log.mat", arrays)
    (path / "motion.yaml").write_text(drake_trajectory(trajectory()), encoding="utf-8")
    digest = fleet.make_digest(model(), log(), settings(), facts())
    (path / "x.digest").write_bytes(fleet.digest_content(digest))
    return path


def in_folder(name):
    return Fresh(lambda: folder() / name)


def trajectory():
    family = FourierMotion(5.0, 2)
    size = (family.basis([0.0]).shape[-1], 2)
    coefficients = 0.1 * np.random.default_rng(0).normal(size=size)
    return excitation.ExcitationTrajectory(family, coefficients, JOINTS)


@cache
def settings():
    return fleet.make_settings(model(), log())


def facts():
    return fleet.LogFacts("0" * 64, (PENDULUM,))


@cache
def rival(name="coulomb_friction"):
    return excitation.make_rival(name, model(), limits())


@cache
def limits():
    return excitation.motion_limits(model(), velocity=2.0, acceleration=10.0, effort=50.0)


@cache
def target():
    return excitation.make_target(model(), noise=0.01)


@cache
def law():
    return AdaptationLaw(parameter_manifold(model()))


@cache
def control_model():
    return control.ControlModel.of(model())


def polyhedron():
    return mass_limits(len(control_model().prior), 0, 0.1, 50.0)


@cache
def biped():
    return geodrake.load_model(PENDULUM.with_name("biped.urdf"), floating=True)


def soft():
    """Return the model with an elastic joint, which rollouts fit."""
    spring = FittedEffect(effects.JointElasticity("elbow"), np.array([1e-3]))
    return replace(model(), effects=(*model().effects, spring), information=None)


def friction(joint="shoulder"):
    return effects.ViscousFriction(joint)


def factor(*, measured=False):
    """Return the information of a motion, with or without measured efforts."""
    motion = Motion(Q, V, VD)
    efforts = (model().effort(motion),) if measured else None
    return excitation.measurement_factor(target(), motion, efforts)


PLANT = pendulum()
PHI = inertia.inertial_parameters(PLANT)
PRIOR = PHI.ravel()
MEASURED = SCATTER @ PRIOR + NOISE
PSEUDO = inertia.pseudo_inertia(PHI)
MASS, COM, MOMENT = inertia.to_mass_com_inertia(PHI)
ELLIPSOID = equivalent_ellipsoid(PHI[0])
QUADRIC = ELLIPSOID.scaled(3.0).quadric
REGRESSOR = inverse_dynamics_regressor(PLANT, Q, V, VD)
DESIRED = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
    np.linspace(0, 1, 11), np.sin([np.linspace(0, 1, 11), np.linspace(0, 2, 11)])
)
_ROWS = np.column_stack([log().time, log().position, log().effort])
TWO, WIDTH = np.array([1.0, 2.0]), np.full(2, 0.01)

BY_TYPE = {
    "RobotModel": model,
    "JointLog": log,
    "MultibodyPlant": lambda: PLANT,
    "DiagramBuilder": lambda: Fresh(DiagramBuilder),
    "Context": PLANT.CreateDefaultContext,
    "np.random.Generator": lambda: Fresh(lambda: np.random.default_rng(0)),
    "Trajectory": lambda: DESIRED,
    "RigidTransform": RigidTransform,
    "Shape": lambda: Box(1, 1, 1),
    "Manifold": lambda: Positive(2),
    "UpdateLaw": law,
    "AdaptationLaw": law,
    "ConvexSet": lambda: ConvexSet(lambda p: p[0] - 2.0, lambda p: np.eye(len(p))[0]),
    "Polyhedron": polyhedron,
    "Transmission": lambda: LinearTransmission.of([[1.0, 0.0], [1.0, 2.0]]),
    "Effect": lambda: effects.CoulombFriction("elbow"),
    "EffectWithValues": lambda: (friction(), [0.3]),
    "ColumnMapping": lambda: None,
    "Given": lambda: None,
    "Regularizer": Riemannian,
    "MotionFamily": lambda: FourierMotion(5.0, 2),
    "Target": target,
    "ExcitationTrajectory": trajectory,
    "ExecutableMotion": trajectory,
    "LogFacts": facts,
    "FleetWork": lambda: fleet.FleetWork(workers=0),
    "Progress": lambda: lambda *_: None,
    "Callable": lambda: lambda *_: None,
    "Told": lambda: lambda *_: None,
    "AdaptiveController": lambda: Fresh(
        lambda: control.PassivityBasedAdaptiveController(control_model(), law())
    ),
}

BY_KIND = {
    "ArrayLike|Array|ByJoint|Scalars": np.array([1.0, 2.0]),
    r"\bfloat\b": 0.5,
    r"\bint\b": 2,
    r"(Sequence|tuple)\[str": JOINTS,
    r"\bstr\b": JOINTS[0],
}
"""Words of an annotation -> a value of a required argument."""
BY_NAME = {
    "phi": PHI, "phi1": PHI, "phi2": 1.2 * PHI, "reference": PHI, "prior": PHI, "R_AB": np.eye(3),
    "p_AoBo_A": np.array([0.1, 0.2, 0.3]), "com": COM, "inertia_com": MOMENT, "matrix": PSEUDO,
    "matrices": PSEUDO, "center": ELLIPSOID.center, "semi_axes": ELLIPSOID.semi_axes,
    "rotation": ELLIPSOID.rotation, "points": rng.normal(size=(9, 3)), "Q": QUADRIC,
    "quadric": QUADRIC, "count": 3, "size": 22, "q": Q, "v": V, "vd": VD, "X_WP": np.eye(4),
    "regressor": REGRESSOR, "wrench": np.arange(1.0, 31.0).reshape(5, 6), "A": SCATTER,
    "b": MEASURED, "sigma": np.full(60, 0.01), "gamma": 1.0, "sign_width": WIDTH, "body": 1,
    "bodies": BODIES, "joints": JOINTS, "joint": "shoulder", "where": ("shoulder",), "findings": (),
    "names": (BODIES[0],), "lower": np.zeros(2), "upper": np.ones(2), "lock": {}, "rate": 10.0,
    "effort_limits": TWO, "largest_gap": 0.1, "bandwidth": 8.0, "blocks": 4, "noise": WIDTH,
    "start": 1.0, "end": 2.0, "weights": TWO, "temperature": np.ones(4), "robot": "a",
    "frequency": 0.2, "acceleration": 10.0, "effort": 50.0, "held": {"elbow": 0.1}, "to": "urdf",
    "kind": "current", "extra": (), "total_mass": float(MASS.sum()), "limit": 50.0,
    "parameters": control_model().prior, "scheduler": "tcp://a:1", "truth": control_model().prior,
    "date": 1.7e9, "units": {}, "columns: tuple[str, ...]": (), "regularizer": "entropic",
    "theta": Q, "path": in_folder("log.csv"), "signal": V, "starts": ("entropic",), "kept": 2,
}  # fmt: skip
"""Name of an argument -> its value in any function."""

IN_FOLDER = {
    "read_mapping": "mapping.yaml", "save_export": "new.urdf",
    "save_model": "saved.yaml", "write_log": "written.csv", "write_trajectory": "new.csv",
    "read_drake_trajectory": "motion.yaml", "load_effect_file": "effect.py",
    "read_fleet": "fleet.yaml", "read_digest": "x.digest", "load_description": PENDULUM,
    "read_description": PENDULUM,
}  # fmt: skip
"""Name of a callable -> the file in the folder that it reads or writes."""
BY_CALL = {
    **{call: {"path": in_folder(name)} for call, name in IN_FOLDER.items()},
    "Reading": {"rate": None},
    **{manifold: {"dimension": 2} for manifold in ("Positive", "Free")},
    "body_limits": {"rows": np.eye(10)[:1], "lower": [0.1], "upper": [9.0]},
    "center_of_mass_box": {"lower": -np.ones(3), "upper": np.ones(3)},
    "parameter_limits": {"indices": (1, 2)},
    "parameter_manifold": {"weights": {BODIES[0]: 2.0},
        "bodies": {BODIES[0]: PhysicalInertia()}},
    "ConstantMetric": {"matrix": 2 * np.eye(2), "inverse": 0.5 * np.eye(2)},
    "PartialLaw": {"law": AdaptationLaw(PhysicalInertia(), 2.0), "adapted": np.arange(22) < 10},
    "FittedEffect": {"effect": friction("elbow"), "parameters": [0.3], "deviations": [0.1]},
    "RobotInstance.set_state": {"state": np.ones(4)},
    "RobotInstance": {"name": "double_pendulum"},
    "log_of_frame": {"frame": dict(zip(HEADER.split(","), _ROWS.T, strict=True))},
    "take_out_stated": {"name": "double_pendulum",
        "plant": Fresh(lambda: pendulum(finalized=False))},
    **dict.fromkeys(("add_adaptive_loop", "EffectForce.AddToBuilder"), IN_BUILDER),
    "EffectForce": {"log": "swing"},
    "roll_out": {"logs": Fresh(lambda: (log(3.0),))},
    "fit_rollouts": {"model": Fresh(soft), "logs": Fresh(lambda: (log(3.0),)), "most": 4},
    "export_to": {"folder": in_folder("out"), "force": True},
    "load_model": {"path": in_folder("model.yaml"), "transmission": None},
    "digest_logs": {"to": in_folder("digests"),
        "payloads": Fresh(lambda: {folder() / "log.csv": (KnownPayload("lower_link", 0.3),)})},
    "LogFacts": {"episode": 0},
    "Ellipsoid.contains": {"points": np.ones((9, 2, 3))},
    "Ellipsoid.random_points": {"size": (4, 2)},
    "Product": {"manifolds": (PhysicalInertia(), Positive(2)), "weights": (1.0, 2.0)},
    "Interval": {"lower": (0.0, -1.0), "upper": (1.0, 2.0)},
    "ConstrainedInertia": {"normals": np.eye(10)[:1], "offsets": np.array([0.01])},
    "bregman_projection": {"constraints": slab([1.0, 1.0], 0.5, 1.0)},
    "Separation": {"prior": np.eye(2)},
    "Polyhedron": {"matrix": np.array([[1.0, 1.0]]), "lower": [0.5], "upper": [1.0]},
    "Polyhedron.violation": {"y": np.ones(22)},
    "affine_set": {"A": np.eye(2), "b": np.ones(2)},
    "LinearTransmission": {"matrix": [[1.0, 0.0], [1.0, 2.0], [0.5, 0.5]], "offset": np.ones(3)},
    "LinearTransmission.of": {"matrix": [[1.0, 0.0], [1.0, 2.0]]},
    "LinearTransmission.from_ratios": {"joints": ("a", "b"), "actuators": ("a",),
        "ratios": {"a": {"a": 1.0}, "b": {"a": 2.0}}},
    "Shape": {"grid": (0.1, 0.2), "usual": 0.1},
    "effect_class": {"name": "payload"},
    "make_effect": {"name": "joint_spring", "shape": {"exponent": 3}},
    "make_rival": {"name": "coulomb_friction"},
    "add": {"effect": "coulomb_friction"},
    "motion_limits": {"position": {"shoulder": (-1.0, 1.0)}, "velocity": {"shoulder": 2.0}},
    "DesignOptions": {"start": np.zeros(2), "stance": None},
    "Stance.noise": {"noise": 0.1},
    "Stance.target": {"noise": 0.1, "bodies": None, "effects": None},
    "Stance.efforts": {"motion": Motion(*np.zeros((3, 5, 14))), "sign_width": 0.01},
    "make_stance": {"robot": Fresh(biped), "feet": ("l_foot", "r_foot"), "posture": None,
        "limits": None},
    "make_separation": {"second": Fresh(lambda: rival("effort_offset")), "stance": None},
    "measurement_factor": {"measured": (V,)},
    "identifiable_parameters": {"factor": Fresh(factor), "kept": None},
    "reduced_identification": {"factor": Fresh(lambda: factor(measured=True)), "kept": None},
    "make_target": {"X_WP": None},
    "CollisionWorld": {"links": {BODIES[0]: ()}},
    "identify": {"constraints": None,
        "ellipsoids": equivalent_ellipsoid(PHI).scaled(3.0).quadric},
    "FitProblem": {"factor": np.linalg.qr(np.column_stack([SCATTER, SCATTER @ PRIOR]))[1],
        "inertia_blocks": (0, 10), "prior_mean": PRIOR, "prior_information": np.eye(20),
        "entropic": {0: (PHI[0], 1.0)}, "residual_bound": 10.0, "lower": None, "upper": None,
        "reference": None},
    "FitProblem.residual": {"x": PRIOR},
    "PointMasses": {"positions": (np.ones((3, 3)),), "masses": (np.ones(3),)},
    "PointMasses.within": {"ellipsoids": equivalent_ellipsoid(PHI), "counts": 24},
    "PointMasses.parameters": {"masses": None},
    "IdentificationSettings": {"residual_ratio": 1.1, "gamma": None},
    "digest_files": {"folder": Fresh(folder)},
    "JointLog": {"time": log().time, "position": log().position, "effort": log().effort,
        "velocity": log().position, "temperature": None},
    "SampleUpdate": {"prior": control_model().prior, "relaxation": 0.5},
    "RobotModel.motion": {"load": V},
    "RobotModel.with_fit": {"effects": Fresh(lambda: model().effects),
        "information": np.eye(22)},
    "to_spatial_inertia": {"phi": PHI[0]},
    "RobotModel.add_to_builder": {"log": "swing", "scene_graph": True},
    "RobotModel.positions": {"by_joint": Q},
    "EffectForce.lags": {"q": Q[0], "v": V[0], "vd": VD[0]},
    "EffectForce.set_motors": {"lag": np.zeros(0), "speed": np.ones(0)},
}  # fmt: skip
"""Name of a callable -> arguments of its own."""
