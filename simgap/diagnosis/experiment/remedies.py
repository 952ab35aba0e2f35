"""What else to do where no input separates rivals: something that is weighed, or one more sensor.

Rivals that predict the same for every input are equal to these sensors on this plant. They part if a number of the
plant is set to a value that is known (a weight is mounted that was weighed), or if a state is read that was not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from simgap.effects import AppliedEffect
from simgap.model.symbolic import SymbolicModel
from simgap.notation import number, pretty_unit

FACTOR = 1.5
"""What a number of the plant is set to, over its declared value. Judgement: far enough to show."""


@dataclass(frozen=True)
class Remedy:
    """What to do, and how sure one will then be."""

    sentence: str
    kind: str
    name: str
    sure: float

    def plain(self) -> dict[str, str | float]:
        """As JSON takes it."""
        return {"kind": self.kind, "name": self.name, "sentence": self.sentence, "probability": self.sure}


def settable(model: SymbolicModel, sets: Sequence[Sequence[AppliedEffect]]) -> Iterator[tuple[str, float]]:
    """Numbers of the plant that a person can weigh or measure, and what to set them to: first those in doubt."""
    doubted = [a.on for effects in sets for a in effects if a.name == "parameter_error" and a.on in model.parameters]
    masses = [n for n, p in model.parameters.items() if p.unit == "kg" and "." not in n]
    for name in dict.fromkeys((*doubted, *masses)):
        value = model.parameters[name].value
        if value != 0.0:
            yield name, FACTOR * value


def best_remedy(options: Sequence[tuple[str, str, str, Callable[[], float]]], wanted: float) -> Remedy | None:
    """The first option that makes one as sure as wanted, else the best above even odds; (kind, name, words, sure)."""
    best: Remedy | None = None
    for kind, name, words, ask in options:
        found = Remedy(words, kind, name, ask())
        if best is None or found.sure > best.sure:
            best = found
        if found.sure >= wanted:
            break
    return best if best is not None and best.sure > 0.5 else None


def set_words(name: str, value: float, unit: str) -> str:
    """What to mount."""
    size = f"{number(value)} {pretty_unit(unit)}".strip()
    return (
        f"set {name} to a value that you know, such as {size} (weigh or measure it), and say so under "
        "measured.conditions"
    )
