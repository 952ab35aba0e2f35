"""The two ways a run ends early: a person's mistake and a promise that does not hold."""

from __future__ import annotations

from pathlib import Path


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
        where = ": ".join(str(part) for part in (file, key) if part is not None)
        text = f"{where}: {problem}" if where else problem
        if remedy:
            text = f"{text.rstrip('.')}. {remedy}"
        super().__init__(" ".join(text.split()))


class BrokenPromise(SimgapError):
    """A guarantee that does not hold (gamma fails to cover, a controller leaves its domain): the run fails."""

    exit_status = 1

    def __init__(self, problem: str, remedy: str | None = None) -> None:
        text = f"{problem.rstrip('.')}. {remedy}" if remedy else problem
        super().__init__(" ".join(text.split()))
