"""Formulas of temporal logic over regions, and whether an automaton accepts only runs of which one holds.

A formula is read here anew, by the grammar of `docs/how-to/tasks.md`, into nested tuples:

    ("in", region, inside)  ("true",)  ("false",)  ("and", p, q)  ("or", p, q)  ("X", p)  ("U", n, p, q)  ("R", n, p, q)

with n the largest number of samples, None without end. A deterministic automaton accepts a run that breaks the formula
if its product with a nondeterministic one of the *negation* has a circle that both accept. That one is the tableau of
Gerth, Peled, Vardi and Wolper (PSTV 1995), with acceptance on moves: a state is what is asked for from now on, and
`branches` are the ways to meet it. What the automaton reads of a cell is a set of literals that are sure there; the run
may be any that agrees with them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any

import numpy as np
from expressions import Malformed

UNITS = {"": Fraction(1), "s": Fraction(1), "ms": Fraction(1, 1000), "min": Fraction(60), "h": Fraction(3600)}
TOKEN = re.compile(r"\s*(->|[!&|()]|[A-Za-z_]\w*|\[\s*<=\s*[^\]]+\])", re.ASCII)
OPERATORS = {"X", "F", "G", "U", "W", "R"}
LONGEST = 100_000  # samples of a deadline
LONGEST_TEXT = 2000  # tokens of a formula
MOST_WEAK = 12  # W in a formula: each writes what stands at its right twice
MOST_STEPS = 200_000  # to find the ways to meet what is asked for at one sample
MOST_MOVES = 3_000_000  # of the product: beyond it the question is not decided
TRUE, FALSE = ("true",), ("false",)
Formula = tuple[Any, ...]
Letter = frozenset[tuple[str, bool]]


def read_formula(text: str, tau: Fraction) -> Formula:
    """A formula in which only regions are negated; `tau` is the sampling time in s.

    Raises:
        Malformed: what is none.
    """
    tokens, at = [], 0
    while text[at:].strip():
        found = TOKEN.match(text, at)
        if found is None:
            raise Malformed(f"its formula cannot be read at {text[at : at + 20]!r}")
        tokens.append(found[1])
        at = found.end()
    if not 0 < len(tokens) <= LONGEST_TEXT or tokens.count("W") > MOST_WEAK:
        raise Malformed(f"its formula is empty, or has more than {LONGEST_TEXT} words or {MOST_WEAK} times W")
    reader = _Reader(tokens, tau)
    whole = reader.implied()
    if reader.left:
        raise Malformed(f"its formula cannot be read at {reader.left[-1][:20]!r}")
    return whole(True)


class _Reader:
    """Recursive descent: each method reads one formula, and returns what makes it or its negation in normal form."""

    def __init__(self, tokens: list[str], tau: Fraction) -> None:
        self.left, self.tau = tokens[::-1], tau

    def next_is(self, *tokens: str) -> str:
        """Take the next token if it is one of these."""
        return self.left.pop() if self.left and self.left[-1] in tokens else ""

    def implied(self):
        first = self.joined("|", "or", lambda: self.joined("&", "and", self.until))
        if not self.next_is("->"):
            return first
        then = self.implied()
        return lambda yes: ("or" if yes else "and", first(not yes), then(yes))

    def joined(self, sign, kind, part):
        parts = [part()]
        while self.next_is(sign):
            parts.append(part())
        other = {"and": "or", "or": "and"}[kind]
        return lambda yes: reduce(lambda p, q: (kind if yes else other, p, q), [p(yes) for p in parts])

    def until(self):
        first = self.single()
        kind = self.next_is("U", "W", "R")
        if not kind:
            return first
        n, last = self.deadline(), self.until()
        if kind == "W":  # p W q = q R (p or q)
            return lambda yes: ("R" if yes else "U", n, last(yes), ("or" if yes else "and", first(yes), last(yes)))
        return lambda yes: ("U" if (kind == "U") is yes else "R", n, first(yes), last(yes))

    def single(self):
        if not self.left:
            raise Malformed("its formula ends too early")
        token = self.left.pop()
        return self._operator(token) if token in OPERATORS | {"!", "("} else self._atom(token)

    def _operator(self, token):
        if token == "(":
            inner = self.implied()
            if not self.next_is(")"):
                raise Malformed("its formula has a parenthesis that does not end")
            return inner
        n = self.deadline() if token in ("F", "G") else None
        part = self.single()
        if token == "!":
            return lambda yes: part(not yes)
        if token == "X":
            return lambda yes: ("X", part(yes))
        if token not in ("F", "G"):
            raise Malformed(f"its formula cannot be read at {token!r}")
        return lambda yes: ("U", n, TRUE, part(yes)) if (token == "F") is yes else ("R", n, FALSE, part(yes))

    def _atom(self, token):
        if token in ("true", "false"):
            return lambda yes: TRUE if (token == "true") is yes else FALSE
        if not re.fullmatch(r"[A-Za-z_]\w*", token):
            raise Malformed(f"its formula cannot be read at {token[:20]!r}")
        return lambda yes: ("in", token, yes)

    def deadline(self) -> int | None:
        """The samples of '[<= 40 s]' if there is one."""
        if not (self.left and self.left[-1].startswith("[")):
            return None
        number, _, unit = self.left.pop().strip("[]").strip().removeprefix("<=").strip().partition(" ")
        if not re.fullmatch(r"\d{1,9}(\.\d{0,9})?|\.\d{1,9}", number) or unit.strip() not in UNITS:
            raise Malformed(f"its deadline {f'{number} {unit}'[:30]!r} is not in {', '.join(UNITS)[2:]}")
        samples = Fraction(number) * UNITS[unit.strip()] // self.tau
        if samples > LONGEST:
            raise Malformed(f"a deadline of it is longer than {LONGEST:,} samples")
        return int(samples)


def regions_of(formula: Formula) -> set[str]:
    """Names of the regions in a formula."""
    if formula[0] == "in":
        return {formula[1]}
    return set().union(*(regions_of(part) for part in formula[1:] if isinstance(part, tuple)))


def negated(formula: Formula) -> Formula:
    """What holds where a formula does not."""
    kind, *rest = formula
    if kind == "in":
        return ("in", rest[0], not rest[1])
    other = {"true": "false", "false": "true", "and": "or", "or": "and", "X": "X", "U": "R", "R": "U"}[kind]
    return (other, *(negated(part) if isinstance(part, tuple) else part for part in rest))


@dataclass(frozen=True)
class Branch:
    """One way to meet what is asked for: literals now, what is asked for next, and the endless U that were put off."""

    now: Letter = frozenset()
    later: frozenset[Formula] = frozenset()
    put_off: frozenset[Formula] = frozenset()


def branches(asked: frozenset[Formula]) -> set[Branch]:
    """All ways, whose literals do not contradict each other."""
    found, open_ones, looked_at = set(), [(tuple(asked), Branch())], 0
    while open_ones:
        looked_at += 1
        if looked_at > MOST_STEPS:
            raise Malformed("its formula has too many ways to be kept for this program to compare")
        rest, way = open_ones.pop()
        if not rest:
            found.add(way)
            continue
        f, rest = rest[0], rest[1:]
        for parts, more in _ways(f):
            now = way.now | more.now
            if not any((name, not inside) in now for name, inside in more.now):
                open_ones.append((parts + rest, Branch(now, way.later | more.later, way.put_off | more.put_off)))
    return found


def _ways(f: Formula) -> Iterator[tuple[tuple[Formula, ...], Branch]]:
    """The ways to meet one formula: what is asked for of this sample still, and what of the next."""
    kind = f[0]
    if kind == "true":
        yield (), Branch()
    elif kind == "in":
        yield (), Branch(now=frozenset([f[1:]]))
    elif kind == "and":
        yield f[1:], Branch()
    elif kind == "or":
        yield from (((part,), Branch()) for part in f[1:])
    elif kind == "X":
        yield (), Branch(later=frozenset([f[1]]))
    elif kind in ("U", "R"):
        n, p, q = f[1:]
        yield (q,) if kind == "U" or n == 0 else (p, q), Branch()
        if n != 0:
            again = Branch(later=frozenset([(kind, None if n is None else n - 1, p, q)]))
            put_off = frozenset([f]) if kind == "U" and n is None else frozenset()
            yield ((p,) if kind == "U" else (q,)), Branch(later=again.later, put_off=put_off)


@dataclass
class Automaton:
    """A deterministic automaton over letters.

    Attributes:
        letters: literals that are sure at a sample, by number. step: (Q, L) next state, -1 for none. good: (Q, L) bool,
            moves of which there are infinitely many in an accepted run, or, with `persists`, all but finitely many.
        done: the state in which a run is accepted whatever follows, -1 for none.
    """

    letters: list[Letter]
    step: np.ndarray
    good: np.ndarray
    done: int
    persists: bool

    def moves(self, q: int) -> Iterator[tuple[Letter, int, bool]]:
        """Literals that are sure, next state, and whether the move is good."""
        if q == self.done:
            yield frozenset(), q, True
            return
        for k, letter in enumerate(self.letters):
            if self.step[q, k] >= 0:
                yield letter, int(self.step[q, k]), bool(self.good[q, k])


def implies(automaton: Automaton, formula: Formula) -> bool:
    """Whether every run that the automaton accepts keeps the formula.

    Raises:
        Malformed: a product that is too large to decide.
    """
    start = (0, frozenset([negated(formula)]))
    numbers, queue, ways = {start: 0}, [start], {}
    moves: dict[tuple[int, int], set] = {}
    for q, asked in queue:
        if asked not in ways:
            ways[asked] = branches(asked)
        here = numbers[q, asked]
        for letter, following, good in automaton.moves(q):
            clash = {(name, not inside) for name, inside in letter}
            if clash & letter:
                continue
            for way in ways[asked]:
                if way.now & clash:
                    continue
                to = (following, way.later)
                if to not in numbers:
                    numbers[to] = len(numbers)
                    queue.append(to)
                moves.setdefault((here, numbers[to]), set()).add((good, way.put_off))
        if len(moves) > MOST_MOVES:
            raise Malformed("its formula and its automaton are too large for this program to compare")
    return not _accepting_circle(automaton, moves, len(numbers))


def _accepting_circle(automaton: Automaton, moves: dict[tuple[int, int], set], count: int) -> bool:
    """Whether an endless way has moves of every kind that is to come again and again (Emerson and Lei).

    All states can be reached, so any such way will do. Where moves must be good in the end it has good moves only.
    """
    flat = [(a, b, good, off) for (a, b), own in moves.items() for good, off in own if good or not automaton.persists]
    if not flat:
        return False
    source, target = (np.array([move[k] for move in flat]) for k in (0, 1))
    good = np.array([move[2] for move in flat])
    every = set().union(*(move[3] for move in flat))
    again = [good, *(np.array([f not in move[3] for move in flat]) for f in every)]
    alive = np.ones(count, bool)
    while True:
        before = alive.copy()
        for wanted in again:
            inside = alive[source] & alive[target]
            reaches = np.zeros(count, bool)
            reaches[source[inside & wanted]] = True
            while True:
                more = source[inside & reaches[target] & ~reaches[source]]
                if not len(more):
                    break
                reaches[more] = True
            alive = reaches
        if (alive == before).all():
            return bool(alive.any())
