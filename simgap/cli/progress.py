"""How far a command is: a line that changes on a terminal, now and then a line where the output goes elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from simgap.cli.terminal import console, say
from simgap.notation import printable

EVERY_S = 30.0


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """Gives what is to be told of progress, in words; it goes to stderr."""
    from rich.text import Text

    terminal = console(stderr=True)
    if terminal.is_terminal:
        with terminal.status(Text(first)) as status:
            yield lambda words: status.update(Text(printable(words)))
        return
    said = time.monotonic()

    def tell(words: str) -> None:
        nonlocal said
        if time.monotonic() - said >= EVERY_S:
            said = time.monotonic()
            say(words, err=True)

    yield tell
