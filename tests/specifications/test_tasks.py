"""Tasks against brute force on explicit products of a few cells with an automaton.

The oracle lists every node (cell, pending input, state) and solves the game by removing what the adversary can trap,
the other way round than the fixed points of the code. Automata are tested by themselves (`test_formula`). What a
controller may apply is checked by following all of it: nothing unserved is reached, and no circle lacks a good move.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from simgap.closed_loop import Sensing, batch_loop, closed_loop, strays
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.io.controller_file import load_controller, save_controller
from simgap.specifications.base import Run
from simgap.specifications.formula import automaton_of, parse, regions
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.specifications.task import Task
from simgap.synthesis.controller import Controller
from tests.specifications.formulas import conjunction, persistent, text
from tests.specifications.tiny_games import INPUTS, Tiny, inside, random_box

PROBLEMS = 120


def sure(tiny, cell, boxes, names):
    """Literals that hold of every state of a cell, its faces included."""
    found = set()
    for name in names:
        turns = (-tiny.cells[1], 0, tiny.cells[1]) if tiny.periodic else (0,)
        touches = any(
            all(
                boxes[name][axis][0] <= k + by + 1 and k + by <= boxes[name][axis][1]
                for axis, k, by in (("a", cell[0], 0), ("b", cell[1], turn))
            )
            for turn in turns
        )
        if inside(cell, boxes[name]):
            found.add((name, True))
        elif not touches:
            found.add((name, False))
    return frozenset(found)


class Explicit:
    """The product of a tiny plant with a task: nodes, moves, and whether they are good."""

    def __init__(self, tiny, formula, boxes, late):
        names = sorted(regions(formula))
        cells = list(itertools.product(*(range(n) for n in tiny.cells)))
        self.free = {k for k in cells if not any(inside(k, box) for box in tiny.obstacles)}
        letters = {k: sure(tiny, k, boxes, names) for k in cells}
        order = [(name, side) for name in names for side in (True, False)]  # states are numbered as letters come
        every = tuple(sorted({*letters.values()}, key=lambda own: sum(1 << order.index(one) for one in own)))
        self.automaton = automaton_of(formula, every)
        number = {k: every.index(letters[k]) for k in cells}
        self.step = lambda q, k: int(self.automaton.step[q, number[k]]) if k in self.free else -1
        self.good = lambda q, k: bool(self.automaton.good[q, number[k]])
        after = {k: tiny.moves(k) for k in cells}
        pending = range(INPUTS if late else 1)
        states = range(len(self.automaton.step))
        self.nodes = [(k, p, q) for k in cells for p in pending for q in states if k in self.free]
        self.moves = {}
        for k, p, q in self.nodes:
            own = []
            for m in range(INPUTS):
                reached = after[k][p if late else m]
                if q == self.automaton.done:
                    own.append([])
                elif reached is None or any(self.step(q, t) < 0 for t in reached):
                    own.append(None)
                else:
                    own.append([((t, m if late else 0, self.step(q, t)), self.good(q, t)) for t in reached])
            self.moves[k, p, q] = own

    def winning(self):
        """Nodes that are won: for co-Buechi those where the adversary cannot force moves that are not good for ever."""
        persists = self.automaton.persists
        alive = set(self.nodes)
        if persists:
            return self._persistent(alive)
        while True:
            forced = self._force(alive)
            if forced == alive:
                return alive
            alive = forced

    def _force(self, alive):
        """Nodes of `alive` from which a good move within it can be forced; done ones need no move."""
        found = {n for n in alive if n[2] == self.automaton.done}
        while True:
            more = {
                n
                for n in alive - found
                if any(
                    own is not None and all((good and t in alive) or t in found for t, good in own)
                    for own in self.moves[n]
                )
            }
            if not more:
                return found
            found |= more

    def _persistent(self, alive):
        lost = set()
        while True:
            left = alive - lost
            trapped = {n for n in left if all(own is None or any(t in lost for t, _ in own) for own in self.moves[n])}
            if trapped:
                lost |= trapped
                continue
            # Nodes of `left` where the adversary forces a bad move that stays in a set from which he can do so again.
            again = set(left)
            while True:
                force = set()
                while True:
                    more = {
                        n
                        for n in again - force
                        if all(
                            own is None or any((not good and t in again) or t in force or t in lost for t, good in own)
                            for own in self.moves[n]
                        )
                    }
                    if not more:
                        break
                    force |= more
                if force == again:
                    break
                again = force
            if not again:
                return left
            lost |= again


def solved(tiny, formula, boxes, late):
    task = Task(kind="task", formula=formula, regions=boxes, obstacles=tiny.obstacles)
    return task.solve(tiny.game(late))


def by_oracle(tiny, explicit, found, late):
    """Compare winning sets; -> how many nodes are won."""
    won = explicit.winning()
    states, base = len(explicit.automaton.step), INPUTS if late else 1
    value = found.value.reshape(*tiny.cells, states, base)
    bits = np.unpackbits(found.mask, axis=1, count=INPUTS, bitorder="little").reshape(*value.shape, INPUTS)
    for k in itertools.product(*(range(n) for n in tiny.cells)):
        for before, p in itertools.product(range(states), range(base)):
            q = explicit.step(before, k)
            assert (value[(*k, before, p)] >= 0) == (q >= 0 and (k, p, q) in won), (k, before, p)
            if q < 0 or (k, p, q) not in won or q == explicit.automaton.done:
                assert not bits[(*k, before, p)].any()
                continue
            level = value[(*k, before, p)]
            goes_on = explicit.automaton.persists
            assert goes_on or (level == 0) == explicit.good(before, k)
            assert bits[(*k, before, p)].any()
            for m in np.flatnonzero(bits[(*k, before, p)]):
                for (t, pending, _), good in explicit.moves[k, p, q][m]:
                    then = value[(*t, q, pending)]
                    assert then >= 0
                    if goes_on:  # it never rises, and stays as it is at the goal alone
                        assert then < level or (then == level and explicit.good(before, k))
                    else:
                        assert good or level == 0 or then < level, "a circle without a good move"
    return len(won)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize("make", [conjunction, persistent])
def test_winning_sets_of_tasks_are_those_of_the_definition(make, rows, late):
    some = all_won = unequal = 0
    for seed in range(PROBLEMS):
        tiny = Tiny([seed, rows, late, 35], rows)
        rng = np.random.default_rng([seed, 35])
        tree = make(rng)
        boxes = {name: random_box(rng, tiny.cells, 3) for name in ("a", "b", "c")}
        formula = parse(text(tree), int)
        explicit = Explicit(tiny, formula, boxes, late)
        if not explicit.automaton.possible:
            assert not explicit.winning(), text(tree)
            with pytest.raises(UserError, match="no way through the regions"):
                solved(tiny, text(tree), boxes, late)
            continue
        found = solved(tiny, text(tree), boxes, late)
        count = by_oracle(tiny, explicit, found, late)
        some += count > 0
        all_won += count == len(explicit.nodes)
        unequal += 0 < count < len(explicit.nodes)
    assert unequal > PROBLEMS // 5
    assert some > all_won


def test_the_rank_falls_until_the_next_good_move_and_no_further():
    """Two rooms of a corridor that are visited in turn: by hand."""
    tiny = Tiny([1, False], False)
    tiny.cells, tiny.periodic, tiny.obstacles = (5, 1), (), []
    tiny.offsets = np.zeros((2, 5, INPUTS, 2), int)
    tiny.offsets[0] = np.array([-1, 0, 1, 1])[None, :, None]
    found = solved(tiny, "G F a & G F b", {"a": {"a": (0.0, 1.0)}, "b": {"a": (4.0, 5.0)}}, False)
    assert found.winning.all()
    waits_for_a, waits_for_b = found.value.reshape(5, 2).T
    assert sorted([waits_for_a.tolist(), waits_for_b.tolist()])[0][:4] != [-1] * 4
    assert found.statistics["states"] == 2
    assert max(found.value) <= 8


def asked(formula, boxes):
    return Task(kind="task", formula=formula, regions=boxes)


def test_what_cannot_be_read_is_refused_in_one_line():
    space = Space(("a", "b"), Box([0, 0], [4, 4]), (), tau=0.5)
    boxes = {"home": {"a": (0.0, 1.0)}, "round": "a^2 + b^2 <= 1"}
    for formula, problem in (
        ("G F work", "no region 'work'"),
        ("F[<= soon] home", "no deadline"),
        ("F[<= 3 m] home", "does not convert|no deadline|unit"),
        ("F[<= -0.1 s] home", "no deadline"),
        ("F (home & G round)", "fragment"),
    ):
        with pytest.raises(UserError, match=problem):
            asked(formula, boxes).region(space)
    with pytest.raises(UserError, match="no inequality"):
        asked("F a", {"a": "a + b"}).region(space)
    with pytest.raises(UserError, match="everywhere or nowhere"):
        asked("F a", {"a": "a <= a + 1"}).region(space)
    with pytest.raises(ValueError, match="empty list"):
        asked("F a", {"a": []})
    with pytest.raises(UserError, match="no state 'z'"):
        asked("F a", {"a": {"z": (0.0, 1.0)}}).region(space)


def test_a_formula_that_no_way_through_the_regions_keeps_is_refused():
    tiny = Tiny([1, False], False)
    tiny.obstacles = []
    boxes = {"a": {"a": (0.0, 1.0)}, "b": {"a": (1.0, 2.0)}}
    for formula in ("G a & G b", "F (a & b)", "G F a & F[<= 3] b & G !b", "F G a & G !a"):
        with pytest.raises(UserError, match="no way through the regions"):
            solved(tiny, formula, boxes, False)


def test_cells_of_inequalities_are_sure_on_both_sides():
    rng = np.random.default_rng(11)
    space = Space(("a", "b"), Box([-2.0, -2.0], [2.0, 2.0]), ())
    grid = space.grid(space.box, (23, 31))

    for error in (np.zeros(2), np.array([0.05, 0.0])):
        for text_of, truth in (
            ("a^2 + b^2 <= 1", lambda x: x[:, 0] ** 2 + x[:, 1] ** 2 <= 1),
            ("a + b >= 0.5", lambda x: x.sum(axis=1) >= 0.5),
            ("abs(a) <= 1", lambda x: abs(x[:, 0]) <= 1),
            ("sqrt(a^2 + b^2) <= 1", lambda x: x[:, 0] ** 2 + x[:, 1] ** 2 <= 1),
            ("sqrt(a) <= 1", lambda x: (x[:, 0] >= 0) & (x[:, 0] <= 1)),  # what has no root is outside
            ("log(a) <= -1", lambda x: (x[:, 0] >= 0) & (x[:, 0] <= np.exp(-1.0))),
        ):
            task = Task(kind="task", formula="F r", regions={"r": text_of})
            within, meeting = task._cells(space, grid, error, "r", text_of)
            x = rng.uniform(-2, 2, (200_000, 2))
            seen = np.clip(x + error * np.sign(rng.uniform(-1, 1, x.shape)), -2, 2)
            cell, true = grid.index(seen), truth(x)
            assert true[within[cell]].all()
            assert not true[~meeting[cell]].any()
            assert within.any()
            assert (~meeting).any()
            assert (meeting & ~within).mean() < 0.25


class Picked:
    """A plant on the cells of a tiny one that picks any of the cells that may follow, or `jumps` anywhere."""

    path = None

    def __init__(self, tiny, controller, rng, jumps):
        self.tiny, self.controller, self.rng, self.jumps = tiny, controller, rng, jumps

    def reset(self, x):
        self.x = np.array(x)

    def advance(self, u):
        cell = tuple(int(v) for v in np.floor(self.x))
        after = sorted(self.tiny.moves(cell)[int(u[0])])
        if self.jumps and self.rng.random() < 0.2:
            after = [tuple(int(v) for v in self.rng.integers(0, self.tiny.cells))]
        self.x = np.array(after[self.rng.integers(len(after))]) + 0.5
        return self.x


def test_runs_keep_the_task_and_its_certificate_and_those_that_jump_are_found(tmp_path):
    kept = wandered = 0
    for seed in range(60):
        tiny, rng = Tiny([seed, 7], False), np.random.default_rng([seed, 7])
        tiny.obstacles = []
        boxes = {name: random_box(rng, tiny.cells, 3) for name in ("a", "b", "c")}
        formula = ("G F a & G F b", "G (a -> F b) & G F c", "!c U (a & F b)", "F G a", "F[<= 6] b & G F a")[seed % 5]
        found = solved(tiny, formula, boxes, False)
        if not found.useful:
            continue
        made = Controller(np.arange(INPUTS, dtype=float)[:, None], ("a", "b"), ("u",), found, "least_effort", {})
        save_controller(made, tmp_path / "law.npz")
        law = load_controller(tmp_path / "law.npz")
        assert np.array_equal(law.progress.after, found.progress.after)
        space = Space(("a", "b"), Box([0, 0], tiny.cells), tiny.periodic)
        task = Task(kind="task", formula=formula, regions=boxes)
        task.recognise(space, law.solution, np.zeros(2))
        monitor = task.monitor(space, law.solution)
        for number in range(20):
            start = law.grid.centres()[rng.choice(found.beginnings)]
            jumps = number % 2 == 1
            plant = Picked(tiny, law, rng, jumps)
            run = closed_loop(plant, law, start, 60, Sensing(np.zeros(2)), rng, monitor)
            verdict = monitor.judge(run, 60)
            if not jumps:
                assert verdict.outcome.kept, (formula, verdict.outcome.end)
                assert strays(law.solution, run) == 0
                assert np.array_equal(law.solution.levels(run.measured, run.memory) >= 0, np.ones(len(run.x), bool))
                kept += 1
            else:
                wandered += not verdict.outcome.kept or strays(law.solution, verdict.run) > 0
    assert kept > 200
    assert wandered > 100


def test_a_controller_that_does_not_get_on_is_found():
    """Home is left for good, or nothing is ever visited: the run is judged so, and its certificate is broken."""
    tiny = Tiny([3, False], False)
    tiny.cells, tiny.periodic, tiny.obstacles = (5, 1), (), []
    tiny.offsets = np.zeros((2, 5, INPUTS, 2), int)
    tiny.offsets[0] = np.array([-1, 0, 1, 1])[None, :, None]
    space, boxes = Space(("a", "b"), Box([0, 0], [5, 1]), ()), {"a": {"a": (0.0, 1.0)}, "b": {"a": (4.0, 5.0)}}
    for formula, going in (("F G a", [0, 2, 0, 1]), ("G F a & G F b", [1, 1, 1, 1]), ("F G a", [1, 1, 1, 1])):
        task, found = asked(formula, boxes), solved(tiny, formula, boxes, False)
        monitor, steps = task.monitor(space, found), 40
        x, memory = [np.array([0.5 if formula == "G F a & G F b" else 1.5, 0.5])], [found.first]
        for k in range(steps):
            m = going[k % 4]
            cell = int(found.grid.index(x[-1][None])[0])
            memory.append(int(found.step(memory[-1], m, cell)[1]))
            x.append(np.array([min(max(x[-1][0] + (-1, 0, 1, 1)[m], 0.5), 4.5), 0.5]))
        applied = np.array([going[k % 4] for k in range(steps)])
        run = Run(np.array(x), applied, False, np.array(x), np.ones(steps + 1), np.array(memory))
        assert not monitor.judge(run, steps).outcome.kept
        assert strays(found, run) > 0


def test_a_controller_file_that_calls_a_task_done_too_early_is_refused():
    """Its own account would let it rest after one round: no run of it strays, and it waits no longer than it says."""
    tiny = Tiny([3, False], False)
    tiny.cells, tiny.periodic, tiny.obstacles = (5, 1), (), []
    tiny.offsets = np.zeros((2, 5, INPUTS, 2), int)
    tiny.offsets[0] = np.array([-1, 0, 1, 1])[None, :, None]
    space, boxes = Space(("a", "b"), Box([0, 0], [5, 1]), ()), {"a": {"a": (0.0, 1.0)}, "b": {"a": (4.0, 5.0)}}
    task, found = asked("G F a & G F b", boxes), solved(tiny, "G F a & G F b", boxes, False)
    task.recognise(space, found, np.zeros(2))
    value, mask = found.value.reshape(5, 2).copy(), found.mask.reshape(5, 2, -1).copy()
    value[1:, 0], value[0, 1], mask[1:, 0] = 0, 2**20, 1 << 1  # back at the first state it is done and stays
    value = value.reshape(-1)
    tampered = replace(found, mask=mask.reshape(10, -1), value=value, target=value == 0)
    law = Controller(np.arange(INPUTS, dtype=float)[:, None], ("a", "b"), ("u",), tampered, "least_effort", {})
    rng, monitor = np.random.default_rng(0), task.monitor(space, tampered)
    run = closed_loop(Picked(tiny, law, rng, False), law, np.full(2, 0.5), 60, Sensing(np.zeros(2)), rng, monitor)
    assert monitor.judge(run, 60).outcome.kept
    assert strays(tampered, run) == 0
    turned = replace(found, progress=replace(found.progress, after=found.progress.after[:, ::-1].copy()))
    stays = replace(found, progress=replace(found.progress, persists=True))
    for other in (tampered, turned, stays, replace(found, progress=None)):
        with pytest.raises(UserError, match="is not what the formula says"):
            task.recognise(space, other, np.zeros(2))
    with pytest.raises(UserError, match="which this case does not have"):
        Invariance(kind="invariance", safe={}).recognise(space, found, np.zeros(2))


def test_a_state_on_a_face_of_two_cells_is_in_a_region_that_ends_there():
    tiny = Tiny([3, False], False)
    tiny.cells, tiny.periodic, tiny.obstacles = (5, 1), (), []
    tiny.offsets = np.zeros((2, 5, INPUTS, 2), int)
    boxes = {"a": {"a": (1.0, 2.0)}}
    found = solved(tiny, "G !a", boxes, False)
    assert found.winning.tolist() == [False, False, False, True, True]
    on_face = np.array([[2.0, 0.5]])
    space = Space(("a", "b"), Box([0, 0], [5, 1]), ())
    assert asked("G !a", boxes).monitor(space, found).letters(on_face).tolist() == [1]
    assert not found.winning[found.grid.index(on_face)]


def test_a_batch_of_runs_is_the_runs_one_by_one():
    tiny = Tiny([3, False], False)
    tiny.cells, tiny.periodic, tiny.obstacles = (5, 4), (), []
    tiny.offsets = np.zeros((2, 20, INPUTS, 2), int)
    tiny.offsets[0] = np.array([-1, 0, 1, 1])[None, :, None]
    tiny.offsets[1] = np.array([0, 1, 0, -1])[None, :, None]
    boxes = {"a": {"a": (0.0, 1.0)}, "b": {"b": (3.0, 4.0)}}
    found = solved(tiny, "G F a & G F b", boxes, False)
    law = Controller(np.arange(INPUTS, dtype=float)[:, None], ("a", "b"), ("u",), found, "middle", {})
    space = Space(("a", "b"), Box([0, 0], tiny.cells), ())
    monitor = Task(kind="task", formula="G F a & G F b", regions=boxes).monitor(space, found)
    rng, starts = np.random.default_rng(0), law.grid.centres()[found.beginnings]

    def step(x, u):
        cells = [tuple(int(v) for v in np.floor(p)) for p in x]
        return np.array([min(tiny.moves(cell)[int(m)]) for cell, m in zip(cells, u[:, 0], strict=True)]) + 0.5

    class One(Picked):
        def advance(self, u):
            self.x = step(self.x[None], u[None])[0]
            return self.x

    together = batch_loop(step, law, starts, 30, monitor)
    for start, other in zip(starts, together, strict=True):
        run = closed_loop(One(tiny, law, rng, False), law, start, 30, Sensing(np.zeros(2)), rng, monitor)
        assert np.array_equal(run.x, other.x)
        assert np.array_equal(run.memory, other.memory)
        assert monitor.judge(run, 30).outcome.figures["rounds"] >= 2
