"""Whether a step repeats itself along a periodic axis, by the form of its expressions; and what no check can settle.

A step repeats along an axis with period P if moving that state by P moves each successor by whole periods of its own
axis, or not at all where its axis ends. How far an expression moves is read off its form, exactly: sums add; a number
multiplies; sine and cosine of what moves by whole turns do not move. What has no such rule does not pass.

A turn is no double: a period counts as whole turns if it differs from them by `ROUNDING` of it. The margin of a cell is
sixteen times as much.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import rationals
from certificate import Certificate
from expressions import exact

ROUNDING = Fraction(1, 2**48)
BETWEEN = "What happens between two sampling instants: a certificate is about the states at them."
BLACK_BOX = (
    "That the bound of the gap holds for the simulator, which is a black box: the certificate takes it as stated, with "
    "the guarantee that stands in its header."
)
PATH = (
    "That the path of each step stays in the stated box, seen from the body: it is measured in the simulator, like the "
    "bound of the gap."
)
STRAY = "That a path strays from its samples by no more than the stated distances."
CLOCK = "That samples are the stated time apart, in which deadlines are counted."
HARDWARE = "That the simulator, or its equations, describe the real plant."


def unrepeated(c: Certificate) -> str | None:
    """What of the step is not shown to repeat along a periodic axis, in words; None if all of it is."""
    maps = {"map": c.header["nominal"], "simulator": c.header["simulator"] or {}}
    framed = c.reach is not None and (c.reach.bound is not None or c.reach.swept is not None)
    for s, period in _periods(c).items():
        by = dict.fromkeys([*c.states, *c.input_names], Fraction(0)) | {s: period}
        along = f"is not shown to repeat along {s} every {float(period):g}"
        for what, successors in maps.items():
            for name, e in successors.items():
                if name in c.states and not _whole_periods(c, name, moved(e, by)):
                    return f"the {what} of {name} {along}"
        if framed and moved(["sin", c.states[c.reach.pose[2]]], by) != 0:
            return f"the frame of the body {along}"
    return None


def on_trust(c: Certificate) -> list[str]:
    """What is not verified, by what a certificate holds: it may say less."""
    unknown = c.header["simulator"] is None
    between = BETWEEN if c.reach is None else STRAY if c.reach.swept is None else PATH
    found = [between, *([BLACK_BOX] if unknown else []), HARDWARE]
    if c.task is not None and "[" in c.task.text:
        found.append(CLOCK)
    for s, period in _periods(c).items():
        same = f"That states {float(period):g} apart along {s} are one and the same"
        found.append(same + (", and the black box repeats itself so." if unknown else "."))
    return found


def moved(e: Any, by: dict[str, Fraction]) -> Fraction | None:
    """How far an expression moves, wherever that is, when names move `by` so much; None where its form does not say."""
    if not isinstance(e, list):
        return by.get(e, Fraction(0)) if isinstance(e, str) else Fraction(0)
    parts = [moved(part, by) for part in (e[1:2] if e[0] == "^" else e[1:])]
    if None in parts:
        return None
    if not any(parts):
        return Fraction(0)
    if e[0] == "+":
        return sum(parts, Fraction(0))
    if e[0] == "*":
        return _product(e[1:], parts, by)
    if e[0] in ("min", "max"):
        return parts[0] if len({*parts}) == 1 else None
    return Fraction(0) if e[0] in ("sin", "cos") and _whole_turns(parts[0]) else None


def _product(factors: list[Any], parts: list[Fraction], by: dict[str, Fraction]) -> Fraction | None:
    """One factor that moves, times numbers: beside one that varies, how far the product moves varies too."""
    total = Fraction(1)
    for factor, part in zip(factors, parts, strict=True):
        if not part and (isinstance(factor, list) or factor in by):
            return None
        total *= part or (factor if isinstance(factor, int) else exact(factor))
    return total if sum(part != 0 for part in parts) == 1 else None


def _whole_turns(by: Fraction) -> bool:
    turn = 4 * rationals.HALF_PI[0]
    return round(by / turn) != 0 and abs(by - round(by / turn) * turn) <= ROUNDING * abs(by)


def _periods(c: Certificate) -> dict[str, Fraction]:
    return {s: c.hi[j] - c.lo[j] for j, s in enumerate(c.states) if c.periodic[j]}


def _whole_periods(c: Certificate, state: str, by: Fraction | None) -> bool:
    """Whether a successor that moves `by` so much is the same one."""
    period = _periods(c).get(state)
    return by == 0 or (by is not None and period is not None and (by / period).denominator == 1)
