"""The checker of certificates: it imports nothing of simgap, accepts what holds and names the cell of what does not."""

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from simgap.config.gap import GapSection, LipschitzSection
from simgap.errors import UserError
from simgap.extras.certify import Certified, prefix, write_certificate
from simgap.gap.bases import Expressions
from simgap.gap.bounds.enclosures import ClosedFormGap
from simgap.geometry import Box, Grid
from simgap.model.expressions import parse
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import symbol
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.checker.checker_runs import CHECKER, change, run
from tests.gap.fit_in_memory import GapSamples, fit_gap

NAMES = ["x1", "x2", "u"]
NOMINAL = ("x1 + 0.05*x2", "x2 + 0.15*u - 0.7*sin(x1)")
SIMULATOR = ("x1 + 0.05*x2 + 0.001*x2*abs(x2)", "x2 + 0.16*u - 0.69*sin(x1) + 0.003*x1*x2*cos(x1)")
U = np.linspace(-1.2, 1.2, 5)[:, None]
SHAPE = (32, 30)


def pendulum(periodic=(), safe=None, shape=SHAPE):
    """A small pendulum, its proven bound and its invariant set."""
    x, u = (symbol("x1"), symbol("x2")), (symbol("u"),)
    model = NominalModel(x, u, tuple(parse(t, NAMES) for t in NOMINAL), 0.05)
    known = ClosedFormGap.of([parse(t, NAMES) for t in SIMULATOR], model)
    box = Box([-0.2, -0.5], [0.2, 0.5])
    grid = Grid(box, [20, 50], periodic)
    points, inputs = np.repeat(grid.centres(), len(U), axis=0), np.tile(U, (grid.size, 1))
    simulator = NominalModel(x, u, tuple(parse(t, NAMES) for t in SIMULATOR), 0.05)
    d = (simulator.step(points, inputs) - model.step(points, inputs)).reshape(grid.size, len(U), 2)
    samples = GapSamples(grid, U, d, ("x1", "x2"), ("u",), periodic=periodic, known=known)
    basis = Expressions(terms=("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1"))
    bound = fit_gap(samples, GapSection(basis=basis, lipschitz=LipschitzSection(extreme_value=False))).function
    specification = Invariance(kind="invariance", safe={"x1": (-0.2, 0.2), "x2": (-0.5, 0.5)} | (safe or {}))
    space = Space(("x1", "x2"), box, periodic)
    solution = synthesise(SynthesisProblem(model, specification, space, shape, U, bound.kernel()))
    units = {"x1": "rad", "x2": "rad/s", "u": "N*m"}
    return Certified("small", units, model, bound, known, solution, U, ["u"], specification.region(space))


@pytest.fixture(scope="module")
def made():
    return pendulum(safe={"x1": (-0.1, 0.2)})


@pytest.fixture(scope="module")
def original(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificate")
    write_certificate(folder, made, {})
    return folder


@pytest.fixture
def certificate(original, tmp_path):
    return Path(shutil.copytree(original, tmp_path / "copy"))


def test_it_imports_the_standard_library_numpy_and_itself():
    own = {path.stem for path in CHECKER.glob("*.py")}
    for path in CHECKER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for name in names:
                root = name.split(".")[0]
                assert root in own or root == "numpy" or root in sys.stdlib_module_names, (path, name)


def test_a_true_certificate_is_accepted_in_both_arithmetics(certificate, made):
    status, words = run(certificate, "--exact", "60")
    assert (status, "ACCEPTED" in words) == (0, True), words
    assert f"{int(made.solution.winning.sum()):,} of {np.prod(SHAPE):,} cells" in words
    assert f"{int(np.bitwise_count(made.solution.mask).sum()):,} pairs" in words
    header = json.loads((certificate / "certificate.json").read_text())
    assert [line for line in words.splitlines() if line.startswith("not covered")] == [
        f"not covered: {text}" for text in header["not_covered"]
    ]
    assert made.solution.fraction > 0.3


def test_every_input_that_the_controller_does_not_admit_is_refused_where_it_would_be_unsafe(certificate, made):
    """One bit: an input that leaves the winning set, in the cell that is named."""
    mask = made.solution.mask.copy()
    bits = np.unpackbits(mask, axis=1, count=len(U), bitorder="little").astype(bool)
    cell = int(np.flatnonzero(made.solution.winning & ~bits[:, 0])[7])
    mask[cell, 0] |= 1
    change(certificate, inputs=mask)
    status, words = run(certificate, "--exact", "0")
    index = tuple(int(k) for k in np.unravel_index(cell, SHAPE))
    assert status == 1
    assert f"REJECTED: cell {index} with input 0" in words


def test_one_winning_cell_taken_out_is_missed(certificate, made):
    winning = made.solution.winning.astype(np.uint8)
    inner = np.flatnonzero(winning)
    cell = int(inner[len(inner) // 2])
    winning[cell], mask = 0, made.solution.mask.copy()
    mask[cell] = 0
    change(certificate, winning=winning, inputs=mask)
    status, words = run(certificate, "--exact", "0")
    assert status == 1
    assert "REJECTED: cell (" in words


def test_a_promise_without_an_input_and_an_input_without_a_promise_are_named(certificate, made):
    cell = int(np.flatnonzero(made.solution.winning)[3])
    index = tuple(int(k) for k in np.unravel_index(cell, SHAPE))
    mask = made.solution.mask.copy()
    mask[cell] = 0
    change(certificate, inputs=mask)
    assert run(certificate)[1].startswith(f"REJECTED: cell {index} is promised and has no input")
    winning = made.solution.winning.astype(np.uint8)
    winning[cell] = 0
    change(certificate, inputs=made.solution.mask, winning=winning)
    assert run(certificate)[1].startswith(f"REJECTED: cell {index} has an input and no promise")


@pytest.mark.parametrize("state", ["x1", "x2"])
def test_a_bound_too_narrow_for_the_equations_is_refused_with_a_cell(certificate, state):
    def narrow(head):
        head["gap"][state]["upper"] = ["+", head["gap"][state]["upper"], (-2e-5).hex()]

    change(certificate, narrow)
    status, words = run(certificate, "--exact", "0")
    assert status == 1
    assert "REJECTED: cell (" in words
    assert "within the stated bound" in words


def test_a_larger_safe_set_or_another_map_is_refused(certificate):
    change(certificate, lambda head: head["safe"].update(x1=[(-0.05).hex(), (0.2).hex()]))
    assert "is not safe along x1" in run(certificate)[1]
    change(certificate, lambda head: head["safe"].update(x1=[(-0.1).hex(), (0.2).hex()]))
    assert run(certificate, "--sample", "50", "--exact", "0")[0] == 0
    change(certificate, lambda head: head["nominal"].update(x1=["+", head["nominal"]["x1"], (1e-3).hex()]))
    assert run(certificate, "--exact", "0")[0] == 1


def test_damage_is_unreadable_and_not_accepted(certificate):
    path = certificate / "inputs.npy"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(bytes(content))
    status, words = run(certificate)
    assert (status, "UNREADABLE: inputs.npy was changed" in words) == (2, True)
    head = (certificate / "certificate.json").read_text()
    (certificate / "certificate.json").write_text(head.replace('"small"', '"other"'))
    assert run(certificate)[0] == 2


def line(folder, step, upper, lower="0x0.0p+0", simulator=None, **more):
    """A chain of four cells on [0, 1] with one input, by hand: cells 0 to 2 are promised."""
    folder.mkdir(exist_ok=True)
    ends = ["0x0.0p+0", "0x1.0p+0"]
    head = {
        "format": "simgap certificate", "version": 1, "kind": "invariance", "case": "line",
        "states": [{"name": "x", "unit": "m"}], "inputs": [{"name": "u", "unit": "m"}],
        "grid": {"lo": ends[:1], "hi": ends[1:], "cells": [4], "periodic": [False]}, "input_set": [["0x0.0p+0"]],
        "domain": {"x": ends}, "safe": {"x": ends}, "nominal": {"x": step}, "files": {}, "not_covered": [],
        "gap": {"x": {"lower": lower, "upper": upper}}, "simulator": {"x": simulator} if simulator else None,
    }  # fmt: skip
    (folder / "certificate.json").write_text(json.dumps(head | more))
    tables = {"winning": np.array([1, 1, 1, 0], np.uint8), "inputs": np.array([[1], [1], [1], [0]], np.uint8)}
    return head | more, tables


def test_rounding_that_is_left_out_of_a_bound_is_found(tmp_path):
    """The gap is 0.1 + 0.2 exactly; the nearest double lies above it, that of 0.3 below."""
    gap = Fraction(0.1) + Fraction(0.2)
    assert Fraction(0.3) < gap < Fraction(0.1 + 0.2)
    step = ["+", ["*", "0x1.0p-2", "x"], "0x1.0p-5"]
    simulator = ["+", step, (0.1).hex(), (0.2).hex()]
    for upper, status in ((0.3, 1), (0.3 + 1e-14, 0)):
        _, tables = line(tmp_path / "line", step, upper.hex(), simulator=simulator)
        change(tmp_path / "line", **tables)
        for exactly in ("0", "9"):
            assert run(tmp_path / "line", "--exact", exactly)[0] == status
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path\n"
        "import certificate, check; c = certificate.read(Path(sys.argv[2]))\n"
        "print([check.fails_exactly(check.Steps(c), k, 0) for k in range(3)])"
    )
    leaves = ["+", step, ["*", (0.1).hex(), "x"]]  # leaves [0, 0.03] on part of the first cells
    for upper, known, said in ((0.3, simulator, "[True, True, True]"), (0.03, leaves, "[True, True, True]")):
        line(tmp_path / "line", step, upper.hex(), simulator=known)
        change(tmp_path / "line", **tables)
        command = [sys.executable, "-c", code, str(CHECKER), str(tmp_path / "line")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.stdout.strip() == said, done.stderr


def test_a_box_that_ends_on_the_border_of_a_losing_cell_touches_it(tmp_path):
    """x+ = x / 2 + c: the largest promised state .75 goes to .375 + c, and the losing cell begins at .75."""
    for c, status in ((0.375, 1), (0.375 - 1e-10, 0)):
        _, tables = line(tmp_path / "line", ["+", ["*", "0x1.0p-1", "x"], c.hex()], "0x0.0p+0")
        change(tmp_path / "line", **tables)
        done, words = run(tmp_path / "line")
        assert done == status, words
    assert "cell (2,) with input 0" not in words


@pytest.mark.parametrize("black", [True, False])
def test_a_step_that_does_not_repeat_is_not_taken_for_one_that_wraps_around(tmp_path, black):
    """The sine of x1 is another one after .4: a controller that keeps every cell keeps nothing."""
    made = pendulum(periodic=(0,), shape=(16, 30))
    assert made.solution.fraction == 1.0
    write_certificate(tmp_path / "false", replace(made, known=None) if black else made, {})
    status, words = run(tmp_path / "false", "--exact", "0")
    assert (status, words) == (1, "REJECTED: the map of x2 is not shown to repeat along x1 every 0.4\n")


@pytest.mark.parametrize(
    ("ends", "simulated", "words"),
    [
        ((0.0, 1.0), None, "states 1 apart along x are one and the same, and the black box repeats itself so."),
        ((0.0, 1.0), "x", "REJECTED: the simulator of x is not shown to repeat along x every 1"),
        ((-np.pi, np.pi), ["sin", "x"], "states 6.28319 apart along x are one and the same."),
        ((-np.pi, np.pi), ["sin", ["*", "1/3", "x"]], "REJECTED: the simulator of x is not shown to repeat along x"),
    ],
)
def test_on_a_circle_equations_repeat_and_what_is_one_state_is_said(checker, tmp_path, capsys, ends, simulated, words):
    """Whatever the header says of it: nothing."""
    ends, step = [end.hex() for end in ends], ["+", "x", (0.3).hex()]
    more = {"grid": {"lo": ends[:1], "hi": ends[1:], "cells": [4], "periodic": [True]}, "not_covered": []}
    more |= {"domain": {"x": ends}, "safe": {"x": ends}}
    simulator = ["+", step, ["*", (0.1).hex(), simulated]] if simulated else None
    line(tmp_path / "line", step, (0.2).hex(), (-0.2).hex(), simulator, **more)
    change(tmp_path / "line", winning=np.ones(4, np.uint8), inputs=np.ones((4, 1), np.uint8))
    status, said = checker([str(tmp_path / "line")]), capsys.readouterr().out
    assert status == int(words.startswith("REJECTED"))
    assert words in said
    assert ("which is a black box" in said) == (simulated is None)


@pytest.mark.parametrize(
    ("text", "by"),
    [
        ("x1 + 0.05*x2 - 0.7*sin(x1)", 1), ("cos(2*x1)/(2 + sin(x1 + u))", 0), ("3*x1 - abs(cos(x1))^3", 3),
        ("max(x1, x1 + x2)", 1), ("sin(x1 + x2*cos(x1))*x2", 0), ("x2*(x1 - (x1 + u))", 0), ("x1/2", 0.5),
        ("x1*x2", None), ("sin(x1/2)", None), ("x1^2", None), ("abs(x1)", None), ("1/(9 + x1)", None),
        ("max(x1, x2)", None), ("sin(1.0001*x1)", None), ("sin(x1*x2)", None), ("cos(x1^2)", None),
    ],
)  # fmt: skip
def test_how_far_an_expression_moves_after_a_turn_is_what_its_values_say(arithmetics, text, by):
    import repeats
    import sympy as sp

    e, turn, rng = (
        sp.sympify(text.replace("^", "**"), locals={n: symbol(n) for n in NAMES}),
        2 * np.pi,
        np.random.default_rng(5),
    )
    found = repeats.moved(prefix(e), {"x1": Fraction(turn), "x2": Fraction(0), "u": Fraction(0)})
    at = rng.uniform(-1, 1, (50, 3))
    value = sp.lambdify([symbol(n) for n in NAMES], e, "numpy")
    apart = value(*(at + np.array([turn, 0, 0])).T) - value(*at.T)
    if by is None:
        assert found is None
        assert np.ptp(apart) > 1e-6
    else:
        assert found == Fraction(turn) * Fraction(by)
        assert np.abs(apart - by * turn).max() < 1e-12


def nested(depth):
    return "x" if depth == 0 else ["+", nested(depth - 1)]


def without(key):
    return lambda head: head.pop(key)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (without("not_covered"), "'not_covered'"),
        (without("simulator"), "'simulator'"),
        (without("safe"), "'safe'"),
        (without("files"), "'files'"),
        (lambda head: head["files"].pop("winning.npy"), "'winning.npy'"),
        (lambda head: head["gap"]["x"].pop("upper"), "'upper'"),
        (lambda head: head["nominal"].pop("x"), "'x'"),
        (lambda head: head.update(not_covered="nothing"), "sentences"),
        (lambda head: head.update(simulator={"x": "y"}), "'y' is neither a number nor a name"),
        (lambda head: head.update(domain={"x": ["0x0.0p+0"]}), "no interval"),
        (lambda head: head.update(input_set=[[]]), "do not fit"),
        (lambda head: head["grid"].update(cells=["4"]), "do not fit"),
        (lambda head: head.update(inputs=[{"name": "x"}]), "no two the same"),
        (lambda head: head.update(kind="reach_stay"), "of the kind 'reach_stay', which this checker does not know"),
        (lambda head: head.update(kind="reach_avoid"), "'levels.npy'"),
        (lambda head: head.update(inputs=[{"name": "*a0", "unit": "m"}]), "no name begins with '*'"),
        (lambda head: head.update(inputs=[{"name": "u\nACCEPTED", "unit": "m"}]), "cannot be printed"),
    ],
)
def test_a_malformed_header_is_one_line_and_unreadable(checker, tmp_path, capsys, edit, words):
    _, tables = line(tmp_path / "line", ["*", "0x1.0p-1", "x"], "0x0.0p+0")
    change(tmp_path / "line", edit, **tables)
    assert checker([str(tmp_path / "line")]) == 2
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 1
    assert said[0].startswith("UNREADABLE: ")
    assert words in said[0]


@pytest.mark.parametrize(
    "e",
    [
        ["^", "x"], ["^", "x", 2, 2], ["^", "x", 0], ["^", "x", True], ["^", "x", "0x1.0p+1"], ["/", "x", "x"], ["/"],
        ["sin", "x", "x"], ["abs"], ["+"], [["+", "x"], "x"], ["hull", "0x0.0p+0"], ["by_input", "x"], ["tan", "x"],
        [], "y", "1/0", "0x1p+9999", "1" + "0" * 400 + "/3", 10**400, 0.5, None, {"x": 1}, "x\ny",
        ["*", "x", ["/", "x", "x"]], nested(201), ["^", "x", 10**9], ["^", ["+", ["^", "x", 9_999]], 2],
    ],
)  # fmt: skip
def test_a_malformed_expression_is_one_line_and_unreadable(checker, tmp_path, capsys, e):
    _, tables = line(tmp_path / "line", e, "0x0.0p+0")
    change(tmp_path / "line", **tables)
    assert checker([str(tmp_path / "line")]) == 2
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 1
    assert said[0].startswith("UNREADABLE: ")


def test_a_table_that_is_empty_or_of_something_else_is_unreadable(checker, tmp_path, capsys):
    folder = tmp_path / "line"
    _, tables = line(folder, "x", "0x0.0p+0")
    change(folder, **tables)
    for content in (b"", b"PK", b"\x93NUMPY"):
        (folder / "winning.npy").write_bytes(content)
        digest = hashlib.sha256(content).hexdigest()
        change(folder, lambda head, digest=digest: head["files"].update({"winning.npy": digest}))
        assert checker([str(folder)]) == 2
        assert len(capsys.readouterr().out.splitlines()) == 1
    assert checker([str(tmp_path / "nowhere")]) == 2


@pytest.mark.parametrize("name", ["certificate.json", "winning.npy"])
@pytest.mark.parametrize("kind", ["pipe", "device", "empty", "folder"])
def test_what_would_keep_its_reader_waiting_is_not_opened(tmp_path, name, kind):
    """In a process of its own, which would wait for ever."""
    folder = tmp_path / "line"
    _, tables = line(folder, "x", "0x0.0p+0")
    change(folder, **tables)
    path = folder / name
    path.unlink()
    make = {"pipe": os.mkfifo, "device": lambda p: p.symlink_to("/dev/zero"), "empty": Path.touch, "folder": Path.mkdir}
    make[kind](path)
    command = [sys.executable, str(CHECKER / "check.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stderr, len(done.stdout.splitlines())) == (2, "", 1)
    assert f"UNREADABLE: {name} is no regular file" in done.stdout


def test_a_sample_is_at_least_one_pair(checker, tmp_path, capsys):
    step = ["+", ["*", "0x1.0p-1", "x"], "0x1.0p-5", ["*", "0x0.0p+0", nested(198)]]  # as deep as it may be
    _, tables = line(tmp_path / "line", step, "0x0.0p+0")
    change(tmp_path / "line", **tables)
    for option in ("--sample=0", "--sample=-3", "--exact=-1"):
        assert checker([str(tmp_path / "line"), option]) == 2
        assert capsys.readouterr().out == "--sample is at least 1, --exact and --seed at least 0\n"
    assert checker([str(tmp_path / "line"), "--sample=1", "--exact=0"]) == 0
    assert "intervals: 1 pairs of cell and input verified (every k-th of each input)" in capsys.readouterr().out


@pytest.fixture
def checker(arithmetics):
    """`main` of the checker in this process: status of a list of arguments."""
    import check

    return check.main


@pytest.fixture(scope="module")
def arithmetics():
    sys.path.insert(0, str(CHECKER))
    try:
        import check  # noqa: F401
        import expressions
        import intervals
        import rationals

        yield intervals, rationals, expressions
    finally:
        sys.path.remove(str(CHECKER))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_hold_the_true_value(arithmetics, name):
    """SymPy's forty digits are the oracle, in every quadrant and at the crests."""
    import sympy as sp

    intervals, rationals, _ = arithmetics
    rng = np.random.default_rng(4)
    points = np.concatenate([rng.uniform(-12, 12, 60), np.pi / 2 * np.arange(-5, 6), [0.0, 1e-300, 1e-8]])
    lo, hi = getattr(intervals, name)((points, points))
    for k, x in enumerate(points.tolist()):
        value = Fraction(str(sp.N(getattr(sp, name)(sp.Rational(x)), 40)))
        a, b = getattr(rationals, name)((Fraction(x), Fraction(x)))
        assert Fraction(lo[k]) <= value <= Fraction(hi[k])
        slack = Fraction(1, 10**38)  # the oracle is rounded too
        assert a - slack <= value <= b + slack
        assert hi[k] - lo[k] < 1e-14
        assert b - a < Fraction(1, 10**31)  # at a crest its top is taken
    wide = np.array([-0.3, 1.0, 1.5, -2.0]), np.array([0.4, 2.0, 5.0, 9.0])
    lo, hi = getattr(intervals, name)(wide)
    for k in range(4):
        values = getattr(np, name)(np.linspace(wide[0][k], wide[1][k], 2001))
        assert lo[k] <= values.min() <= lo[k] + 1e-5
        assert hi[k] - 1e-5 <= values.max() <= hi[k]


def test_rounded_operations_hold_the_exact_ones_and_would_not_without_rounding(arithmetics, monkeypatch):
    intervals, rationals, _ = arithmetics
    rng = np.random.default_rng(8)
    ends = np.sort(rng.normal(size=(2, 2, 300)) * 10.0 ** rng.integers(-8, 8, (2, 2, 300)), axis=1)
    a, b = (tuple(pair) for pair in ends)

    def missed():
        count = 0
        for name, args in (
            ("add", (a, b)), ("mul", (a, b)), ("inverse", (b,)), ("power", (a, 3)), ("power", (b, 4)),
        ):  # fmt: skip
            lo, hi = getattr(intervals, name)(*args)
            for k in range(300):
                own = [tuple(Fraction(end[k]) for end in p) if isinstance(p, tuple) else p for p in args]
                if name == "inverse" and own[0][0] <= 0 <= own[0][1]:
                    continue
                low, high = getattr(rationals, name)(*own)
                count += not (Fraction(lo[k]) <= low and high <= Fraction(hi[k]))
        return count

    assert missed() == 0
    monkeypatch.setattr(intervals, "down", lambda x: x)
    monkeypatch.setattr(intervals, "up", lambda x: x)
    assert missed() > 100


@pytest.mark.parametrize(
    "text", ["x1*sin(x2) - u/3", "abs(x1 - x2)*cos(3*x1)", "max(x1, x2^2) + min(u, x1)", "x1^3/(2 + x2^2)", "0.1 + x1"]
)
def test_ranges_hold_the_values(arithmetics, text):
    """Random boxes and points of them, both arithmetics, values in ordinary floating point as the oracle."""
    import sympy as sp

    intervals, rationals, expressions = arithmetics
    e, rng = parse(text, NAMES), np.random.default_rng(1)
    value = sp.lambdify([symbol(n) for n in NAMES], e, "numpy")
    form, u = json.loads(json.dumps(prefix(e))), 0.7
    states = {"x1": 0, "x2": 1}
    for _ in range(5):
        ends = np.sort(rng.uniform(-1, 1, (2, 2)), axis=0)
        at = rng.uniform(ends[0], ends[1], (500, 2))
        values = value(at[:, 0], at[:, 1], u)
        for arithmetic, kind in ((intervals, np.float64), (rationals, Fraction)):
            box = [(kind(ends[0, j]), kind(ends[1, j])) for j in range(2)]
            mid = [((lo + hi) / 2,) * 2 for lo, hi in box]
            named = {"u": arithmetic.number(Fraction(u))}
            lo, hi = expressions.Place(arithmetic, states, box, mid, named).range(form)
            assert float(lo) <= values.min() + 1e-12
            assert values.max() - 1e-12 <= float(hi)


def test_what_a_certificate_does_not_cover_is_refused_in_one_line(made, tmp_path):
    from simgap.gap.bounds.cells import CellGap

    blocks = CellGap(made.bound.domain, (), (), np.zeros(0), np.zeros(0))
    late = replace(made.solution, memory=2, late=True)
    reach = replace(made.solution, value=np.zeros(np.prod(SHAPE), np.int32))
    for changed, words in (
        ({"bound": blocks}, "linear"),
        ({"solution": late}, "latency"),
        ({"solution": reach}, "latency"),
    ):
        with pytest.raises(UserError, match=words) as caught:
            write_certificate(tmp_path / "none", replace(made, **changed), {})
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "none").exists()
    with pytest.raises(UserError, match="no form for 'tanh'"):
        prefix(parse("tanh(x1)", NAMES))
