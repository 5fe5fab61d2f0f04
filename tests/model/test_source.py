"""Efforts as source code that runs without geodrake, against other engines."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from every_effect import EFFECTS, LEFT_OUT

from geodrake import effects, load_model
from geodrake.effects import FittedEffect, load_effect_file
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.model.source import cpp_source, effort_source, is_written, python_source

DEMO = files("geodrake") / "demo" / "demo.urdf"
MODELS = Path(__file__).parents[2] / "models"
PENDULUM = """<robot name="r">
  <link name="base"/>
  <link name="arm"><inertial><mass value="2"/><origin xyz="0.1 0 0.2"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/></joint>
</robot>"""
CLOSE = {"rtol": 1e-10, "atol": 1e-11}


def fitted(pairs):
    return tuple(FittedEffect(effect, np.array(values, float)) for effect, values in pairs)


def with_effects(pairs, path=DEMO):
    return replace(load_model(path), effects=fitted(pairs))


def motion_of(model, count=4, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(count, model.plant.num_positions()))
    return Motion(q, *rng.normal(size=(2, count, len(model.joints))))


def ran(source, motion):
    """Return efforts (N, nv) of Python source, run in this process."""
    names = {}
    exec(compile(source, "effort.py", "exec"), names)
    samples = zip(motion.q, motion.v, motion.vd, strict=True)  # whose numbers are NumPy's
    return np.array([names["effort"](*sample) for sample in samples])


def compiled_efforts(source, motion, folder):
    """Return efforts (N, nv) of a C++ header, compiled with all warnings as errors."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    name = source.split("namespace ")[1].split(" ")[0]
    (folder / "effort.hpp").write_text(source, encoding="utf-8")
    main = f"""#include "effort.hpp"
#include <cstdio>
int main() {{
  std::array<double, {name}::kPositions> q;
  std::array<double, {name}::kJoints> v, vd;
  for (;;) {{
    for (double& x : q) if (std::scanf("%lf", &x) != 1) return 0;
    for (double& x : v) if (std::scanf("%lf", &x) != 1) return 1;
    for (double& x : vd) if (std::scanf("%lf", &x) != 1) return 1;
    for (double x : {name}::effort(q, v, vd)) std::printf("%.17g ", x);
    std::printf("\\n");
  }}
}}
"""
    (folder / "main.cpp").write_text(main)
    options = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "main.cpp", "-o", "main"]
    built = subprocess.run(
        [compiler, *options], cwd=folder, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    rows = np.hstack([motion.q, motion.v, motion.vd])
    given = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    done = subprocess.run(
        [folder / "main"], input=given, capture_output=True, text=True, check=True
    )
    return np.array([line.split() for line in done.stdout.splitlines()], float)


class TestAllEffects:
    @pytest.fixture(scope="class")
    @classmethod
    def model(cls):
        return with_effects([*EFFECTS, LEFT_OUT[0], LEFT_OUT[3]])

    def test_python_needs_nothing(self, model, tmp_path):
        motion = motion_of(model)
        source = effort_source(model, "python")
        assert source.file_name == "demo_effort.py"
        (tmp_path / source.file_name).write_text(source.text, encoding="utf-8")
        code = (
            "import json, sys; sys.path.insert(0, sys.argv[1]); before = set(sys.modules)\n"
            "from demo_effort import JOINTS, effort\n"
            "added = sorted(set(sys.modules) - before)\n"
            "print(json.dumps([added, JOINTS, [effort(*x) for x in json.load(sys.stdin)]]))"
        )
        samples = [x.tolist() for x in (motion.q, motion.v, motion.vd)]
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-c", code, str(tmp_path)],
            input=json.dumps(list(zip(*samples, strict=True))),
            capture_output=True,
            text=True,
            check=True,
        )
        added, joints, efforts = json.loads(done.stdout)
        assert set(added) <= {"demo_effort", "math"}
        assert tuple(joints) == model.joints
        np.testing.assert_allclose(efforts, model.effort(motion), **CLOSE)

    def test_cpp_compiles(self, model, tmp_path):
        motion = motion_of(model)
        source = effort_source(model, "cpp")
        assert source.file_name == "demo_effort.hpp"
        efforts = compiled_efforts(source.text, motion, tmp_path)
        np.testing.assert_allclose(efforts, model.effort(motion), **CLOSE)


@pytest.mark.parametrize("name", ["ambidex_like.urdf", "cheetah.dmd.yaml"])
def test_rigid_bodies_of_any_tree(name):
    model = load_model(MODELS / name, floating=name.startswith("cheetah"))
    motion = motion_of(model)
    np.testing.assert_allclose(ran(python_source(model), motion), model.effort(motion), **CLOSE)


def test_what_is_left_out_is_named():
    source = effort_source(with_effects([*LEFT_OUT, EFFECTS[8]]), "python")
    words = " ".join(line.removeprefix("# ") for line in source.text.splitlines())
    assert not any(is_written(effect) for effect, _ in (*LEFT_OUT, EFFECTS[8]))
    for what in (
        "effort_delay of the robot (delay 0.01): logged efforts are delayed",
        "joint_elasticity of base_yaw (compliance 0.0001): it depends on the history of the motion",
        "backlash of elbow_pitch",
        "contact of flange",
        "the history of hysteresis of wrist_roll",
    ):
        assert f"Not included: {what}" in words
        assert any(line.startswith(what) for line in source.left_out)
    assert python_source(load_model(DEMO)).startswith('# Effort that "demo.urdf" needs')


OWN = """
from dataclasses import dataclass
import numpy as np
from geodrake.effects import BodyEffect, JointEffect, Parameter


@dataclass(frozen=True)
class Stop(JointEffect):
    name = "stop"
    parameters = (Parameter("stiffness", "N·m/rad"), Parameter("step", "N·m"), Parameter("x", "1"))

    def columns(self, joint):
        beyond = np.clip(joint.q, 0.2, None) - 0.2
        step = np.where((joint.q > 0.0) & (joint.v < 0.5), np.sign(joint.v), 0.1 * joint.q**2)
        return [beyond, step, np.sinc(joint.q) + np.arctan2(joint.v, 2.0) % 0.7 + (joint.q > 1)]


@dataclass(frozen=True)
class Rope(BodyEffect):
    name = "rope"
    parameters = (Parameter("pull", "N"),)

    def rows(self, motion):
        body = motion.body_motions(self.name).motion(self.body)
        J = body.jacobian_at([0.0, 0.1, 0.2])
        away = body.position - np.array([1.0, 0.0, 2.0])
        along = away / np.linalg.norm(away, axis=1)[:, None]
        efforts = (J * along[:, :, None]).sum(1)
        return {joint: efforts[:, i, None] for i, joint in enumerate(motion.joints)}


@dataclass(frozen=True)
class Decided(JointEffect):
    name = "decided"
    parameters = (Parameter("x", "N·m"),)

    def columns(self, joint):
        return [joint.q if joint.q[0] > 0 else joint.v]


@dataclass(frozen=True)
class Sampled(JointEffect):
    name = "sampled"
    parameters = (Parameter("x", "N·m"),)

    def columns(self, joint):
        return [np.interp(joint.q, [-1.0, 1.0], [0.0, 1.0])]
"""


class TestOwnEffects:
    @pytest.fixture(scope="class")
    @classmethod
    def own(cls, tmp_path_factory):
        path = tmp_path_factory.mktemp("own") / "own.py"
        path.write_text(OWN, encoding="utf-8")
        return {effect.name: effect for effect in load_effect_file(path)}

    def test_formulas_are_recorded(self, own, tmp_path):
        pairs = [(own["stop"]("elbow_pitch"), [1.0, 2.0, 3.0]), (own["rope"]("wrist"), [5.0])]
        model = with_effects(pairs)
        motion = motion_of(model, 12)
        expected = model.effort(motion)
        np.testing.assert_allclose(ran(python_source(model), motion), expected, **CLOSE)
        efforts = compiled_efforts(cpp_source(model), motion, tmp_path)
        np.testing.assert_allclose(efforts, expected, **CLOSE)

    @pytest.mark.parametrize("name", ["decided", "sampled"])
    def test_what_is_no_formula_is_refused(self, own, name):
        model = with_effects([(own[name]("elbow_pitch"), [1.0])])
        message = rf"{name} of elbow_pitch works with numbers only \(line \d+ of .*own.py\)"
        with pytest.raises(ModelError, match=message) as caught:
            python_source(model)
        assert "NumPy" in caught.value.advice


@pytest.mark.parametrize(
    "joint",
    ['x""" + __import__("os").abort() + """', "x\\", "upper\nlower\x9b31mred\x85", '*/ "; #error '],
)
def test_joints_of_any_name(joint, tmp_path):
    path = tmp_path / "1 class.urdf"
    name = quoteattr(joint, {"\n": "&#10;"})
    path.write_text(PENDULUM.replace('"elbow"', name), encoding="utf-8")
    own = load_model(path).joints
    pairs = [(effects.CoulombFriction(joint), [1.0]), (effects.EffortDelay(0.1, joint), [])]
    model = with_effects(pairs, path)
    motion = motion_of(model)
    expected = model.effort(motion)
    names = {}
    exec(python_source(model), names)
    assert names["JOINTS"] == own == (joint,)
    np.testing.assert_allclose(ran(python_source(model), motion), expected, **CLOSE)
    if joint.endswith("error "):
        efforts = compiled_efforts(cpp_source(model), motion, tmp_path)
        np.testing.assert_allclose(efforts, expected, **CLOSE)
