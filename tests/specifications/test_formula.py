"""Automata of formulas against the definition of their truth on words that repeat for ever.

The oracle evaluates a formula at every position of a word `prefix (loop)^omega` by the definitions of the operators. It
shares no code with the parser, the normal form or the automata: formulas are drawn as trees and written as text.
"""

import itertools

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.specifications.formula import automaton_of, parse, regions
from simgap.specifications.task import exact_letters
from tests.specifications.formulas import NAMES, conjunction, persistent, text

LETTERS = tuple(frozenset(zip(NAMES, bits, strict=True)) for bits in itertools.product((False, True), repeat=3))


def truth(tree, word, loop):
    """Whether the formula holds at each position of a word whose last position is followed by position `loop`."""
    kind, *parts = tree
    n = len(word)
    follow = [*range(1, n), loop]
    if kind in NAMES:
        return [(kind, True) in letter for letter in word]
    if kind in ("true", "false"):
        return [kind == "true"] * n
    if kind in ("F<", "G<"):
        own, out = truth(parts[1], word, loop), []
        for start in range(n):
            at, seen = start, [own[start]]
            for _ in range(parts[0]):
                at = follow[at]
                seen.append(own[at])
            out.append(any(seen) if kind == "F<" else all(seen))
        return out
    own = [truth(part, word, loop) for part in parts]
    if kind == "!":
        return [not v for v in own[0]]
    if kind == "X":
        return [own[0][follow[i]] for i in range(n)]
    if kind in ("&", "|", "->"):
        by = {"&": lambda p, q: p and q, "|": lambda p, q: p or q, "->": lambda p, q: q or not p}[kind]
        return [by(p, q) for p, q in zip(*own, strict=True)]
    out = []
    for start in range(n):  # by definition: along the next 2 n positions everything has been seen
        at, path = start, []
        for _ in range(2 * n):
            path.append(at)
            at = follow[at]
        holds = [[values[i] for i in path] for values in own]
        if kind in ("F", "G"):
            out.append(any(holds[0]) if kind == "F" else all(holds[0]))
            continue
        before = [all(holds[0][:k]) for k in range(len(path))]
        until = any(b and q for b, q in zip(before, holds[1], strict=True))
        if kind == "U":
            out.append(until)
        elif kind == "W":
            out.append(until or all(holds[0]))
        else:  # p R q: q holds up to and with the first p
            out.append(all(q or any(holds[0][:k]) for k, q in enumerate(holds[1])))
    return out


def accepts(automaton, word, loop):
    numbers = [LETTERS.index(letter) for letter in word]
    state, seen, at = 0, {}, 0
    moves = []
    while (state, at) not in seen:
        if state < 0:
            return False
        if state == automaton.done:
            return True
        seen[state, at] = len(moves)
        moves.append(bool(automaton.good[state, numbers[at]]))
        state, at = int(automaton.step[state, numbers[at]]), at + 1 if at + 1 < len(word) else loop
    again = moves[seen[state, at] :]
    return all(again) if automaton.persists else any(again)


@pytest.mark.parametrize("make", [conjunction, persistent])
def test_automata_accept_the_words_of_which_the_formula_holds(make):
    rng, held, sizes = np.random.default_rng([83, make is persistent]), 0, []
    for number in range(500):
        tree = make(rng)
        automaton = automaton_of(parse(text(tree), int), LETTERS)
        sizes.append(len(automaton.step))
        assert regions(parse(text(tree), int)) <= {*NAMES}
        for _ in range(25):
            length = int(rng.integers(1, 7))
            word, loop = [LETTERS[i] for i in rng.integers(0, 8, length)], int(rng.integers(length))
            wanted = truth(tree, word, loop)[0]
            held += wanted
            assert accepts(automaton, word, loop) == wanted, (number, text(tree), word, loop)
    assert 0.1 < held / (500 * 25) < 0.9
    assert (max(sizes) > 1) == (make is conjunction)


@pytest.mark.parametrize(
    ("formula", "states", "done"),
    [
        ("G F a", 1, False),
        ("G F a & G F b", 2, False),
        ("G (a -> F b)", 2, False),
        ("!c U (a & F b)", 3, True),
        ("G !c", 1, False),
        ("F[<= 3] a", 5, True),
        ("F G a & G !c", 1, False),
    ],
)
def test_the_automata_of_known_tasks_are_as_small_as_they_can_be(formula, states, done):
    automaton = automaton_of(parse(formula, int), LETTERS)
    assert (len(automaton.step), automaton.done >= 0) == (states, done)


def test_a_literal_that_is_not_sure_holds_neither_way():
    neither = (frozenset(),)
    for formula in ("a", "!a", "a | !a"):
        assert automaton_of(parse(formula, int), neither).step.tolist() == [[-1]]


@pytest.mark.parametrize(
    ("formula", "problem"),
    [
        ("F G (a U b)", "outside the fragment"),
        ("F (a & G b)", "outside the fragment"),
        ("F G a & G F b", "beside what must be remembered"),
        ("F G a & F b", "beside what must be remembered"),
        ("F[<= 900] a & F[<= 900] b", "more than 500 states"),
        ("a &", "ends too early"),
        ("a b", "column 3"),
        ("G", "ends too early"),
        ("(a", "ends too early"),
        ("a & & b", "column 5"),
        ("a -> true", "holds whatever happens"),
    ],
)
def test_what_is_outside_the_fragment_or_no_formula_is_refused_in_one_line(formula, problem):
    with pytest.raises(UserError, match=problem) as caught:
        automaton_of(parse(formula, int), LETTERS)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("formula", "awaits"),
    [
        ("G F a & G F b", {("a", "b")}),
        ("!w U (a & F b)", {("a", "b", "")}),
        ("F G a & G !w", {("a",)}),
        ("F (a | b)", {("", "")}),
        ("F a & F b", {("", "a", "b", ""), ("", "b", "a", "")}),
    ],
)
def test_a_state_knows_the_region_that_it_waits_for(formula, awaits):
    words = automaton_of(parse(formula, int), exact_letters(sorted({*"abw"} & {*formula}))).awaits
    assert words in awaits


@pytest.mark.parametrize(("formula", "states"), [("G (a -> F[<= 60] b)", 61), ("G (a -> G[<= 30] b)", 31)])
def test_a_deadline_that_is_answered_again_and_again_needs_a_state_for_each_sample(formula, states):
    """The stricter of two deadlines stands for both: without that there were as many states as sets of deadlines."""
    assert len(automaton_of(parse(formula, int), exact_letters("ab")).step) == states
