"""A simulator with noise: its statement against counting, its random numbers made again, and every refusal."""

import numpy as np
import pytest
import yaml

from simgap.closed_loop import BEYOND, LEFT, Judge
from simgap.config.load import load_case
from simgap.errors import BrokenPromise, UserError
from simgap.gap.noise import NoiseStatement, alpha_of_run, draws_at, statement_of
from simgap.lint.gap import find_noise
from simgap.plants.context import Context
from simgap.simulators.rollouts import TOGETHER, make_simulator, roll_out, roll_out_alike, roll_out_range
from simgap.specifications.base import Outcome, Run, Verdict
from simgap.stages import validation
from simgap.statistics import fewest_draws
from tests.little_cart import CASE, write_cart

NOISY = """
import numpy as np

def step(x, u, tau, rng):
    friction = 0.3 * rng.uniform()
    return np.array([x[0] + tau * x[1], x[1] + tau * (u[0] - friction * x[1])])

def many(x, u, tau, rng):
    friction = 0.3 * rng.uniform(size=len(x))
    return np.stack([x[:, 0] + tau * x[:, 1], x[:, 1] + tau * (u[:, 0] - friction * x[:, 1])], axis=1)

def unseeded(x, u, tau, rng):
    return x + np.random.default_rng().normal(size=2)
"""
X, U = np.array([[0.1, 0.2], [-0.3, 0.4], [0.9, -0.9]]), np.array([[1.0], [0.0], [-1.0]])
EQUATIONS = {"engine": "equations", "integrator": "rk4", "slopes": "sampled"}
BOTH = {"v": {"normal": 0.02}, "F": {"uniform": 0.1}}


def function(folder, name="step", **keys):
    (folder / "my_sim.py").write_text(NOISY)
    return {"engine": "python", "function": f"my_sim.py:{name}", "stochastic": True} | keys


def cart(folder, simulator, **sections):
    return load_case(write_cart(folder, simulator=simulator, **sections))


@pytest.mark.parametrize(("missed", "doubt", "extremes"), [(0.1, 0.05, 2), (0.05, 0.2, 4), (0.2, 0.01, 2)])
def test_the_hull_of_the_fewest_draws_misses_too_much_as_rarely_as_said_and_not_with_one_less(missed, doubt, extremes):
    rng, trials, found = np.random.default_rng(4), 20_000, []
    for draws in (fewest_draws(missed, doubt, extremes), fewest_draws(missed, doubt, extremes) - 1):
        sides = rng.uniform(size=(trials, draws, extremes // 2))
        inside = np.sort(sides, axis=1)
        if extremes == 2:
            covered = (inside[:, -1] - inside[:, 0])[:, 0]
        else:  # draws on a cross around 0.5: all four sides of the box are always made by different draws
            axis = rng.integers(0, 2, (trials, draws))
            ends = [np.where(axis == j, sides[:, :, j], np.nan) for j in (0, 1)]
            covered = sum(0.5 * (np.nanmax(e, axis=1) - np.nanmin(e, axis=1)) for e in ends)
        found.append(float((1.0 - covered > missed).mean()))
    slack = 4.0 * np.sqrt(doubt / trials)
    assert found[0] <= doubt + slack
    assert found[1] > doubt - slack
    if extremes == 2:
        assert found[0] < found[1]


def test_the_fewest_draws_of_one_number_are_those_of_wilks():
    assert fewest_draws(0.05, 0.05, 2) == 93
    assert fewest_draws(0.1, 0.05, 2) == 46


@pytest.mark.parametrize("name", ["step", "many"])
def test_a_function_with_a_generator_gives_the_same_again_in_any_order_and_another_by_another_seed(tmp_path, name):
    case = cart(tmp_path, function(tmp_path, name, batch=name == "many"))
    first, _ = roll_out(case, tmp_path, X, U)
    again, _ = roll_out(case, tmp_path, X[::-1], U[::-1])
    assert np.array_equal(first, again[::-1])
    other = cart(tmp_path, function(tmp_path, name, batch=name == "many", noise_seed=1))
    assert (roll_out(other, tmp_path, X, U)[0][:, 1] != first[:, 1]).any()


def test_the_draws_of_a_range_are_the_same_everywhere_and_cover_the_noise(tmp_path):
    x, u = np.array([[0.0, 1.0], [0.5, 1.0], [0.0, 0.5]]), np.zeros((3, 1))
    case = cart(tmp_path, function(tmp_path, "many", batch=True))
    lo, hi = roll_out_range(case, tmp_path, x, u, TOGETHER + 10)[1]
    friction = (x[:, [1]] - np.stack([hi[:, 1], lo[:, 1]], axis=1)) / (0.01 * x[:, [1]])
    assert np.abs(friction - friction[0]).max() < 1e-12
    assert 0.0 < friction[0, 0] < 1e-4
    assert 0.2999 < friction[0, 1] < 0.3
    alike, _ = roll_out_alike(case, tmp_path, x, u)
    assert np.ptp((x[:, 1] - alike[:, 1]) / (0.01 * x[:, 1])) < 1e-12


@pytest.mark.parametrize("name", ["step", "many"])
def test_range_and_step_alike_for_one_at_a_time_and_many(tmp_path, name):
    case = cart(tmp_path, function(tmp_path, name, batch=name == "many", parameters={}))
    lo, hi = roll_out_range(case, tmp_path, X, U, 50)[1]
    middle = X[:, 1] + 0.01 * (U[:, 0] - 0.15 * X[:, 1])
    assert np.all((lo[:, 1] <= middle) & (middle <= hi[:, 1]))
    assert np.all(hi[:, 1] - lo[:, 1] <= 0.01 * 0.3 * np.abs(X[:, 1]) + 1e-15)


def test_noise_is_put_on_commands_and_states_of_an_engine_without_its_own(tmp_path):
    case = cart(tmp_path, EQUATIONS | {"noise": BOTH})
    x, u = np.zeros((20_000, 2)), np.zeros((20_000, 1))
    x[:, 1] = np.linspace(-1.0, 1.0, len(x))
    following, _ = roll_out(case, tmp_path, x, u)
    off = following[:, 1] - x[:, 1]
    assert abs(off.mean()) < 4 * 0.02 / np.sqrt(len(x))
    assert abs(off.std() - np.hypot(0.02, 0.01 * 0.1 / np.sqrt(3))) < 4e-4
    with make_simulator(case, tmp_path) as simulator:
        runs = []
        for _ in range(2):
            simulator.reset(X[0])
            runs.append(np.array([simulator.advance(U[0]) for _ in range(50)]))
    assert np.array_equal(*runs)
    speeds = np.diff(np.concatenate([[X[0, 1]], runs[0][:, 1]])) - 0.01
    assert 0.01 < speeds.std() < 0.04
    assert abs(np.corrcoef(speeds[:-1], speeds[1:])[0, 1]) < 0.5
    places = np.concatenate([[X[0]], runs[0][:-1]])
    assert np.abs(runs[0][:, 0] - places @ [1.0, 0.01]).max() < 1e-4  # the next step begins at the noisy state


def grid(**gap):
    return {"grid": {"half_widths": {"x": 0.25, "v": 0.25}}, "gap": {"basis": ["v", 1]} | gap}


REFUSED = {
    "an engine without randomness": ({"simulator": EQUATIONS | {"stochastic": True}}, "simulator.stochastic"),
    "names": ({"simulator": EQUATIONS | {"noise": {"w": {"normal": 1.0}}}}, "simulator.noise has ['w']"),
    "two laws": ({"simulator": EQUATIONS | {"noise": {"v": {"normal": 1.0, "uniform": 1.0}}}}, "normal or uniform"),
    "proven": ({"simulator": EQUATIONS | {"slopes": "enclosed", "noise": BOTH}}, "say slopes: sampled"),
    "lag": ({"simulator": EQUATIONS | {"noise": BOTH, "effects": [
        {"name": "input_delay", "on": "F", "parameters": {"delay": 0.004}}]}}, "simulator.effects"),
    "symmetry": ({"simulator": EQUATIONS | {"noise": BOTH}, "grid": {"half_widths": {"v": 0.25}},
                  "symmetry": {"group": "translation", "along": ["x"], "tolerance": {}}}, "symmetry is not supported"),
    "twin": ({"simulator": EQUATIONS | {"noise": BOTH}, "twin": {"of": EQUATIONS}}, "twin is not supported"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_not_supported_is_refused_with_key_and_remedy(tmp_path, what):
    sections, words = REFUSED[what]
    with pytest.raises(UserError) as caught:
        roll_out(load_case(write_cart(tmp_path, **sections)), tmp_path, X, U)
    assert words in str(caught.value)


@pytest.mark.parametrize("keys", [{"stochastic": True}, {}])
def test_random_numbers_of_its_own_are_refused_by_the_name_of_the_key(tmp_path, keys):
    source = NOISY if keys else NOISY.replace("tau, rng)", "tau)")
    section = function(tmp_path, "unseeded") | {"stochastic": False} | keys
    (tmp_path / "my_sim.py").write_text(source)
    with pytest.raises(UserError, match=r"two results for the same call.*simulator.stochastic: true"):
        roll_out(cart(tmp_path, section), tmp_path, X, U)


ENGINES = """
import numpy as np
from simgap.config.simulator import EngineSection
from simgap.simulators.base import Engine

class Fresh(Engine):
    Settings, engine, nx, nu, stochastic = EngineSection, "own", 2, 1, True

    @classmethod
    def build(cls, case, folder):
        return cls()

    def reset(self, x):
        self.x, self.wind = x, 0.0

    def drawn(self):
        return self.rng.normal(size=self.rng.integers(1, 4))[-1]

    def advance(self, u):
        self.x = self.x + 0.01 * np.array([self.x[1], u[0] + self.drawn()])
        return self.x.copy()

class Coloured(Fresh):
    def drawn(self):
        self.wind = 0.9 * self.wind + self.rng.normal()
        return self.wind

class OnceARun(Fresh):
    def reset(self, x):
        self.x, self.wind = x, self.rng.normal()

    def drawn(self):
        return self.wind
"""


@pytest.mark.parametrize("name", ["Coloured", "OnceARun"])
def test_noise_that_depends_on_earlier_steps_is_refused(tmp_path, name):
    (tmp_path / "own.py").write_text(ENGINES)
    roll_out(cart(tmp_path, {"engine": "own.py:Fresh", "stochastic": True}), tmp_path, X, U)
    with pytest.raises(UserError, match="the simulator has more state than the case"):
        roll_out(cart(tmp_path, {"engine": f"own.py:{name}", "stochastic": True}), tmp_path, X, U)


def test_an_engine_that_draws_though_the_case_does_not_say_so_is_refused_by_the_key(tmp_path):
    (tmp_path / "own.py").write_text(ENGINES)
    with pytest.raises(UserError, match=r"^simulator\.stochastic: .*draws random numbers.*stochastic: true"):
        roll_out(cart(tmp_path, {"engine": "own.py:Fresh"}), tmp_path, X, U)


def test_the_statement_is_one_of_steps_and_of_runs(tmp_path):
    case = cart(tmp_path, EQUATIONS | {"noise": BOTH}, **grid(noise={"alpha": 1e-4}))
    said = statement_of(case, 48)
    assert said.draws == fewest_draws(1e-4, 0.01 / 48, 4)
    assert "at least 95.1 %, with 99 % confidence" in said.of_run(500)
    assert "at least 99.99 %" in said.of_step
    assert statement_of(load_case(write_cart(tmp_path, simulator=EQUATIONS)), 48) is None
    assert draws_at(load_case(write_cart(tmp_path, simulator=EQUATIONS)), 48) == 0
    for steps in (1, 7, 500, 123_456):
        assert 0.95 <= (1.0 - alpha_of_run(steps)) ** steps < 0.955


@pytest.mark.parametrize("noise", [{"alpha": 1e-13}, {"confidence": 1.0 - 1e-13}])
def test_what_would_be_printed_as_certain_cannot_be_asked_for(tmp_path, noise):
    with pytest.raises(UserError, match=f"gap.noise.{next(iter(noise))}"):
        cart(tmp_path, EQUATIONS | {"noise": BOTH}, **grid(noise=noise))
    said = NoiseStatement(1e-8, 1.0 - 1e-8, 1, 1)
    assert "at least 99.999999 %, with 99.999999 % confidence" in said.of_step


def test_check_says_what_a_statement_costs(tmp_path):
    path = write_cart(tmp_path, simulator=EQUATIONS | {"noise": BOTH}, **grid())
    (found,) = find_noise(Context.load(path))
    draws = fewest_draws(1e-3, 0.01 / 48, 4)
    assert f"drawn {draws:,} times at each of 48 samples, {48 * draws:,} roll-outs" in found.problem
    assert "gap.noise.alpha: 0.05 would make it 95 %" in found.remedy
    assert not list(find_noise(Context.load(write_cart(tmp_path, simulator=EQUATIONS, **grid()))))


def test_a_share_above_alpha_is_told_from_chance():
    said = NoiseStatement(0.01, 0.99, 0, 0)
    assert not said.is_contradicted(100, 3)
    assert said.is_contradicted(100, 6)
    assert not said.is_contradicted(0, 0)
    rng = np.random.default_rng(0)
    outside = rng.binomial(10_000, 0.01, 2_000)
    assert np.mean([said.is_contradicted(10_000, int(n)) for n in outside]) <= 0.02


def test_a_run_that_fails_after_a_step_outside_breaks_nothing_and_one_without_does():
    said = NoiseStatement(0.01, 0.99, 0, 0)
    tally = {"runs": 10, "steps": 1000, "runs_that_violated_it": 1, "steps_outside_gamma": 5, "ends": {BEYOND: 1}}
    validation.keep_promise(tally, 0.01, said)
    for broken in ({"ends": {LEFT: 1}}, {"steps_outside_gamma": 30}, {"runs_that_violated_it": 2}):
        with pytest.raises(BrokenPromise):
            validation.keep_promise(tally | broken, 0.01, said)


@pytest.mark.parametrize(("noisy", "outside", "end"), [(True, 1, BEYOND), (True, 0, "left"), (False, 1, "left")])
def test_the_judge_names_a_failure_after_a_step_outside(noisy, outside, end):
    judge = Judge(None, None, 1, None, None, None, certificate=object(), tolerant=True, noisy=noisy)
    run = Run(np.zeros((2, 2)), np.zeros(1, np.int64), False, np.zeros((2, 2)))
    failed = Verdict(Outcome("left", False, 1), run, None)
    assert judge.certified(failed, outside).outcome.end == end


def test_a_case_without_noise_says_nothing_of_it():
    content = yaml.safe_load(yaml.safe_dump(CASE | {"simulator": EQUATIONS} | grid()))
    from simgap.config.case import Case

    dumped = Case.model_validate(content).model_dump(mode="json")
    assert not {"noise", "stochastic", "noise_seed"} & set(dumped["simulator"])
    assert "noise" not in dumped["gap"]
