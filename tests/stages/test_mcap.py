"""Bags: joint states and commands of a robot, written by the format's own library, up to a verdict."""

import re
import struct
import sys
import tracemalloc

import mcap_ros2.decoder
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.writer import Writer

from simgap.cli import main
from simgap.config.measured import MeasuredSection
from simgap.diagnosis.record.channels import Channel
from simgap.diagnosis.record.traces import read_traces
from simgap.errors import UserError
from simgap.io.recordings.tables import read_header, read_recording
from simgap.stages import check
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

STATES = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
ARRAY = """std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
Q, V, U = "/joint_states/hinge/position", "/joint_states/hinge/velocity", "/effort_controller/commands/0"
MEASURED = f"""\
measured:
  effects: [coulomb_friction, viscous_friction, spring]
  max_effects: 2
  columns: {{q: {Q}, v: {V}, u: {U}}}
"""
EPOCH = 1_700_000_000_000_000_000


def bag(path, seed=1, seconds=8.0, late_ns=0, names=("gripper", "hinge"), stamped=True):
    """A bag of the example's pendulum: states at 100 Hz beside another joint, commands on a topic of their own."""
    t = np.arange(int(seconds * 100.0)) / 100.0
    rng = np.random.default_rng(seed)
    y = example.simulate(t, [rng.uniform(-0.5, 0.5), 0.0], example.FRICTION)
    y += example.SIGMA * rng.standard_normal(y.shape)
    with path.open("wb") as stream:
        writer = Writer(stream)
        states = writer.register_msgdef("sensor_msgs/msg/JointState", STATES)
        commands = writer.register_msgdef("std_msgs/msg/Float64MultiArray", ARRAY)
        for k in range(len(t)):
            at = EPOCH + round(t[k] * 1e9)
            stamp = {"sec": at // 10**9, "nanosec": at % 10**9} if stamped else {"sec": 0, "nanosec": 0}
            content = {"layout": {"dim": [], "data_offset": 0}, "data": [float(example.torque(t[k]))]}
            writer.write_message("/effort_controller/commands", commands, content, log_time=at)
            joint = {"gripper": (0.0, 0.0), "hinge": y[k]}
            message = {
                "header": {"stamp": stamp, "frame_id": ""}, "name": list(names),
                "position": [float(joint[n][0]) for n in names], "velocity": [float(joint[n][1]) for n in names],
                "effort": [],
            }  # fmt: skip
            writer.write_message("/joint_states", states, message, log_time=at + late_ns)
        writer.finish()
    return t, y


def test_from_bags_to_a_verdict(tmp_path):
    for k in range(2):
        bag(tmp_path / f"run_{k}.mcap", seed=k, late_ns=3_000_000)
    case = tmp_path / "case.yaml"
    case.write_text(example.CASE + MEASURED)
    found = stage.run(case, sorted(tmp_path.glob("run_*.mcap")), tmp_path / "found")
    assert found["verdict"] == "attributed"
    (effect,) = found["effects"]
    assert (effect["name"], effect["on"]) == ("coulomb_friction", "hinge")
    assert effect["parameters"]["F_c"]["value"] == pytest.approx(example.FRICTION, abs=0.003)
    assert found["recording"] == []  # the header's stamps, and not when the logger got round to it
    assert [note["rows"] for note in found["data"]] == [800, 800]


def test_a_check_needs_no_time_column(tmp_path):
    bag(tmp_path / "run.mcap", seconds=2.0)
    case = tmp_path / "case.yaml"
    case.write_text(example.CASE + MEASURED + "  files: [run.mcap]\n")
    assert check.run(case) is not None
    case.write_text(example.CASE + MEASURED.replace(Q, "/joint_states/elbow/position") + "  files: [run.mcap]\n")
    with pytest.raises(UserError, match="elbow"):
        check.run(case)


def test_columns_are_the_messages_numbers(tmp_path):
    t, y = bag(tmp_path / "run.mcap", seconds=1.0)
    header, _ = read_header(tmp_path / "run.mcap", "run.mcap")
    assert set(header) == {Q, V, U, Q.replace("hinge", "gripper"), V.replace("hinge", "gripper")}
    raw = read_recording(tmp_path / "run.mcap", [Q, V, U, "absent"], "t", "trace", "run.mcap")
    assert raw.time_unit == "ns"
    assert list(raw.time - EPOCH) == [round(at * 1e9) for at in t]
    assert raw.columns[Q] == pytest.approx(y[:, 0], abs=0)
    assert raw.columns[U] == pytest.approx(example.torque(t), abs=0)
    assert set(raw.columns) == {Q, V, U}


def test_without_stamps_the_logger_s_clock_counts_and_commands_are_held(tmp_path):
    t, _ = bag(tmp_path / "run.mcap", seconds=1.0, late_ns=4_000_000, stamped=False)
    raw = read_recording(tmp_path / "run.mcap", [Q, U], "t", "trace", "run.mcap")
    assert raw.time[0] - EPOCH == 4_000_000
    assert raw.columns[U] == pytest.approx(example.torque(t), abs=0)  # the last one before each state


@pytest.mark.parametrize("cut", [0.3, 0.9])
def test_a_damaged_bag_is_one_line(tmp_path, cut):
    bag(tmp_path / "run.mcap", seconds=1.0)
    content = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(content[: int(cut * len(content))])
    with pytest.raises(UserError, match=r"run\.mcap") as caught:
        read_recording(tmp_path / "run.mcap", [Q], "t", "trace", "run.mcap")
    assert "\n" not in str(caught.value)
    flipped = bytearray(content)
    flipped[len(content) // 3] ^= 0xFF
    (tmp_path / "run.mcap").write_bytes(bytes(flipped))
    with pytest.raises(UserError, match=r"run\.mcap"):
        read_recording(tmp_path / "run.mcap", [Q], "t", "trace", "run.mcap")


def test_refusals_name_the_message_and_what_to_do(tmp_path, monkeypatch):
    with (tmp_path / "talk.mcap").open("wb") as stream:
        writer = Writer(stream)
        talk = writer.register_msgdef("std_msgs/msg/String", "string data\n")
        writer.write_message("/chatter", talk, {"data": "hello"}, log_time=EPOCH)
        writer.finish()
    with pytest.raises(UserError, match=r"no topic of joint states, only /chatter"):
        read_recording(tmp_path / "talk.mcap", [Q], "t", "trace", "talk.mcap")
    with (tmp_path / "mixed.mcap").open("wb") as stream:
        writer = Writer(stream)
        states = writer.register_msgdef("sensor_msgs/msg/JointState", STATES)
        for k, (name, at) in enumerate((("hinge", 0.1), ("hinge", float("nan")), ("other", 0.1))):
            header = {"stamp": {"sec": k + 1, "nanosec": 0}, "frame_id": ""}
            message = {"header": header, "name": [name], "position": [at], "velocity": [], "effort": []}
            writer.write_message("/joint_states", states, message, log_time=EPOCH)
        writer.finish()
    with pytest.raises(UserError, match=r"message 2 .* is nan"):
        read_recording(tmp_path / "mixed.mcap", [Q], "t", "trace", "mixed.mcap")
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(UserError, match=r"simgap\[mcap\]"):
        read_recording(tmp_path / "mixed.mcap", [Q], "t", "trace", "mixed.mcap")


def written(path, messages, encodings=("ros2msg", "cdr"), **options):
    """A bag of (topic, header's stamp, logged, content): joints by name and position, or a command's numbers."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start()
        kinds = {"joints": ("sensor_msgs/msg/JointState", STATES), "numbers": ("std_msgs/msg/Float64MultiArray", ARRAY)}
        packed = {kind: serialize_dynamic(name, text)[name] for kind, (name, text) in kinds.items()}
        schemas = {k: writer.register_schema(n, encodings[0], text.encode()) for k, (n, text) in kinds.items()}
        channels = {}
        for topic, stamp, logged, content in messages:
            kind = "joints" if isinstance(content, dict) else "numbers"
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encodings[1], schemas[kind])
            said = {"layout": {"dim": [], "data_offset": 0}, "data": content}
            if kind == "joints":
                stamp = {"sec": stamp // 10**9, "nanosec": stamp % 10**9}
                frame = content.get("frame", "")
                names = [name for name in content if name != "frame"]
                said = {
                    "header": {"stamp": stamp, "frame_id": frame}, "name": names,
                    "position": [content[name] for name in names], "velocity": [], "effort": [],
                }  # fmt: skip
            writer.add_message(channels[topic], logged, packed[kind](said), logged)
        writer.finish()
    return path


def read(path, *columns):
    return read_recording(path, list(columns), "t", "trace", path.name)


BOMB = 8_000_000


@pytest.mark.parametrize("lie", ["none", "index", "chunk"])
@pytest.mark.parametrize("packer", [CompressionType.ZSTD, CompressionType.LZ4])
def test_what_does_not_fit_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, packer, lie):
    joints = {"hinge": 0.0, "frame": "x" * BOMB}
    path = written(
        tmp_path / "bomb.mcap", [("/joint_states", EPOCH, EPOCH, joints)], compression=packer, enable_crcs=False,
        use_statistics=False,
    )  # fmt: skip
    content = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        (index,) = make_reader(stream).get_summary().chunk_indexes
    places = [m.start() for m in re.finditer(re.escape(struct.pack("<Q", index.uncompressed_size)), content)]
    inside = index.chunk_start_offset + 9 + 16  # behind kind, length and two instants
    assert inside in places
    for at in places:
        if (lie == "chunk" and at == inside) or (lie != "none" and at > index.chunk_start_offset + index.chunk_length):
            content[at : at + 8] = struct.pack("<Q", 1000)
    path.write_bytes(content)
    monkeypatch.setattr("simgap.reading.MOST", BOMB // 4)
    read_header(bag_of_one(tmp_path), "small.mcap")  # the libraries are loaded
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=r"a chunk does not fit its length" if lie == "chunk" else "GB unpacked"):
            read_header(path, path.name)
        assert tracemalloc.get_traced_memory()[1] < BOMB // 4
    finally:
        tracemalloc.stop()


def bag_of_one(folder):
    return written(folder / "small.mcap", [("/joint_states", EPOCH, EPOCH, {"hinge": 0.0})])


@pytest.mark.parametrize("chunked", [True, False])
def test_a_message_of_too_many_numbers_is_refused_before_it_is_decoded(tmp_path, monkeypatch, chunked):
    messages = [("/joint_states", EPOCH, EPOCH, {"hinge": 0.0}), ("/commands", EPOCH, EPOCH, [0.0] * 20_000)]
    path = written(tmp_path / "wide.mcap", messages, use_chunking=chunked)
    assert len(read_header(path, path.name)[0]) == 20_001
    monkeypatch.setattr("simgap.reading.MOST", 4_000_000)
    with pytest.raises(UserError, match=r"wide\.mcap.*GB unpacked"):
        read_header(path, path.name)


def test_joints_with_a_slash_in_their_names(tmp_path):
    states = [("/joint_states", EPOCH + k, EPOCH + k, {"arm/hinge": 0.1 * k, "plain": -0.1 * k}) for k in range(5)]
    commands = [("/commands", 0, EPOCH + k, [1.0 * k]) for k in range(5)]
    path = written(tmp_path / "slash.mcap", states + commands)
    slash = "/joint_states/arm/hinge/position"
    raw = read(path, slash, "/joint_states/plain/position", "/commands/0")
    assert raw.columns[slash] == pytest.approx(0.1 * np.arange(5), abs=1e-15)
    assert raw.columns["/joint_states/plain/position"] == pytest.approx(-0.1 * np.arange(5), abs=1e-15)
    assert read(path, slash, "/commands/0").rows == 5
    other = ("/joint_states/arm", EPOCH, EPOCH, {"hinge": 0.0})
    with pytest.raises(UserError, match=r"two topics give a column '/joint_states/arm/hinge/position'"):
        read(written(tmp_path / "both.mcap", [*states, other]), slash)


@pytest.mark.parametrize("turns", [("gripper", "hinge"), ("hinge", "gripper")])
def test_publishers_that_take_turns_on_a_topic_are_told_of(tmp_path, turns):
    states = [("/joint_states", EPOCH + k, EPOCH + k, {turns[k % 2]: 0.0}) for k in range(6)]
    path = written(tmp_path / "turns.mcap", states)
    assert set(read_header(path, path.name)[0]) == {Q, Q.replace("hinge", "gripper")}
    with pytest.raises(UserError, match=r"message [12] of '/joint_states' has no .*a topic of its own"):
        read(path, Q)


@pytest.mark.parametrize("ahead_s", [3600, -3600])
def test_clocks_that_do_not_fit_each_other_are_refused(tmp_path, ahead_s):
    at = [EPOCH + k * 10_000_000 for k in range(100)]
    states = [("/joint_states", t + ahead_s * 10**9, t, {"hinge": 0.01 * k}) for k, t in enumerate(at)]
    commands = [("/commands", 0, t, [np.sin(0.1 * k)]) for k, t in enumerate(at)]
    with pytest.raises(UserError, match=r"has no joint state (before|after).*by one clock"):
        read(written(tmp_path / "clocks.mcap", states + commands), Q, "/commands/0")
    if ahead_s > 0:  # one that never changes is held all the same
        raw = read(written(tmp_path / "held.mcap", [*states, ("/commands", 0, EPOCH, [0.5])]), Q, "/commands/0")
        assert list(raw.columns["/commands/0"]) == [0.5] * 100


@pytest.mark.parametrize("encodings", [("ros1msg", "ros1"), ("ros2idl", "cdr"), ("ros2msg", "json")])
def test_messages_of_another_encoding_are_not_called_damaged(tmp_path, encodings):
    path = written(tmp_path / "other.mcap", [("/joint_states", EPOCH, EPOCH, {"hinge": 0.0})], encodings)
    with pytest.raises(UserError, match=r"'/joint_states' is not in messages of ROS 2.*Convert it to ROS 2 messages"):
        read(path, Q)


def test_messages_that_overtake_each_other_are_put_in_order(tmp_path):
    at = [EPOCH + k * 10_000_000 for k in (0, 2, 1, 3, 5, 4)]
    states = [("/joint_states", t, EPOCH + k, {"hinge": float(t - EPOCH)}) for k, t in enumerate(at)]
    commands = [("/commands", 0, t, [float(t - EPOCH)]) for t in sorted(at)]
    raw = read(written(tmp_path / "order.mcap", states + commands), Q, "/commands/0")
    assert list(raw.time) == sorted(at)
    assert list(raw.columns[Q]) == list(raw.columns["/commands/0"]) == [t - EPOCH for t in sorted(at)]
    again = [("/joint_states", 10**9 * (1 + k % 10), EPOCH + k, {"hinge": 0.0}) for k in range(20)]
    with pytest.raises(UserError, match=r"the clock of '/joint_states' goes back by 9 s.*Cut it there"):
        read(written(tmp_path / "reset.mcap", again), Q)


def test_a_definition_of_many_fields_is_refused_before_it_is_parsed(tmp_path, monkeypatch):
    """300,000 of them took 25 s."""
    monkeypatch.setattr(mcap_ros2.decoder, "generate_dynamic", lambda *_: pytest.fail("it is parsed"))
    with (tmp_path / "wide.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        text = STATES.encode() + b"".join(b"int8 a%d\n" % k for k in range(300_000))
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text)
        writer.add_message(writer.register_channel("/joint_states", "cdr", schema), EPOCH, b"\0" * 40, EPOCH)
        writer.finish()
    with pytest.raises(
        UserError, match=r"wide\.mcap: the definition of sensor_msgs/msg/JointState .* bytes, more than"
    ):
        read_header(tmp_path / "wide.mcap", "wide.mcap")


def test_a_joint_that_a_message_names_twice_is_refused_where_it_is_asked_for(tmp_path):
    path = tmp_path / "twice.mcap"
    bag(path, seconds=0.1, names=("gripper", "gripper", "hinge"))
    with pytest.raises(UserError, match=r"message 1 of '/joint_states' has '/joint_states/gripper/position' twice"):
        read(path, Q.replace("hinge", "gripper"))
    assert read(path, Q).rows == 10


def test_a_simulated_clock_begins_at_0(tmp_path):
    at = [k * 10_000_000 for k in range(50)]
    path = written(tmp_path / "sim.mcap", [("/joint_states", t, EPOCH + t, {"hinge": 0.01 * t}) for t in at])
    assert list(read(path, Q).time) == at
    for zeros in ([0], [20], [0, 1, 20]):
        some = [("/joint_states", 0 if k in zeros else EPOCH + t, EPOCH + t, {"hinge": 0.0}) for k, t in enumerate(at)]
        first = next((k for k in zeros if k > 1), 0) + 1
        with pytest.raises(UserError, match=rf"message {first} of '/joint_states' has no stamp in its header, others"):
            read(written(tmp_path / "some.mcap", some), Q)


def test_a_stamp_that_goes_back_is_told(tmp_path):
    at = [EPOCH + k * 10_000_000 for k in range(100)]
    back = [*at[:50], at[20] + 1, *at[50:]]
    messages = [("/joint_states", t, EPOCH + k, {"hinge": 0.0}) for k, t in enumerate(back)]
    raw = read(written(tmp_path / "back.mcap", messages), Q)
    assert raw.notes == (
        "1 of 101 messages of '/joint_states' are stamped before one that was logged earlier, by up to 0.29 s; "
        "they are put in order",
    )
    reading = read_traces([raw], [Channel("q", "rad", False, Q)], MeasuredSection(window_s=0.1))
    assert reading.warnings[0] == f"back.mcap: {raw.notes[0]}"
    assert read(written(tmp_path / "fine.mcap", messages[:50]), Q).notes == ()


def test_names_of_joints_move_no_cursor(tmp_path, capsys):
    name = "a\x1b[2Jb"
    path = written(tmp_path / "esc.mcap", [("/t\x1b[31m", EPOCH + k, EPOCH + k, {name: 0.0}) for k in range(3)])
    case = tmp_path / "case.yaml"
    case.write_text(example.CASE + MEASURED.replace(Q, "other"))
    with pytest.raises(SystemExit, match="2"):
        main(["diagnose", str(case), str(path), "--out", str(tmp_path / "out")])
    said = "".join(capsys.readouterr())
    assert r"\x1b[2J" in said
    assert "\x1b" not in said
