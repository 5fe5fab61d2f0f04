"""Added mass of fluids in SDF against Lagrange's equations of independently written energies."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model, save_model
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.model.export import save_export
from geodrake.robot.files.checks import ADDED_MASS

LINK = """<link name="{name}"><pose>{pose}</pose><inertial><pose>{com}</pose><mass>{mass}</mass>
<inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz></inertia>{fluid}</inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>
<axis><xyz>{axis}</xyz></axis></joint>"""
AXES = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
PLACES = np.array([[0.1, 0.2, 0.3], [0.5, -0.1, 0.2], [0.2, 0.3, -0.4]])  # of links, in the world
TURN = 0.3  # of the welded link about x
COMS = np.array([[0.1, 0.0, 0.05], [0.0, 0.2, 0.1], [0.0, 0.0, 0.1]])
MASSES = (2.0, 1.5, 0.5)


def fluids(seed=0):
    """Return added masses (3, 6, 6) of three links, and their texts."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(3, 6, 6))
    matrices = roots @ np.moveaxis(roots, 1, 2)
    texts = []
    for A in matrices:
        entries = zip(ADDED_MASS, A[np.triu_indices(6)].tolist(), strict=True)
        inside = "".join(f"<{tag}>{value!r}</{tag}>" for tag, value in entries)
        texts.append(f"<fluid_added_mass>{inside}</fluid_added_mass>")
    return matrices, texts


def arm(folder, texts=("", "", ""), kind="revolute"):
    """Return an arm of two joints, the second link of which has a third one welded to it."""
    turns = (0.0, 0.0, TURN)
    links = "".join(
        LINK.format(
            name=f"l{k}",
            pose=f"{' '.join(map(str, PLACES[k]))} {turns[k]} 0 0",
            com=f"{' '.join(map(str, COMS[k]))} 0 0 0",
            mass=MASSES[k],
            fluid=texts[k],
        )
        for k in range(3)
    )
    axes = [" ".join(map(str, axis)) for axis in AXES]
    joints = JOINT.format(name="a", kind=kind, parent="world", child="l0", axis=axes[0])
    joints += JOINT.format(name="b", kind="revolute", parent="l0", child="l1", axis=axes[1])
    joints += '<joint name="w" type="fixed"><parent>l1</parent><child>l2</child></joint>'
    path = folder / "r.sdf"
    path.write_text(f'<sdf version="1.10"><model name="r">{links}{joints}</model></sdf>')
    return load_model(path)


def skew(x):
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def turned(axis, angle):
    """Return the rotation about a unit axis, also for complex angles."""
    K = skew(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def mass_matrix(q, matrices, slides):
    """Return the mass matrix (2, 2) of the fluids, and the heights of the mass centres."""
    M, heights = 0.0, []
    first = np.eye(3) if slides else turned(AXES[0], q[0])
    base = PLACES[0] + (q[0] * AXES[0] if slides else 0.0)
    second = first @ turned(AXES[1], q[1])
    pivot = base + first @ (PLACES[1] - PLACES[0])
    for k, A in enumerate(matrices):
        R = first if k == 0 else second
        origin = (base, pivot, pivot + second @ (PLACES[2] - PLACES[1]))[k]
        R = R @ turned(np.array([1.0, 0, 0]), TURN) if k == 2 else R
        one = (AXES[0], 0.0 * AXES[0]) if slides else (skew(AXES[0]) @ (origin - base), AXES[0])
        axis = first @ AXES[1]
        two = (skew(axis) @ (origin - pivot), axis) if k else (0.0 * axis, 0.0 * axis)
        J = np.array([np.concatenate([R.T @ x for x in joint]) for joint in (one, two)]).T
        M = M + J.T @ A @ J
        heights.append((origin + R @ COMS[k])[2])
    return M, np.array(heights)


def lagrange(q, v, vd, matrices, slides=False):
    """Return d/dt ∂T/∂v − ∂T/∂q, with derivatives of the mass matrix by complex steps."""
    step = 1e-30
    slopes = np.array(
        [mass_matrix(q + 1j * step * unit, matrices, slides)[0].imag / step for unit in np.eye(2)]
    )
    M = mass_matrix(q, matrices, slides)[0]
    return M @ vd + np.tensordot(v, slopes, 1) @ v - 0.5 * (slopes @ v) @ v


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_efforts_are_those_of_lagrange(tmp_path, kind):
    matrices, texts = fluids()
    model, dry = arm(tmp_path, texts, kind), arm(tmp_path, kind=kind)
    assert [f.effect.name for f in model.effects] == ["added_mass", "added_mass"]
    assert not model.left_out and any("added mass in the file" in note for note in model.notes)
    samples = np.random.default_rng(1).uniform(-2, 2, (3, 20, 2))
    added = model.effort(Motion(*samples)) - dry.effort(Motion(*samples))
    expected = [
        lagrange(*each, matrices, kind == "prismatic") for each in zip(*samples, strict=True)
    ]
    np.testing.assert_allclose(added, expected, rtol=1e-10, atol=1e-10)


def test_a_simulation_conserves_the_energy_of_bodies_and_fluid(tmp_path):
    matrices, texts = fluids()
    model = arm(tmp_path, texts)
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder, time_step=0.0)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = robot.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    robot.plant.SetPositions(context, [0.4, -0.7])
    robot.plant.SetVelocities(context, [1.0, 2.0])

    def energy():
        q, v = robot.plant.GetPositions(context), robot.plant.GetVelocities(context)
        M, heights = mass_matrix(q, matrices, False)
        bodies = robot.plant.CalcKineticEnergy(context)
        return 0.5 * v @ M @ v + bodies + 9.81 * np.array(MASSES) @ heights

    start, before = energy(), robot.plant.CalcKineticEnergy(context)
    simulator.AdvanceTo(2.0)
    assert energy() == pytest.approx(start, abs=1e-6)
    assert abs(robot.plant.CalcKineticEnergy(context) - before) > 0.1


def test_saved_and_exported_models_keep_it(tmp_path):
    model = arm(tmp_path, fluids()[1])
    motion = Motion(*np.random.default_rng(1).uniform(-2, 2, (3, 5, 2)))
    save_model(model, tmp_path / "m.yaml")
    save_export(replace(model, phi=1.1 * model.phi), tmp_path / "e.sdf")
    saved, exported = (load_model(tmp_path / name) for name in ("m.yaml", "e.sdf"))
    np.testing.assert_allclose(saved.effort(motion), model.effort(motion), rtol=1e-14)
    for fitted, other in zip(model.effects, exported.effects, strict=True):
        assert fitted.effect == other.effect
    np.testing.assert_allclose(exported.total_phi, 1.1 * model.total_phi, rtol=1e-9)


def test_what_is_no_added_mass_is_refused_or_told(tmp_path):
    with pytest.raises(ModelError, match=r"<yr> has 'much' instead of a number"):
        arm(tmp_path, ["<fluid_added_mass><yr>much</yr></fluid_added_mass>", "", ""])
    (told,) = arm(
        tmp_path, ["<fluid_added_mass><yy>-3</yy></fluid_added_mass>"] + [""] * 2
    ).left_out
    assert "line 2: <fluid_added_mass> is ignored, as it has the negative eigenvalue -3." in told
    assert not arm(tmp_path, ["<fluid_added_mass><yy>0</yy></fluid_added_mass>"] + [""] * 2).effects
    first, other = (f"<fluid_added_mass><yy>{mass}</yy></fluid_added_mass>" for mass in (1, 2))
    twice, once = (arm(tmp_path, [text, "", ""]) for text in (f"{first}\n{other}", first))
    (told,) = twice.left_out
    assert "line 3: another <fluid_added_mass> of r::l0 is ignored." in told
    assert [f.effect for f in twice.effects] == [f.effect for f in once.effects]
    (told,) = arm(
        tmp_path, ["<fluid_added_mass><yy>1</yy><yx>1</yx></fluid_added_mass>"] + [""] * 2
    ).left_out
    assert "line 2: <yx> of <fluid_added_mass> ignored; its entries are xx, xy, … rr." in told
