"""Pictures of robots: what is nearest is seen, in the colour of its error, and pages hold them."""

import re
from base64 import b64decode
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from pendulum_logs import PENDULUM
from PIL import Image
from pydrake.geometry import Box, Rgba
from pydrake.math import RigidTransform
from report_results import URDF, comparison

from geodrake import load_model
from geodrake.report import page_of, render
from geodrake.report.pictures import Camera, DrawnRobots, error_pictures
from geodrake.report.robot_scene import PosedLink, link_joints
from geodrake.robot.shapes import LinkShape


def boxes(*places):
    """A robot of red, green and blue boxes of 0.2 m, each moved by a joint."""
    colors = np.zeros((1, len(places), 4), np.uint8)
    colors[0, :, :3] = 255 * np.eye(3)[: len(places)]
    shape = LinkShape(Box(0.2, 0.2, 0.2), RigidTransform(), Rgba(1, 1, 1, 1))
    links = [
        PosedLink(f"link_{j}", (shape,), j, (RigidTransform(place),))
        for j, place in enumerate(places)
    ]
    return links, colors


def test_the_nearest_link_is_seen_whatever_the_order():
    camera = Camera(np.array([2.0, 0.0, 0.0]), np.zeros(3), 80, 60)
    for places in (([0, 0, 0], [0.5, 0, 0]), ([0.5, 0, 0], [0, 0, 0])):
        picture = DrawnRobots([boxes(*places)], camera).picture(0)
        assert picture.shape == (60, 80, 4)
        assert picture[30, 40, :3].argmax() == places.index([0.5, 0, 0])
        assert picture[30, 40, 3] == 255 and not picture[0, 0].any()


def test_what_is_where_the_camera_says():
    """A box 1 m above the middle, seen from 4 m: 75 degrees of view fill the height."""
    camera = Camera(np.array([4.0, 0.0, 0.0]), np.zeros(3), 80, 60)
    cover = DrawnRobots([boxes([0, 0, 1])], camera).picture(0)[..., 3]
    rows, columns = np.nonzero(cover)
    above = 30 - 30 / np.tan(np.radians(37.5)) / 4.0
    assert rows.mean() == pytest.approx(above, abs=1.0)
    assert columns.mean() == pytest.approx(39.5, abs=0.5)


def test_what_is_behind_the_camera_is_not_seen():
    camera = Camera(np.array([2.0, 0.0, 0.0]), np.zeros(3), 80, 60)
    assert not DrawnRobots([boxes([3.0, 0, 0])], camera).picture(0).any()


def test_pages_show_the_robot_before_and_after():
    model = load_model(URDF)
    first, last = (comparison(model.joints, share) for share in (1.0, 0.1))
    pictures = error_pictures(model, {"as it stands": first, "now": last})
    html = render(replace(page_of(first), pictures=pictures))
    shown = re.findall(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]+)">', html)
    assert [words.partition(" nrms")[0] for _, words in shown] == [
        "The robot, as it stands,",
        "The robot, now,",
    ]
    before, after = (
        np.asarray(Image.open(BytesIO(b64decode(data))).convert("RGBA"), int) for data, _ in shown
    )
    assert before.shape == after.shape and before[..., 3].any((0, 1))
    red = [(p[..., 0] > 1.5 * p[..., 2])[p[..., 3] > 200].mean() for p in (before, after)]
    assert red[0] > 0.5 and red[1] < 0.1


def test_a_robot_in_no_posture_of_a_log_has_no_picture(tmp_path):
    body = '<body name="b"><joint name="j" type="ball"/><geom size="0.1"/></body>'
    (tmp_path / "ball.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    model = load_model(tmp_path / "ball.xml")
    assert error_pictures(model, {"": comparison(model.joints, 1.0)}) is None


def test_a_free_base_is_drawn_with_its_root_in_the_colour_of_its_joints():
    model = load_model(PENDULUM, floating=True)
    found = comparison(model.joints, 1.0)
    pictures = error_pictures(model, {"": found})
    image = np.asarray(Image.open(BytesIO(pictures.shown[0].png)).convert("RGBA"), int)
    assert image[..., 3].any()
    root = link_joints(model)
    assert {model.joints[j].rpartition("_")[2] for j in root.values()} >= {"roll"}
