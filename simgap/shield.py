"""The admissible inputs of a controller as a filter around any other one: a learned policy, a planner, a person.

    shield = Shield(load_controller("controller.npz"))
    u = shield(x, policy(x))                                # at every sample; `shield.reset()` before a run

An input that the controller admits passes; of any other the nearest admissible one is given. The promise is the
controller's, from every state of its winning domain, because what is applied is always admitted there. It is made for
the inputs of the finite set U and no others, so what is given is a member of U: an input between two of them becomes
the nearest admissible member, even where both are admissible. The shield has *acted* where it gave another member than
the nearest of all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.synthesis.controller import Controller
from simgap.synthesis.input_sets import unpack


class Shield:
    """A filter that gives an input if the controller admits it, else the nearest input that it admits.

    Distances are Euclidean, each input divided by its range in U; of two at the same distance the first in U is taken.
    An input outside the range of U counts as its end, as an actuator that saturates takes it.

    Attributes:
        controller: which inputs are admissible where.
        memory: what the controller remembers, of a run that the shield itself follows: kept by `shield(x, u)`.
        steps, acted: samples since the shield was made, and at how many of them the nearest member of U was refused.

    Raises:
        UserError: a controller that records one input a cell.
    """

    def __init__(self, controller: Controller) -> None:
        if controller.solution.chosen is not None:
            raise UserError(
                "the controller records one input a cell, so a shield could give no other", key="synthesis.record",
                remedy="Remove `record: one` and run the synthesis again.",
            )  # fmt: skip
        self.controller = controller
        self._low, self._high = controller.input_set.min(axis=0), controller.input_set.max(axis=0)
        self._scale = np.where(self._high > self._low, self._high - self._low, 1.0)
        self.steps = self.acted = 0
        self.reset()

    def reset(self) -> None:
        """Begin a run: nothing has been chosen yet."""
        self.memory = self.controller.first

    def __call__(self, x: ArrayLike, u: ArrayLike) -> Floats:
        """The input to apply at the measured state x (nx,) where u (nu,) is wanted, and a sample passes: -> (nu,).

        As `Controller.input` says, it is to be applied a sample later where there is latency.

        Raises:
            BrokenPromise, UserError: as `filter`; no sample has passed then.
        """
        given, wanted = self._given(x, u, self.memory)
        _, self.memory = self.controller.solution.step(self.memory, given, self.controller.cell(x)[0])
        self.count(given, wanted)
        return self.controller.input_set[given].copy()

    def count(self, given: int, wanted: int) -> None:
        """Count a sample at which input `given` was applied and `wanted` was the nearest of all, by their numbers."""
        self.steps += 1
        self.acted += given != wanted

    def filter(self, x: ArrayLike, u: ArrayLike, pending: int | None = None) -> Floats:
        """The same for one state, of a controller that remembers `pending`; nothing is kept or counted.

        Raises:
            BrokenPromise: outside the winning domain, or in the target, where the task is done.
            UserError: what is no state or no input of this controller; no `pending`, where it remembers something.
        """
        if pending is None and self.controller.memory > 1:
            raise UserError(
                "this controller remembers more than the state (a pending input, the class of the previous one, what "
                "its task has come to), and the filter is not told what",
                remedy="Give its memory as `pending`, `controller.first` at the first sample; or use shield(x, u).",
            )
        return self.controller.input_set[self._given(x, u, pending)[0]].copy()

    def numbers(self, x: ArrayLike, u: ArrayLike, pending: int | None = None) -> tuple[int, int]:
        """Number of the nearest admissible input at x (nx,), -1 where there is none, and of the nearest of all of U."""
        far = self._distances(u)
        row = int(self.controller.rows(np.asarray(x)[None], pending)[0])
        count, wanted = len(far), int(np.argmin(far))
        if row < 0:
            return -1, wanted
        admitted = unpack(self.controller.solution.admitted(count, [row])[0], count)
        return (int(np.argmin(np.where(admitted, far, np.inf))) if admitted.any() else -1), wanted

    def _given(self, x: ArrayLike, u: ArrayLike, pending: int | None) -> tuple[int, int]:
        given, wanted = self.numbers(x, u, pending)
        if given < 0:
            raise BrokenPromise(
                f"the shield has no admissible input at {np.asarray(x).tolist()}",
                "Outside the winning domain nothing is promised; in a target the task is done.",
            )
        return given, wanted

    def _distances(self, u: ArrayLike) -> Floats:
        """Squared distances from u (nu,) to all of U, (M,): the operations of an export, in their order."""
        wanted, names = np.asarray(u, dtype=np.float64), ", ".join(self.controller.input_names)
        if wanted.shape != self._low.shape or np.isnan(wanted).any():
            raise UserError(f"an input is {self._low.size} numbers ({names}), not {np.asarray(u).tolist()!r:.60}")
        off = (np.clip(wanted, self._low, self._high) - self.controller.input_set) / self._scale
        far = np.zeros(len(off))
        for axis in off.T:
            far += axis * axis
        return far
