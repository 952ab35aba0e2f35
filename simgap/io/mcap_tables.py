"""Recordings in MCAP files, as rosbag2 writes them: joint states and commands as plain columns (extra `mcap`).

A `sensor_msgs/JointState` gives columns `<topic>/<joint>/position`, `velocity` and `effort`; a `std_msgs` number
`<topic>/data`, an array of them `<topic>/0`, `<topic>/1` ... The rows are the messages of the first topic of joint
states that is asked for; what comes on other topics is held from its message on, as a command is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simgap.diagnosis.reading.table import Floats, RawTable
from simgap.errors import UserError, excerpt
from simgap.io.unpacked import require_room

MAGIC = b"\x89MCAP0\r\n"
_JOINTS = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
_FIELDS = ("position", "velocity", "effort")
_NUMBERS = tuple(f"std_msgs/{way}{kind}" for way in ("msg/", "") for kind in ("Float64", "Float32"))
_ARRAYS = tuple(f"{name}MultiArray" for name in _NUMBERS)
_BYTES = 512  # what a column of a decoded message may take, roughly
_DAMAGED = "Copy it again, or mend it (`mcap recover`)."


@dataclass
class _Topic:
    """What one topic told: instants (ns) and, by column, values."""

    joints: bool
    stamps: list[int] = field(default_factory=list)
    columns: dict[str, list[float]] = field(default_factory=dict)


def is_mcap(path: Path) -> bool:
    """Whether a file begins as MCAP files do."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror}", file=path) from None


def mcap_header(path: Path, file: str) -> tuple[str, ...]:
    """Names of all columns, from the first message of each topic.

    Raises:
        UserError: a damaged file, no topic that is read, or a missing library.
    """
    names: list[str] = []
    with _opened(path, file) as reader:
        for topic in _topics(reader, file):
            for _, _, _, message in reader.iter_decoded_messages(topics=[topic]):
                names += _values(topic, message)
                break
    return tuple(names)


def read_mcap(path: Path, wanted: Sequence[str], file: str, sha256: str) -> RawTable:
    """The wanted columns; those that the file lacks are left out.

    Raises:
        UserError: a damaged file, a joint that is missing from a message, numbers that are not finite.
    """
    header = mcap_header(path, file)
    chosen = [name for name in dict.fromkeys(wanted) if name in header]
    with _opened(path, file) as reader:
        kinds = _topics(reader, file)
        asked = [topic for topic in kinds if any(_is_of(name, topic) for name in chosen)]
        _require_room(reader, asked if asked else kinds, len(chosen), file)
        heard = {topic: _heard(reader, topic, chosen, kinds[topic], file) for topic in asked}
    joints = [topic for topic in asked if heard[topic].joints]
    if not joints:  # the reading names what it misses
        return RawTable(file, header, np.zeros(0, np.int64), "ns", {}, sha256=sha256)
    stamps = np.array(heard[joints[0]].stamps, dtype=np.int64)
    first, columns = 0, dict[str, Floats]()
    for topic in asked:
        own = np.array(heard[topic].stamps, dtype=np.int64)
        order = np.argsort(own, kind="stable")
        at = np.searchsorted(own[order], stamps, side="right") - 1
        first = max(first, int(np.searchsorted(stamps, own[order][0])))
        for name, values in heard[topic].columns.items():
            columns[name] = np.array(values) if topic == joints[0] else np.array(values)[order][np.maximum(at, 0)]
    if first >= len(stamps):
        raise UserError(
            "has no joint state after the first command", file=file,
            remedy="Record both at the same time, by one clock (stamps of simulated time are of another).",
        )  # fmt: skip
    kept = {name: np.ascontiguousarray(columns[name][first:]) for name in chosen}
    return RawTable(file, header, stamps[first:], "ns", kept, sha256=sha256)


@contextmanager
def _opened(path: Path, file: str) -> Iterator[Any]:
    """A reader that decodes ROS 2 messages; whatever a damaged file does to it becomes one line."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise UserError(
            "is an MCAP file, which takes a library that is not installed", file=file,
            remedy="Install it: pip install 'simgap[mcap]'.",
        ) from None  # fmt: skip
    try:
        with path.open("rb") as stream:
            yield make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
    except (UserError, MemoryError):
        raise
    except Exception as error:  # the libraries raise their own, struct's, zstandard's and lz4's
        raise UserError(
            f"cannot be read as MCAP ({excerpt(str(error) or type(error).__name__, 120)})", file=file, remedy=_DAMAGED
        ) from None


def _topics(reader: Any, file: str) -> dict[str, str]:
    """Topic -> type of message, of those that are read, in the order of their names."""
    summary = reader.get_summary()
    if summary is None:
        raise UserError("has no summary: its recording was cut off", file=file, remedy=_DAMAGED)
    types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values() if c.schema_id}
    found = {topic: types[topic] for topic in sorted(types) if types[topic] in (*_JOINTS, *_NUMBERS, *_ARRAYS)}
    if not any(kind in _JOINTS for kind in found.values()):
        listed = excerpt(", ".join(f"{topic} ({kind})" for topic, kind in sorted(types.items())), 200)
        raise UserError(
            f"has no topic of joint states, only {listed or 'none'}", file=file,
            remedy="Record a sensor_msgs/JointState, such as /joint_states.",
        )  # fmt: skip
    return found


def _require_room(reader: Any, topics: Sequence[str] | Mapping[str, str], columns: int, file: str) -> None:
    summary = reader.get_summary()
    counts = summary.statistics.channel_message_counts if summary.statistics is not None else {}
    messages = sum(n for k, n in counts.items() if summary.channels[k].topic in topics)
    try:
        require_room(messages * (columns + 2) * _BYTES)
    except UserError as error:
        raise UserError(error.problem, file=file, remedy=error.remedy) from None


def _heard(reader: Any, topic: str, chosen: Sequence[str], kind: str, file: str) -> _Topic:
    """Every message of a topic."""
    own = [name for name in chosen if _is_of(name, topic)]
    out = _Topic(kind in _JOINTS, columns={name: [] for name in own})
    for k, (_, _, message, content) in enumerate(reader.iter_decoded_messages(topics=[topic])):
        values = _values(topic, content)
        for name in own:
            if name not in values:
                raise UserError(
                    f"message {k + 1} of '{topic}' has no '{name}'", file=file,
                    remedy="Record each robot's joints on a topic of its own.",
                )  # fmt: skip
            if not np.isfinite(values[name]):
                raise UserError(
                    f"message {k + 1} of '{topic}': '{name}' is {values[name]}, not a finite number", file=file,
                    remedy="Leave that column out of the case if its driver does not measure it.",
                )  # fmt: skip
            out.columns[name].append(values[name])
        out.stamps.append(_stamp(content, message.log_time))
    return out


def _stamp(content: Any, logged: int) -> int:
    """Nanoseconds: of the message's header where it is set, else when it was logged."""
    stamp = getattr(getattr(content, "header", None), "stamp", None)
    if stamp is None or (stamp.sec == 0 and stamp.nanosec == 0):
        return int(logged)
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _values(topic: str, content: Any) -> dict[str, float]:
    """Column -> value of one message; an array that a driver leaves empty gives no columns."""
    if hasattr(content, "position") and hasattr(content, "name"):
        return {
            f"{topic}/{joint}/{quantity}": float(value)
            for quantity in _FIELDS
            for joint, value in zip(content.name, getattr(content, quantity), strict=False)
        }
    if isinstance(content.data, int | float):
        return {f"{topic}/data": float(content.data)}
    return {f"{topic}/{k}": float(value) for k, value in enumerate(content.data)}


def _is_of(name: str, topic: str) -> bool:
    """Whether a column is of a topic and not of one whose name goes on."""
    if not name.startswith(f"{topic}/"):
        return False
    rest = name[len(topic) + 1 :].split("/")
    return rest[0] == "data" or rest[0].isdigit() if len(rest) == 1 else len(rest) == 2 and rest[1] in _FIELDS
