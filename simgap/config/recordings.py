"""The recordings that a case names: files, and patterns that stand for several."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from simgap import reading
from simgap.errors import UserError, excerpt

_SIGNS = "*?["
MOST = 10_000
"""Files that a pattern may stand for."""


def matching(folder: Path, names: Sequence[str], typed: bool = False) -> list[tuple[int, Path]]:
    """The files behind names, each with the place of the name that brought it.

    A name with `*`, `?` or `[` that is no file itself stands for the files of the folder that match it, sorted; `**`
    for folders below. A name that nothing matches stays as it is, and a file that several names bring comes once.

    Args:
        folder: where names start from; names: as `measured.files` lists them.
        typed: whether a person typed them, who may look anywhere; a case may come from a stranger.

    Raises:
        UserError: a pattern that leads out of the folder, or matches too much.
    """
    found: dict[Path, int] = {}
    for place, name in enumerate(names):
        path = folder / name
        hits = [path]
        if any(s in name for s in _SIGNS) and not path.exists():
            hits = _files(folder, name, None if typed else f"measured.files.{place}") or [path]
        for hit in hits:
            found.setdefault(hit, place)
    return [(place, path) for path, place in found.items()]


def _files(folder: Path, pattern: str, key: str | None) -> list[Path]:
    """Files that match, sorted; none where it is no pattern (`**` stands alone between slashes)."""
    anchor = Path(pattern).anchor
    if key is not None and (anchor or ".." in Path(pattern).parts):
        raise UserError(
            f"the pattern '{excerpt(pattern, 60)}' leads out of the case's folder", key=key,
            remedy="Name the files one by one, or put the case beside them.",
        )  # fmt: skip
    try:
        found = list(islice((folder / anchor).glob(pattern.removeprefix(anchor)), MOST + 1))
    except ValueError:
        return []
    if len(found) > MOST:
        raise UserError(
            f"the pattern '{excerpt(pattern, 60)}' stands for more than {MOST} files", key=key, remedy="Narrow it."
        )
    return sorted(path for path in found if reading.is_file(path))
