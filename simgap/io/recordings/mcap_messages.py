"""Messages of MCAP files, unpacked a chunk at a time and never beyond the room there is (extra `mcap`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

from simgap import reading
from simgap.errors import UserError, excerpt, optional, placed
from simgap.reading import require_room

MAGIC = b"\x89MCAP0\r\n"
JOINTS = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
COLUMN_BYTES = 512  # what a column of a decoded message may take, beside the topic in its name
_NUMBERS = tuple(f"std_msgs/{way}{kind}" for way in ("msg/", "") for kind in ("Float64", "Float32"))
_ARRAYS = tuple(f"{name}MultiArray" for name in _NUMBERS)
_LEAST = 4  # bytes of a packed number
_DEFINITION = 16_384
"""Bytes of a type's definition: those that are read have some 3,000 with all their comments, and parsing takes longer
than it grows (25 s for 300,000 fields)."""
_DAMAGED = "Copy it again, or mend it (`mcap recover`)."


def is_mcap(path: Path) -> bool:
    """Whether a file begins as MCAP files do."""
    try:
        with reading.opened(path) as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror}", file=path) from None


@dataclass(frozen=True)
class Bag:
    """An open recording.

    Attributes:
        kinds: topic -> type of message, of those that are read, in the order of their names.
        channels: topic -> numbers of its channels.
    """

    file: str
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
                self.require_room(len(record.data) // _LEAST * (COLUMN_BYTES + len(topic)))
                channel = self.summary.channels[record.channel_id]
                decode = factory.decoder_for(channel.message_encoding, self.summary.schemas[channel.schema_id])
                yield int(record.log_time), decode(record.data)

    def require_room(self, size: int) -> None:
        """Refuse so many bytes if they are too many; the message names the file."""
        with placed(file=self.file):
            require_room(size)

    def _records(self, channels: set[int]) -> Iterator[Any]:
        """What the file holds, but for chunks that say they have none of these channels."""
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
        self.require_room(size)
        plain = {"zstd": _zstd, "lz4": _lz4, "": _plain}[chunk.compression](chunk.data, size)
        if len(plain) != size or (chunk.uncompressed_crc and crc32(plain) != chunk.uncompressed_crc):
            raise ValueError("a chunk does not fit its length or checksum")
        with suppress(EndOfFile):  # one at a time: small records take ten times their bytes
            yield from StreamReader(BytesIO(plain), skip_magic=True, emit_chunks=True).records


def _plain(data: bytes, size: int) -> bytes:
    """As it is."""
    return data


def _zstd(data: bytes, size: int) -> bytes:
    """Unpacked, `size` bytes at most: a frame that tells its length gets that much memory whatever it holds."""
    import zstandard

    told = zstandard.get_frame_parameters(data).content_size
    if told not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError("a chunk does not fit its length")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _lz4(data: bytes, size: int) -> bytes:
    """Unpacked, one byte more than `size` at most."""
    from lz4.frame import LZ4FrameDecompressor

    return bytes(LZ4FrameDecompressor().decompress(data, max_length=size + 1))


@contextmanager
def opened_bag(path: Path, file: str) -> Iterator[Bag]:
    """A recording of ROS 2; whatever a damaged file does to its reader becomes one line.

    Raises:
        UserError: a damaged file, no topic that is read, or a missing library.
    """
    with optional("the library for MCAP files", "mcap", file=file, key=None):
        import mcap_ros2.decoder  # noqa: F401
        from mcap.reader import make_reader
    try:
        with reading.opened(path) as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            if summary is None:
                raise UserError("has no summary: its recording was cut off", file=file, remedy=_DAMAGED)
            kinds, channels = _topics(summary, file)
            yield Bag(file, stream, summary, kinds, channels)
    except (UserError, MemoryError):
        raise
    except Exception as error:  # the libraries raise their own, struct's, zstandard's and lz4's
        raise UserError(
            f"cannot be read as MCAP ({excerpt(str(error) or type(error).__name__, 120)})", file=file, remedy=_DAMAGED
        ) from None


def _topics(summary: Any, file: str) -> tuple[dict[str, str], dict[str, set[int]]]:
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
            said = excerpt(f"{channel.message_encoding}, {schema.encoding}", 40)
            raise UserError(
                f"'{excerpt(topic, 60)}' is not in messages of ROS 2 (cdr, ros2msg) but in others ({said})", file=file,
                remedy="Convert it to ROS 2 messages.",
            )  # fmt: skip
        if len(schema.data) > _DEFINITION:
            raise UserError(
                f"the definition of {schema.name} for '{excerpt(topic, 60)}' has {len(schema.data):,} bytes, more than "
                f"{_DEFINITION:,}", file=file, remedy="Record it with the definition of ROS 2, or leave the topic out.",
            )  # fmt: skip
        kinds[topic] = schema.name
        channels.setdefault(topic, set()).add(number)
    if not any(kind in JOINTS for kind in kinds.values()):
        listed = excerpt(", ".join(f"{topic} ({kind})" for topic, kind in types.items()), 200)
        raise UserError(
            f"has no topic of joint states, only {listed or 'none'}", file=file,
            remedy="Record a sensor_msgs/JointState, such as /joint_states.",
        )  # fmt: skip
    return kinds, channels
