"""What a fault of a recording is: its words, and how a look at the data finds it and mends it."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from typing import ClassVar

from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import RecordingFault
from simgap.model.symbolic import SymbolicModel

Mended = tuple[Record, tuple[RecordingFault, ...]]
"""The record without a fault, and what was found; the very record where nothing was."""


class Fault(ABC):
    """A fault of the data and not of the plant; subclasses are final and hold no state.

    The docstring of one says what is wrong and, after 'Detected:', how it is found and what becomes of it.
    """

    name: ClassVar[str]
    unit: ClassVar[str] = "1"
    """Of its number; where it is the channel's own, the finding says which."""
    remedy: ClassVar[str] = ""
    """What a person can do; `{}` stands for the channel."""

    def said(self) -> tuple[str, str]:
        """What is wrong, and how it is detected, from the docstring."""
        meaning, detected = (inspect.getdoc(type(self)) or "").split("\n\n")[:2]
        return meaning, " ".join(detected.split()).removeprefix("Detected: ")

    def told(
        self, channel: str, value: float | None, sentence: str, remedy: str = "", unit: str | None = None
    ) -> RecordingFault:
        """The finding; the remedy and the unit are those of the fault where nothing else is given."""
        words = (remedy or self.remedy).format(channel)
        return RecordingFault(self.name, channel, value, self.unit if unit is None else unit, sentence, words)


class SeenFault(Fault):
    """A fault that the data alone show, before any model is simulated."""

    @abstractmethod
    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record without it, and what was found; the model gives units, coordinates and nothing of its dynamics."""
