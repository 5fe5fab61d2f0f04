"""The commands `excite` and `identifiable`: the information in motions and logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import one_of, positive
from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.identify import named_effects
from geodrake.cli.input_options import number_in, pairs, split_effects
from geodrake.cli.options import ExciteOptions, IdentifiableOptions
from geodrake.cli.progress import STOPPING
from geodrake.errors import ArgumentError, ModelError, nearest
from geodrake.excitation import (
    CollisionWorld,
    Criterion,
    DesignOptions,
    FourierMotion,
    FreeSamples,
    MotionLimits,
    Objective,
    SplineMotion,
    Stance,
    make_stance,
    motion_limits,
)
from geodrake.excitation.collisions import FLOOR, floor_of, read_obstacles
from geodrake.excitation.design import DesignProgress, ExcitationResult, design_excitation
from geodrake.excitation.families import MotionFamily
from geodrake.excitation.identifiable import LogIdentifiability, log_identifiability
from geodrake.excitation.limits import FULL_EFFORT, FULL_SPEED, motors_of, signal_limits
from geodrake.excitation.objective import CRITERIA, NORMALIZATIONS
from geodrake.excitation.solve import Budget
from geodrake.excitation.stance import Foot
from geodrake.excitation.starts import below_floor
from geodrake.excitation.target import SIZE_WORDS, WRENCH, usual_noise, usual_target
from geodrake.excitation.tell_apart import Placed, separation_of
from geodrake.excitation.trajectory import check_rate, trajectory_content
from geodrake.inertia import Array
from geodrake.logs.motion import SIGNAL_KINDS
from geodrake.model.robot_model import RobotModel
from geodrake.robot.shapes import robot_shapes

_FAMILIES = {"fourier": ("harmonics", "frequency"), "spline": ("points",), "free": ()}
_MARGIN = 0.9  # of the velocity limits, by default
_LEAST_SECONDS = 1e-3  # if collision geometry took all the time
_UPDATED_EVERY = 5  # evaluations
_SAMPLES = 300
_FORM = "Write EFFECT,EFFECT; either may have a place: EFFECT@elbow."
_PLATE_SHARE, _PLATE_ARM = 0.01, 0.15  # of the weight; m
_PLATE_NOISE = np.array([*3 * [_PLATE_ARM], *3 * [1.0]])  # moments and forces, over the force
_PLATE_WORDS = (
    f"noise: {100 * _PLATE_SHARE:.0f} % of the weight, moments at {_PLATE_ARM:g} m, as nothing "
    "else is known"
)
_UNDER = 0.001  # m, gap between an assumed floor and the clearance below the feet
_REPEATS = 3  # periods of a motion that distinguishes effects, so every block contains some
_QUANTITIES = ("position", "velocity", "acceleration", "effort", "jerk", *SIGNAL_KINDS)
_JOINTS = "joint_1=0.1,joint_2=0.2"
_EXAMPLE = "Write 0.5, velocity=1.5, velocity=50% or JOINT.position=-1:0.5."


def run_excite(options: ExciteOptions) -> None:
    """Run `geodrake excite`: design a motion."""
    files, names = split_effects(options.effects)
    _check(options, names)
    family = family_of(options)
    if family.timed:
        check_rate(options.rate, family.length)
    design = DesignOptions(
        samples=_SAMPLES if options.samples is None else options.samples,
        solver=options.solver,
        iterations=options.iterations,
        seconds=options.seconds,
    )
    command = Command(
        "excite",
        "Designing",
        lambda given: _designed(options, given, names, family, design),
        outputs={
            "save": Output(
                "motion",
                (".csv", ".npz", ".txt", ".yaml", ".yml"),
                lambda found, path: trajectory_content(
                    found.executed, path, found.objective.target.model, rate=options.rate
                ),
            ),
            "meshcat": Output("replay of the motion", make=_replay),
        },
    )
    floating = options.floating or options.feet is not None
    run(command, replace(options, effects=files, floating=floating))


def run_identifiable(options: IdentifiableOptions) -> None:
    """Run `geodrake identifiable`: show which parameters logs identify."""
    positive(options.threshold, "--threshold")
    files, names = split_effects(options.effects)

    def decomposed(given: Input) -> LogIdentifiability:
        text, model = options.noise, given.model
        return log_identifiability(
            model,
            given.logs,
            effects=named_effects(names, model, given.extra),
            threshold=options.threshold,
            noise=None if text is None else joint_values(text, model.joints, "--noise"),
            progress=given.progress,
            **given.settings,
        )

    command = Command("identifiable", "Reading the logs", decomposed)
    run(command, replace(options, effects=files))


def family_of(options: ExciteOptions) -> MotionFamily:
    """Return the family of motions."""
    name = options.trajectory
    one_of(name, "--trajectory", _FAMILIES)
    for other, keys in _FAMILIES.items():
        for key in keys:
            if other != name and getattr(options, key) is not None:
                raise ArgumentError(f"--{key} needs --trajectory {other}, not {name}.")
    if name == "free":
        unsuitable = [o for o in ("save", "meshcat", "stand") if getattr(options, o) is not None]
        if unsuitable:
            raise ArgumentError(
                f"--{unsuitable[0]} does not apply to --trajectory free, which is not a motion.",
                advice="Use --trajectory fourier or spline.",
            )
        return FreeSamples(50 if options.samples is None else options.samples)
    if name == "spline":
        return SplineMotion(options.duration, 16 if options.points is None else options.points)
    frequency = options.frequency
    if frequency is not None:
        positive(frequency, "--frequency")  # in Hz
    elif options.tell_apart is not None and 0 < options.duration < np.inf:
        frequency = _REPEATS / options.duration
    rate = None if frequency is None else 2.0 * np.pi * frequency
    harmonics = 5 if options.harmonics is None else options.harmonics
    return FourierMotion(options.duration, harmonics, rate)


def _check(options: ExciteOptions, names: Sequence[str]) -> None:
    """Raise for invalid options, before the model is read."""
    one_of(options.criterion, "--criterion", CRITERIA)
    one_of(options.normalization, "--normalization", NORMALIZATIONS)
    if options.feet is None and options.force_plate:
        raise ArgumentError("--force-plate measures under feet.", advice="Add --feet LINK,LINK.")
    if options.force_plate and (names or options.tell_apart is not None):
        raise ArgumentError(
            "A force plate does not measure effects of joints, such as friction.",
            advice="Omit --force-plate, or --effects and --tell-apart.",
        )
    if options.tell_apart is None:
        return
    for name in ("criterion", "normalization"):
        if getattr(options, name) != getattr(ExciteOptions, name):
            raise ArgumentError(
                f"--{name} does not apply to --tell-apart, which has its own criterion.",
                advice=f"Omit --{name}.",
            )
    if names:
        raise ArgumentError(
            f"With --tell-apart, --effects takes only FILE.py; got {', '.join(names)}.",
            advice="Add the robot's effects to its model first: geodrake add EFFECT MODEL LOG "
            "--save model.yaml.",
        )
    rivals_in(options.tell_apart)


def _designed(
    options: ExciteOptions,
    given: Input,
    names: Sequence[str],
    family: MotionFamily,
    design: DesignOptions,
) -> ExcitationResult:
    """Return the designed motion."""
    model, update, motors = given.model, given.progress, motors_of(given.model)
    if model.base_joints and options.feet is None:
        raise ArgumentError(
            f"The base of {model.path.name} is free, but nothing supports it.",
            advice="Name the links that it stands on: --feet LINK,LINK. If its base is fixed, as "
            "for a hanging robot, omit --floating.",
        )
    budget = Budget.of(options.seconds)
    limits, margins = _limits(options, model)
    start = None if options.start is None else joint_values(options.start, motors, "--start")
    stand = None if options.stand is None else joint_values(options.stand, motors, "--stand")
    stance = None
    if options.feet is not None:
        posture = start if stand is None else stand
        feet = feet_in(options.feet)
        stance = make_stance(model, feet, limits=limits, posture=posture, friction=options.friction)
        if stand is None and len(feet) > 1:
            stand = stance.placed
    robot = model if stance is None else stance.model
    collisions, notes = _collisions(options, robot, limits, start if stand is None else stand)
    if options.meshcat is not None:
        notes = (*notes, *robot_shapes(model.path, model.given).notes)
    objective, more = _objective(options, given, stance, limits, names)
    seconds = max(budget.left, _LEAST_SECONDS)
    design = replace(
        design, stance=stance, start=start, stand=stand, collisions=collisions, seconds=seconds
    )
    update("Designing")

    def updated(now: DesignProgress) -> None:
        if now.is_stopped:
            update.history(STOPPING)
        elif now.evaluations % _UPDATED_EVERY == 0:
            update(
                f"Initial motion {now.seed + 1} of {now.seeds}, log criterion {now.value:.3f}",
                1.0 - budget.left / options.seconds,
            )

    result = design_excitation(
        objective,
        limits,
        trajectory=family,
        options=design,
        seeds=range(options.seed, options.seed + options.seeds),
        progress=updated,
    )
    return replace(result, notes=(*result.notes, *notes, *margins, *more))


def _limits(options: ExciteOptions, model: RobotModel) -> tuple[MotionLimits, tuple[str, ...]]:
    """Return the limits of the motion, and notes on those that were not stated."""
    limits = limits_of(options.limits, model, bounded=True)
    stated = [part for text in options.limits or () for part in text.split(",") if part]
    notes = []
    if all("=" in part and "velocity" not in part for part in stated):
        limits = replace(limits, velocity=_MARGIN * limits.velocity)
        share = f"{100 * _MARGIN:.0f} %"
        notes.append(f"speeds are limited to {share} of their limits (--limits velocity=100%)")
    motors = [k for k, joint in enumerate(model.joints) if joint in limits.joints]
    if not any("acceleration" in part for part in stated) and np.any(
        ~np.isfinite(model.acceleration_limits[motors])
    ):
        notes.append(
            "the file has no acceleration limits: accelerations are limited to effort limit over "
            f"largest joint inertia, and to full speed in {FULL_SPEED:g} s; jerks to full "
            f"acceleration in {FULL_EFFORT:g} s (--limits acceleration=5,jerk=50)"
        )
    unlimited = [j for j, e in zip(limits.joints, limits.effort, strict=True) if np.isinf(e)]
    if unlimited:
        notes.append(
            f"WARNING: {', '.join(unlimited)} have no effort limits, so the motion may exceed what "
            "the motors can do (--limits effort=40)"
        )
    return limits, tuple(notes)


def _objective(
    options: ExciteOptions,
    given: Input,
    stance: Stance | None,
    limits: MotionLimits,
    names: Sequence[str],
) -> tuple[Objective, tuple[str, ...]]:
    """Return the objective of the motion, and notes."""
    criterion, model = Criterion(options.criterion), given.model
    notes: tuple[str, ...] = ()
    if stance is not None and options.force_plate:
        noise = _PLATE_SHARE * stance.weight * _PLATE_NOISE
        if options.noise is not None:
            noise = joint_values(options.noise, WRENCH, "--noise")
        target = stance.target(noise=noise, on_plate=True)
        notes = () if options.noise is not None else (_PLATE_WORDS,)
        return Objective(target, criterion, options.normalization), notes
    if options.noise is not None:
        noise = joint_values(options.noise, motors_of(model), "--noise")
    else:
        noise, source = usual_noise(model)
        notes = (f"noise: {source}",)
    if stance is not None:
        noise = stance.noise(noise)
    if options.tell_apart is not None:
        separation, more = separation_of(
            model,
            *rivals_in(options.tell_apart),
            limits,
            noise=noise,
            extra=given.extra,
            stance=stance,
        )
        return separation, (*notes, *more)
    if stance is not None:
        model = stance.model
    effects = named_effects(names, given.model, given.extra)
    if effects:
        notes = (*notes, f"effects of unknown size are assumed to take {SIZE_WORDS}")
    target = usual_target(model, noise=noise, effects=effects)
    if stance is not None:
        target = replace(target, trial=stance.random_motion())
    return Objective(target, criterion, options.normalization), notes


def _collisions(
    options: ExciteOptions,
    model: RobotModel,
    limits: MotionLimits,
    start: NDArray[np.float64] | None,
) -> tuple[CollisionWorld | None, tuple[str, ...]]:
    """Return the obstacles and the robot's collision geometry, and notes."""
    obstacles = read_obstacles(options.obstacle or ())
    if not options.collisions:
        if obstacles:
            raise ArgumentError(
                "--obstacle needs the robot's collision geometry.", advice="Omit --no-collisions."
            )
        return None, ("self-collisions were not checked (--no-collisions)",)
    try:
        world = CollisionWorld(model, clearance=options.clearance)
    except ArgumentError as error:
        if error.evidence.get("name") == "clearance":
            raise
        if obstacles:
            raise ArgumentError(
                f"{model.path.name} has no collision geometry, which --obstacle needs.",
                advice="Add <collision> elements to its links, or omit --obstacle.",
            ) from None
        return None, (
            f"WARNING: {model.path.name} has no collision geometry: only joint limits keep the "
            "robot from hitting itself or the ground",
        )
    except ModelError as error:
        raise ModelError(
            error.problem, advice="Correct the file, or use --no-collisions."
        ) from error
    notes: tuple[str, ...] = ()
    has_floor = any(solid.name.startswith(FLOOR) for solid in obstacles)
    if options.floor and not has_floor and options.feet is not None:
        # The floor is below the feet, as these touch the ground.
        obstacles = (floor_of(model, below=options.clearance + _UNDER), *obstacles)
    elif options.floor and not has_floor:
        floor = floor_of(model)
        below = below_floor(world.among((floor,)), model, limits, start)
        if below:
            notes = (f"no floor is assumed, as {below}",)
        else:
            obstacles = (floor, *obstacles)
            notes = ("the robot stays above its base (--no-floor to allow less)",)
    return world.among(obstacles) if obstacles else world, notes


def _replay(result: ExcitationResult, path: Path) -> str:
    del path
    from geodrake.report.meshcat_scene import replay_page
    from geodrake.report.robot_scene import FRAMES

    times = result.executed.instants(FRAMES)
    motion = result.executed.motion(times)
    return replay_page(result.objective.target.model, times, motion.q)


def rivals_in(text: str) -> tuple[Placed, Placed]:
    """Return names and places of two effects, `a@elbow,b@j1+j2`; places may be empty."""
    rivals = []
    for part in text.split(","):
        name, _, places = part.strip().partition("@")
        rivals.append((name, tuple(filter(None, places.split("+")))))
    if len(rivals) != 2 or not all(name for name, _ in rivals):
        raise ArgumentError(f"--tell-apart takes two effects; got {text!r}.", advice=_FORM)
    return rivals[0], rivals[1]


def joint_values(text: str, joints: Sequence[str], option: str) -> Array:
    """Return the values (n,) of joints from `0.1`, for all of them, or `a=0.1,b=0.2`."""
    if "=" not in text and "," not in text:
        return np.full(len(joints), _number(text, option))
    values: dict[str, float] = {}
    for joint, value in pairs(option, [text], _JOINTS).items():
        _check_joint(joint, joints, option)
        values[joint] = _number(value, option)
    missing = [joint for joint in joints if joint not in values]
    if missing:
        raise ArgumentError(
            f"{option} has no value for {', '.join(missing)}.",
            advice="Give one number for all joints, or one for each.",
        )
    return np.array([values[joint] for joint in joints])


_FEET = (
    "Write --feet LINK,LINK; give the size of a link without collision geometry, LINK=LENGTHxWIDTH "
    "in m, or LINK=point."
)


def feet_in(text: str) -> list[str | Foot]:
    """Return feet from `l_foot,r_foot`; each may have a size: `l_foot=0.26x0.12`."""
    feet: list[str | Foot] = []
    for part in text.split(","):
        link, equals, size = (word.strip() for word in part.partition("="))
        if not link or (equals and not size):
            raise ArgumentError(f"--feet takes links; got {text!r}.", advice=_FEET)
        if not equals:
            feet.append(link)
        elif size == "point":
            feet.append(Foot(link, np.zeros((1, 3))))
        else:
            length, _, width = size.partition("x")
            try:
                sides = float(length), float(width)
            except ValueError:
                message = f"{size!r} of --feet {text!r} is not a size."
                raise ArgumentError(message, advice=_FEET) from None
            feet.append(Foot.sole(link, *sides))
    return feet


def limits_of(
    given: Sequence[str] | None, model: RobotModel, *, bounded: bool = False
) -> MotionLimits:
    """Return the model's limits, overridden by options.

    Args:
        given: `0.5` for a share of all limits; `velocity=1.5` for all joints, `velocity=50%` for a
            share of the model's; `current=8` (A; also voltage and pwm) for joints whose efforts the
            model computes from currents; `joint.effort=40` and `joint.position=-1:0.5` for one
            joint. Each may contain several, separated by commas; later ones win.
        bounded: As for `motion_limits`.
    """
    motors, scale = motors_of(model), 1.0
    values = {quantity: dict[str, Any]() for quantity in _QUANTITIES}
    shares = {quantity: dict[str, float]() for quantity in _QUANTITIES}
    for text in filter(None, ",".join(given or ()).split(",")):
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            scale *= _amount(key)
            continue
        joint, _, quantity = key.rpartition(".")
        if quantity not in _QUANTITIES:
            raise ArgumentError(
                f"--limits {text!r}: unknown quantity {quantity!r}.",
                advice=f"{nearest(quantity, _QUANTITIES)}Quantities are {', '.join(_QUANTITIES)}. "
                f"{_EXAMPLE}",
            )
        if joint:
            _check_joint(joint, motors, "--limits")
        signals = tuple(signal.joint for signal in model.effort_signals if signal.kind == quantity)
        joints, percent = signals if quantity in SIGNAL_KINDS else motors, value.endswith("%")
        if percent and quantity in SIGNAL_KINDS:
            raise ArgumentError(
                f"--limits {text!r}: the model has no {quantity} limit to take a share of.",
                advice=f"Give a number, such as {quantity}=8.",
            )
        if not joints or joint not in ("", *joints):
            raise ArgumentError(
                f"--limits {text!r}: the model computes no efforts from a "
                f"{quantity}{f' of {joint}' * bool(joint)}.",
                advice="Limit the effort, or use a model that was fitted to such a log.",
            )
        limit: Any = _range(value) if quantity == "position" else _amount(value)
        for name in [joint] if joint else joints:
            values[quantity].pop(name, None)
            shares[quantity].pop(name, None)
            (shares if percent else values)[quantity][name] = limit
    largest_signals = {j: x for kind in SIGNAL_KINDS for j, x in values.pop(kind).items()}
    limits = motion_limits(model, bounded=bounded, **values)
    for quantity in values.keys() - {"position"}:
        share = np.array([shares[quantity].get(joint, 1.0) for joint in motors])
        limits = replace(limits, **{quantity: share * getattr(limits, quantity)})
    # After the shares, which refer to the model's limits; the smaller limit applies.
    effort = np.minimum(limits.effort, signal_limits(model, largest_signals))
    return replace(limits, effort=effort).scaled(scale)


def _range(text: str) -> tuple[float, float]:
    """Return the ends of a range, `-1:0.5`."""
    low, colon, high = text.partition(":")
    if not colon:
        raise ArgumentError(f"--limits has position={text}, not a range.", advice=_EXAMPLE)
    return _number(low, "--limits"), _number(high, "--limits")


def _amount(text: str) -> float:
    """Return a number, or a share of 1 from `50%`."""
    if text.endswith("%"):
        return 0.01 * _number(text.rstrip("%"), "--limits")
    return _number(text, "--limits")


def _number(text: str, option: str) -> float:
    advice = _EXAMPLE if option == "--limits" else f"Write 0.1, or {_JOINTS}."
    return number_in(text, option, advice)


def _check_joint(joint: str, joints: Sequence[str], option: str) -> None:
    if joint not in joints:
        raise ArgumentError(
            f"{option} names {joint!r}, which is not a joint of the model.",
            advice=f"{nearest(joint, joints)}Joints are: {', '.join(joints)}.",
        )
