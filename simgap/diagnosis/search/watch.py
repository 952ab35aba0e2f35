"""What a search spends and has found so far: progress in words, answers on the way, and an end on request."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from simgap.deadline import Tell, copied, last_within, seconds_left
from simgap.errors import UserError

Found = TypeVar("Found")
TOLD_EVERY_S = 5.0  # progress, where no answer is better
_SAVED_EVERY = 0.2  # of the budget: a better answer is saved so often at most


def answered(budget_s: float | None, search: Callable[[Tell], Found], tell: Tell) -> Found:
    """What a search answers; under a budget of CPU seconds the last answer that was whole in time.

    Ctrl-C ends it with that one too.

    Raises:
        UserError: a budget in which there was none.
        RuntimeError: a search that broke, whatever it had answered.
    """
    if budget_s is None:
        return search(tell)
    last = last_within(budget_s, lambda told: iter([search(told)]), tell, stoppable=True)
    if last is None:
        raise UserError(
            "nothing was judged in that time", key="measured.budget_s",
            remedy=f"Give more than {budget_s:g} s; a first run of a plant also compiles it.",
        )  # fmt: skip
    return last


class Stopped(Exception):
    """A search that ends before it is done, with the best that it has found."""


@dataclass(eq=False)
class Watch:
    """One for a whole diagnosis.

    Under a budget the system ends the process, whatever it is at. So the best so far becomes an answer on the way, in a
    copy of the process in which the search is stopped: the last answer that was whole in time stands.

    Attributes:
        budget_s: CPU seconds of the process (`simgap.deadline`); None: all it needs.
        tell: told in words how far it is.
        begun: CPU time at the start, s; told: when something was told last, s; sets: how many sets were fitted.
        best: the best answer so far, in words.
        stopped: why it ended early ("" if it did not); what follows then is neither counted nor interrupted.
        over: whether the search is done: what is fitted then, to choose and to say what else there is, is no answer.
        saved: the answer that was saved last, in words, and when; cost: CPU seconds that saving it took.
    """

    budget_s: float | None = None
    tell: Tell = lambda words: None
    begun: float = field(default_factory=time.process_time)
    told: float = 0.0
    sets: int = 0
    best: str = ""
    stopped: str = ""
    over: bool = False
    saved: tuple[str | None, float] = (None, -math.inf)
    cost: float = 0.0

    def step(self, best: str) -> None:
        """One set of effects was fitted, and this is the best answer so far.

        Raises:
            Stopped: in a copy that answers with it.
        """
        now = time.process_time() - self.begun
        self.sets += 1
        if best != self.best or now - self.told > TOLD_EVERY_S:
            self.best, self.told = best, now
            self.tell(
                f"{self.sets} set{'s' * (self.sets > 1)} of effects fitted in {now:.0f} s of CPU; best so far: {best}"
            )
        self.save()

    def save(self, anyhow: bool = False) -> None:
        """Answer with the best so far, if it is another one and a while after the last, or `anyhow`; then go on.

        Raises:
            Stopped: in the copy that answers.
        """
        if self.budget_s is None or self.stopped or self.over:
            return
        words, at = self.saved
        now = self.budget_s - seconds_left()
        if self.best == words or (now - at < max(self.cost, _SAVED_EVERY * self.budget_s) and not anyhow):
            return
        if copied():
            self.stopped = f"The search did not come to its end (measured.budget_s = {self.budget_s:g} s)"
            raise Stopped
        after = self.budget_s - seconds_left()
        self.saved, self.cost = (self.best, after), after - now
