"""One trace of a file becomes uninterrupted pieces: `(stamps, channels, masks) -> pieces and counts`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.reading.channels import unwrap
from simgap.diagnosis.reading.stamps import TimeRange, gap_limit, kept, merge_repeats, pieces
from simgap.diagnosis.thresholds import MIN_SAMPLES


@dataclass(frozen=True, eq=False)
class Split:
    """Pieces of one trace, and how many rows or pieces were treated how.

    Attributes:
        pieces: stamps (n,) and channels (n, m) of each.
        samples: rows with stamps of their own.
        unwrapped: columns that jumped by full turns.
    """

    pieces: tuple[tuple[Floats, Floats], ...]
    samples: int
    repeated: int = 0
    masked: int = 0
    gaps: int = 0
    short_pieces: int = 0
    short_rows: int = 0
    unwrapped: tuple[int, ...] = ()


def split(
    t: Floats,
    block: Floats,
    turns: Mapping[int, tuple[float, bool | None]],
    ranges: Sequence[TimeRange],
    gap_s: float | None,
    window_s: float,
) -> Split:
    """The pieces of a trace that are at least a window long.

    Args:
        t: (n,) stamps in s, not decreasing.
        block: (n, m) channels.
        turns: for the columns that may be wrapped: a full turn, and whether they are (None: the data decide).
        ranges: stretches to keep or to drop.
        gap_s: a longer interval (s) ends a piece; None: `gap_limit` of the intervals.
        window_s: shortest piece (s).
    """
    if not np.any(np.diff(t) > 0.0):
        return Split((), samples=min(t.size, 1), short_pieces=1, short_rows=int(t.size))
    block, unwrapped = _unwrapped(t, block, turns)  # before repeats are averaged: a mean across a wrap is neither side
    t, block, repeated = merge_repeats(t, block)
    inside = kept(t, ranges)
    steps = np.diff(t)
    limit = gap_limit(steps) if gap_s is None else gap_s
    out, short = [], []
    for piece in pieces(t, inside, limit):
        long = t[piece.stop - 1] - t[piece.start] >= window_s * (1 - 1e-9) and piece.stop - piece.start >= MIN_SAMPLES
        if long:
            out.append((t[piece], block[piece]))
        else:
            short.append(piece.stop - piece.start)
    return Split(
        tuple(out),
        samples=int(t.size),
        repeated=repeated,
        masked=int(np.count_nonzero(~inside)),
        gaps=int(np.count_nonzero((steps > limit) & inside[1:] & inside[:-1])),
        short_pieces=len(short),
        short_rows=sum(short),
        unwrapped=unwrapped,
    )


def _unwrapped(
    t: Floats, block: Floats, turns: Mapping[int, tuple[float, bool | None]]
) -> tuple[Floats, tuple[int, ...]]:
    steps = np.diff(t)
    typical = float(np.median(steps[steps > 0.0]))
    changed: list[int] = []
    for j, (turn, wrapped) in turns.items():
        straight, jumped = unwrap(block[:, j], steps, typical, turn, wrapped)
        if jumped:
            block = block.copy() if not changed else block
            block[:, j] = straight
            changed.append(j)
    return block, tuple(changed)
