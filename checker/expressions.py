"""Expressions of a certificate over a box: their range, by values and by slopes.

An expression is a number, the name of a state or an input, or a list [operation, argument, ...]. `Enclosure` carries
three enclosures of it: of its values on the box, of its value at the box's centre, and of its slope along each state.
By the mean value theorem its range lies in

    value at the centre + sum_j slope_j * (x_j - centre_j),

and in the range of its values. `arithmetic` is the module `intervals` or `rationals`; nothing here depends on which.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from typing import Any

ANY = ("+", "*", "min", "max")  # of one argument or more
ONE = ("/", "sin", "cos", "abs")
DEEPEST = 200  # lists within lists
HIGHEST = 10_000  # power of a name, powers of powers included


class Malformed(Exception):
    """What is no expression of a certificate."""


@dataclass
class Enclosure:
    """Ranges on the box and at its centre, and slopes by state (absent: 0)."""

    box: Any
    mid: Any
    slope: dict[int, Any]


@dataclass
class Place:
    """Where an expression is asked for: cell boxes and centres by state, and intervals by name (inputs among them)."""

    arithmetic: Any
    states: dict[str, int]
    box: list[Any]
    mid: list[Any]
    named: dict[str, Any]
    known: dict[int, tuple[Any, Enclosure]] = field(default_factory=dict)
    """Enclosures of lists by identity, with the list, so that no other one can take its identity."""

    def range(self, e):
        """An enclosure of the expression on the box."""
        a, found = self.arithmetic, self.enclose(e)
        total = found.mid
        for j, slope in found.slope.items():
            total = a.add(total, a.mul(slope, a.add(self.box[j], a.negative(self.mid[j]))))
        return a.meet(found.box, total)

    def enclose(self, e) -> Enclosure:
        if not isinstance(e, list):
            return self._leaf(e)
        if id(e) not in self.known:
            self.known[id(e)] = e, self._operation(e)
        return self.known[id(e)][1]

    def _leaf(self, e) -> Enclosure:
        a = self.arithmetic
        if isinstance(e, str):
            if e in self.states:
                j = self.states[e]
                return Enclosure(self.box[j], self.mid[j], {j: a.number(Fraction(1))})
            value = self.named[e] if e in self.named else a.number(exact(e))
            return Enclosure(value, value, {})
        value = a.number(Fraction(e))
        return Enclosure(value, value, {})

    def _operation(self, e) -> Enclosure:
        if e[0] == "^":
            return self._power(self.enclose(e[1]), e[2])
        parts = [self.enclose(part) for part in e[1:]]
        rules = {
            "+": self._sum, "*": self._product, "/": self._inverse, "sin": self._sin, "cos": self._cos,
            "abs": self._abs, "min": self._extreme, "max": self._extreme,
        }  # fmt: skip
        return rules[e[0]](parts, e[0])

    def _sum(self, parts, _):
        a = self.arithmetic
        slope = {}
        for part in parts:
            for j, s in part.slope.items():
                slope[j] = a.add(slope[j], s) if j in slope else s
        return Enclosure(reduce(a.add, [p.box for p in parts]), reduce(a.add, [p.mid for p in parts]), slope)

    def _product(self, parts, _):
        return reduce(self._times, parts)

    def _times(self, p: Enclosure, q: Enclosure) -> Enclosure:
        a = self.arithmetic
        slope = {j: a.mul(s, q.box) for j, s in p.slope.items()}
        for j, s in q.slope.items():
            more = a.mul(s, p.box)
            slope[j] = a.add(slope[j], more) if j in slope else more
        return Enclosure(a.mul(p.box, q.box), a.mul(p.mid, q.mid), slope)

    def _chain(self, p: Enclosure, f, derivative) -> Enclosure:
        """f(p) with f' enclosed by `derivative` on p's range."""
        a = self.arithmetic
        slope = {j: a.mul(derivative, s) for j, s in p.slope.items()} if p.slope else {}
        return Enclosure(f(p.box), f(p.mid), slope)

    def _power(self, p: Enclosure, n) -> Enclosure:
        a = self.arithmetic
        steep = a.number(Fraction(1)) if n == 1 else a.mul(a.number(Fraction(n)), a.power(p.box, n - 1))
        return self._chain(p, lambda x: a.power(x, n), steep)

    def _inverse(self, parts, _):
        a, (p,) = self.arithmetic, parts
        return self._chain(p, a.inverse, a.negative(a.power(a.inverse(p.box), 2)))

    def _sin(self, parts, _):
        a, (p,) = self.arithmetic, parts
        return self._chain(p, a.sin, a.cos(p.box) if p.slope else None)

    def _cos(self, parts, _):
        a, (p,) = self.arithmetic, parts
        return self._chain(p, a.cos, a.negative(a.sin(p.box)) if p.slope else None)

    def _abs(self, parts, _):
        a, (p,) = self.arithmetic, parts
        return self._chain(p, a.absolute, a.sign(p.box))

    def _extreme(self, parts, name):
        a = self.arithmetic
        join, zero = (a.minimum if name == "min" else a.maximum), a.number(Fraction(0))
        axes = {j for p in parts for j in p.slope}
        slope = {j: reduce(a.hull, [p.slope.get(j, zero) for p in parts]) for j in axes}
        return Enclosure(reduce(join, [p.box for p in parts]), reduce(join, [p.mid for p in parts]), slope)


def exact(text: str) -> Fraction:
    """A number as it stands in a certificate: the hexadecimal form of a double, or a fraction 'p/q' of integers."""
    try:
        if "/" in text:
            value = Fraction(text)
        elif text.removeprefix("-").startswith("0x"):
            value = Fraction(float.fromhex(text))
        else:
            raise ValueError
        float(value)  # no number of doubles is beyond them
        return value
    except (ValueError, OverflowError, ZeroDivisionError):
        raise Malformed(f"{text[:60]!r} is neither a number nor a name") from None


def interval(ends, name: str) -> tuple[Fraction, Fraction]:
    """Two numbers, the first below the second.

    Raises:
        Malformed: naming whose they are.
    """
    if not isinstance(ends, list) or len(ends) != 2 or exact(ends[0]) >= exact(ends[1]):
        raise Malformed(f"the ends of {str(name)[:60]!r} are no interval")
    return exact(ends[0]), exact(ends[1])


def well_formed(e, names: set[str], depth: int = 0, power: int = 1) -> None:
    """Look through an expression before it is evaluated: operations, number of arguments, numbers and names.

    Raises:
        Malformed: showing the part that is none.
    """
    if isinstance(e, str):
        if e not in names:
            exact(e)
        return
    if isinstance(e, int) and not isinstance(e, bool):
        float(e)
        return
    if depth >= DEEPEST:
        raise Malformed(f"an expression is more than {DEEPEST} lists deep")
    arguments = e[1:] if isinstance(e, list) else []
    name = e[0] if arguments and isinstance(e[0], str) else ""
    if name == "^" and len(arguments) == 2:
        n = arguments.pop()
        if not isinstance(n, int) or isinstance(n, bool) or n < 1:
            raise Malformed(f"the exponent {str(n)[:60]!r} is no positive integer")
        power *= n
        if power > HIGHEST:
            raise Malformed(f"an expression has a higher power than {HIGHEST}")
    elif not (name in ANY or (name in ONE and len(arguments) == 1)):
        raise Malformed(f"{repr(e)[:60]} is no expression")
    for part in arguments:
        well_formed(part, names, depth + 1, power)
