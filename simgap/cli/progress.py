"""How far a command is: a line that changes on a terminal, now and then a line where the output goes elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

EVERY_S = 30.0


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """Gives what is to be told of progress, in words; it goes to stderr."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(escape(first)) as status:
            yield lambda words: status.update(escape(words))
        return
    said = time.monotonic()

    def tell(words: str) -> None:
        nonlocal said
        if time.monotonic() - said >= EVERY_S:
            said = time.monotonic()
            sys.stderr.write(f"{words}\n")
            sys.stderr.flush()

    yield tell
