"""A person's function in a process of its own: what goes wrong in it is named with its call, and is bounded in time."""

from __future__ import annotations

import contextlib
import faulthandler
import importlib.util
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.function_file import KEY, FunctionFile
from simgap.errors import UserError, excerpt
from simgap.simulators.process import SharedBytes, Unnamed
from simgap.simulators.watched import LOOK, grown_too_large

ROWS = 1024
"""Most calls (rows of one call, of a function that takes many) that are sent at once."""
STARTING = 60.0
"""Longest time that the file may take to be imported, s."""
TOO_LARGE = 73
"""Exit status of a process that has grown too large."""
_ENDING = 2.0  # seconds that a process is given to end by itself


class FunctionProcess:
    """Calls of `name(x, u, tau, **parameters)` in another process."""

    def __init__(
        self, function: FunctionFile, tau: float, parameters: dict[str, float], batch: bool, timeout: float
    ) -> None:
        """Start the process and import the file.

        Raises:
            UserError: a file that fails, ends its process or takes too long while it is imported.
        """
        context = Unnamed()
        self._function, self._timeout, self._batch = function, timeout, batch
        self._done = SharedBytes(8)
        self._pipe, theirs = context.Pipe()
        job = (theirs, self._done, str(function.path), function.name, tau, parameters, batch, timeout)
        self._process = context.Process(target=_serve, args=job, daemon=True)
        self._process.start()
        theirs.close()
        answer = self._answer(max(STARTING, timeout), lambda: "while it was imported")
        if isinstance(answer, str):
            raise self.fault(answer, "while it was imported")

    def call(self, x: Floats, u: Floats, said: Callable[[Any, Any], str]) -> Floats:
        """(n, nx), (n, nu) -> (n, nx); `said` puts a call into words.

        Raises:
            UserError: the first call that fails, ends the process, takes too long or gives something else than numbers.
        """
        out = np.empty_like(x, dtype=np.float64)
        for first in range(0, len(x), ROWS):
            rows = slice(first, first + ROWS)
            out[rows] = self._block(x[rows], u[rows], said)
        return out

    def _block(self, x: Floats, u: Floats, said: Callable[[Any, Any], str]) -> Floats:
        done = self._done.view.cast("q")

        def where() -> str:
            return said(x[done[0]], u[done[0]])

        done[0] = 0
        try:
            self._pipe.send((x, u))
        except OSError:
            raise self.fault("is not running any more", "before this call") from None
        before = -1
        while not self._batch and not self._pipe.poll(self._timeout) and done[0] != before:
            before = done[0]  # one call more must be done each time
        answer = self._answer(self._timeout if self._batch else 0.0, where)
        if isinstance(answer, str) or answer is None:
            raise self.fault(str(answer), where())
        return answer

    def fault(self, problem: str, where: str) -> UserError:
        """What went wrong, as one line."""
        return UserError(
            f"the function '{self._function.name}' {problem}, {where}", file=self._function.path, key=KEY,
            remedy="Correct it, or leave what it cannot do out of domain.X and domain.U.",
        )  # fmt: skip

    def _answer(self, longest: float, where: Callable[[], str]) -> Floats | str | None:
        if not self._pipe.poll(longest):
            self.close()
            raise self.fault(f"takes longer than {longest or self._timeout:g} s", where())
        try:
            found: Floats | str | None = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join(_ENDING)
            code = self._process.exitcode
            how = f"signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"status {code}"
            if code == TOO_LARGE:
                raise self.fault("takes more than half of the machine's memory", where()) from None
            raise self.fault(f"ends its process ({how})", where()) from None
        return found

    def close(self) -> None:
        """End the process, whatever it does."""
        with contextlib.suppress(OSError):
            self._pipe.close()
        if self._process.is_alive():
            self._process.kill()
        self._process.join(_ENDING)


def _serve(
    pipe: Connection, done: SharedBytes, path: str, name: str, tau: float, parameters: dict[str, float], batch: bool,
    timeout: float,
) -> None:  # fmt: skip
    """The process: import the file, then answer calls until the pipe is closed, by arrays or by what is wrong."""
    threading.Thread(target=_end_with_parent, name="watchdog", daemon=True).start()
    nowhere = open(os.devnull, "w")  # noqa: SIM115 - as long as the process lives
    try:
        function = _imported(Path(path), name)
    except Exception as error:
        pipe.send(f"cannot be imported: {type(error).__name__}: {excerpt(str(error))}")
        return
    pipe.send(None)
    at = done.view.cast("q")
    while True:
        try:
            x, u = pipe.recv()
        except (EOFError, OSError):
            return
        # Ends the process even where C code holds the interpreter and whoever started it is gone.
        faulthandler.dump_traceback_later(STARTING + timeout * len(x), exit=True, file=nowhere)
        try:
            answer: Floats | str = _many(function, x, u, tau, parameters) if batch else np.empty_like(x)
            for k in range(0 if batch else len(x)):
                at[0] = k
                answer[k] = _row(function(x[k].copy(), u[k].copy(), tau, **parameters), x[k].shape)  # type: ignore[index]
        except _NoStateError as error:
            answer = str(error)
        except Exception as error:
            answer = f"fails: {type(error).__name__}: {excerpt(str(error))}{_line(error, path)}"
        faulthandler.cancel_dump_traceback_later()
        pipe.send(answer)


class _NoStateError(Exception):
    """A result that is no state."""


def _many(function: Callable[..., Any], x: Floats, u: Floats, tau: float, parameters: dict[str, float]) -> Floats:
    return _row(function(x.copy(), u.copy(), tau, **parameters), x.shape)


def _row(result: Any, shape: tuple[int, ...]) -> Floats:
    try:
        found = np.asarray(result, dtype=np.float64)
    except (TypeError, ValueError):
        raise _NoStateError(f"gives {excerpt(repr(result), 60)}, which is no array of numbers") from None
    if found.shape != shape:
        raise _NoStateError(f"gives an array {found.shape} instead of {shape}")
    return found


def _line(error: BaseException, path: str) -> str:
    """The line of the file where it failed."""
    trace, found = error.__traceback__, ""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == path:
            found = f" (line {trace.tb_lineno})"
        trace = trace.tb_next
    return found


def _imported(path: Path, name: str) -> Callable[..., Any]:
    sys.dont_write_bytecode = True  # what runs is what was hashed
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(f"simgap_function_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path.name} cannot be read")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    function = getattr(module, name)
    if not callable(function):
        raise TypeError(f"'{name}' is no function")
    found: Callable[..., Any] = function
    return found


def _end_with_parent() -> None:
    """Follow whoever started this process: a killed run leaves no function running, nor one that takes all memory."""
    parent = multiprocessing.parent_process()
    while parent is not None and not wait([parent.sentinel], timeout=LOOK):
        if grown_too_large():
            os._exit(TOO_LARGE)
    os._exit(1)
