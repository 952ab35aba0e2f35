"""What became of the columns of recordings, in words: read under another name, not there, or not used."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from simgap.diagnosis.reading.channels import Channel
from simgap.diagnosis.reading.table import RawTable
from simgap.errors import excerpt

LONGEST = 160
"""Characters of a list of columns; some recordings have hundreds."""


def column_words(tables: Sequence[RawTable], channels: Sequence[Channel], others: Collection[str]) -> tuple[str, ...]:
    """A line for each file, or one for all where they are alike; none where every column has the name of its state.

    Args:
        others: columns that are neither a state nor an input, such as those of time and of traces.
    """
    told = [(table.file, "; ".join(_words(table.header, channels, others))) for table in tables]
    if len({words for _, words in told}) == 1:
        return tuple(f"Columns: {words}." for _, words in told[:1] if words)
    return tuple(f"Columns of {file}: {words}." for file, words in told if words)


def _words(header: Sequence[str], channels: Sequence[Channel], others: Collection[str]) -> Iterator[str]:
    read = [c for c in channels if c.constant is None and c.column in header]
    renamed = [f"{c.name} is read from '{excerpt(c.column, 40)}'" for c in read if c.column != c.name]
    if renamed:
        yield excerpt(", ".join(renamed), LONGEST)
    left = [name for name in header if name not in others and name not in {c.column for c in read}]
    lacking = [c.name for c in channels if c.constant is None and c.column not in header]
    if left:
        names = excerpt(", ".join(f"'{name}'" for name in left), LONGEST)
        yield f"{names} {'is' if len(left) == 1 else 'are'} not used, as the model has no such state or input"
    if lacking and left:  # else velocities that nobody measured, as in most recordings
        count, it = ("count", "one of them") if len(lacking) > 1 else ("counts", "it")
        yield f"{', '.join(lacking)} {count} as not measured (name a column that is {it} under measured.columns)"
