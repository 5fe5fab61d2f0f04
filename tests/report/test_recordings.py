"""Pictures, videos and recordings of robots, read back by other libraries."""

import json
import re
import sys
from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from unittest.mock import Mock

import numpy as np
import pytest
from commands import refused, told
from pendulum_logs import PENDULUM
from PIL import Image
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from report_results import JOINT, LOG, URDF, comparison

from geodrake import load_model
from geodrake.report import page_of, recordings, render, videos
from geodrake.report.pictures import error_pictures, triangles
from geodrake.report.playback import play_back
from geodrake.report.robot_scene import drawn_shapes, link_joints


def recorded(short, to):
    return recordings.recording(to, short, title="demo")


def flange_places(short):
    """Return positions (F, 3) of the flange by the plant."""
    model = short.models[0].model
    plant, context = model.plant, model.plant.CreateDefaultContext()
    body, places = plant.GetBodyByName("flange"), []
    for q in model.plant_positions(model.positions(short.q)):
        plant.SetPositions(context, q)
        places.append(plant.EvalBodyPoseInWorld(context, body).translation())
    return np.array(places)


class TestSticks:
    """Test links without shapes, which are sticks from joint to joint."""

    @pytest.fixture
    def model(self, tmp_path):
        bare = re.sub(r"<(visual|collision)>.*?</\1>", "", URDF.read_text(), flags=re.S)
        (tmp_path / "bare.urdf").write_text(bare)
        return load_model(tmp_path / "bare.urdf")

    def test_they_join_the_joints_of_a_link(self, model):
        shapes = drawn_shapes(model)
        assert shapes.notes == ("the file has no shapes, so links are drawn as sticks",)
        assert not drawn_shapes(load_model(URDF)).notes
        plant = model.plant
        joint = plant.GetJointByName("elbow_pitch")
        end = joint.frame_on_parent().GetFixedPoseInBodyFrame().translation()
        own = shapes.links[joint.parent_body().scoped_name().get_full()]
        (stick,) = [s for s in own if isinstance(s.shape, Cylinder) and s.shape.radius() < 0.02]
        np.testing.assert_allclose(stick.X_BG.translation(), end / 2, atol=1e-12)
        assert stick.shape.length() == pytest.approx(np.linalg.norm(end))
        axis = stick.X_BG.rotation().matrix()[:, 2]
        np.testing.assert_allclose(np.cross(axis, end), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Box(0.1, 0.2, 0.3), 0.006),
        (Sphere(0.1), 4 / 3 * np.pi * 1e-3),
        (Ellipsoid(0.1, 0.2, 0.3), 4 / 3 * np.pi * 6e-3),
        (Cylinder(0.1, 0.5), np.pi * 5e-3),
        (Capsule(0.1, 0.5), np.pi * 5e-3 + 4 / 3 * np.pi * 1e-3),
    ],
)
def test_triangles_enclose_the_volume_of_their_shape(shape, volume):
    points, faces = triangles(shape)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    enclosed = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0  # positive where seen from outside
    assert enclosed == pytest.approx(volume, rel=0.05)


def test_rerun_reads_its_recording(short, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    path = tmp_path / "r.rrd"
    path.write_bytes(recorded(short, "rerun"))
    rows = {}
    for one in chunk.RrdReader(path).stream():
        batch = one.to_record_batch()
        for name in batch.schema.names:
            rows.setdefault((one.entity_path, name), batch.column(name).to_pylist())
    names = {entity for entity, _ in rows}
    (flange,) = [n for n in names if n.startswith("/robots/after/") and n.endswith("flange")]
    base = flange_places(short)
    other = np.array(rows[flange.replace("after", "before"), "Transform3D:translation"])[:, 0]
    np.testing.assert_allclose(other, base, atol=1e-6)
    colors = rows[flange, "Mesh3D:albedo_factor"]
    assert len(colors) == len(short.q)
    residual = np.array(rows[f"/efforts/{JOINT}/residual/after", "Scalars:scalars"])[:, 0]
    j, played = short.joints.index(JOINT), short.models[1]
    np.testing.assert_allclose(residual, (played.measured - played.predicted)[:, j])
    position = np.array(rows[f"/positions/{JOINT}", "Scalars:scalars"])[:, 0]
    np.testing.assert_allclose(position, short.q[:, j])
    ((words,),) = rows["/findings/after", "TextDocument:text"]
    assert "payload 2.50 kg (flange)" in words and "Coulomb friction 8.00 N·m" in words
    worst = [moment for played in short.models for moment in played.moments]
    assert len(rows["/worst_moments", "TextLog:text"]) == len(worst)


def test_mcap_is_read_by_its_libraries(short):
    reader, decoder = (
        pytest.importorskip("mcap.reader"),
        pytest.importorskip("mcap_protobuf.decoder"),
    )
    data = recorded(short, "mcap")
    read = reader.make_reader(BytesIO(data), decoder_factories=[decoder.DecoderFactory()])
    found = {}
    for schema, channel, message in read.iter_messages():
        found.setdefault(channel.topic, []).append((schema, channel, message))
    decoded = {
        topic: [m.decoded_message for m in read.iter_decoded_messages(topics=[topic])]
        for topic in ("/tf", "/robot", "/errors", "/findings")
    }
    names = {topic: messages[0][0].name for topic, messages in found.items()}
    assert names["/tf"] == "foxglove.FrameTransforms" and names["/robot"] == "foxglove.SceneUpdate"
    places = [
        [t.translation.x, t.translation.y, t.translation.z]
        for message in decoded["/tf"]
        for t in message.transforms
        if t.child_frame_id.startswith("before/") and t.child_frame_id.endswith("flange")
    ]
    np.testing.assert_allclose(places, flange_places(short), atol=1e-9)
    (scene,) = decoded["/robot"]
    assert all(len(e.triangles[0].indices) % 3 == 0 for e in scene.entities)
    assert any("payload" in text.text for e in scene.entities for text in e.texts)
    assert len(decoded["/errors"]) == len(short.q)
    words = [message.message for message in decoded["/findings"]]
    assert any(w.startswith("after: payload 2.50 kg") for w in words)
    assert any(": error " in w for w in words)
    schema, channel, message = found["/joints/after"][0]
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    row = json.loads(message.data)[JOINT]
    played, j = short.models[1], short.joints.index(JOINT)
    assert row["residual"] == pytest.approx((played.measured - played.predicted)[0, j])
    stamps = [m.log_time for _, _, m in found["/joints/after"]]
    times = short.times
    np.testing.assert_allclose(np.array(stamps) * 1e-9, times - times[0], atol=1e-8)


def test_videos_show_the_robot_in_motion(after, cut):
    moving = play_back(after, [cut], seconds=0.7)
    image = Image.open(BytesIO(videos.video(moving, ".gif")))
    assert image.n_frames == round(len(moving.q) / 3)
    image.seek(0)
    first = np.asarray(image.convert("RGB"), int)
    image.seek(image.n_frames - 1)
    last = np.asarray(image.convert("RGB"), int)
    assert (np.abs(first - last).sum(-1) > 60)[:500].mean() > 0.005
    encoder = pytest.importorskip("imageio_ffmpeg")
    data = videos.video(moving, ".mp4", speed=4.0)
    assert data[4:8] == b"ftyp" and encoder.get_ffmpeg_exe()


@pytest.mark.parametrize(
    ("module", "options"),
    [
        ("imageio_ffmpeg", ("--video", "p.mp4")),
        ("rerun", ("--to", "rerun", "p.rrd")),
        ("foxglove", ("--to", "mcap", "p.mcap")),
    ],
)
def test_a_missing_package_is_named_before_the_work(monkeypatch, module, options):
    monkeypatch.setitem(sys.modules, module, None)
    assert 'pip install "geodrake[viewers]"' in refused("play", URDF, LOG, *options)


@pytest.mark.parametrize("program", [RuntimeError("No ffmpeg exe could be found."), "/bin/false"])
def test_no_ffmpeg_that_runs_is_one_line(monkeypatch, program):
    pytest.importorskip("imageio_ffmpeg")
    found = Mock(side_effect=[program] * 9)
    monkeypatch.setattr("imageio_ffmpeg._utils.get_ffmpeg_exe", found)
    said = refused("play", URDF, LOG, "--video", "p.mp4")
    assert "No working ffmpeg" in said and "FILE.gif" in said


def test_the_command_writes_recordings_without_a_page(tmp_path, monkeypatch):
    pytest.importorskip("foxglove")
    monkeypatch.chdir(tmp_path)
    said = told("play", URDF, LOG, "--seconds", 1, "--to", "mcap", "p.mcap")
    assert "Saved the recording: p.mcap" in said
    assert [path.name for path in tmp_path.iterdir()] == ["p.mcap"]


def pixels(data):
    return np.asarray(Image.open(BytesIO(data)).convert("RGBA"), int)


def test_pages_show_the_robot_before_and_after():
    model = load_model(URDF)
    first, last = (comparison(model.joints, share) for share in (1.0, 0.1))
    pictures = error_pictures(model, {"as it stands": first, "now": last})
    html = render(replace(page_of(first), pictures=pictures))
    shown = re.findall(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]+)">', html)
    titles = [words.partition(" nrms")[0] for _, words in shown]
    assert titles == ["The robot, as it stands,", "The robot, now,"]
    before, after = (pixels(b64decode(data)) for data, _ in shown)
    assert before.shape == after.shape and before[..., 3].any((0, 1))
    red = [(p[..., 0] > 1.5 * p[..., 2])[p[..., 3] > 200].mean() for p in (before, after)]
    assert red[0] > 0.5 and red[1] < 0.1


def test_a_robot_without_joint_positions_has_no_picture(tmp_path):
    body = '<body name="b"><joint name="j" type="ball"/><geom size="0.1"/></body>'
    (tmp_path / "ball.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    model = load_model(tmp_path / "ball.xml")
    assert error_pictures(model, {"": comparison(model.joints, 1.0)}) is None


def test_the_root_of_a_free_base_has_the_colour_of_its_joints():
    model = load_model(PENDULUM, floating=True)
    (data,) = error_pictures(model, {"": comparison(model.joints, 1.0)}).shown.values()
    assert pixels(data)[..., 3].any()
    root = link_joints(model)
    assert {model.joints[j].rpartition("_")[2] for j in root.values()} >= {"roll"}
