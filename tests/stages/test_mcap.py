"""Bags: joint states and commands of a robot, written by the format's own library, up to a verdict."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer

sys.path.insert(0, str(Path(__file__).parent))
import diagnosis_example as example

from simgap.errors import UserError
from simgap.io.diagnosis_tables import read_header, read_recording
from simgap.stages import check
from simgap.stages import diagnosis as stage

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
