"""Certificates of tasks: formulas against the definition of their truth, small controllers, and deceit."""

import functools
import importlib
import itertools
import json
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import tampering

from simgap.errors import UserError
from simgap.extras import certify
from simgap.extras.certify import prefix, write_certificate
from simgap.geometry import Box
from simgap.specifications.formula import automaton_of, parse
from simgap.specifications.space import Space
from simgap.specifications.task import inequality
from tests.checker.checker_runs import change
from tests.specifications.formulas import conjunction, persistent, text
from tests.specifications.test_formula import LETTERS, accepts, truth

check, checked, expressions = map(importlib.import_module, ("check", "formula", "expressions"))  # as `tampering` does
PARTIAL = tuple(
    frozenset((name, side) for name, side in zip("abc", sides, strict=True) if side is not None)
    for sides in itertools.product((False, True, None), repeat=3)
)
WORDS = [
    ([LETTERS[i] for i in letters], loop)
    for length in (1, 2, 3)
    for letters in itertools.product(range(8), repeat=length)
    for loop in range(length)
]


def as_checked(automaton):
    """simgap's automaton as the checker holds it."""
    letters = list(automaton.letters)
    return checked.Automaton(letters, automaton.step, automaton.good, automaton.done, automaton.persists)


def renamed(f):
    """simgap's normal form in the checker's words."""
    if f[0] in ("U", "R"):
        return (f[0], f[3], renamed(f[1]), renamed(f[2]))
    return f if f[0] in ("in", "true", "false") else (f[0], *map(renamed, f[1:]))


@pytest.mark.parametrize("make", [conjunction, persistent])
def test_formulas_are_read_alike_by_both_programs(make):
    rng = np.random.default_rng(5)
    texts = [text(make(rng)) for _ in range(300)]
    texts += ["!c U a & F b -> a | b U c U a", "a W b & c", "G F a", "!(a R[<=3] b)", "X X !a", "true U a|false & b"]
    texts += ["! F[<= 2] G a -> ! X b", "(a W[<= 3] b) -> c -> a"]
    for one in texts:
        assert checked.read_formula(one, Fraction(1)) == renamed(parse(one, int)), one


@pytest.mark.parametrize(
    ("deadline", "samples"), [("40 s", 800), ("0.1 s", 2), ("0.149 s", 2), ("100 ms", 2), ("1 min", 1200), ("3", 60)]
)
def test_deadlines_count_whole_samples(deadline, samples):
    assert checked.read_formula(f"F[<= {deadline}] a", Fraction("0.05"))[1] == samples


@pytest.mark.parametrize(
    "wrong",
    ["", "a &", "(a", "a b", "G", "a U", "F[<= soon] a", "F[<= 3 m] a", "F[<= -1] a", "[<= 3] a", "a ) b", "a # b",
     "U a", "F[<= 1e9 s] a", "F[<= 999999999] a", "(" * 3000 + "a", "X " * 1500 + "a", "&".join(["a"] * 900),
     "|".join(["(a&b)"] * 40),
     "a W " * 200 + "b"],
)  # fmt: skip
def test_what_is_no_formula_or_too_much_of_one_is_refused(wrong):
    with pytest.raises((expressions.Malformed, RecursionError)):
        checked.implies(as_checked(automaton_of(parse("F a", int), LETTERS)), checked.read_formula(wrong, Fraction(1)))


@pytest.mark.parametrize("make", [conjunction, persistent])
def test_every_automaton_of_simgap_implies_its_formula(make):
    """Also over letters that leave regions open."""
    rng, tried = np.random.default_rng([3, make is persistent]), 0
    for _ in range(120):
        one = text(make(rng))
        for letters in (LETTERS, PARTIAL):
            automaton = automaton_of(parse(one, int), letters)
            tried += 1
            assert checked.implies(as_checked(automaton), checked.read_formula(one, Fraction(1))), one
    assert tried == 240


def test_an_automaton_implies_another_formula_where_no_word_tells_them_apart():
    rng, found = np.random.default_rng(8), {True: 0, False: 0}
    missed = 0
    makers = (conjunction, persistent)
    for number in range(150):
        one, other = makers[number % 2](rng), makers[(number // 2) % 2](rng)
        automaton = automaton_of(parse(text(one), int), LETTERS)
        implied = checked.implies(as_checked(automaton), checked.read_formula(text(other), Fraction(1)))
        told = any(accepts(automaton, word, loop) and not truth(other, word, loop)[0] for word, loop in WORDS)
        found[implied] += 1
        assert not (implied and told), (text(one), text(other))
        missed += not implied and not told
    assert min(found.values()) > 10
    assert missed < found[False] / 10, (missed, found)  # words of three letters do not tell all


@pytest.mark.parametrize("make", [conjunction, persistent])
def test_an_edge_or_a_good_move_that_is_changed_is_found_where_a_word_shows_it(make):
    rng, found = np.random.default_rng([9, make is persistent]), {True: 0, False: 0}
    for _ in range(80):
        tree = make(rng)
        automaton = as_checked(automaton_of(parse(text(tree), int), LETTERS))
        states, count = automaton.step.shape
        automaton.step, automaton.good = automaton.step.copy(), automaton.good.copy()
        for _ in range(3):
            q, k = int(rng.integers(states)), int(rng.integers(count))
            automaton.step[q, k] = rng.integers(states)
            automaton.good[q, k] = True
        implied = checked.implies(automaton, checked.read_formula(text(tree), Fraction(1)))
        told = any(accepts(automaton, word, loop) and not truth(tree, word, loop)[0] for word, loop in WORDS[::3])
        found[implied] += 1
        assert not (implied and told), text(tree)
    assert min(found.values()) > 5


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    return tampering.originals(tmp_path_factory.mktemp("tasks"), ("rounds", "settling", "errand"))


@pytest.fixture
def copy(originals, tmp_path):
    def make(kind):
        return Path(shutil.copytree(originals[kind], tmp_path / kind))

    return make


def said(folder, capsys, *more):
    status = check.main([str(folder), "--exact", "20", *more])
    return status, capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("rounds", "'G F left & G F right & G slow' holds of every run that the automaton accepts (2 states)"),
        ("settling", "'F G right' holds of every run that the automaton accepts (1 states)"),
        ("errand", "not covered: That samples are the stated time apart, in which deadlines are counted."),
    ],
)
def test_every_pair_of_a_task_is_verified(copy, capsys, kind, words):
    folder = copy(kind)
    status, out = said(folder, capsys)
    assert (status, "ACCEPTED" in out) == (0, True), out
    assert words in out
    head = json.loads((folder / "certificate.json").read_text())
    lines = out.splitlines()
    assert [line for line in lines if "not covered" in line] == [f"not covered: {text}" for text in head["not_covered"]]
    bits = np.bitwise_count(np.load(folder / "inputs.npy")).sum()
    assert f"{int(bits):,} pairs of node and input" in out
    assert bits > 1000


def automaton(edit):
    return lambda head, tables: edit(head["automaton"])


def first(test):
    """The first node of those that a test of levels, inputs and moves chooses."""

    def nodes(head, tables):
        level, own = tables["levels"], head["automaton"]
        step, good = np.array(own["step"])[:, tables["letters"]].T, np.array(own["good"])[:, tables["letters"]].T
        return int(np.flatnonzero(test(level, step, good))[0])

    return nodes


def one_input_more(head, tables):
    """A push to the left at the lowest speed that wins."""
    level, bits = tables["levels"].reshape(60, 36, -1), tables["inputs"].reshape(60, 36, -1)
    v, x, state = np.argwhere((level > 0).swapaxes(0, 1))[0]
    bits[x, v, state] |= 1


def rank_lowered(head, tables):
    tables["levels"].reshape(-1)[first(lambda level, step, good: level == level.max())(head, tables)] = 1


def level_0(head, tables):
    tables["levels"].reshape(-1)[first(lambda level, step, good: (level == level.max()) & ~good)(head, tables)] = 0


def letter_flipped(head, tables):
    for letter in head["automaton"]["letters"]:
        for literal in letter:
            if literal[0] == "right":
                literal[1] = not literal[1]


def in_a_letter(head, tables):
    k = next(k for k, own in enumerate(head["automaton"]["letters"]) if ["left", True] in own)
    far = int(np.flatnonzero((tables["letters"] != k) & (tables["levels"] >= 0).any(axis=1))[-1])
    tables["letters"][far] = k


def moved(name, by):
    def edit(head, tables):
        ends = head["regions"][name][0]["x"]
        ends[:] = [(float.fromhex(end) + by).hex() for end in ends]

    return edit


def all_good(own):
    own["good"] = [[True] * len(row) for row in own["good"]]


def first_state_done(own):
    own["done"] = 0


def all_edges_alike(own):
    own["step"] = [[0] * len(row) for row in own["step"]]


def formula_is(words):
    return lambda head, tables: head.update(formula=words)


BREAKS = "REJECTED: the automaton accepts runs that break the formula"


@pytest.mark.parametrize(
    ("kind", "edit", "words"),
    [
        *((kind, one_input_more, "its successors are not shown") for kind in ("rounds", "settling", "errand")),
        *((kind, rank_lowered, "its successors are not shown") for kind in ("rounds", "settling", "errand")),
        ("rounds", level_0, "is at level 0 and its move is not good"),
        ("errand", level_0, "is at level 0 and its move is not good"),
        ("rounds", letter_flipped, "'right' and is not shown to be"),
        ("rounds", in_a_letter, "counts as in 'left' and is not shown to be"),
        ("rounds", automaton(all_good), BREAKS),
        ("settling", automaton(all_good), BREAKS),
        ("errand", automaton(all_good), BREAKS),
        ("settling", automaton(lambda own: own.update(persists=False)), BREAKS),
        ("rounds", automaton(first_state_done), BREAKS),
        ("errand", automaton(all_edges_alike), BREAKS),
        ("rounds", formula_is("G F left & G F right & G !slow"), BREAKS),
        ("rounds", formula_is("F G left"), BREAKS),
        ("settling", formula_is("G right"), BREAKS),
        ("errand", formula_is("F[<= 3.8 s] right & F left"), BREAKS),
        ("errand", formula_is("F[<= 4 s] (right & F left)"), BREAKS),
        ("errand", lambda head, tables: head.update(sampling_time="1/4"), BREAKS),
        ("rounds", moved("left", 0.1), "'left' and is not shown to be"),
        ("errand", moved("left", -0.05), "'left' and is not shown to be"),
        ("rounds", lambda head, tables: head["regions"].update(slow=[["+", "v", "x"]]), "'slow' and is not shown"),
        ("rounds", lambda head, tables: head["regions"]["right"].pop(), "counts as in 'right'"),
    ],
)
def test_a_changed_certificate_of_a_task_is_refused(copy, capsys, kind, edit, words):
    folder = copy(kind)
    head = json.loads((folder / "certificate.json").read_text())
    tables = {Path(name).stem: np.load(folder / name) for name in head["files"]}
    edit(head, tables)
    change(folder, lambda own: own.update({k: v for k, v in head.items() if k not in ("files", "digest")}), **tables)
    status, out = said(folder, capsys)
    assert (status, "REJECTED" in out) == (1, True), out
    assert words in out


@pytest.mark.parametrize("words", ["F left", "G F (left | right)", "G F left"])
def test_a_formula_that_asks_for_less_is_true_of_the_same_runs(copy, capsys, words):
    folder = copy("rounds")
    change(folder, lambda head: head.update(formula=words))
    assert said(folder, capsys)[0] == 0


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda h: h.update(formula="G F nowhere"), "no region 'nowhere'"),
        (lambda h: h.update(formula="G F"), "ends too early"),
        (lambda h: h.update(formula="G F left\n"), "cannot be printed"),
        (lambda h: h["regions"].update({"u\nACCEPTED": h["regions"]["left"]}), "cannot be printed"),
        (lambda h: h.update(formula=3), "a sampling time, a formula and regions"),
        (lambda h: h.update(sampling_time="-1/5"), "a sampling time, a formula and regions"),
        (lambda h: h["regions"].update(left=[]), "no list of boxes"),
        (lambda h: h["regions"].update(left=[{"z": ["0x0p+0", "0x1p+0"]}]), "bound some of the states"),
        (lambda h: h["regions"].update(left=[["sin", "u"]]), "neither a number nor a name"),
        (lambda h: h["automaton"].update(done=9), "no table of states"),
        (lambda h: h["automaton"]["step"][0].pop(), "no table of states"),
        (lambda h: h["automaton"]["step"][0].__setitem__(0, 7), "no table of states"),
        (lambda h: h["automaton"]["letters"][0].append(["left", 1]), "no table of states"),
        (lambda h: h["automaton"].pop("good"), "'good'"),
        (lambda h: h["files"].pop("letters.npy"), "'letters.npy'"),
    ],
)
def test_a_malformed_task_is_one_line_and_unreadable(copy, capsys, edit, words):
    folder = copy("rounds")
    change(folder, edit)
    status, out = said(folder, capsys)
    assert (status, out.count("\n")) == (2, 1), out
    assert words in out


def test_tables_of_a_task_that_are_cut_off_are_unreadable(copy, capsys):
    folder = copy("rounds")
    tables = {name: np.load(folder / f"{name}.npy") for name in ("letters", "levels", "inputs", "winning")}
    for name, table in tables.items():
        change(folder, **{name: table[:-1]})
        assert said(folder, capsys)[0] == 2
        change(folder, **{name: table})
    change(folder, letters=tables["letters"] + 9)
    assert "letters that its automaton does not know" in said(folder, capsys)[1]
    change(folder, letters=tables["letters"], levels=tables["levels"][:, :1].copy())
    assert said(folder, capsys)[0] == 2


def test_random_tasks_of_simgap_are_accepted(tmp_path, capsys):
    """The cart on a coarse grid, with any formula of the fragment about any boxes."""
    accepted, starts = 0, 0
    for seed in range(60):
        rng = np.random.default_rng([seed, 61])
        asked = {"formula": text((conjunction, persistent)[seed % 2](rng)), "regions": {}}
        for name in "abc":
            a, b = np.sort(rng.uniform(0.0, 2.0, 2))
            asked["regions"][name] = {"x": (a, b + 0.1)} if rng.random() < 0.7 else f"x^2 + v <= {a:.3f} + x*v"
        try:
            made = tampering.cart(asked, (24, 12), 1.0)
        except UserError:  # what no way through the regions keeps, or nothing wins
            continue
        write_certificate(tmp_path / str(seed), made, {})
        status, out = said(tmp_path / str(seed), capsys)
        assert status == 0, (asked, out)
        accepted += 1
        starts += 0 < made.solution.fraction < 1
    assert accepted > 15
    assert starts > 10


def test_deadlines_and_inequalities_that_have_no_form_are_refused_in_one_line(tmp_path):
    for asked, problem in (
        ({"formula": "F[<= 4000000 us] right"}, "no deadline '4000000 us'"),
        ({"formula": "F[<= 0.12345678901 min] right"}, "no deadline '0.12345678901 min'"),
        ({"formula": "F küche", "regions": {"küche": {"x": [0, 1]}}}, "no region 'küche'"),
        ({"formula": "G F left", "regions": {"left": "sqrt(x) <= 1"}}, "no form for"),
    ):
        with pytest.raises(UserError, match=problem) as caught:
            write_certificate(tmp_path / "none", tampering.cart(asked), {})
        assert caught.value.key.startswith("synthesis.specification.")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"sensing": {"error": {"q": 0.01}}}, "covers exact sensing"),
        ({"sensing": {"latency": 1}}, "covers exact sensing"),
        ({"simulator.noise": {"u": {"uniform": 0.1}}}, "a simulator with noise"),
    ],
)
def test_a_task_with_what_no_certificate_covers_is_refused_in_one_line(vary, tmp_path, changes, problem):
    case = vary("swing_up", changes)
    with pytest.raises(UserError, match=problem) as caught:
        certify.run(case, tmp_path / "gap.json", tmp_path / "controller.npz", tmp_path / "out")
    assert caught.value.remedy
    assert not (tmp_path / "out").exists()


INSIDE = {
    "sin(q) <= 0.3": lambda q, v: np.sin(q) <= 0.3,
    "(q - 1)^2 - v*q <= 0.4": lambda q, v: (q - 1) ** 2 - v * q <= 0.4,
    "1/(3 + v) <= 0.4": lambda q, v: 1 / (3 + v) <= 0.4,
    "max(q, v) <= 0.7": lambda q, v: np.maximum(q, v) <= 0.7,
    "1/v <= 2": lambda q, v: 1 / v <= 2,
}


def in_copies(q, v, ends, turns):
    return np.any([(q + t >= ends[0]) & (q + t <= ends[1]) for t in turns], axis=0)


def test_no_point_refutes_what_is_shown_of_a_cell():
    """Boxes of any size and place and inequalities, on a grid that may wrap around."""
    grids, regions = (importlib.import_module(name) for name in ("certificate", "regions"))
    shown = 0
    for seed in range(30):
        rng = np.random.default_rng([seed, 62])
        lo, width, cells = np.array([rng.choice([-3.0, 0.0]), -2.0]), rng.choice([2.0, 6.0], 2), rng.integers(3, 20, 2)
        wraps = bool(rng.integers(2))
        ends = [[*map(Fraction, side.tolist())] for side in (lo, lo + width)]
        level, flags = np.zeros((cells.prod(), 1), np.int32), [wraps, False]
        c = grids.Certificate({}, ["q", "v"], [], *ends, cells.tolist(), flags, [], None, None, level, None)
        if rng.random() < 0.5:
            name = list(INSIDE)[rng.integers(len(INSIDE))]
            part, holds = prefix(inequality(name, Space(("q", "v"), Box(lo, lo + width)), "a")), INSIDE[name]
        else:
            a = rng.uniform(-9, 9)
            b = a + rng.uniform(0.1, 7)
            part = {0: (Fraction(a), Fraction(b))}
            turns = width[0] * np.arange(-12, 13) * wraps
            holds = functools.partial(in_copies, ends=(a, b), turns=turns)
        with np.errstate(all="ignore"):
            inside, outside = (regions._shown(c, part, side, np.arange(c.size)) for side in (True, False))
            index = np.stack(np.unravel_index(np.arange(c.size), cells), axis=1)
            for _ in range(30):
                true = holds(*(lo + width / cells * (index + rng.beta(0.3, 0.3, index.shape))).T)
                assert true[inside].all()
                assert not true[outside].any()
        shown += int(inside.sum() + outside.sum())
    assert shown > 500
