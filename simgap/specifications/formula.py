"""Tasks as formulas of linear temporal logic, and the deterministic automata that watch over them.

A formula is read into negation normal form: literals (a region, and whether the state is inside or outside), `and`,
`or`, `X`, and the two operators that all others are made of, both with a largest number of samples or without end:

    a U b = b or (a and X(a U b)),        a R b = b and (a or X(a R b)).

What is left of a formula after a letter follows from these equations (the `after` function of Esparza, Kretinsky and
Sickert, J. ACM 67(6), 2020): a positive Boolean combination of subformulas, kept as the set of its least clauses, which
is unique. So equal rests are one state. A conjunction of these can be watched by a deterministic Buechi automaton:

    safety           no U without end           the rest never becomes false
    co-safety        no R without end           the rest becomes true
    recurrence       G of a co-safe formula     the rest becomes true again and again (breakpoints)

and beside safety without memory one more: persistence, F G of a region, by a co-Buechi automaton.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np

from simgap.arrays import Bools, Ints
from simgap.errors import UserError

Formula = tuple[Any, ...]
Letter = frozenset[tuple[str, bool]]
"""Literals that are sure at a sample: (region, True) inside of it, (region, False) outside."""
Clauses = frozenset[frozenset[Formula]]

TRUE: Clauses = frozenset([frozenset()])
FALSE: Clauses = frozenset()
MOST_STATES = 500
FRAGMENT = (
    "Write a conjunction (&) of formulas without G, R, W that have no end (co-safety), without such F, U (safety), and "
    "of G over co-safety (recurrence: G F a, G (a -> F b)); or of F G of regions (persistence) and G of regions."
)

GRAMMAR = r"""
?start: implies
?implies: or | or "->" implies -> implies
?or: and | or "|" and -> or_
?and: until | and "&" until -> and_
?until: unary | unary "U" [bound] until -> until | unary "W" [bound] until -> weak | unary "R" [bound] until -> release
?unary: "!" unary -> not_ | "X" unary -> next | "F" [bound] unary -> finally_ | "G" [bound] unary -> globally | atom
?atom: "true" -> true | "false" -> false | NAME -> region | "(" implies ")"
bound: "[" "<=" QUANTITY "]"
QUANTITY: /[^\]]+/
NAME: /(?!(?:true|false|[XFGUWR])\b)[A-Za-z_]\w*/
%ignore /\s+/
"""


def parse(text: str, samples: Callable[[str], int]) -> Formula:
    """A formula in negation normal form; `samples` says how many sampling times a bound like '40 s' holds.

    Raises:
        UserError: what is no formula, with the place.
    """
    from lark.exceptions import UnexpectedInput

    try:
        tree = _parser().parse(text)
    except UnexpectedInput as error:
        ended = getattr(getattr(error, "token", None), "type", "") == "$END"
        where = "it ends too early" if ended else f"column {error.column} cannot be read"
        remedy = "Use region names, ! & | ->, X F G U W R and bounds such as F[<= 40 s]."
        raise UserError(f"'{text}' is no formula: {where}", remedy=remedy) from None
    return _normal(tree, True, samples)


@lru_cache(1)
def _parser() -> Any:
    from lark import Lark

    return Lark(GRAMMAR, parser="lalr", maybe_placeholders=True)


def _normal(tree: Any, positive: bool, samples: Callable[[str], int]) -> Formula:
    """The tree, or its negation, in negation normal form: ('U', a, b, samples or None) and the like."""

    def own(child: Any, same: bool = True) -> Formula:
        return _normal(child, positive is same, samples)

    kind, parts = tree.data, tree.children
    if kind == "region":
        return ("in", str(parts[0]), positive)
    if kind in ("true", "false"):
        return ("true",) if (kind == "true") is positive else ("false",)
    if kind == "not_":
        return own(parts[0], False)
    if kind in ("and_", "or_", "implies"):
        return ("and" if (kind == "and_") is positive else "or", own(parts[0], kind != "implies"), own(parts[1]))
    if kind == "next":
        return ("X", own(parts[0]))
    *operands, last = parts
    within = next((samples(str(p.children[0])) for p in operands if p is not None and p.data == "bound"), None)
    first = operands[0] if kind in ("until", "weak", "release") else None
    if kind == "weak":  # a W b = b R (a | b)
        left, right = own(last), ("or" if positive else "and", own(first), own(last))
    else:
        neutral = ("true",) if (kind == "finally_") is positive else ("false",)
        left, right = neutral if first is None else own(first), own(last)
    return ("U" if (kind in ("until", "finally_")) is positive else "R", left, right, within)


def literals(formula: Formula) -> set[Formula]:
    """The literals in a formula: ('in', region, whether inside)."""
    if formula[0] == "in":
        return {formula}
    return set().union(*(literals(part) for part in formula[1:] if isinstance(part, tuple)))


def regions(formula: Formula) -> set[str]:
    """The names of the regions in a formula."""
    return {name for _, name, _ in literals(formula)}


def _without(operator: str, formula: Formula) -> bool:
    """True if a formula has no such operator without end."""
    return (formula[0] != operator or formula[3] is not None) and all(
        _without(operator, part) for part in formula[1:] if isinstance(part, tuple)
    )


def _conjuncts(formula: Formula) -> list[Formula]:
    """The parts of a conjunction; G distributes over it."""
    if formula[0] == "and":
        return [part for one in formula[1:] for part in _conjuncts(one)]
    if formula[0] == "R" and formula[1] == ("false",) and formula[3] is None and formula[2][0] == "and":
        return [part for one in _conjuncts(formula[2]) for part in _conjuncts(("R", ("false",), one, None))]
    return [formula]


def _stronger(a: Formula, b: Formula) -> bool:
    """True if a subformula implies another by itself: it is the same, but for a deadline that is no less strict."""
    if a[:-1] != b[:-1] or a[0] not in ("U", "R"):
        return a == b
    sooner, later = (math.inf if part[3] is None else part[3] for part in ((a, b) if a[0] == "U" else (b, a)))
    return bool(sooner <= later)


def _entails(clause: frozenset[Formula], other: frozenset[Formula]) -> bool:
    return other <= clause or all(any(_stronger(a, b) for a in clause) for b in other)


def _least(clauses: Iterable[frozenset[Formula]]) -> Clauses:
    """The same without what follows: of each clause, and clauses that another one is left by."""
    found = {frozenset(b for b in c if not any(a != b and _stronger(a, b) for a in c)) for c in clauses}
    return frozenset(c for c in found if not any(other != c and _entails(c, other) for other in found))


def _and(a: Clauses, b: Clauses) -> Clauses:
    return _least(x | y for x in a for y in b)


def _or(a: Clauses, b: Clauses) -> Clauses:
    return _least(a | b)


def _implies(a: Clauses, b: Clauses) -> bool:
    return all(any(_entails(clause, other) for other in b) for clause in a)


def later(formula: Formula) -> Clauses:
    """A formula that is asked for from the next sample on."""
    kind = formula[0]
    if kind in ("true", "false"):
        return TRUE if kind == "true" else FALSE
    if kind in ("and", "or"):
        return (_and if kind == "and" else _or)(later(formula[1]), later(formula[2]))
    return frozenset([frozenset([formula])])


def after(formula: Formula, letter: Letter) -> Clauses:
    """What is left of a formula after a letter."""
    kind = formula[0]
    if kind == "in":
        return TRUE if formula[1:] in letter else FALSE
    if kind == "X":
        return later(formula[1])
    if kind not in ("U", "R"):
        return later(formula) if kind in ("true", "false") else _joined(kind, formula[1:], letter)
    left, right, within = formula[1:]
    again = (kind, left, right, None if within is None else within - 1)
    goes_on, stops = after(left, letter), after(right, letter)
    rest = (FALSE if kind == "U" else TRUE) if within == 0 else later(again)
    return _or(stops, _and(goes_on, rest)) if kind == "U" else _and(stops, _or(goes_on, rest))


def _joined(kind: str, parts: Sequence[Formula], letter: Letter) -> Clauses:
    return reduce(_and if kind == "and" else _or, (after(part, letter) for part in parts))


def _after_all(rest: Clauses, letter: Letter) -> Clauses:
    every = (reduce(_and, (after(part, letter) for part in clause), TRUE) for clause in rest)
    return reduce(_or, every, FALSE)


@dataclass(frozen=True, eq=False)
class Automaton:
    """A deterministic automaton over the letters 0 to L - 1.

    Attributes:
        step: (Q, L) next state, -1 where the formula can no longer hold; state 0 comes before the first letter.
        good: (Q, L) bool, moves of which there must be infinitely many (Buechi); with `persists`, moves of which all
            but finitely many must be (co-Buechi).
        done: state in which the formula holds whatever follows, -1 for none.
        persists: whether acceptance is co-Buechi.
        letters: what they say, (L,).
    """

    step: Ints
    good: Bools
    done: int = -1
    persists: bool = False
    letters: tuple[Letter, ...] = ()

    @property
    def awaits(self) -> tuple[str, ...]:
        """Of each state, the regions that every move on from it, or good move, is inside of: 'a and b', '' for none."""
        there, moves = self.step >= 0, self.step != np.arange(len(self.step))[:, None]
        inside = [{name for name, within in letter if within} for letter in self.letters]
        words = []
        for on in there & (moves | self.good):
            common = [inside[k] for k in np.flatnonzero(on)]
            words.append(" and ".join(sorted(set.intersection(*common))) if common else "")
        return tuple(words)

    @property
    def possible(self) -> bool:
        """True if some word over the letters is accepted."""
        kept, there = np.ones(len(self.step), np.bool_), self.step >= 0
        while True:
            found = np.any(self.good & there & kept[self.step], axis=1) | (np.arange(len(kept)) == self.done)
            while (more := found | np.any(there & found[self.step], axis=1)).sum() > found.sum():
                found = more
            if np.array_equal(found, kept):
                return bool(kept[0])
            kept = found

    def read(self, letters: Ints) -> tuple[Ints, Bools]:
        """States after each letter of a word (k,), -1 from where it is broken, and which moves were good: (k,)."""
        states, good, state = np.empty(len(letters), np.int64), np.zeros(len(letters), np.bool_), 0
        for k, letter in enumerate(letters.tolist()):
            good[k] = state >= 0 and self.good[state, letter]
            state = int(self.step[state, letter]) if state >= 0 else -1
            states[k] = state
        return states, good


@lru_cache(64)
def automaton_of(formula: Formula, letters: tuple[Letter, ...]) -> Automaton:
    """The automaton that accepts the words, over some letters, of which a formula holds.

    Raises:
        UserError: a formula outside the fragment, one that asks for nothing, or one that needs too many states.
    """
    watch = _Watch(_conjuncts(formula))
    if watch.start == watch.done and not watch.persistent:
        raise UserError("the formula holds whatever happens", remedy="Ask for something of a region.")
    plain = all(part[:2] == ("R", ("false",)) and part[3] is None and _is_state(part[2]) for part in watch.safe)
    if watch.persistent and (watch.ends or watch.again or not plain):
        raise UserError("F G stands beside what must be remembered: outside the fragment", remedy=FRAGMENT)
    numbers, rows, good = {watch.start: 0}, [], []
    for state in (queue := [watch.start]):
        moves = [watch.move(state, letter) for letter in letters]
        for following, _ in moves:
            if following is not None and following not in numbers:
                numbers[following] = len(numbers)
                queue.append(following)
        if len(numbers) > MOST_STATES:
            raise UserError(
                f"the formula needs more than {MOST_STATES} states of an automaton",
                remedy="Shorten its deadlines (they count samples), or ask for less at once.",
            )
        rows.append([-1 if following is None else numbers[following] for following, _ in moves])
        good.append([own for _, own in moves])
    step, good_moves = np.array(rows, np.int64), np.array(good, np.bool_)
    done = numbers.get(watch.done, -1) if not (watch.again or watch.persistent) else -1
    return Automaton(*_merged(step, good_moves, done), bool(watch.persistent), letters)


def _merged(step: Ints, good: Bools, done: int) -> tuple[Ints, Bools, int]:
    """The automaton with states that nothing tells apart made one (Moore's partition refinement)."""
    block = (np.arange(len(step)) == done).astype(np.int64)
    while True:
        rows = np.column_stack([block, good, np.where(step >= 0, block[step], -1)])
        _, first, finer = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        finer = finer.reshape(-1)
        if len(first) == block.max() + 1:
            break
        block = finer
    order = np.argsort(first)  # the first state stays in front
    place = np.argsort(order)
    kept = first[order]
    new = np.where(step[kept] >= 0, place[finer[step[kept]]], -1)
    return new, good[kept], int(place[finer[done]]) if done >= 0 else -1


class _Watch:
    """The parts of a conjunction, and what has to be remembered of them.

    A state is what is left of the safe parts, of each co-safe one, of each recurrent one (the rest before the last
    breakpoint and since), and the number of the part that is waited for.
    """

    def __init__(self, parts: list[Formula]) -> None:
        self.safe, self.ends = list[Formula](), list[Formula]()
        self.again, self.persistent = list[Formula](), list[Formula]()
        for part in parts:
            always = part[0] == "R" and part[1] == ("false",) and part[3] is None
            stays = (
                part[0] == "U" and part[1] == ("true",) and part[2][0] == "R" and part[2][1::2] == (("false",), None)
            )
            if _without("U", part):
                self.safe.append(part)
            elif _without("R", part):
                self.ends.append(part)
            elif always and _without("R", part[2]):
                self.again.append(part[2])
            elif stays and part[3] is None and _is_state(part[2][2]):
                self.persistent.append(part[2][2])
            else:
                raise UserError("the formula is outside the fragment that deterministic automata here watch over",
                                remedy=FRAGMENT)  # fmt: skip
        pairs = tuple((later(part), TRUE) for part in self.again)
        self.start = (reduce(_and, map(later, self.safe), TRUE), tuple(map(later, self.ends)), pairs, 0)
        self.done = (TRUE, tuple(TRUE for _ in self.ends), (), 0)

    def move(self, state: Any, letter: Letter) -> tuple[Any, bool]:
        """The next state, None where the formula is broken, and whether the move is good."""
        safe, ends, pairs, waits = state
        safe, ends = _after_all(safe, letter), tuple(_after_all(rest, letter) for rest in ends)
        met, following = [], []
        for part, (now, since) in zip(self.again, pairs, strict=True):
            now, since = _after_all(now, letter), _and(_after_all(since, letter), after(part, letter))
            met.append(now == TRUE)
            if FALSE in (now, since):
                return None, False
            if now == TRUE:
                now, since = (later(part), TRUE) if since == TRUE else (since, TRUE)
            following.append((now, TRUE if _implies(now, since) else since))
        if FALSE in (safe, *ends):
            return None, False
        met = [all(rest == TRUE for rest in ends), *met]
        good = False
        for _ in met:
            if not met[waits]:
                break
            waits = (waits + 1) % len(met)
            good |= waits == 0
        if self.persistent:
            good = all(after(part, letter) == TRUE for part in self.persistent)
        return (safe, ends, tuple(following), waits), good


def _is_state(formula: Formula) -> bool:
    """True if a formula is about one sample."""
    return formula[0] in ("in", "true", "false") or (formula[0] in ("and", "or") and all(map(_is_state, formula[1:])))
