"""Traces of a CAN bus against the numbers that were packed into their frames."""

import gzip
import struct

import can
import numpy as np
import pytest

from geodrake.errors import LogError
from geodrake.logs.files import Reading, read_log

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 513 Motor1: 7 A
 SG_ Position : 0|16@1- (0.0005,0) [0|0] "rad" A
 SG_ Velocity : 16|16@1- (0.001,0) [0|0] "rad/s" A
 SG_ Torque : 32|16@1- (0.01,0) [0|0] "Nm" A
 SG_ Mode : 48|8@1+ (1,0) [0|0] "" A
BO_ 2147484162 Motor2: 7 A
 SG_ Position : 0|16@1- (0.02,0) [0|0] "deg" A
 SG_ Velocity : 16|16@1- (0.05,0) [0|0] "deg/s" A
 SG_ Torque : 32|16@1- (0.01,0) [0|0] "Nm" A
 SG_ Mode : 48|8@1+ (1,0) [0|0] "" A
VAL_ 513 Mode 0 "Off" 1 "On" ;
"""
MUXED = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 513 Motor: 3 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Position m0 : 8|16@1- (0.001,0) [0|0] "rad" A
 SG_ Torque m1 : 8|16@1- (0.01,0) [0|0] "Nm" A
"""
START = 1700000000.0
NAMES = ("Motor1", "Motor2")
IDS = (0x201, 0x202)
COUNTS = np.random.default_rng(0).integers(-6000, 6000, (400, 2, 3))
SCALES = np.array([[0.0005, 0.001, 0.01], [np.deg2rad(0.02), np.deg2rad(0.05), 0.01]])


def frames(counts=COUNTS):
    """Yield time, id, whether it has 29 bits, and data of both motors at 200 Hz."""
    for k, row in enumerate(counts.tolist()):
        for motor, values in enumerate(row):
            yield START + 0.005 * k, IDS[motor], motor == 1, struct.pack("<hhhB", *values, 1)


def line(time, key, long, data, channel="can0"):
    return f"({time:.6f}) {channel} {key:0{8 if long else 3}X}#{data.hex().upper()}\n"


def write(folder, text, name="can.log", dbc=DBC):
    (folder / "arm.dbc").write_text(dbc)
    (folder / name).write_text(text)
    return folder / name, Reading(dbc=folder / "arm.dbc")


@pytest.fixture
def candump(tmp_path):
    return write(tmp_path, "".join(line(*frame) for frame in frames()))


def assert_packed(log, joints=("joint_1", "joint_2")):
    assert log.joints == joints
    for values, k in ((log.position, 0), (log.velocity, 1), (log.effort, 2)):
        np.testing.assert_allclose(values, COUNTS[:, :, k] * SCALES[:, k], atol=1e-12)
    np.testing.assert_allclose(log.time, 0.005 * np.arange(len(COUNTS)), atol=1e-5)


def test_frames_are_decoded_with_the_units_of_the_dbc(candump):
    path, reading = candump
    assert_packed(read_log(path, reading=reading))


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_degree_signs_of_a_dbc_are_read_in_either_encoding(candump, encoding):
    path, reading = candump
    reading.dbc.write_bytes(DBC.replace('"deg', '"°').encode(encoding))
    assert_packed(read_log(path, reading=reading))


def test_units_of_a_dbc_may_be_scaled_and_must_be_known(candump):
    path, reading = candump
    reading.dbc.write_text(DBC.replace('(0.02,0) [0|0] "deg"', '(0.2,0) [0|0] "0.1deg"'))
    assert_packed(read_log(path, reading=reading))
    reading.dbc.write_text(DBC.replace('"deg"', '"furlong"'))
    with pytest.raises(LogError, match="is in 'furlong', which is no known unit of position"):
        read_log(path, reading=reading)


def test_other_layouts_of_candump(candump):
    path, reading = candump
    rows = [
        f" ({time:.6f})  can0  {key:0{8 if long else 3}X}   [7]  {data.hex(' ').upper()}\n"
        for time, key, long, data in frames()
    ]
    path.write_text("".join(rows))
    assert_packed(read_log(path, reading=reading))
    packed = path.with_suffix(".log.gz")
    packed.write_bytes(gzip.compress("".join(line(*frame) for frame in frames()).encode()))
    assert_packed(read_log(packed, reading=reading))


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".csv"])
def test_traces_of_vector_pcan_and_python_can(candump, suffix):
    path, reading = candump
    path = path.with_suffix(suffix)
    with can.Logger(path) as trace:
        for time, key, long, data in frames():
            trace(can.Message(time, key, long, data=data, channel=1))
    log = read_log(path, reading=reading)
    np.testing.assert_allclose(log.position, COUNTS[:, :, 0] * SCALES[:, 0], atol=1e-12)
    np.testing.assert_allclose(np.diff(log.time), 0.005, atol=1.1e-3 if suffix == ".trc" else 1e-5)


def test_pages_of_a_multiplexed_frame(tmp_path):
    rows, values = [], COUNTS[:, 0]
    for k, (position, _, torque) in enumerate(values.tolist()):
        for page, value in enumerate((position, torque)):
            data = struct.pack("<Bh", page, value)
            rows.append(line(START + 0.005 * k, 0x201, False, data))
    path, reading = write(tmp_path, "".join(rows), dbc=MUXED)
    log = read_log(path, reading=reading)
    np.testing.assert_allclose(log.position[:, 0], 0.001 * values[:, 0], atol=1e-12)
    np.testing.assert_allclose(log.effort[:, 0], 0.01 * values[:, 2], atol=1e-12)


def test_the_same_ids_on_two_channels_are_two_arms(candump):
    path, reading = candump
    channels = [f"{side}_can" for side in ("left", "right")]
    rows = [
        line(*frame, channel=channel)
        for frame in frames()
        if frame[1] == IDS[0]
        for channel in channels
    ]
    path.write_text("".join(rows))
    log = read_log(path, reading=reading)
    assert len(log.joints) == 2
    np.testing.assert_allclose(log.position, np.repeat(COUNTS[:, :1, 0], 2, 1) * 0.0005, atol=1e-12)


def test_frames_that_the_dbc_lacks_are_counted(candump):
    path, reading = candump
    others = [line(START + 0.1 * k, 0x7FF, False, b"\x00") for k in range(30)]
    short = [line(START + 0.1 * k, IDS[0], False, b"\x00") for k in range(2)]
    path.write_text("".join([line(*frame) for frame in frames()] + others + short))
    log = read_log(path, reading=reading)
    assert_packed(log)
    assert "there are frames with the ids 0x7FF (30), which arm.dbc lacks" in log.notes
    assert any(
        note.startswith("frames with the ids 0x201 (2) are not used: ") for note in log.notes
    )


def test_what_cannot_be_decoded_is_refused_with_its_ids(candump):
    path, reading = candump
    with pytest.raises(LogError, match=r"trace of a CAN bus.*--dbc robot\.dbc"):
        read_log(path)
    path.write_text(line(START, 0x7FF, False, b"\x00") * 3)
    with pytest.raises(
        LogError, match=r"it has the ids 0x7FF \(3\), which arm.dbc lacks; the DBC "
    ):
        read_log(path, reading=reading)
    reading.dbc.write_text("no dbc")
    with pytest.raises(LogError, match=r"arm\.dbc' cannot be read"):
        read_log(path, reading=reading)
    with pytest.raises(LogError, match=r"no\.dbc"):
        read_log(path, reading=Reading(dbc=path.parent / "no.dbc"))


def test_frames_without_time_or_joints_are_refused(candump):
    path, reading = candump
    rows = [f"  can0  {key:03X}   [7]  {data.hex(' ').upper()}\n" for _, key, _, data in frames()]
    text, dbc = "".join(line(*frame) for frame in frames()), DBC
    path.write_text("".join(rows))
    with pytest.raises(LogError, match=r"frames without time.*candump -l"):
        read_log(path, reading=reading)
    for word, letter in (("Position", "S_x"), ("Velocity", "S_y"), ("Torque", "S_z")):
        dbc = dbc.replace(word, letter)
    reading.dbc.write_text(dbc)
    path.write_text(text)
    with pytest.raises(LogError) as raised:
        read_log(path, reading=reading)
    assert "Motor1.S_x" in raised.value.evidence["proposal"]


def test_traces_are_known_by_their_content(candump):
    path, reading = candump
    text = "".join(line(*frame, channel="slcan-0") for frame in frames())
    for name in ("a.txt", "a.asc"):
        (path.parent / name).write_text(text)
        assert_packed(read_log(path.parent / name, reading=reading))
    with can.Logger(path.with_suffix(".asc")) as trace:
        for time, key, long, data in frames():
            trace(can.Message(time, key, long, data=data, channel=1))
    text = path.with_suffix(".asc").read_text()
    (path.parent / "b.txt").write_text(text)
    (path.parent / "b.asc.gz").write_bytes(gzip.compress(text.encode()))
    for name in ("b.txt", "b.asc.gz"):
        log = read_log(path.parent / name, reading=reading)
        np.testing.assert_allclose(log.effort, COUNTS[:, :, 2] * SCALES[:, 2], atol=1e-12)


def test_lines_and_frames_that_are_not_used_are_counted(tmp_path):
    frame, rows = struct.pack("<Bh", 0, 1), []
    for k in range(300):
        for page in (0, 1, 7) if k == 5 else (0, 1):
            rows.append(line(START + 0.005 * k, 0x201, False, struct.pack("<Bh", page, k)))
    rows[100:100] = ["(1700000000.2) can0 20#0\n", "interrupted\n", "\n"]
    path, reading = write(tmp_path, "".join(rows), dbc=MUXED)
    notes = read_log(path, reading=reading).notes
    words = "lines without data frames are not used: 2, such as '(1700000000.2) can0 20#0'"
    assert words in notes
    assert any(
        "0x201 (1) are not used: they are shorter than in the DBC, or of a p" in n for n in notes
    )
    path.write_text(f"can0 201#{frame.hex().upper()}\n")
    with pytest.raises(LogError, match=r"without data frames; its first line is 'can0 201#000100'"):
        read_log(path, reading=reading)
    path.write_text(line(START, 0x201, False, struct.pack("<Bh", 7, 1)))
    with pytest.raises(LogError, match=r"the ids 0x201 \(1\), which do not fit; the DBC has 0x201"):
        read_log(path, reading=reading)


GROUPS = """BO_ {id} State: 7 A
 SG_ Position : 0|16@1- (0.0005,0) [0|0] "rad" A
 SG_ Velocity : 16|16@1- (0.001,0) [0|0] "rad/s" A
 SG_ Torque : 32|16@1- (0.01,0) [0|0] "Nm" A
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ {id} 3;
"""


@pytest.mark.parametrize(("stated", "sent"), [(0x98FF0010, 0x0CFF0021), (0x98EF1410, 0x0CEF3221)])
def test_ids_of_j1939_have_any_priority_and_source(candump, stated, sent):
    """Motors with the same group of parameters are told by their sources."""
    path, reading = candump
    reading.dbc.write_text(DBC[: DBC.index("BO_ ")] + GROUPS.format(id=stated))
    rows = [(time, sent + IDS.index(key), True, data) for time, key, _, data in frames()]
    path.write_text("".join(line(*row) for row in rows))
    log = read_log(path, reading=reading)
    np.testing.assert_allclose(log.position, COUNTS[:, :, 0] * SCALES[0, 0], atol=1e-12)


def test_several_messages_with_one_id_are_refused(candump, capfd):
    path, reading = candump
    again = 'BO_ 513 Again: 8 A\n SG_ X : 0|8@1- (1,0) [0|0] "" A\n'
    reading.dbc.write_text(DBC.replace("VAL_", f"{again}VAL_"))
    with pytest.raises(LogError, match="messages with the id 0x201: Motor1 and Again"):
        read_log(path, reading=reading)
    assert not "".join(capfd.readouterr())


def test_truncated_lines_of_asc_are_counted(candump):
    path, reading = candump
    path = path.with_suffix(".asc")
    with can.Logger(path) as trace:
        for time, key, long, data in frames():
            trace(can.Message(time, key, long, data=data, channel=1))
    lines = path.read_text().splitlines()
    lines[301:500:50] = [text[:30] for text in lines[301:500:50]]
    path.write_text("\n".join(lines))
    words = f"lines without data frames are not used: 4, such as {lines[301].strip()!r}"
    assert words in read_log(path, reading=reading).notes


def test_stamps_since_the_frame_before_are_added_up(candump):
    path, reading = candump
    rows, last = [], START
    for k, (time, key, long, data) in enumerate(frames()):
        stamp = time + 0.001 * (k % 2)
        rows.append(line(stamp - last, key, long, data))
        last = stamp
    path.write_text("".join(rows))
    log = read_log(path, reading=reading)
    np.testing.assert_allclose(log.time, 0.005 * np.arange(len(COUNTS)), atol=1e-3)
    assert "time stamps are times since the frame before: added up" in log.notes
