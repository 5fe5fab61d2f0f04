"""What commands say of inertias that are not the file's, and where users' own prints go."""

import json
import sys

import pytest
from commands import run
from processes import ended, start

URDF = """<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/>{mass}
    <inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1.2"/>
    <inertia ixx="0.012" iyy="0.012" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="60" velocity="4"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="4"/></joint>
</robot>
"""
PRINTS = """
import atexit, ctypes, os, sys, threading, time
from dataclasses import dataclass
from geodrake.effects import JointEffect, Parameter
print("printed")
os.write(1, b"written\\n")
ctypes.CDLL(None).printf(b"in C\\n")
atexit.register(lambda: sys.__stdout__.write("at the end\\n"))
atexit.register(os.system, "echo by a child at the end")
def loop():
    while True:
        os.write(1, b"in a thread\\n")
        time.sleep(0.001)
threading.Thread(target=loop, daemon=True).start()
@dataclass(frozen=True)
class Hose(JointEffect):
    name = "hose"
    parameters = (Parameter("a", "N·m"),)
    def columns(self, joint):
        return [joint.q]
"""


def model_of(folder, mass):
    path = folder / "two.urdf"
    path.write_text(URDF.format(mass=mass), encoding="utf-8")
    return path


def checked(path):
    """How `geodrake check` ends, and its numbers."""
    numbers = path.with_suffix(".json")
    done = run("check", path, "--samples", 2, "--json", numbers)
    return done, json.loads(numbers.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("mass", "problem"),
    [
        ('<mass value="nan"/>', "upper has a mass or inertia that is not a number"),
        ('<mass value="abc"/>', "upper has a mass or inertia that is not a number"),
        ('<mass value="-2"/>', "upper has a mass of -2 kg"),
        ("", "upper has a mass of 0 kg"),
    ],
)
def test_a_mass_that_was_replaced_is_no_agreement(tmp_path, mass, problem):
    done, numbers = checked(model_of(tmp_path, mass))
    assert done.exit_code == 1
    assert done.output.startswith(f"Warning: two.urdf was repaired. {problem}")
    assert "agree" not in done.output.rpartition("Verdict")[2]
    assert not numbers["agrees"] and numbers["repaired"]
    assert numbers["notes"][0].startswith(problem)


@pytest.mark.parametrize(
    ("form", "file"),
    [
        ("urdf", "two.urdf"),
        ("sdf", "two.sdf"),
        ("mjcf", "two.xml"),
        ("drake", "two.dmd.yaml"),
        ("isaac", "two.actuators.json"),
        ("python", "two_effort.py"),
        ("cpp", "two_effort.hpp"),
    ],
)
def test_what_is_exported_says_what_was_replaced(tmp_path, form, file):
    target = tmp_path / "out"
    done = run("export", model_of(tmp_path, '<mass value="nan"/>'), "--to", form, target, "-q")
    assert done.exit_code == 0
    assert done.output.startswith("Warning: two.urdf was repaired. upper has a mass")
    text = (target / file).read_text(encoding="utf-8")
    assert "geodrake repaired two.urdf: upper has a mass" in text


def test_a_repair_of_a_link_with_any_name_leaves_xml(tmp_path):
    path = model_of(tmp_path, '<mass value="nan"/>')
    text = path.read_text("utf-8").replace('"upper"', '"up--per--&gt;-"')
    path.write_text(text, encoding="utf-8")
    assert run("export", path, "--to", "urdf", tmp_path / "out", "-q").exit_code == 0
    assert checked(tmp_path / "out" / "two.urdf")[0].exit_code == 0


def test_many_repairs_are_counted(tmp_path):
    links = "".join(f'<link name="l{k}"/>' for k in range(9))
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="{"fore" if k == 0 else f"l{k - 1}"}"/>'
        f'<child link="l{k}"/></joint>'
        for k in range(9)
    )
    path = model_of(tmp_path, '<mass value="2"/>')
    text = path.read_text("utf-8").replace("</robot>", f"{links}{joints}</robot>")
    path.write_text(text, encoding="utf-8")
    done, _ = checked(path)
    assert done.output.count("Warning") == 6
    assert "4 more of its parts were replaced or left out" in done.output


def test_what_code_of_users_prints_is_no_result(tmp_path):
    own = tmp_path / "own.py"
    own.write_text(PRINTS, encoding="utf-8")
    model = model_of(tmp_path, '<mass value="2"/>')
    command = [sys.executable, "-m", "geodrake", "check", model, "--samples", "2", "--json", "-"]
    code, out, err = ended(start([*command, "--effects", own]))
    assert code == 0 and json.loads(out)["agrees"]
    told = {"printed", "written", "in C", "in a thread", "at the end", "by a child at the end"}
    assert told <= set(err.splitlines())


MJCF = """<mujoco model="m"><option density="{}"/><worldbody><body name="a">
<joint name="j" axis="0 1 0"/><geom type="capsule" size=".05 .2" pos=".1 0 0"/></body>
</worldbody></mujoco>"""


def test_what_is_left_out_fails_the_check_and_is_told_first(tmp_path):
    path = tmp_path / "m.xml"
    band = '<tendon><fixed name="p" stiffness="50" springlength=".1 .2"><joint joint="j" coef="1"/>'
    text = MJCF.format(0).replace("</mujoco>", f"{band}</fixed></tendon></mujoco>")
    path.write_text(text, encoding="utf-8")
    done, numbers = checked(path)
    assert done.exit_code == 1
    assert done.output.startswith("Warning: m.xml was repaired. ")
    assert "Tendon p with stiffness 50 is ignored." in done.output
    verdict = " ".join(done.output.rpartition("Verdict")[2].split())
    assert "has forces or parts that geodrake does not model" in verdict and "MuJoCo" in verdict
    assert not numbers["agrees"] and not numbers["repaired"]
    assert numbers["left_out"] == numbers["notes"][:1]
    assert numbers["second_opinion"]["by"].startswith("MuJoCo")
    assert numbers["second_opinion"]["relative"] > 0.01


@pytest.mark.parametrize(("name", "program"), [("m.xml", "MuJoCo"), ("two.urdf", "Pinocchio")])
def test_a_program_that_reads_the_file_itself_agrees(tmp_path, monkeypatch, name, program):
    model_of(tmp_path, '<mass value="2"/>')
    (tmp_path / "m.xml").write_text(MJCF.format(0), encoding="utf-8")
    done, _ = checked(tmp_path / name)
    assert done.exit_code == 0 and f"as does {program}" in " ".join(done.output.split())
    assert "Warning" not in done.output
    monkeypatch.setitem(sys.modules, program.lower(), None)
    done, numbers = checked(tmp_path / "two.urdf")
    by = numbers["second_opinion"]["by"]
    assert ("not installed" in by) == (program == "Pinocchio") and done.exit_code == 0
