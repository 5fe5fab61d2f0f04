"""Benchmark of hidden effects: what `geodrake explain` says of logs whose truth is known.

Pinocchio or MuJoCo makes logs of five arms with effects in other formulas than geodrake's: none,
one or two of its catalogue, or one that it has no name for. Robots, motions (fast, slow, from point
to point), noise (0.5, 1, 2 % of effort), bodies (exact, or 20 % off in the geometric metric) and
sizes (3 to 25 % of effort) are random. geodrake gets the log and the model file. Further studies:
`--coverage N` of the intervals of found parameters under coloured noise, `--disturbed N` of the
same beside outside effects, `--kinds N` of difficult kinds, `--smallest N` of the smallest effect
that is found, by bisection.

    python -m diagrams.benchmarks.hidden_effects --json hidden_effects.json
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated import engines, motions, truths
from diagrams.benchmarks.simulated.recording import TIME_CONSTANTS, Sensors, between
from diagrams.benchmarks.simulated.scoring import (
    Line,
    Row,
    calibration,
    is_sure_and_wrong,
    median,
    share,
    show_lines,
    step_row,
    told,
)
from diagrams.harness import positive_number, run_draws, script_parser, show, whole_number, write
from geodrake.diagnosis import explain
from geodrake.diagnosis.drafting import Correlate
from geodrake.diagnosis.drafting.draft import draft_rest
from geodrake.diagnosis.explain import Investigation, investigate
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.compare import compare
from geodrake.logs import JointLog
from geodrake.model import RobotModel

ONE, TWO, NONE, UNKNOWN = "one", "two", "none", "outside"
COVERAGE, SMALLEST, TIMING, KIND = "coverage", "smallest", "timing", "kind"
WHITE = "white"
EXACT, OFF = "exact", "off"
NOISES = (0.005, 0.01, 0.02)
LEAST_SHARE, MOST_SHARE = 0.03, 0.25
_LEAST_OF_TWO = 0.05
OFF_BY = 0.2
COVERED = ("viscous_friction", "coulomb_friction", "effort_offset", "rotor_inertia", "payload")
_MOTION_ODDS = (0.45, 0.25, 0.3)
_EXACT_ODDS = 0.7
_FIRST_COLOURED = 100_000


@dataclass(frozen=True)
class Draw:
    """One log."""

    case: str
    hidden: tuple[str, ...]
    robot: str
    engine: str
    motion: str
    noise: float  # deviation of the effort's noise, as a share of that of the effort
    colour: str
    prior: str  # whether the model file's bodies are "exact", or "off" by 20 %
    # RMS of every hidden effect, as a share of the deviation of the effort; at its joint, or at the
    # median of the joints that an effect of a body or of the robot acts upon.
    shares: tuple[float, ...]
    number: int
    seed: int
    duration: float = 24.0
    rate: float = 200.0


def draw(case: str, hidden: Sequence[str], number: int, seed: int, **fixed: object) -> Draw:
    """Return a random draw of a case, except for the `fixed` fields."""
    words = f"{case} {' '.join(hidden)}"
    rng = np.random.default_rng([seed, engines.number_of(words), number])
    least = _LEAST_OF_TWO if len(hidden) > 1 else LEAST_SHARE
    robots = engines.robot_names()
    if any(name in truths.OUTSIDE and truths.OUTSIDE[name].in_space for name in hidden):
        robots = tuple(name for name in robots if name != engines.PENDULUM)
    shares = np.exp(rng.uniform(np.log(least), np.log(MOST_SHARE), len(hidden)))
    chosen = {
        "robot": str(rng.choice(robots)),
        "engine": str(rng.choice(engines.ENGINES)),
        "motion": str(rng.choice(motions.MOTIONS, p=_MOTION_ODDS)),
        "noise": float(rng.choice(NOISES)),
        "colour": WHITE,
        "prior": EXACT if rng.random() < _EXACT_ODDS else OFF,
        "shares": tuple(shares.round(4).tolist()),
    }
    values = {**chosen, **fixed}
    return Draw(case, tuple(hidden), number=number, seed=seed, **values)  # type: ignore[arg-type]


def pair(number: int, seed: int) -> tuple[str, str]:
    """Return a random pair of compatible effects."""
    rng = np.random.default_rng([seed, 2, number])
    names = [name for name, truth in truths.TRUTHS.items() if not truth.alone]
    first, second = rng.choice(names, 2, replace=False)
    return str(first), str(second)


def all_draws(
    draws: int,
    seed: int,
    *,
    effects: Sequence[str] = tuple(truths.TRUTHS),
    outside: Sequence[str] = tuple(truths.OUTSIDE),
    others: tuple[int, int] | None = None,
    **fixed: object,
) -> list[Draw]:
    """Return every case, `draws` logs an effect.

    Args:
        draws: Logs an effect of the catalogue; other counts follow from it.
        effects: Effects that are hidden alone.
        outside: Effects of no catalogue; finding words for them takes longest.
        others: Logs that hide two effects, and that hide none, of either colour; 4 and 6 times
            `draws` if None.
        fixed: Fields of the draws that are not left to chance.
    """
    pairs, empty = others or (4 * draws, 6 * draws)
    found = []
    for name in effects:
        # Where every body is wrong, the one that is more so is no truth to be found.
        sure = {"prior": EXACT} if name == truths.WRONG_INERTIA else {}
        found += [draw(ONE, (name,), k, seed, **{**fixed, **sure}) for k in range(draws)]
    for name in outside:
        found += [draw(UNKNOWN, (name,), k, seed, **fixed) for k in range((draws + 1) // 2)]
    found += [draw(TWO, pair(k, seed), k, seed, **fixed) for k in range(pairs)]
    for colour in (WHITE, truths.COLOURED):
        sure = {"colour": colour, "prior": EXACT, "shares": ()}
        # The number says which log: that of the other colour is another one.
        first = 0 if colour == WHITE else _FIRST_COLOURED
        found += [draw(NONE, (), first + k, seed, **{**fixed, **sure}) for k in range(empty)]
    return found


_SURE = {"motion": motions.FAST, "prior": EXACT}
STUDIES: Mapping[str, tuple[str, Sequence[str], Mapping[str, object]]] = {
    "kinds": (KIND, tuple(truths.HARD), {}),
    "coverage": (COVERAGE, COVERED, {**_SURE, "colour": truths.COLOURED, "shares": (0.1,)}),
    "disturbed": (COVERAGE, COVERED, {**_SURE, "shares": (0.1, 0.05)}),
    "smallest": (SMALLEST, tuple(truths.TRUTHS), {**_SURE, "noise": 0.01, "shares": ()}),
    "timing": (
        TIMING,
        ("coulomb_friction", "payload"),
        {"robot": "arm6", "motion": motions.FAST, "duration": 50.0, "rate": 200.0},
    ),
}
"""Further studies: the case, its effects, and what is not left to chance.

Those of coverage are large enough to be found, and have one of no catalogue beside if disturbed.
"""


def study_draws(
    study: str, draws: int, seed: int, *, effects: Sequence[str] = (), **fixed: object
) -> list[Draw]:
    """Return a study's draws, `draws` logs for each of its effects or of some."""
    case, names, sure = STUDIES[study]
    found = []
    for at, name in enumerate(effects or names):
        given = truths.HARD[name][1] if case == KIND else {}
        for k in range(draws):
            hidden = (name,)
            if study == "disturbed":
                beside = np.random.default_rng([seed, 3, at, k]).choice(tuple(truths.OUTSIDE))
                hidden = (name, str(beside))
            found.append(draw(case, hidden, k, seed, **{**sure, **given, **fixed}))
    return found


_ENCODER, _TACHO = 1e-5, 2e-4  # rad, rad/s
_TURN = {truths.HELD: 0, truths.LATE: 2}
_CLOSE = 0.03
_ACTED_UPON = 0.5
_ONE_AT_A_JOINT: tuple[set[str], ...] = (
    {"joint_spring", truths.OFFSET},
    {"asymmetric_friction", truths.OFFSET},
    {"asymmetric_friction", "coulomb_friction"},
    {"asymmetric_friction", "viscous_friction"},
)
"""A spring with an offset is one of another rest; asymmetric friction with an offset, or with more
friction, is asymmetric friction of other heights and slopes."""
_RUBBING = 0.08


@dataclass(frozen=True, eq=False)
class Secret:
    """A hidden effect."""

    name: str
    where: tuple[str, ...]  # joints or body that are to be named; none for one of the whole robot
    joints: tuple[str, ...]
    share: float  # its RMS as a share of the deviation of the effort, as in `Draw.shares`
    values: Mapping[str, float]  # parameters that geodrake should find
    # For an effect of no catalogue, joints and signals that it varies with.
    follows: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A log and its hidden effects."""

    log: JointLog
    secrets: tuple[Secret, ...]  # what it hides
    bare: JointLog  # the log of the same motion and noise if the robot were that of the model file
    # A log of the same robot before, without the effects; None where the model file is all that is
    # known.
    known: JointLog | None = None


def make_recording(draw: Draw, bodies: tuple[str, ...]) -> Recording:
    """Return the log of a draw; `bodies` are geodrake's names, in the order of the joints."""
    key = f"{draw.case} {draw.hidden} {draw.robot}"
    seeds = np.random.SeedSequence([draw.seed, engines.number_of(key), draw.number]).spawn(4)
    on_robot, on_motion, on_site, on_noise = map(np.random.default_rng, seeds)
    engine = engines.make_engine(draw.engine, engines.robot_file(draw.robot))
    file = engine.bodies()
    if draw.prior == OFF:
        engine.set_bodies(engines.congruent(engine.bodies(), OFF_BY, on_robot))
    seen = _seen(draw, engine, on_motion)
    kinds = [truths.truth_of(name) for name in draw.hidden]
    known = None
    if any(kind.needs_known_inertia for kind in kinds):
        before = _seen(draw, engine, on_motion)
        sizes = _RUBBING * before.load.std(0)
        known = _measured(draw, before, before.load + _rubbing(before, sizes), on_noise)
        seen = replace(seen, load=seen.load + _rubbing(seen, sizes))
    sites = _sites(kinds, seen.load, on_site)
    total, secrets = seen.load.copy(), dict[int, Secret]()
    # Gears bear what the last body holds; a delay, in the measurement, is that of all efforts.
    for k in sorted(range(len(kinds)), key=lambda k: _TURN.get(kinds[k].name, 1)):
        if kinds[k].name == truths.LATE:
            seen = replace(seen, load=total)
        effort, secrets[k] = _hide(kinds[k], sites[k], draw.shares[k], seen, bodies)
        total = total + effort
        if kinds[k].name == truths.HELD:
            seen = replace(seen, load=total)
    log = _measured(draw, seen, total, on_noise)
    engine.set_bodies(file)
    bare = replace(log, effort=log.effort - total + engine.efforts(seen.q, seen.v, seen.a))
    return Recording(log, tuple(secrets[k] for k in range(len(kinds))), bare, known)


def _seen(draw: Draw, engine: engines.Engine, rng: np.random.Generator) -> truths.Seen:
    return truths.Seen.of(engine, draw.motion, np.arange(0.0, draw.duration, 1.0 / draw.rate), rng)


def _rubbing(seen: truths.Seen, sizes: engines.Array) -> engines.Array:
    """Return dry and viscous friction at all joints."""
    return np.asarray(sizes * (truths.smooth_sign(seen.v) + 0.7 * seen.v))


def _measured(
    draw: Draw, seen: truths.Seen, effort: engines.Array, rng: engines.Generator
) -> JointLog:
    """Return measurements of the motion and its efforts."""
    memory = partial(between, TIME_CONSTANTS) if draw.colour == truths.COLOURED else None
    sensors = Sensors(draw.noise, _ENCODER, _TACHO, memory=memory)
    return sensors.log(f"{draw.robot} {draw.number}", seen, effort, rng, effort_uncertainty=0.0)


def _sites(
    kinds: list[truths.Truth], load: engines.Array, rng: engines.Generator
) -> list[truths.Site]:
    """Return where effects act; two on joints share one in half of the logs."""
    found, n = list[truths.Site](), load.shape[1]
    for kind in kinds:
        own = rng.spawn(1)[0]
        joint = int(rng.integers(n))
        if found and rng.random() < 0.5:
            joint = found[0].joint
        if found and joint == found[0].joint and {kind.name for kind in kinds} in _ONE_AT_A_JOINT:
            joint = (joint + 1) % n
        found.append(truths.Site(*kind.placed(joint, load, rng), own))
    return found


def _hide(
    kind: truths.Truth, site: truths.Site, wanted: float, seen: truths.Seen, bodies: tuple[str, ...]
) -> tuple[engines.Array, Secret]:
    """Return the effort of an effect of a share, and what geodrake should find."""
    deviation = seen.load.std(0)

    def shares(effort: engines.Array) -> tuple[engines.Array, float]:
        own = np.sqrt(np.mean(effort**2, 0)) / deviation
        some = (
            own[own > 1e-3 * own.max()]
            if kind.places in (truths.LINK, truths.BODY, truths.ROBOT)
            else own.max()
        )
        return own, float(np.median(some))

    def reached(size: float) -> float:
        return shares(kind.law(seen, site, size))[1]

    size = truths.scaled(wanted, reached, kind, close=_CLOSE, tries=10)
    effort, joints = kind.law(seen, site, size), seen.engine.joints
    found, share = shares(effort)
    acted = tuple(joints[j] for j in np.flatnonzero(found >= _ACTED_UPON * found.max()))
    own, other = joints[site.joint], joints[site.other]
    where = kind.where(site, joints, bodies)
    names = {truths.OWN: own, truths.OTHER: other}
    follows = tuple((names.get(whose, whose), what) for whose, what in kind.follows)
    return effort, Secret(kind.name, where, acted, share, kind.found(site, size), follows)


_SIGNALS = {
    "position": ("position",),
    "speed": ("velocity", "direction of motion"),
    truths.TIME: (),
}
_RANGE = (0.0005, 0.256)
_HALVINGS = 6


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return the row of a draw: its truth, the findings, and which are right."""
    recording = make_recording(draw, engines.robot_model(draw.robot).bodies)
    model = _told(draw, recording)
    began = time.process_time()
    case = prepare_case(model, [recording.log], candidates=True)
    found = investigate(case)
    seconds = time.process_time() - began
    explanation, secrets = found.explanation, recording.secrets
    right: dict[str, tuple[str, ...]] = {}
    for secret in secrets:
        for name in (secret.name, *truths.truth_of(secret.name).companions):
            right[name] = (*right.get(name, ()), *secret.where)
    if draw.prior == OFF:
        right[truths.WRONG_INERTIA] = model.bodies
    steps = [
        {**step_row(step, right), "before": step.error_before, "after": step.error_after}
        for step in explanation.steps
    ]
    row = {
        **asdict(draw),
        "secrets": [asdict(secret) for secret in secrets],
        "steps": steps,
        "verdict": explanation.verdict,
        "over_floor": _over_floor(draw, recording, found),
        "start_nrms": explanation.start.nrms,
        "end_nrms": explanation.end.nrms,
        "seconds": seconds,
        "extra": [step["effect"] for step in steps if not step["right"]],
        **_judged(steps, secrets, draw),
    }
    return row | (_drafted(found, secrets[0]) if draw.case == UNKNOWN else {})


def _told(draw: Draw, recording: Recording) -> RobotModel:
    """Return the model that geodrake gets: the file's, fitted to an earlier log if any."""
    model = engines.robot_model(draw.robot)
    return model if recording.known is None else explain(model, [recording.known]).model


def _over_floor(draw: Draw, recording: Recording, found: Investigation) -> float:
    """Return the final held-out error relative to that of the true model, which is noise alone."""
    bandwidth = found.case.trajectories[0].filter.bandwidth
    bare = compare(engines.robot_model(draw.robot), [recording.bare], bandwidth=bandwidth).errors
    pairs = zip(bare.joints, found.explanation.end.joints, strict=True)
    floor = np.sqrt(np.mean([(alone.rms / joint.std) ** 2 for alone, joint in pairs]))
    return float(found.explanation.end.nrms / floor)


def _judged(steps: Sequence[Row], secrets: Sequence[Secret], draw: Draw) -> dict[str, Any]:
    """Return which steps are right; None without a truth."""
    row: dict[str, Any] = dict.fromkeys(("named", "first", "in_set", "placed"))
    if not secrets or any(secret.name not in truths.TRUTHS for secret in secrets):
        return row
    row["named"] = all(
        any(s["effect"] == one.name and set(one.where) <= set(s["where"]) for s in steps)
        for one in secrets
    )
    row["in_set"] = all(any(_may_be(s, one) for s in steps) for one in secrets)
    first = next(
        (s for s in steps if s["effect"] != truths.WRONG_INERTIA or draw.prior != OFF), None
    )
    first = first or next(iter(steps), None)
    if len(secrets) == 1:
        (secret,), answer = secrets, first and first["effect"]
        names = (secret.name, *truths.TRUTHS[secret.name].companions)
        row |= {"answer": answer, "first": answer in names and row["named"]}
        if secret.where:
            # What comes with the truth, a coupled rotor's own rotors, may come first.
            there = next((s for s in steps if s["effect"] == secret.name and row["first"]), first)
            row["placed"] = there is not None and set(there["where"]) == set(secret.where)
    return row


def _may_be(step: Row, secret: Secret) -> bool:
    """Return whether a step may be the effect."""
    return secret.name in (step["effect"], *step["rivals"])


def _drafted(found: Investigation, secret: Secret) -> dict[str, Any]:
    """Return geodrake's description of the rest, and whether joint and kind are right."""
    began = time.process_time()
    draft = draft_rest(found)
    correlates = draft.correlates
    there = [c for c in correlates if c.joint in secret.joints]
    return {
        "correlates": [f"{c.joint}: {c.share:.0%} with {c.words}" for c in correlates],
        "right_joint": bool(correlates) and correlates[0].joint in secret.joints,
        "right_correlate": any(_goes_with(c, secret) for c in there),
        "drafted_over_floor": draft.after.nrms / draft.after.floor_nrms,
        "draft_seconds": time.process_time() - began,
    }


def _goes_with(correlate: Correlate, secret: Secret) -> bool:
    """Return whether a correlate names a signal that the hidden effect is a function of."""
    words = correlate.words
    for whose, what in secret.follows:
        names = [f"{signal} of {whose}" for signal in _SIGNALS[what]]
        if whose == truths.ANY:
            names = [*_SIGNALS[what]]
        elif whose == correlate.joint:
            names += [f"its {signal}" for signal in _SIGNALS[what]]
        if any(name in words for name in names):
            return True
    return secret.follows == ((truths.TIME, truths.TIME),) and words.startswith(
        ("time", "the clock")
    )


def smallest_of(draw: Draw) -> dict[str, Any]:
    """Return the smallest share at which one log reveals an effect, by bisection."""
    low, high = _RANGE
    bodies = engines.robot_model(draw.robot).bodies
    known: RobotModel | None = None
    seconds, found_at = 0.0, None
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        recording = make_recording(replace(draw, shares=(middle,)), bodies)
        known = known or _told(draw, recording)
        began = time.process_time()
        steps = [step_row(step, {}) for step in explain(known, [recording.log]).steps]
        seconds += time.process_time() - began
        (secret,) = recording.secrets
        if any(_may_be(s, secret) and set(secret.where) <= set(s["where"]) for s in steps):
            high = found_at = min(middle, secret.share)
        else:
            low = middle
    return {**asdict(draw), "smallest": found_at, "seconds": seconds}


def coverage_of(draw: Draw) -> dict[str, Any]:
    """Return the errors of found parameters in deviations, of noise and systematic."""
    recording = make_recording(draw, engines.robot_model(draw.robot).bodies)
    secret, off = recording.secrets[0], list[float]()
    for step in explain(engines.robot_model(draw.robot), [recording.log]).steps:
        if step.effect == secret.name:
            place = secret.where[0] if secret.where else next(iter(step.parameters))
            found, own = step.parameters.get(place, {}), step.deviations.get(place, {})
            beside = step.systematic.get(place, {})
            off = [
                float((found[name] - value) / np.hypot(own[name], beside.get(name, 0.0)))
                for name, value in secret.values.items()
                if name in found and own.get(name, np.nan) > 0.0
            ]
    return {**asdict(draw), "off": off}


FOUND_IN = 0.9
"""Share of the logs in which the smallest effect is found."""


def bars(rows: Sequence[Row]) -> list[Line]:
    """Return the lines of ordinary draws."""
    one = [r for r in _of(rows, ONE) if r["secrets"][0]["share"] >= LEAST_SHARE]
    two, outside = _of(rows, TWO), _of(rows, UNKNOWN)
    slow, brisk = (
        [r for r in one if (r["motion"] == motions.SLOW) == own] for own in (True, False)
    )
    main, off = ([r for r in brisk if r["prior"] == prior] for prior in (EXACT, OFF))
    exactly_slow, slow_and_off = ([r for r in slow if r["prior"] == p] for p in (EXACT, OFF))
    plain = [r for r in two if r["motion"] != motions.SLOW and r["prior"] == EXACT]
    both, both_of_others = (
        [r["named"] and not r["extra"] for r in two if (r in plain) == own] for own in (True, False)
    )
    alarms = {
        colour: [bool(r["steps"]) for r in _of(rows, NONE) if r["colour"] == colour]
        for colour in (WHITE, truths.COLOURED)
    }
    honest = [
        bool(r["verdict"] == "unexplained" and r["right_joint"] and r["right_correlate"])
        for r in outside
    ]
    usual = [r["seconds"] for r in rows if r["case"] in (ONE, TWO, NONE, UNKNOWN)]
    named = [r["over_floor"] for r in (*one, *two) if r["named"]]
    return [
        share("one effect: truth first", _get(main, "first"), 0.95),
        share("… truth in the set", _get(main, "in_set"), 0.99),
        share("… right joint or body", _get(main, "placed"), 0.98),
        share("… and nothing else", [not r["extra"] for r in main]),
        *(
            share(f"nothing hidden, {colour} noise: false alarms", found, 0.01, most=True)
            for colour, found in alarms.items()
        ),
        share("outside effects: unexplained, joint and correlate", honest, 0.95),
        share("… unexplained", [r["verdict"] == "unexplained" for r in outside]),
        share("… right joint", _get(outside, "right_joint")),
        share("… right correlate", _get(outside, "right_correlate")),
        share("… a wrong name at > 0.9", [is_sure_and_wrong(r) for r in outside], most=True),
        share("two effects: both, nothing else", both, 0.92),
        share("… in slow motion or with inertia 20 % off", both_of_others),
        *calibration(rows),
        median("error after / noise floor where named, median", named, 1.05),
        share("inertia 20 % off: truth in the set", _get(off, "in_set"), 0.97),
        share("… truth first", _get(off, "first")),
        share("slow motion: truth in the set", _get(exactly_slow, "in_set"), 0.95),
        share("… with inertia 20 % off, too", _get(slow_and_off, "in_set")),
        median("seconds for one log of 24 s, median", usual, 10.0),
        median(
            "seconds for 6 joints, 10,000 samples", [r["seconds"] for r in _of(rows, TIMING)], 10.0
        ),
    ]


def coverage_lines(rows: Sequence[Row]) -> list[Line]:
    """Return how often 95 % intervals hold the truth, in coloured noise or beside others."""
    lines = []
    for beside, hidden in (("coloured noise", 1), ("an outside effect beside", 2)):
        off = [z for r in _of(rows, COVERAGE) if len(r["hidden"]) == hidden for z in r["off"]]
        inside = [abs(z) <= 1.96 for z in off]
        lines.append(share(f"coverage of 95 % intervals, {beside}", inside, 0.9, highest=0.98))
    return lines


def kind_lines(rows: Sequence[Row]) -> list[Line]:
    """Return how often each difficult kind is among the possible effects, at its place."""
    hard = _of(rows, KIND)
    return [
        share(
            f"{name}: in the set, placed",
            [r["in_set"] and r["placed"] is not False for r in hard if r["hidden"] == [name]],
            0.9,
        )
        for name in truths.HARD
    ]


def smallest_lines(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the share of the effort at which nine of ten logs reveal each effect."""
    lines = []
    for name in truths.TRUTHS:
        found = [r["smallest"] for r in rows if r["hidden"] == [name]]
        sizes = np.sort([np.inf if size is None else size for size in found])
        if len(sizes):
            # The least size with which at least this share of the logs gives the effect away.
            at = float(sizes[int(np.ceil(FOUND_IN * len(sizes))) - 1])
            middle = float(np.median(sizes))
            lines.append(
                {
                    "effect": name,
                    "smallest": at if np.isfinite(at) else None,
                    "median": middle if np.isfinite(middle) else None,
                    "logs": len(sizes),
                }
            )
    return lines


def _of(rows: Sequence[Row], case: str) -> list[Row]:
    return [row for row in rows if row["case"] == case]


def _get(rows: Sequence[Row], key: str) -> list[Any]:
    return [row[key] for row in rows if row.get(key) is not None]


QUICK_EFFECTS = ("coulomb_friction", "effort_offset", "payload")
QUICK_OUTSIDE = ("oscillation in time",)

FURTHER = {
    "kinds": "logs a hard kind and seed",
    "coverage": "logs an effect and seed under coloured noise",
    "disturbed": "the same beside an effect of no catalogue",
    "smallest": "logs an effect and seed",
}
"""Studies that there are only where logs are asked for: of what."""


def run_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table."""
    return {COVERAGE: coverage_of, SMALLEST: smallest_of}.get(draw.case, score_draw)(draw)


def wanted_draws(logs: Mapping[str, Any], seeds: Iterable[int]) -> list[Draw]:
    """Return the draws of the options, one seed after the other."""
    return [
        each
        for seed in seeds
        for each in (
            *all_draws(logs["draws"], seed),
            *study_draws("timing", min(logs["draws"], 1), seed),
            *(each for name in FURTHER for each in study_draws(name, logs[name], seed)),
        )
    ]


def quick_draws(seed: int) -> list[Draw]:
    """Return a few short logs of every study."""
    short = {"robot": "double_pendulum", "duration": 8.0, "rate": 100.0}
    found = all_draws(1, seed, effects=QUICK_EFFECTS, outside=QUICK_OUTSIDE, others=(1, 2), **short)
    for name in ("coverage", "smallest"):
        found += study_draws(name, 1, seed, effects=QUICK_EFFECTS[:1], **short)
    return found


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument(
        "--seeds", type=positive_number, default=1, help="seeds, from --seed on, that are pooled"
    )
    number = partial(parser.add_argument, type=whole_number, metavar="N")
    number("--draws", default=6, help="logs an effect and seed; 0 for none")
    for name, words in FURTHER.items():
        number(f"--{name}", default=0, help=words)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.seeds)
    wanted = quick_draws(options.seed) if options.quick else wanted_draws(vars(options), seeds)
    rows = run_draws(parser, options, run_draw, wanted)
    lines = [*bars(rows), *kind_lines(rows), *coverage_lines(rows)]
    smallest = smallest_lines([row for row in rows if row["case"] == SMALLEST])
    show_lines("Hidden effects", lines)
    if smallest:
        show("Smallest effect found in 9 of 10 logs", smallest)
    write(options, {"lines": told(lines), "smallest": smallest, "rows": rows})


if __name__ == "__main__":
    main()
