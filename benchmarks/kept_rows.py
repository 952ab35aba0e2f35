"""Studies of many records: what is asked for, and rows that are kept as soon as they are there."""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def asked(
    doc: str | None, plants: Iterable[str], kinds: Iterable[str], usual: Sequence[str] = ()
) -> argparse.Namespace:
    """The command line of a study: plants (the `usual` ones if none are named), kinds, seeds, budget, again."""
    plants, kinds = list(plants), list(kinds)
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=list(usual) or plants, choices=plants)
    parser.add_argument("--kinds", nargs="*", default=kinds, choices=kinds)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--budget", type=float, default=None, help="CPU s that a search may take")
    parser.add_argument("--again", action="store_true", help="make again what is there")
    return parser.parse_args()


def places(given: argparse.Namespace, **more: Sequence[Any]) -> Iterator[Row]:
    """Every seed, kind and plant that is asked for, with each combination of what is varied besides."""
    for seed in range(given.first, given.first + given.seeds):
        for kind, plant, *own in itertools.product(given.kinds, given.plants, *more.values()):
            yield {"plant": plant, "kind": kind, **dict(zip(more, own, strict=True)), "seed": seed}


class Rows:
    """The rows of a study in `out` and their table beside it; what is there is not made again unless that is asked."""

    def __init__(self, out: Path, table: Callable[[list[Row]], str], again: bool) -> None:
        self._out, self._table, self._again = out, table, again
        self.known: list[Row] = json.loads(out.read_text()) if out.exists() else []
        out.parent.mkdir(exist_ok=True)

    def make(self, place: Row, one: Callable[[], Row], unsaid: Sequence[str] = ()) -> None:
        """The row of a place, printed but for what is `unsaid`, and written at once."""
        there = [r for r in self.known if all(r[k] == v for k, v in place.items())]
        if there and not self._again:
            return
        row = one()
        self.known = [r for r in self.known if r not in there] + [row]
        print({k: v for k, v in row.items() if k not in unsaid}, flush=True)
        self._out.write_text(json.dumps(self.known, indent=1) + "\n")
        self._out.with_suffix(".md").write_text(self._table(self.known))
