"""The recordings that a case names: files, and patterns that stand for several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

_SIGNS = "*?["


def matching(folder: Path, names: Sequence[str]) -> list[tuple[int, Path]]:
    """The files behind names, each with the place of the name that brought it.

    A name with `*`, `?` or `[` that is no file itself stands for the files that match it, sorted; `**` for
    folders below. A name that nothing matches stays as it is, and a file that several names bring comes once.

    Args:
        folder: where names start from; names: as `measured.files` lists them.
    """
    found: dict[Path, int] = {}
    for place, name in enumerate(names):
        path = folder / name
        hits = [path]
        if any(s in name for s in _SIGNS) and not path.exists():
            parts = Path(name)
            root = Path(parts.anchor) if parts.is_absolute() else folder
            pattern = str(parts.relative_to(parts.anchor)) if parts.is_absolute() else name
            hits = _files(root, pattern) or [path]
        for hit in hits:
            found.setdefault(hit, place)
    return [(place, path) for path, place in found.items()]


def _files(root: Path, pattern: str) -> list[Path]:
    """Files that match, sorted; none where it is no pattern (`**` stands alone between slashes)."""
    try:
        return sorted(p for p in root.glob(pattern) if p.is_file())
    except ValueError:
        return []
