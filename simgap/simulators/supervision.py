"""Simulators that are a person's code (a function, an FMU, a plug-in engine): bounded in time, checked, and tried.

An engine's process notes which call it is in, where the process that waits for it can see it. A call that takes too
long ends the process by an alarm of the system, which C code cannot hold up; a process that grows too large ends
itself. Either way, and after a crash, the run is told what was being computed.

Whether the simulator is a map of x and u is tried: the same calls, spread over X and U, are made twice, in another
order and after a pause, and again after every larger block of roll-outs: what differs then depends on what ran before,
on chance or on a clock. A second step must be the step that begins where the first ended: what differs there is state
that x does not have; with noise, drawn alike in both, also noise that depends on earlier steps. A trial is no proof.
"""

from __future__ import annotations

import math
import os
import signal
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.simulators.base import Simulator

T = TypeVar("T")
CALLS, PAUSE, BLOCK = 16, 0.05, 64
"""How many calls, the pause before they are made again, s, and rows of a block after which they are. A block is
four times as many as the calls; all judgement."""
REMEMBERS = 1e-6
"""Largest relative deviation of a second step from one that begins where the first ended: room for a solver of
variable step. Judgement."""
DECLARE = (
    "Declare its memory: as states of the plant (plant.states), or by hidden_state for a robot in the plane. "
    "Fix its seeds. If it is to be random: simulator.stochastic: true, and draw from the `rng` that it then gets."
)


def describe_call(names: tuple[Sequence[str], Sequence[str]], x: Any, u: Any) -> str:
    """A call in words: the names of states and inputs with their values, none of x if it is None."""
    pairs = [] if x is None else list(zip(names[0], x, strict=False))
    pairs += list(zip(names[1], u, strict=False))
    return "at " + ", ".join(f"{name} = {float(value):.9g}" for name, value in pairs)


def try_as_map(simulator: Simulator, case: Case) -> Simulator:
    """The same simulator, tried at its first roll-outs, after them.

    Its `rollouts` raise UserError where it answers the same call in two ways, or has more state than the case.
    """
    if case.domain is None:
        return simulator
    own: Any = simulator
    probe, rollouts, tried = _Probe(simulator, case), own.rollouts, [False]

    def rollouts_tried(x: Floats, u: Floats) -> Floats:
        following: Floats = rollouts(x, u)
        if not tried[0]:
            tried[0] = True
            probe.begin(rollouts)
        elif len(x) >= BLOCK:
            probe.repeat(rollouts)
        return following

    own.rollouts = rollouts_tried
    return simulator


class _Probe:
    """Calls spread over X and U, and what was answered first."""

    def __init__(self, simulator: Simulator, case: Case) -> None:
        self._simulator, self._rng = simulator, np.random.default_rng(0)
        self._names = list(case.plant.states), list(case.plant.inputs)
        self._is_random = case.is_random
        self._whole = case.hidden_state is None and (case.is_random or not simulator.remembers)
        domain: Any = case.domain
        lo, hi = np.array([domain.X[name] for name in self._names[0]]).T
        share = np.stack([self._rng.permutation(CALLS) for _ in self._names[0]], axis=1)
        self._x = lo + (hi - lo) * (share + self._rng.random(share.shape)) / CALLS
        values = [self._rng.choice(domain.U[name].list(), CALLS) for name in self._names[1]]
        self._u = np.stack(values, axis=1) if values else np.zeros((CALLS, 0))

    def begin(self, rollouts: Any) -> None:
        self._first = np.array(rollouts(self._x.copy(), self._u.copy()))
        time.sleep(PAUSE)
        self.repeat(rollouts)
        if self._whole:
            self._second_steps()

    def repeat(self, rollouts: Any) -> None:
        order = self._rng.permutation(CALLS)
        again = rollouts(self._x[order], self._u[order])
        for k in np.flatnonzero((again != self._first[order]).any(axis=1))[:1]:
            where = describe_call(self._names, self._x[order[k]], self._u[order[k]])
            raise UserError(
                f"the simulator gives two results for the same call, {where}: it keeps a state, draws random numbers "
                "or reads a clock", key="simulator", remedy=DECLARE,
            )  # fmt: skip

    def _second_steps(self) -> None:
        simulator = self._simulator
        for x, u, other in zip(self._x, self._u, np.roll(self._u, CALLS // 2, axis=0), strict=True):
            simulator.reset(x.copy())
            middle = simulator.advance(u).copy()
            stream = simulator.rng.bit_generator.state if self._is_random else {}
            onward = simulator.advance(other).copy()
            simulator.reset(middle.copy())
            if self._is_random:
                simulator.rng.bit_generator.state = stream  # both steps under the same noise
            off = np.abs(onward - simulator.advance(other)) > REMEMBERS * np.maximum(1.0, np.abs(onward))
            if off.any():
                name = self._names[0][int(np.argmax(off))]
                raise UserError(
                    f"the simulator has more state than the case: a second step moves {name} otherwise than a step "
                    f"that begins where the first ended, {describe_call(self._names, x, u)}",
                    key="simulator", remedy=DECLARE,
                )  # fmt: skip


KEY = "simulator"
REMEDY = "Correct the engine, or exclude what it cannot do from domain.X and domain.U."
NOTE = 4096
"""Bytes in which a process notes the call that it is in."""
LOOK = 1.0
"""Seconds between two looks at the memory of an engine's process."""
LARGEST = 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
"""Bytes that it may hold: half of the machine's memory, as `budget.memory` where it is not given."""
_HEAD = struct.Struct("=iidd")  # 1 in a call, 2 too large; bytes of text; when it began; how long it may take


class Note:
    """Note of what a process is doing, in memory that it shares with the one that waits for it."""

    def __init__(self, place: Any) -> None:
        """`place` are NOTE bytes of shared memory."""
        self._view = memoryview(place).cast("B")

    def begin(self, what: str, longest: float) -> None:
        """A call begins; the process ends if it takes longer (s)."""
        text = what.encode(errors="replace")[: NOTE - _HEAD.size]
        self._view[_HEAD.size : _HEAD.size + len(text)] = text
        _HEAD.pack_into(self._view, 0, 1, len(text), time.monotonic(), longest)
        signal.setitimer(signal.ITIMER_REAL, longest)

    def end(self) -> None:
        """It has ended."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _HEAD.pack_into(self._view, 0, 0, 0, 0.0, 0.0)

    def too_large(self) -> None:
        """The process ends because it has grown too large."""
        _, length, began, longest = _HEAD.unpack_from(self._view)
        _HEAD.pack_into(self._view, 0, 2, length, began, longest)

    def message(self) -> str | None:
        """The call that a process was in when it ended, and how; None if it was in none."""
        state, length, began, longest = _HEAD.unpack_from(self._view)
        if state == 0:
            return None
        text = bytes(self._view[_HEAD.size : _HEAD.size + length]).decode(errors="replace")
        if state == 2:
            return f"its memory grew beyond the limit of a stage, {text}"
        late = time.monotonic() - began >= longest
        return f"it takes longer than {longest:g} s, {text}" if late else f"it died {text}"


_note: Note | None = None


def note_in(place: Any) -> Note:
    """Let this process, an engine's, note its calls there."""
    global _note
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process, whatever holds the interpreter
    _note = Note(place)
    return _note


def is_too_large() -> bool:
    """True if this process holds more memory than an engine may; not where the system does not say."""
    try:
        with open("/proc/self/statm") as stream:
            return int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") > LARGEST
    except OSError:
        return False


def bounded(what: str, longest: float, run: Callable[[], T]) -> T:
    """The result of `run`; where this is an engine's process, it ends if that takes longer (s), and `what` is told."""
    if _note is None:
        return run()
    _note.begin(what, longest)
    try:
        return run()
    finally:
        _note.end()


WATCHED = ("reset", "advance", "rollouts", "responses", "chain")
"""Calls of an engine that run code of its author; the last two of a robot that records its path."""


class Supervisor:
    """Watches the calls of an engine in its place: bounds their time, and checks what they give."""

    def __init__(self, engine: Any, name: str, names: tuple[Sequence[str], Sequence[str]], longest: float) -> None:
        """`name`: of the engine in the case; `names`: of states and inputs; `longest`: time of one call, s."""
        self._calls = {call: getattr(engine, call) for call in WATCHED if hasattr(engine, call)}
        self._steps_alone = type(engine).rollouts is Simulator.rollouts
        self._name, self._names, self._longest = name, names, longest
        self._x: Floats | None = None
        pairs = (f"{name.replace('%', '%%')} = %.9g" for name in (*names[0], *names[1]))
        self._step = f"at {', '.join(pairs)}"
        for call in self._calls:
            setattr(engine, call, getattr(self, call))

    def reset(self, x: Floats) -> None:
        """See `Simulator.reset`."""
        self._x = np.array(x)
        self._call("reset", f"while it is reset {describe_call(self._names, x, ())}", x)

    def advance(self, u: Floats) -> Floats:
        """See `Simulator.advance`."""
        before = self._x
        what = describe_call(self._names, None, u) if before is None else self._step % (*before.tolist(), *u.tolist())
        following = self._state(self._call("advance", what, u), before, u)
        self._x = following.copy()
        return following

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """See `Simulator.rollouts`."""
        if len(x) == 0 or self._steps_alone:  # a step at a time, each watched
            return np.asarray(self._calls["rollouts"](x, u), dtype=np.float64)
        what = f"in {len(x)} roll-outs from {describe_call(self._names, x[0], u[0])}"
        rows = np.asarray(self._call("rollouts", what, x, u, calls=len(x)), dtype=np.float64)
        if rows.shape != (len(x), len(self._names[0])):
            raise self._fault(f"gives an array {rows.shape}", x[0], u[0])
        for k in np.flatnonzero(~np.isfinite(rows).all(axis=1))[:1]:
            self._state(rows[k], x[k], u[k])
        return rows

    def responses(self, history: Floats, inputs: Floats, heading: float = 0.0) -> Floats:
        """See `PathSimulator.responses`; a call may take as long as its steps."""
        what, calls = f"after {len(history)} inputs", len(inputs) * (len(history) + 1)
        return self._finite(self._call("responses", what, history, inputs, heading, calls=calls), inputs)

    def chain(self, start: Floats, inputs: Floats) -> tuple[Floats, Floats]:
        """See `PathSimulator.chain`; a call may take as long as its steps."""
        what = describe_call(self._names, start, inputs[0])
        poses, paths = self._call("chain", what, start, inputs, calls=len(inputs))
        return self._finite(poses, inputs), self._finite(paths, inputs)

    def _call(self, name: str, what: str, *arguments: Any, calls: int = 1) -> Any:
        return bounded(what, self._longest * max(1, calls), lambda: self._calls[name](*arguments))

    def _state(self, result: Any, x: Floats | None, u: Floats) -> Floats:
        """The result of a step as (nx,), refused if it is none."""
        found, states = np.asarray(result, dtype=np.float64), self._names[0]
        if found.shape != (len(states),):
            raise self._fault(f"gives an array {found.shape} instead of ({len(states)},)", x, u)
        if not math.isfinite(float(found @ found)) and not np.isfinite(found).all():
            bad = [f"{n} = {v:g}" for n, v in zip(states, found, strict=True) if not math.isfinite(v)]
            raise self._fault(f"gives {', '.join(bad)}", x, u)
        return found

    def _finite(self, found: Floats, inputs: Floats) -> Floats:
        if not np.isfinite(found).all():
            raise self._fault("gives a path that is not finite", None, inputs[0])
        return found

    def _fault(self, problem: str, x: Floats | None, u: Floats) -> UserError:
        where = describe_call(self._names, x, u)
        return UserError(f"the engine '{self._name}' {problem}, {where}", key=KEY, remedy=REMEDY)
