"""Messages to a person: a mistake or a broken promise, which end a run early, and a finding, which does not."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from simgap.notation import one_line

MOST_ECHOED = 120
"""Characters of a person's input that a message repeats."""
_LONGEST = 600  # of one part of a message; a last resort against parts that were not cut before


class SimgapError(Exception):
    """Base of every error that simgap raises on purpose; its text is always one line."""

    exit_status = 1


class UserError(SimgapError):
    """A mistake in what a person gave: which file, which key or row, what is wrong, what to do.

    The command line prints it as one line on stderr and leaves with status 2.
    """

    exit_status = 2

    def __init__(
        self, problem: str, *, file: str | Path | None = None, key: str | None = None, remedy: str | None = None
    ) -> None:
        self.problem, self.file, self.key, self.remedy = problem, file, key, remedy
        place = (None if file is None else str(file), None if key is None else excerpt(key))
        where = ": ".join(part for part in place if part is not None)
        problem = excerpt(problem, _LONGEST)
        text = f"{where}: {problem}" if where else problem
        if remedy:
            text = f"{text.rstrip('.')}. {excerpt(remedy, _LONGEST)}"
        super().__init__(one_line(text))


@contextmanager
def placed(*, file: str | Path | None = None, key: str | None = None, remedy: str | None = None) -> Iterator[None]:
    """Mistakes of what is done within are told with this file and key where they name none, and with this remedy."""
    try:
        yield
    except UserError as error:
        located = (file if error.file is None else error.file, error.key or key, remedy or error.remedy)
        if located == (error.file, error.key, error.remedy):
            raise
        raise UserError(error.problem, file=located[0], key=located[1], remedy=located[2]) from None


def nearest(name: str, known: Iterable[str]) -> str:
    """Remedy for a name that nothing has: the nearest one that is known, else all of them."""
    every = list(known)
    near = difflib.get_close_matches(name, every, n=1)
    return f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(every)}."


@contextmanager
def optional(
    product: str, extra: str, *, file: str | Path | None = None, key: str | None = "simulator.engine"
) -> Iterator[None]:
    """Imports of a package that is not installed with every simgap: where it is missing, one line names the extra.

    Raises:
        UserError: an import failed.
    """
    try:
        yield
    except ImportError:
        remedy = f"Install the extra: pip install 'simgap[{extra}]'."
        raise UserError(f"{product} is not installed", file=file, key=key, remedy=remedy) from None


class BrokenPromise(SimgapError):
    """A guarantee that does not hold (gamma fails to cover, a controller leaves its domain): the run fails."""

    exit_status = 1

    def __init__(self, problem: str, remedy: str | None = None) -> None:
        text = f"{problem.rstrip('.')}. {remedy}" if remedy else problem
        super().__init__(one_line(text))


@dataclass(frozen=True)
class Finding:
    """Surprise for a person, for which no run is refused: key or part of a file, what happens, what to do."""

    key: str
    problem: str
    remedy: str


def excerpt(value: object, longest: int = MOST_ECHOED) -> str:
    """The text of `value`, its middle left out if it is longer than a message should repeat."""
    text = str(value)
    half = (longest - 5) // 2
    return text if len(text) <= longest else f"{text[:half]} ... {text[-half:]}"
