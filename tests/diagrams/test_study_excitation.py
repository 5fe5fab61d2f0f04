"""The studies of excitation show what they claim to show."""

import numpy as np
import pytest

from diagrams.studies import atlas_identification as atlas
from diagrams.studies import excitation_contours as contours
from diagrams.studies import scara_excitation as scara
from geodrake.excitation import ExcitationTrajectory, FreeSamples
from geodrake.logs import Motion


class TestContours:
    def test_one_map_in_all_coordinates_with_geometric_normalization_alone(self):
        rows = contours.run(31, 100)["rows"]
        largest = {}
        for row in rows:
            largest.setdefault(row["normalization"], []).append(row)
        own = largest["geometric"]
        assert max(row["shape_difference"] for row in own) < 1e-9  # decades
        assert len({(row["best_amplitude"], row["best_offset"]) for row in own}) == 1
        assert np.ptp([row["best_value"] for row in own]) < 1e-9 * own[0]["best_value"]
        for name in ("none", "diagonal"):
            assert min(row["shape_difference"] for row in largest[name]) > 0.5
            places = {(row["best_amplitude"], row["best_offset"]) for row in largest[name]}
            assert len(places) >= 3


class TestScara:
    def test_frames_are_of_one_robot(self):
        rng, efforts = np.random.default_rng(0), []
        motion = Motion(*rng.uniform(-2, 2, (3, 10, 2)))
        for frame in scara.FRAMES:
            model = scara.scara(frame, scara.payload(*scara.PRIOR))
            efforts.append(model.effort(motion))
        for other in efforts[1:]:
            np.testing.assert_allclose(other, efforts[0], rtol=1e-10, atol=1e-12)

    def test_expected_errors_are_those_of_drawn_noise(self):
        rng = np.random.default_rng(1)
        trajectory = ExcitationTrajectory(
            FreeSamples(50), rng.uniform(-2, 2, (150, 2)), ("shoulder", "elbow")
        )
        target, model = scara.payload_target("3"), scara.scara("3", scara.payload(*scara.TRUTH))
        A = target.measure(trajectory.motion(np.zeros(50))).regressor.reshape(100, -1)[
            :, [0, 1, 2, 6]
        ]
        truth = model.phi[1, [0, 1, 2, 6]]
        noise = scara.NOISE * rng.normal(size=(100, 4000))
        m, hx, hy, izz = truth[:, None] + np.linalg.lstsq(A, noise)[0]
        expected = scara.errors(trajectory)
        drawn = {
            "m": (m - 4.0).std(),
            "px": 1e3 * (hx / m).std(),
            "py": 1e3 * (hy / m).std(),
            "rz": 1e3 * (np.sqrt(izz / m) - 0.08165).std(),
        }
        for key, value in drawn.items():
            assert expected[key] == pytest.approx(value, rel=0.05)


class TestOneFoot:
    def test_motions_are_in_balance(self):
        """By Drake's centre of mass at rest, and by the foot that stays where it is."""
        stance, plan = atlas.standing_robot(None), atlas.Plan(None)
        motion = atlas.sampled(stance, atlas.one_motion(0, plan=plan), 30.0)
        plant, sole = stance.robot.plant, []
        context = plant.CreateDefaultContext()
        for q in stance.model.plant_positions(motion.q):
            plant.SetPositions(context, q)
            center = plant.CalcCenterOfMassPositionInWorld(context)
            assert (np.abs(center[:2]) < 1.2 * np.array([0.12, 0.06])).all()
            X = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("l_foot"))
            sole.append(X.GetAsMatrix4())
        assert np.ptp(sole, axis=0).max() < 1e-9
        assert np.abs(motion.v[[0, -1]]).max() < 1e-9
