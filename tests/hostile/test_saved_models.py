"""Saved models that were changed by hand, by chance, or by somebody who means harm."""

import hashlib
import os
from itertools import pairwise

import numpy as np
import pytest
from hostile import PENDULUM, Row, changed_rows

DIGEST = hashlib.sha256(PENDULUM.read_bytes()).hexdigest()
FRICTION, PAYLOAD = "name: coulomb_friction", "name: payload"
BODIES = """inertial_parameters:
  upper_link: [0.5235, 0.0, 0.0, -0.1047, 0.03189, 0.03189, 0.001095, 0.0, 0.0, 0.0]
  lower_link: [0.6256, 0.0, 0.0, -0.16, 0.05087, 0.05087, 0.00099667, 0.0, 0.0, 0.0]
"""
EFFECTS = """effects:
  - name: coulomb_friction
    where: [shoulder]
    shape: {}
    parameters: [0.3]
    deviations: [0.01]
  - name: joint_spring
    where: [elbow]
    shape: {exponent: 1.0, center: 0.2}
    parameters: [0.5, 0.125]
    deviations: []
  - name: coupled_friction
    where: [shoulder, elbow]
    shape: {sign: 1.0}
    parameters: [0.25, 0.75]
    deviations: [0.02, 0.03]
  - name: payload
    where: [lower_link]
    shape: {}
    parameters: [0.2, 0.0, 0.0, -0.04, 0.0085, 0.0085, 0.001, 0.0, 0.0, 0.0]
    deviations: []
  - name: effort_delay
    where: []
    shape: {delay: 0.002}
    parameters: []
    deviations: []
"""
JOINTS = """effort_noise:
  shoulder: 0.0625
  elbow: 0.03125
fading_speed:
  shoulder: 0.015625
  elbow: 0.0
fitted_to: [abc]
bandwidths:
  abc: [5.0, 15.0]
"""
ROWS_OF_INFORMATION = 20 + 1 + 2 + 2 + 10


def information(change=lambda matrix: None):
    matrix = np.diag(np.arange(1.0, ROWS_OF_INFORMATION + 1))
    change(matrix)
    rows = [f"  - [{', '.join(map(_word, row))}]" for row in matrix.tolist()]
    return "\n".join(["information:", *rows]) + "\n"


def _word(number):
    return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(repr(number), repr(number))


HEAD = f"""format: geodrake model 1
base_model: robot.urdf
base_sha256: {DIGEST}
floating: false
"""
UNINFORMED = HEAD + BODIES + EFFECTS + JOINTS
SAVED = UNINFORMED + information()


def put(name, content):
    def make(folder):
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return make


def whole(name, content, *says, code=2, command="compare {} log.csv", apart=False):
    """A row of a saved model with some content."""
    make = content if callable(content) else put("saved.yaml", content)
    says = (*says, "saved.yaml") if code else says
    return Row(name, command.format("saved.yaml"), says, make, code, apart=apart)


def part(name, old, new, *says, code=2, command="compare {} log.csv"):
    """A row of a saved model, which is read sooner without information, with a text changed."""
    assert old in UNINFORMED, old
    return whole(name, UNINFORMED.replace(old, new, 1), *says, code=code, command=command)


def told(name, change, *says):
    """A row of an information matrix that was changed."""
    return whole(name, UNINFORMED + information(change), "information", *says)


def set_both(i, j, value):
    def change(matrix):
        matrix[i, j] = matrix[j, i] = value

    return change


def set_one(i, j, value):
    def change(matrix):
        matrix[i, j] = value

    return change


EFFECT = """  - name: {}
    where: [{}]
    shape: {{{}}}
    parameters: [{}]
    deviations: [{}]
"""


def added(name, where, shape, parameters, deviations="", *says):
    """A row of one more effect, without an information matrix."""
    effect = EFFECT.format(name, where, shape, parameters, deviations)
    title = f"{name} at {where or 'nothing'} of {shape or 'no shape'} with {parameters}"
    return whole(title, HEAD + BODIES + EFFECTS + effect + JOINTS, name, *says)


ALL = (
    *("compare {0} log.csv", "diagnose {0} log.csv", "add viscous_friction {0} log.csv"),
    *("explain {0} log.csv", "rollout {0} log.csv", "rollout robot.urdf log.csv --before {0}"),
    *("identify {0} log.csv", "identifiable {0} log.csv", "digest {0} log.csv --to new"),
    "excite {0}",
)
GOOD = [
    whole("all in order", SAVED, code=0),
    whole("no information", HEAD + BODIES + EFFECTS + JOINTS, code=0),
    whole("nothing but bodies", HEAD + BODIES, code=0),
    part("base that has changed", DIGEST, "a" * 64, "has changed", code=0),
    whole("information off by rounding", UNINFORMED + information(set_one(3, 4, 1e-12)), code=0),
    whole("empty information of parameters", UNINFORMED + information(set_both(0, 0, 0.0)), code=0),
    whole("byte order mark", SAVED.encode("utf-8-sig"), code=0),
    whole("comments and quotes", "# by hand\n" + SAVED.replace("geodrake model 1",
        "'geodrake model 1'"), code=0),
]  # fmt: skip
IN_EFFECTS = [
    added("coulomb_friction", "shoulder", "", "0.1", "", "twice"),
    added("payload", "lower_link", "", "0.2, 0, 0, 0, 1, 1, 1, 0, 0, 0", "", "twice"),
    added("stribeck_friction", "elbow", "stribeck_velocity: -1.0", "0.1"),
    added("stribeck_friction", "elbow", "stribeck_velocity: .nan", "0.1"),
    added("torque_ripple", "elbow", "order: 1.0e300", "0.1, 0.1"),
    added("hysteresis", "elbow", "breakaway_angle: 0.0", "0.1"),
    added("nonlinear_viscous_friction", "elbow", "exponent: -2.0", "0.1"),
    added("friction_drift", "elbow", "time_constant: 0.0", "0.1, 0.1"),
    added("effort_scale", "elbow", "", ".nan"),
    added("gravity_tilt", "", "", ".nan, 0.0"),
    added("rotor_inertia", "elbow", "", "-0.1"),
    added("joint_elasticity", "elbow", "", "-0.1"),
    added("backlash", "elbow", "half_width: -0.1", "0.1"),
    added("aerodynamic_drag", "lower_link", "", "-1.0, 0, 0, 0"),
    added("contact", "lower_link", "start: 2.0, end: 1.0", "1, 0, 0, 0, 0, 0"),
    added("contact", "lower_link", "start: 1.0, end: 2.0, rise: 0.0", "1, 0, 0, 0, 0, 0"),
    added("contact", "lower_link", "start: 1.0, end: 2.0, x: .nan", "1, 0, 0, 0, 0, 0"),
    added("contact", "lower_link", "start: 1.0, end: 2.0, log: 1.5", "1, 0, 0, 0, 0, 0"),
]  # fmt: skip
IN_THE_REST = [
    told("an entry nan", set_both(1, 2, np.nan)),
    told("an entry of 1e300", set_both(1, 2, 1e300)),
    told("a small negative diagonal", set_both(3, 3, -1e-3)),
    told("not symmetric", set_one(3, 4, 0.5), "symmetric"),
    told("not positive", set_both(3, 4, 100.0), "semidefinite"),
    told("a zero with something beside it", lambda m: (set_both(3, 3, 0.0)(m),
        set_both(3, 4, 0.5)(m))),
    whole("a row too few", UNINFORMED + information().rsplit("  - ", 1)[0], "information"),
    whole("a number too few", UNINFORMED + information().replace("- [1.0, 0.0,", "- [1.0,", 1),
        "information"),
    whole("information as a list of numbers",
        HEAD + BODIES + EFFECTS + JOINTS + "information: [1, 2]\n", "information"),
    whole("information of nothing", HEAD + BODIES + EFFECTS + JOINTS + "information: [[]]\n",
        "information"),
    Row("base that is no robot", "compare saved.yaml log.csv", ("log.csv is not a robot",),
        put("saved.yaml", SAVED.replace("robot.urdf", "log.csv"))),
    whole("base that is a pipe", lambda f: (os.mkfifo(f / "p.urdf"),
        put("saved.yaml", SAVED.replace("robot.urdf", "p.urdf"))(f)), "is a pipe"),
    whole("base that is another saved model", lambda f: (put("other.yaml", SAVED)(f),
        put("saved.yaml", SAVED.replace("robot.urdf", "other.yaml"))(f)), "saved model itself"),
    whole("base that is a link to itself", lambda f: ((f / "l.yaml").symlink_to("saved.yaml"),
        put("saved.yaml", SAVED.replace("robot.urdf", "l.yaml"))(f)), "saved model itself"),
    whole("base of other directives that add the saved model",
        lambda f: (put("d.dmd.yaml", "directives:\n- add_model: {name: a, file: saved.yaml}\n")(f),
        put("saved.yaml", SAVED.replace("robot.urdf", "d.dmd.yaml"))(f))),
    part("digest cut short", DIGEST, DIGEST[1:], "base_sha256"),
    part("digest of other letters", DIGEST, f"{DIGEST.upper()}x", "base_sha256"),
    part("no digest", f"base_sha256: {DIGEST}\n", "", "base_sha256"),
    whole("another robot's", SAVED.replace("upper_link", "thigh").replace("lower_link",
        "shank"), "thigh"),
    whole("a bomb of anchors",
        "format: geodrake model 1\n_a: &a [x, x]\n" + "".join(
            f"_{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise("abcdefghijk")
        ) + "information: *k\n", "unfold"),
    whole("rows of one alias",
        HEAD + f"_a: &a [{', '.join(['1'] * 2000)}]\ninformation: [{', '.join(['*a'] * 2000)}]\n",
        "unfold"),
    whole("merges that double",
        HEAD + "_a: &a {x: 1}\n" + "".join(
            f"_{b}: &{b} {{<<: [{', '.join([f'*{a}'] * 9)}]}}\n" for a, b in pairwise("abcdefghijk")
        ), "unfold"),
    whole("cut off soon", SAVED[: len(SAVED) // 50]),
    whole("cut off later", SAVED[: len(SAVED) * 6 // 10]),
    whole("a list", "# format: \nformat: geodrake model 1\n- a\n"),
    whole("only the format", "format: geodrake model 1\n"),
    whole("lists 1,000 deep", HEAD + "fitted_to: " + "[" * 1000 + "]" * 1000),
    whole("mappings 1,500 deep", HEAD + "fitted_to: " + "{a: " * 1500 + "}" * 1500),
    whole("null characters", SAVED.replace("abc", "a\0c"), "null"),
    whole("bytes that are no UTF-8", SAVED.encode().replace(b"abc", b"a\xff\xfe")),
    whole("UTF-16", SAVED.encode("utf-16")),
    whole("150 MB", lambda f: (put("saved.yaml", HEAD)(f),
        os.truncate(f / "saved.yaml", 150_000_000)), "MB are read"),
    *[part(f"mass of nan, by {command.partition(' ')[0]}{' before' * ('before' in command)}",
        "upper_link: [0.5235", "upper_link: [.nan", "upper_link", command=command)
        for command in ALL],
]  # fmt: skip


CHANGED = [
    part(kind, old, new, *says, code=code)
    for _, code, kind, old, new, says in changed_rows("saved_models.yaml")
]


@pytest.mark.parametrize("row", [*IN_EFFECTS, *IN_THE_REST, *CHANGED], ids=str)
def test_what_is_refused(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("row", GOOD, ids=str)
def test_what_is_read(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
