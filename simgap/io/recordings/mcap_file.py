"""Recordings in MCAP files, as rosbag2 writes them: joint states and commands as plain columns (extra `mcap`).

A `sensor_msgs/JointState` gives columns `<topic>/<joint>/position`, `velocity` and `effort`; a `std_msgs` number
`<topic>/data`, an array of them `<topic>/0`, `<topic>/1` ... The rows are the messages of the first topic of joint
states that is asked for; what comes on other topics is held from its message on, as a command is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from simgap import reading
from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.channels import RawTable
from simgap.errors import UserError, excerpt, optional
from simgap.reading import require_room

_FIELDS = ("position", "velocity", "effort")
_FIRST = 100  # messages of a topic that tell its columns: several publishers may take turns on it
_HELD = 72  # bytes of a number while a topic is gathered: the number, its place in a list, copies as arrays
_BACK_NS = 1_000_000_000
"""A clock that goes back by more than this between messages as logged started anew (a simulation that was reset): its
runs must not be sorted into one. Less is how messages overtake each other. Judgement."""
_SIMULATED_NS = 10**15
"""Stamps below a million seconds count from the start of a simulation and not since 1970."""
_ONE_CLOCK = "Record both at the same time, by one clock (stamps of simulated time are of another)."


@dataclass(frozen=True)
class _Topic:
    """Numbers of one topic: stamps (n,) in ns, ascending; by column, values (n,); notes on their order."""

    stamps: Ints
    columns: dict[str, Floats]
    notes: tuple[str, ...]


def mcap_header(path: Path) -> dict[str, str]:
    """Column -> its topic, of all columns that the first messages of each topic have.

    Raises:
        UserError: a damaged file, one that is too large, no topic that is read, or a missing library.
    """
    with opened_bag(path) as bag:
        return _header(bag)


def read_mcap(path: Path, wanted: Sequence[str], file: str) -> RawTable:
    """The wanted columns of a file that messages call `file`; those that the file lacks are left out.

    Raises:
        UserError: a damaged file or one that is too large, a joint that a message lacks or names twice, numbers that
            are not finite, clocks that do not fit each other.
    """
    with opened_bag(path) as bag:
        header = _header(bag)
        chosen = [name for name in dict.fromkeys(wanted) if name in header]
        chosen_topics = [topic for topic in bag.kinds if any(header[name] == topic for name in chosen)]
        topics = {topic: _read_topic(bag, topic, [n for n in chosen if header[n] == topic]) for topic in chosen_topics}
    joints = next((topic for topic in chosen_topics if bag.kinds[topic] in JOINTS), None)
    if joints is None:  # the reading names what it misses
        return RawTable(file, tuple(header), np.zeros(0, np.int64), "ns", {})
    stamps = topics[joints].stamps
    first, columns = 0, dict(topics[joints].columns)
    for topic, one in topics.items():
        if topic != joints:
            at = np.searchsorted(one.stamps, stamps, side="right") - 1
            first = max(first, int(np.searchsorted(stamps, one.stamps[0])))
            columns |= {name: values[np.maximum(at, 0)] for name, values in one.columns.items()}
            if one.stamps[-1] < stamps[0] and any(np.ptp(values) > 0.0 for values in one.columns.values()):
                problem = f"has no joint state before the last message of '{excerpt(topic, 60)}'"
                raise UserError(problem, remedy=_ONE_CLOCK)
    if first >= len(stamps):
        raise UserError("has no joint state after the first command", remedy=_ONE_CLOCK)
    kept = {name: np.ascontiguousarray(columns[name][first:]) for name in chosen}
    notes = tuple(note for one in topics.values() for note in one.notes)
    return RawTable(file, tuple(header), stamps[first:], "ns", kept, notes=notes)


def _header(bag: Bag) -> dict[str, str]:
    found: dict[str, str] = {}
    for topic in bag.kinds:
        for _, content in islice(bag.messages(topic), _FIRST):
            for name in _values(topic, content):
                if found.setdefault(name, topic) != topic:
                    raise UserError(
                        f"two topics give a column '{excerpt(name, 80)}': '{excerpt(found[name], 60)}' and "
                        f"'{excerpt(topic, 60)}'", remedy="Leave one of them out (`mcap filter`).",
                    )  # fmt: skip
            require_room(len(found) * (COLUMN_BYTES + len(topic)))
    return found


def _read_topic(bag: Bag, topic: str, own: Sequence[str]) -> _Topic:
    """These columns of every message of a topic."""
    stamps, logged = list[int](), list[int]()
    columns: dict[str, list[float]] = {name: [] for name in own}
    for k, (log_time, content) in enumerate(bag.messages(topic)):
        require_room((k + 1) * (len(own) + 2) * _HELD)
        values, twice = _values(topic, content), _twice(topic, content)
        for name in own:
            here = f"message {k + 1} of '{excerpt(topic, 60)}'"
            if name in twice:
                remedy = "Which of them is meant cannot be told: give each joint a name of its own."
                raise UserError(f"{here} has '{excerpt(name, 80)}' twice", remedy=remedy)
            if name not in values:
                remedy = "Record each robot's joints on a topic of its own."
                raise UserError(f"{here} has no '{name}'", remedy=remedy)
            if not np.isfinite(values[name]):
                remedy = "Leave that column out of the case if its driver does not measure it."
                raise UserError(f"{here}: '{name}' is {values[name]}, not a finite number", remedy=remedy)
            columns[name].append(values[name])
        stamps.append(_stamp(content))
        logged.append(log_time)
    when = _instants(np.array(stamps, dtype=np.int64), np.array(logged, dtype=np.int64), topic)
    order, notes = _in_order(when, np.array(logged, dtype=np.int64), topic)
    return _Topic(when[order], {n: np.array(v)[order] for n, v in columns.items()}, notes)


def _instants(stamps: Ints, logged: Ints, topic: str) -> Ints:
    """Stamps (n,) of headers, or when messages were logged (n,) where no header has one, ns.

    A header that nobody set says 0, and so does a simulated clock at its start.

    Raises:
        UserError: some headers are set and others are not.
    """
    if not stamps.any():
        return logged
    order = np.argsort(logged, kind="stable")
    first_set = int(np.argmax(stamps[order] != 0))
    late = np.flatnonzero(stamps[order][first_set:] == 0)
    if late.size or (first_set and stamps[order][first_set] >= _SIMULATED_NS):
        k = int(order[first_set + late[0] if late.size else 0]) + 1
        remedy = "Let the driver set header.stamp in every message, or in none: when it was logged counts then."
        raise UserError(f"message {k} of '{excerpt(topic, 60)}' has no stamp in its header, others have", remedy=remedy)
    return stamps


def _in_order(stamps: Ints, logged: Ints, topic: str) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """The order (n,) of ascending stamps (n,), in ns, and what is to be told of it; equal ones stay as they were logged
    (n,)."""
    order = np.argsort(logged, kind="stable")
    back = np.maximum.accumulate(stamps[order]) - stamps[order]
    if back.max() > _BACK_NS:
        remedy = "Cut it there (`mcap filter`): each start of the clock is a recording of its own."
        raise UserError(f"the clock of '{excerpt(topic, 60)}' goes back by {back.max() / 1e9:.3g} s", remedy=remedy)
    overtaken = int(np.sum(back > 0))
    note = (
        f"{overtaken:,} of {len(stamps):,} messages of '{excerpt(topic, 60)}' "
        f"are stamped before one that was logged earlier, by up to {back.max() / 1e9:.3g} s; they are put in order",
    )
    return order[np.argsort(stamps[order], kind="stable")], note if overtaken else ()


def _twice(topic: str, content: Any) -> frozenset[str]:
    """Columns of joints that one message names more than once."""
    names = getattr(content, "name", ())
    if len(set(names)) == len(names):
        return frozenset()
    return frozenset(f"{topic}/{n}/{q}" for n, count in Counter(names).items() if count > 1 for q in _FIELDS)


def _stamp(content: Any) -> int:
    """Nanoseconds of the message's header; 0 without one."""
    stamp = getattr(getattr(content, "header", None), "stamp", None)
    if stamp is None:
        return 0
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


MAGIC = b"\x89MCAP0\r\n"
JOINTS = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
COLUMN_BYTES = 512  # what a column of a decoded message may take, beside the topic in its name
_NUMBERS = tuple(f"std_msgs/{way}{kind}" for way in ("msg/", "") for kind in ("Float64", "Float32"))
_ARRAYS = tuple(f"{name}MultiArray" for name in _NUMBERS)
_LEAST = 4  # bytes of a packed number
_DEFINITION = 16_384
"""Bytes of a type's definition: those that are read have some 3,000 with all their comments, and parsing takes longer
than it grows (25 s for 300,000 fields)."""
_DAMAGED = "Copy it again, or repair it (`mcap recover`)."


@dataclass(frozen=True)
class Bag:
    """An open recording.

    Attributes:
        kinds: topic -> type of message, of those that are read, in the order of their names.
        channels: topic -> numbers of its channels.
    """

    stream: Any
    summary: Any
    kinds: dict[str, str]
    channels: dict[str, set[int]]

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """When each message of a topic was logged (ns) and what it says, in the order of the file.

        Raises:
            UserError: for what would not fit into memory.
        """
        from mcap.records import Message
        from mcap_ros2.decoder import DecoderFactory

        factory, own = DecoderFactory(), self.channels[topic]
        for record in self._records(own):
            if isinstance(record, Message) and record.channel_id in own:
                require_room(len(record.data) // _LEAST * (COLUMN_BYTES + len(topic)))
                channel = self.summary.channels[record.channel_id]
                decode = factory.decoder_for(channel.message_encoding, self.summary.schemas[channel.schema_id])
                yield int(record.log_time), decode(record.data)

    def _records(self, channels: set[int]) -> Iterator[Any]:
        """Records of the file, without chunks that say they have none of these channels."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader

        for index in sorted(self.summary.chunk_indexes, key=lambda index: int(index.chunk_start_offset)):
            if not index.message_index_offsets or not channels.isdisjoint(index.message_index_offsets):
                self.stream.seek(index.chunk_start_offset + 9)  # behind the record's kind and length
                yield from self._unpacked(Chunk.read(ReadDataStream(self.stream)))
        if not self.summary.chunk_indexes:
            self.stream.seek(0)
            for record in StreamReader(self.stream, emit_chunks=True, validate_crcs=True).records:
                yield from self._unpacked(record) if isinstance(record, Chunk) else (record,)

    def _unpacked(self, chunk: Any) -> Iterator[Any]:
        """The records of a chunk. What it says of its size is the limit of what is unpacked, whatever is in it."""
        from mcap.exceptions import EndOfFile
        from mcap.stream_reader import StreamReader

        size = int(chunk.uncompressed_size)
        require_room(size)
        plain = {"zstd": _zstd, "lz4": _lz4, "": _plain}[chunk.compression](chunk.data, size)
        if len(plain) != size or (chunk.uncompressed_crc and crc32(plain) != chunk.uncompressed_crc):
            raise ValueError("a chunk does not fit its length or checksum")
        with suppress(EndOfFile):  # one at a time: small records take ten times their bytes
            yield from StreamReader(BytesIO(plain), skip_magic=True, emit_chunks=True).records


def _plain(data: bytes, size: int) -> bytes:
    """The data themselves."""
    return data


def _zstd(data: bytes, size: int) -> bytes:
    """Unpacked, `size` bytes at most: a frame that tells its length gets that much memory whatever it holds."""
    import zstandard

    declared = zstandard.get_frame_parameters(data).content_size
    if declared not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError("a chunk does not fit its length")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _lz4(data: bytes, size: int) -> bytes:
    """Unpacked, one byte more than `size` at most."""
    from lz4.frame import LZ4FrameDecompressor

    return bytes(LZ4FrameDecompressor().decompress(data, max_length=size + 1))


@contextmanager
def opened_bag(path: Path) -> Iterator[Bag]:
    """A recording of ROS 2; whatever a damaged file does to its reader becomes one line.

    Raises:
        UserError: a damaged file, no topic that is read, or a missing library.
    """
    with optional("the library for MCAP files", "mcap", key=None):
        import mcap_ros2.decoder  # noqa: F401
        from mcap.reader import make_reader
    try:
        with reading.opened(path) as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            if summary is None:
                raise UserError("has no summary: its recording was cut off", remedy=_DAMAGED)
            kinds, channels = _topics(summary)
            yield Bag(stream, summary, kinds, channels)
    except (UserError, MemoryError):
        raise
    except Exception as error:  # the libraries raise their own, struct's, zstandard's and lz4's
        problem = f"cannot be read as MCAP ({excerpt(str(error) or type(error).__name__, 120)})"
        raise UserError(problem, remedy=_DAMAGED) from None


def _topics(summary: Any) -> tuple[dict[str, str], dict[str, set[int]]]:
    """Topic -> type of message, and -> channels, of those that are read, in the order of their names."""
    types: dict[str, str] = {}
    kinds: dict[str, str] = {}
    channels: dict[str, set[int]] = {}
    for number, channel in sorted(summary.channels.items(), key=lambda item: (item[1].topic, item[0])):
        if not channel.schema_id:
            continue
        schema, topic = summary.schemas[channel.schema_id], channel.topic
        types[topic] = schema.name
        if schema.name not in (*JOINTS, *_NUMBERS, *_ARRAYS):
            continue
        if (channel.message_encoding, schema.encoding) != ("cdr", "ros2msg"):
            others = excerpt(f"{channel.message_encoding}, {schema.encoding}", 40)
            problem = f"'{excerpt(topic, 60)}' is not in messages of ROS 2 (cdr, ros2msg) but in others ({others})"
            raise UserError(problem, remedy="Convert it to ROS 2 messages.")
        if len(schema.data) > _DEFINITION:
            raise UserError(
                f"the definition of {schema.name} for '{excerpt(topic, 60)}' has {len(schema.data):,} bytes, more than "
                f"{_DEFINITION:,}", remedy="Record it with the definition of ROS 2, or leave the topic out.",
            )  # fmt: skip
        kinds[topic] = schema.name
        channels.setdefault(topic, set()).add(number)
    if not any(kind in JOINTS for kind in kinds.values()):
        listed = excerpt(", ".join(f"{topic} ({kind})" for topic, kind in types.items()), 200)
        remedy = "Record a sensor_msgs/JointState, such as /joint_states."
        raise UserError(f"has no topic of joint states, only {listed or 'none'}", remedy=remedy)
    return kinds, channels
