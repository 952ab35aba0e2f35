"""What a search spends and has found so far: progress in words, a budget, and an end on request."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

TOLD_EVERY_S = 5.0  # progress, where no answer is better


class Stopped(Exception):
    """A search that ends before it is done: its budget is spent."""


@dataclass(eq=False)
class Watch:
    """One for a whole diagnosis.

    Attributes:
        budget_s: seconds of CPU time that searching may take; None: all it needs.
        tell: told in words how far it is.
        begun: CPU time at the start, s; told: when something was told last, s; sets: how many sets were fitted.
        best: the best answer so far, in words.
        stopped: why it ended early ("" if it did not); what follows then is neither counted nor interrupted.
        over: whether a set was chosen: what is fitted after it, to say what else there is, is not held to the budget.
    """

    budget_s: float | None = None
    tell: Callable[[str], None] = lambda words: None
    begun: float = field(default_factory=time.process_time)
    told: float = 0.0
    sets: int = 0
    best: str = ""
    stopped: str = ""
    over: bool = False

    @property
    def left(self) -> float | None:
        """What is left of the budget, s; at least a second."""
        return None if self.budget_s is None else max(self.budget_s - (time.process_time() - self.begun), 1.0)

    def step(self, best: str) -> None:
        """One set of effects was fitted, and this is the best answer so far.

        Raises:
            Stopped: if the budget is spent.
        """
        now = time.process_time() - self.begun
        self.sets += 1
        if best != self.best or now - self.told > TOLD_EVERY_S:
            self.best, self.told = best, now
            self.tell(
                f"{self.sets} set{'s' * (self.sets > 1)} of effects fitted in {now:.0f} s of CPU; best so far: {best}"
            )
        if self.budget_s is not None and now > self.budget_s and not (self.stopped or self.over):
            self.stopped = f"The search was stopped after measured.budget_s = {self.budget_s:g} s"
            raise Stopped

    def interrupted(self) -> None:
        """A person ended it."""
        self.stopped = "The search was interrupted"
