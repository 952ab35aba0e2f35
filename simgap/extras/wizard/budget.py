"""The CPU time of a search by games: no game is begun that is not expected to end in it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


class Budget:
    """Seconds of CPU time from now on, and what a pair of cell and input has taken so far.

    Attributes:
        refused: whether the last game that was asked for was not expected to end in time.
    """

    def __init__(self, seconds: float) -> None:
        self._ends = time.process_time() + seconds
        self._rate = 0.0
        self.refused = False

    def allows(self, pairs: int) -> bool:
        """True if a game of so many pairs is expected to end in time, by the slowest game so far."""
        self.refused = time.process_time() + self._rate * pairs > self._ends
        return not self.refused

    def gauge(self, pairs: int, game: Callable[[], object]) -> None:
        """Play a small game twice, unless one was timed: once to compile, and once to see what a pair takes."""
        if not self._rate:
            game()
            self.spent(pairs, game)

    def spent(self, pairs: int, game: Callable[[], Result]) -> Result:
        """What the game returns; its time tells what the next ones take."""
        began = time.process_time()
        found = game()
        self._rate = max(self._rate, (time.process_time() - began) / pairs)
        return found
