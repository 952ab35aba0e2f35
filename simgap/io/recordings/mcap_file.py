"""Recordings in MCAP files, as rosbag2 writes them: joint states and commands as plain columns (extra `mcap`).

A `sensor_msgs/JointState` gives columns `<topic>/<joint>/position`, `velocity` and `effort`; a `std_msgs` number
`<topic>/data`, an array of them `<topic>/0`, `<topic>/1` ... The rows are the messages of the first topic of joint
states that is asked for; what comes on other topics is held from its message on, as a command is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.channels import RawTable
from simgap.errors import UserError, excerpt
from simgap.io.recordings.mcap_messages import COLUMN_BYTES, JOINTS, Bag, opened_bag

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
    """What one topic told, by stamps: (n,) instants, ns, ascending, by column (n,) values; notes: on their order."""

    stamps: Ints
    columns: dict[str, Floats]
    notes: tuple[str, ...]


def mcap_header(path: Path, file: str) -> dict[str, str]:
    """Column -> its topic, of all columns that the first messages of each topic have.

    Raises:
        UserError: a damaged file, one that is too large, no topic that is read, or a missing library.
    """
    with opened_bag(path, file) as bag:
        return _header(bag)


def read_mcap(path: Path, wanted: Sequence[str], file: str, sha256: str) -> RawTable:
    """The wanted columns; those that the file lacks are left out.

    Raises:
        UserError: a damaged file or one that is too large, a joint that a message lacks or names twice, numbers that
            are not finite, clocks that do not fit each other.
    """
    with opened_bag(path, file) as bag:
        header = _header(bag)
        chosen = [name for name in dict.fromkeys(wanted) if name in header]
        asked = [topic for topic in bag.kinds if any(header[name] == topic for name in chosen)]
        heard = {topic: _heard(bag, topic, [n for n in chosen if header[n] == topic]) for topic in asked}
    joints = next((topic for topic in asked if bag.kinds[topic] in JOINTS), None)
    if joints is None:  # the reading names what it misses
        return RawTable(file, tuple(header), np.zeros(0, np.int64), "ns", {}, sha256=sha256)
    stamps = heard[joints].stamps
    first, columns = 0, dict(heard[joints].columns)
    for topic, told in heard.items():
        if topic != joints:
            at = np.searchsorted(told.stamps, stamps, side="right") - 1
            first = max(first, int(np.searchsorted(stamps, told.stamps[0])))
            columns |= {name: values[np.maximum(at, 0)] for name, values in told.columns.items()}
            if told.stamps[-1] < stamps[0] and any(np.ptp(values) > 0.0 for values in told.columns.values()):
                raise UserError(
                    f"has no joint state before the last message of '{excerpt(topic, 60)}'", file=file,
                    remedy=_ONE_CLOCK,
                )  # fmt: skip
    if first >= len(stamps):
        raise UserError("has no joint state after the first command", file=file, remedy=_ONE_CLOCK)
    kept = {name: np.ascontiguousarray(columns[name][first:]) for name in chosen}
    notes = tuple(note for told in heard.values() for note in told.notes)
    return RawTable(file, tuple(header), stamps[first:], "ns", kept, sha256=sha256, notes=notes)


def _header(bag: Bag) -> dict[str, str]:
    found: dict[str, str] = {}
    for topic in bag.kinds:
        for _, content in islice(bag.messages(topic), _FIRST):
            for name in _values(topic, content):
                if found.setdefault(name, topic) != topic:
                    raise UserError(
                        f"two topics give a column '{excerpt(name, 80)}': '{excerpt(found[name], 60)}' and "
                        f"'{excerpt(topic, 60)}'", file=bag.file, remedy="Leave one of them out (`mcap filter`).",
                    )  # fmt: skip
            bag.require_room(len(found) * (COLUMN_BYTES + len(topic)))
    return found


def _heard(bag: Bag, topic: str, own: Sequence[str]) -> _Topic:
    """These columns of every message of a topic."""
    stamps, logged = list[int](), list[int]()
    columns: dict[str, list[float]] = {name: [] for name in own}
    for k, (log_time, content) in enumerate(bag.messages(topic)):
        bag.require_room((k + 1) * (len(own) + 2) * _HELD)
        values, twice = _values(topic, content), _twice(topic, content)
        for name in own:
            if name in twice:
                raise UserError(
                    f"message {k + 1} of '{excerpt(topic, 60)}' has '{excerpt(name, 80)}' twice", file=bag.file,
                    remedy="Which of them is meant cannot be told: give each joint a name of its own.",
                )  # fmt: skip
            if name not in values:
                raise UserError(
                    f"message {k + 1} of '{topic}' has no '{name}'", file=bag.file,
                    remedy="Record each robot's joints on a topic of its own.",
                )  # fmt: skip
            if not np.isfinite(values[name]):
                raise UserError(
                    f"message {k + 1} of '{topic}': '{name}' is {values[name]}, not a finite number", file=bag.file,
                    remedy="Leave that column out of the case if its driver does not measure it.",
                )  # fmt: skip
            columns[name].append(values[name])
        stamps.append(_stamp(content))
        logged.append(log_time)
    when = _instants(np.array(stamps, dtype=np.int64), np.array(logged, dtype=np.int64), topic, bag.file)
    order, notes = _in_order(when, np.array(logged, dtype=np.int64), topic, bag.file)
    return _Topic(when[order], {n: np.array(v)[order] for n, v in columns.items()}, notes)


def _instants(stamps: Ints, logged: Ints, topic: str, file: str) -> Ints:
    """Stamps (n,) of headers, or when messages were logged (n,) where no header has one, ns.

    A header that nobody set says 0, and so does a simulated clock at its start.

    Raises:
        UserError: some headers are set and others are not.
    """
    if not stamps.any():
        return logged
    order = np.argsort(logged, kind="stable")
    begun = int(np.argmax(stamps[order] != 0))
    late = np.flatnonzero(stamps[order][begun:] == 0)
    if late.size or (begun and stamps[order][begun] >= _SIMULATED_NS):
        k = int(order[begun + late[0] if late.size else 0]) + 1
        raise UserError(
            f"message {k} of '{excerpt(topic, 60)}' has no stamp in its header, others have", file=file,
            remedy="Let the driver set header.stamp in every message, or in none: when it was logged counts then.",
        )  # fmt: skip
    return stamps


def _in_order(stamps: Ints, logged: Ints, topic: str, file: str) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """The order (n,) of ascending stamps (n,), in ns, and what is to be told of it; equal ones stay as they were logged
    (n,)."""
    order = np.argsort(logged, kind="stable")
    back = np.maximum.accumulate(stamps[order]) - stamps[order]
    if back.max() > _BACK_NS:
        raise UserError(
            f"the clock of '{excerpt(topic, 60)}' goes back by {back.max() / 1e9:.3g} s", file=file,
            remedy="Cut it there (`mcap filter`): each start of the clock is a recording of its own.",
        )  # fmt: skip
    overtaken = int(np.sum(back > 0))
    told = (
        f"{overtaken:,} of {len(stamps):,} messages of '{excerpt(topic, 60)}' "
        f"are stamped before one that was logged earlier, by up to {back.max() / 1e9:.3g} s; they are put in order",
    )
    return order[np.argsort(stamps[order], kind="stable")], told if overtaken else ()


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
