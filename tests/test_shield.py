"""A shield gives the nearest admissible input, remembers what its controller does, and keeps what that promises."""

from fractions import Fraction

import numpy as np
import pytest

from simgap.closed_loop import Sensing, closed_loop
from simgap.errors import BrokenPromise, UserError
from simgap.extras.shield import Driven, policy_of
from simgap.geometry import Box, Grid
from simgap.shield import Shield
from simgap.specifications.invariance import Invariance
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.synthesis.synthesis_plants import pendulum

ONE = np.array([[-1.5], [-0.25], [0.0], [0.25], [1.5]])
TWO = np.array([[0.0, 0.0], [1.0, 4.0], [-1.0, 4.0], [1.0, -4.0], [-1.0, -4.0], [0.5, 0.0], [0.0, 1.0], [0.0, 0.0]])
FIXED = np.array([[2.0, 0.0], [2.0, 1.0], [2.0, -1.0]])  # its first input has one value
KINDS = {
    "plain": (ONE, False, None, ()),
    "periodic": (ONE, False, None, (1,)),
    "two inputs": (TWO, False, None, ()),
    "an input that never changes": (FIXED, False, None, ()),
    "late": (ONE, True, None, ()),
    "classes": (ONE, False, [0, 0, 1, 2, 2], ()),
    "late classes": (TWO, True, [0, 0, 1, 1, 2, 2, 0, 1], (0,)),
}


def drawn(name):
    """A controller whose admissible inputs are drawn at random, none in a third of its cells, and their flags."""
    inputs, late, kind, periodic = KINDS[name]
    rng = np.random.default_rng(len(name))
    grid = Grid(Box([0.0, 0.0], [4.0, 2.0]), [8, 4], periodic)
    memory = (len(inputs) if late else 1) * (1 if kind is None else max(kind) + 1)
    flags = rng.random((grid.size, memory, len(inputs))) < 0.4
    flags[rng.random(grid.size) < 0.3] = False
    mask = np.packbits(flags.reshape(grid.size * memory, -1), axis=1, bitorder="little")
    some = flags.any(axis=(1, 2))
    classes = None if kind is None else np.array(kind)
    solution = Solution(grid, some, mask, np.ones(grid.size, bool), memory=memory, late=late, kind=classes)
    return Controller(inputs, ("a", "b"), ("u", "w")[: inputs.shape[1]], solution, "least_effort", {}), flags


def oracle(inputs, admitted, u):
    """In exact fractions and by the definition: the number of the nearest admitted input, None without one."""
    columns = [[Fraction(v) for v in column] for column in inputs.T]
    total = {}
    for m in np.flatnonzero(admitted):
        total[int(m)] = Fraction(0)
        for column, wanted in zip(columns, u, strict=True):
            low, high = min(column), max(column)
            saturated = low if wanted < low else high if wanted > high else Fraction(wanted)
            total[int(m)] += ((saturated - column[m]) / ((high - low) or 1)) ** 2
    return min(total, key=lambda m: (total[m], m)) if total else None


@pytest.mark.parametrize("name", KINDS)
def test_the_nearest_admissible_input_is_that_of_brute_force(name):
    """Ties among them: states, inputs and ranges are sums of few powers of two, so that distances are exact."""
    controller, flags = drawn(name)
    shield, rng, answered, changed = Shield(controller), np.random.default_rng(7), 0, 0
    nu, every = controller.input_set.shape[1], np.ones(len(controller.input_set), bool)
    for _ in range(500):
        index = [int(rng.integers(n)) for n in controller.grid.cells]
        x = [0.5 * (k + float(rng.choice([0.0, 0.25, 0.5]))) for k in index]
        u = rng.integers(-40, 41, nu) / 16.0 if rng.random() < 0.8 else controller.input_set[rng.integers(len(every))]
        memory = int(rng.integers(controller.memory))
        own = flags[index[0] * 4 + index[1], memory]
        wanted = oracle(controller.input_set, own, u)
        if wanted is None:
            with pytest.raises(BrokenPromise, match="no admissible input at"):
                shield.filter(x, u, memory)
            continue
        nearest = oracle(controller.input_set, every, u)
        assert shield.numbers(x, u, memory) == (wanted, nearest)
        assert np.array_equal(shield.filter(x, u, memory), controller.input_set[wanted])
        assert nearest == wanted or not own[nearest]
        answered, changed = answered + 1, changed + (nearest != wanted)
    assert answered > 100
    assert 40 < changed < answered
    assert shield.steps == shield.acted == 0


@pytest.mark.parametrize("name", ["plain", "late", "classes", "late classes"])
def test_a_run_carries_the_memory_and_counts(name):
    controller, flags = drawn(name)
    shield, rng = Shield(controller), np.random.default_rng(3)
    nu, solution, steps, acted = controller.input_set.shape[1], controller.solution, 0, 0
    for _ in range(20):
        shield.reset()
        memory = solution.first
        for _ in range(30):
            cell = int(rng.choice(np.flatnonzero(flags[:, memory].any(axis=1))))
            x, u = controller.grid.centres()[cell], rng.uniform(-2, 2, nu)
            given = oracle(controller.input_set, flags[cell, memory], u)
            acted += given != oracle(controller.input_set, np.ones(len(controller.input_set)), u)
            assert np.array_equal(shield(x, u), controller.input_set[given])
            _, memory = solution.step(memory, given, controller.cell(x)[0])
            steps += 1
            assert (shield.memory, shield.steps, shield.acted) == (memory, steps, acted)
    assert 0 < acted < steps


def test_an_input_beyond_all_of_them_is_their_end():
    controller, flags = drawn("plain")
    x = controller.grid.centres()[np.flatnonzero(flags[:, 0].any(axis=1))[0]]
    low, high = controller.inputs(x)[[0, -1]]
    for huge in (1e20, 1e300, np.inf):
        assert Shield(controller).filter(x, [huge]) == high
        assert Shield(controller).filter(x, [-huge]) == low


def test_what_is_no_input_or_state_is_refused():
    shield = Shield(drawn("two inputs")[0])
    for wrong in ([0.0], [0.0, 1.0, 2.0], [[0.0, 1.0]], 0.0, [np.nan, 0.0]):
        with pytest.raises(UserError, match=r"an input is 2 numbers \(u, w\)"):
            shield([1.0, 1.0], wrong)
    for wrong in ([1.0], [np.nan, 1.0], [[1.0, 1.0]]):
        with pytest.raises(UserError, match="a state"):
            shield(wrong, [0.0, 0.0])
    for outside in ([4.5, 1.0], [1.0, -3.0]):
        with pytest.raises(BrokenPromise, match="Outside the winning domain"):
            shield(outside, [0.0, 0.0])
    with pytest.raises(UserError, match="pending input is a number"):
        shield.filter([1.0, 1.0], [0.0, 0.0], 1)
    assert shield.steps == 0


@pytest.mark.parametrize("name", ["late", "classes"])
def test_what_a_controller_remembers_is_not_made_up(name):
    controller, flags = drawn(name)
    x = controller.grid.centres()[np.flatnonzero(flags[:, controller.first].any(axis=1))[0]]
    with pytest.raises(UserError, match="remembers more than the state"):
        Shield(controller).filter(x, [0.0])
    Shield(controller).filter(x, [0.0], controller.first)


def test_a_controller_of_one_input_a_cell_is_no_shield():
    controller, _ = drawn("plain")
    one = Solution(
        controller.grid, controller.solution.winning, np.empty((controller.grid.size, 0), np.uint8),
        controller.solution.free, chosen=controller.choice,
    )  # fmt: skip
    recorded = Controller(ONE, ("a", "b"), ("u",), one, "least_effort", {})
    with pytest.raises(UserError, match=r"^synthesis\.record: .* one input a cell.*Remove `record: one`"):
        Shield(recorded)


class Model:
    """The nominal pendulum as the plant of a closed loop."""

    def __init__(self, model):
        self._step = model.step

    def reset(self, x):
        self._x = np.array(x)

    def advance(self, u):
        self._x = self._step(self._x[None], u[None])[0]
        return self._x


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize("policy", ["random", "largest", "toward the border"])
def test_any_policy_stays_safe_through_the_shield(policy, latency):
    """The nominal model against itself; the simulators are in tests/stages/test_shield.py."""
    model, inputs = pendulum()
    space = Space(("x1", "x2"), Box([-0.2, -0.5], [0.2, 0.5]))
    stay = Invariance(kind="invariance", safe={"x1": (0.0, 0.2)})
    problem = SynthesisProblem(model, stay, space, (200, 100), inputs[::4], latency=latency)
    controller = Controller(problem.inputs, ("x1", "x2"), ("u",), synthesise(problem), "least_effort", {})
    shield, rng = Shield(controller), np.random.default_rng(1)
    ask = {
        "random": lambda x: rng.uniform(-2.0, 2.0, 1),
        "largest": lambda x: problem.inputs.max(axis=0),
        "toward the border": lambda x: np.array([1.2 if x[0] > 0.1 else -1.2]),
    }[policy]
    monitor, sensing = stay.monitor(space, controller.solution), Sensing(np.zeros(2), latency)
    starts = controller.grid.centres()[rng.choice(controller.solution.beginnings, 5)]
    kept = {}
    for through in (True, False):
        driven = Driven(shield, ask, through)
        runs = [closed_loop(Model(model), driven, x, 300, sensing, rng, monitor) for x in starts]
        kept[through] = sum(monitor.judge(run, 300).outcome.kept for run in runs)
    assert kept[True] == 5
    assert kept[False] <= 2
    assert shield.steps == 5 * 300
    assert 0 < shield.acted < shield.steps


def test_a_gymnasium_environment_is_kept_safe():
    gymnasium = pytest.importorskip("gymnasium")
    from simgap.extras.shielded_env import ShieldedEnv

    controller, flags = drawn("late")
    path = controller.grid.centres()[np.flatnonzero(flags.any(axis=2).all(axis=1))]

    class Walk(gymnasium.Env):
        """Goes from cell to cell, whatever is done; the observation has the state and something else."""

        observation_space = gymnasium.spaces.Box(-10.0, 10.0, (3,))
        action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,))

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.k, self.actions = 0, []
            return np.append(path[0], 9.0), {}

        def step(self, action):
            self.k, self.actions = self.k + 1, [*self.actions, action]
            return np.append(path[self.k % len(path)], 9.0), 0.0, False, self.k == 50, {"k": self.k}

    env = ShieldedEnv(Walk(), Shield(controller), lambda seen: seen[:2])
    same, rng = Shield(controller), np.random.default_rng(0)
    for _ in range(2):
        seen, _ = env.reset(seed=0)
        same.reset()
        over = False
        while not over:
            action, before = rng.uniform(-2.0, 2.0, 1), same.acted
            wanted = same(seen[:2], action)
            seen, _, _, over, info = env.step(action)
            assert info["shield_action"] == env.unwrapped.actions[-1] == wanted
            assert info["shield_acted"] == (same.acted > before)
            assert info["k"] == env.unwrapped.k
    assert (env.shield.steps, env.shield.acted) == (100, same.acted)
    assert 0 < same.acted < 100


MISTAKES = {
    "gone.py:ask": "gone.py: --policy: the file of the function does not exist",
    "own.py": "--policy: 'own.py' does not name a function",
    "own.py:nothing": "own.py: --policy: the file has no function 'nothing'",
    "broken.py:ask": "broken.py: --policy: the policy 'ask' cannot be imported: ZeroDivisionError",
}


def test_a_policy_is_a_function_in_a_file(tmp_path):
    (tmp_path / "own.py").write_text("def ask(x):\n    return 2 * x[0]\n\ndef fails(x):\n    return x[7]\n")
    (tmp_path / "broken.py").write_text("def ask(x):\n    return 0\n\n1 / 0\n")
    assert policy_of(f"{tmp_path}/own.py:ask", ONE, 0)(np.array([0.5, 1.0])).tolist() == [1.0]
    random = policy_of("random", ONE, 0)
    assert {float(random(np.zeros(2))[0]) for _ in range(100)} == {*ONE[:, 0]}
    for named, told in MISTAKES.items():
        with pytest.raises(UserError) as caught:
            policy_of(f"{tmp_path}/{named}", ONE, 0)
        assert told in str(caught.value)
        assert caught.value.remedy
    with pytest.raises(UserError, match=r"own\.py: --policy: the policy 'fails' fails at \[0\.5, 1\.0\]: IndexError"):
        policy_of(f"{tmp_path}/own.py:fails", ONE, 0)(np.array([0.5, 1.0]))
