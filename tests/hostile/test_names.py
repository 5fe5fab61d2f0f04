"""Odd names of logs, joints and links in every file that commands write."""

import shlex
from contextlib import chdir
from itertools import product
from xml.sax.saxutils import quoteattr

import pytest
import yaml
from hostile import PENDULUM, Row, put, read_json, table, write_log
from odd_names import IN_FILES, IN_XML

from geodrake import load_model
from geodrake.boundary.escaping import html_text
from geodrake.fleet import digest_files, read_digest


def rename(folder, *, shoulder, link):
    """Give a joint and a link of the model another name, and the joint of the log."""
    text = PENDULUM.read_text(encoding="utf-8")
    for old, new in {"shoulder": shoulder, "upper_link": link}.items():
        attribute = quoteattr(new, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})
        text = text.replace(f'"{old}"', attribute)
    columns = ["time", *(f"{j}.{q}" for q in ("position", "effort") for j in (shoulder, "elbow"))]
    header = ",".join(f'"{c.replace(chr(34), 2 * chr(34))}"' for c in columns)
    put(folder, {"robot.urdf": text, "log.csv": lambda path: write_log(path, table(), header)})


LOG_USES = {
    "compare robot.urdf {} --json new.json --series new.parquet": ("new.json", "new.parquet"),
    "digest robot.urdf {} --to new": None,
}


LOG_CASES = [
    (c, w) for c, w in product(LOG_USES, IN_FILES) if (c[:6], w) != ("digest", "not UTF-8")
]


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("command", "what"), LOG_CASES)
def test_logs(command, what, tmp_path):
    name = IN_FILES[what]
    command, writes = command.format(shlex.quote(f"./{name}.csv")), LOG_USES[command]
    files = {f"{name}.csv": lambda path: write_log(path, table())}
    Row(what, command, make=files, code=0, writes=writes).check(tmp_path)
    for path in digest_files(tmp_path / "new") if writes is None else ():
        assert read_digest(path).logs[0].name == name
    assert not (tmp_path / "PWNED").exists()


def test_a_log_whose_name_no_digest_can_hold_is_refused_and_others_are_digested(tmp_path):
    for name in ("a\udcffb", "good"):
        write_log(tmp_path / f"{name}.csv", table())
    (tmp_path / "robot.urdf").write_text(PENDULUM.read_text(encoding="utf-8"), encoding="utf-8")
    command = "digest robot.urdf './a\udcffb.csv' ./good.csv --to new"
    with chdir(tmp_path):
        code, out, err = Row("not UTF-8", command).run()
    assert code == 1
    assert "1 digested, 0 existed, 1 failed" in out + err
    assert r"'a\udcffb' is not UTF-8, which files of fleets require. Rename" in out + err
    (path,) = digest_files(tmp_path / "new")
    assert read_digest(path).logs[0].name == "good"


def check_saved(folder, names):
    assert tuple(read_json(folder / "new.json")["joints"]) == names
    assert load_model(folder / "new.yaml").joints == names
    assert names[0] in load_model(folder / "new.yaml").bodies


def check_page(folder, names):
    page = (folder / "new.html").read_text(encoding="utf-8")
    assert "<img src=x" not in page
    for name in names:
        assert html_text(name).replace("&quot;", "&#34;").replace("&#x27;", "&#39;") in page


def check_digest(folder, names):
    assert tuple(read_json(folder / "new.json")["logs"][0]["joints"]) == names
    (path,) = digest_files(folder / "new")
    assert read_digest(path).settings.joints == names


def check_export(folder, names):
    before, after = (load_model(folder / f"{name}.urdf") for name in ("robot", "new"))
    assert (after.bodies, after.joints) == (before.bodies, names)


def check_motion(folder, names):
    ros = yaml.safe_load((folder / "new.yaml").read_text(encoding="utf-8"))
    assert tuple(ros["joint_names"]) == names


EXCITE = "excite robot.urdf --limits velocity=2,acceleration=5,effort=50,position=-1:1"
USES = {
    "compare robot.urdf log.csv --json new.json --save new.yaml": check_saved,
    "compare robot.urdf log.csv --report new.html": check_page,
    "digest robot.urdf log.csv --to new --json new.json": check_digest,
    "identify robot.urdf log.csv --gamma 100 --export new.urdf": check_export,
    f"{EXCITE} --seeds 1 --iterations 2 --duration 4 --samples 30 --save new.yaml": check_motion,
}
"""What uses the names of joints and links -> what must become of them."""


@pytest.mark.sampled(14)
@pytest.mark.parametrize(("what", "command"), list(product(IN_XML, USES)))
def test_joints_and_links(what, command, tmp_path):
    name = IN_XML[what]

    def make(folder):
        rename(folder, shoulder=name, link=name)

    Row(what, command, make=make, code=0, writes=None).check(tmp_path)
    USES[command](tmp_path, (name, "elbow"))
    assert not (tmp_path / "PWNED").exists()


def test_a_model_beside_a_path_that_yaml_cannot_hold_is_not_saved(tmp_path):
    (folder := tmp_path / "a\udcffb").mkdir()
    command = "compare robot.urdf log.csv --save kept.yaml --json kept.json"
    Row("a folder that is not UTF-8", command, ("not UTF-8",)).check(folder)
