"""Hidden states on a plant whose memory is known: a first-order lag of the commanded speed."""

import json

import numpy as np
import pytest

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.load import from_json
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.fitting.acceptance import FreshCheck, check_sequences, confirmed
from simgap.gap.fitting.dimension_fit import deterministic_tier
from simgap.gap.memory.bound import Robot, assemble_hulls
from simgap.gap.memory.hidden_state import (
    HistoryInfluence,
    HullFit,
    check_fading,
    fading,
    fit_hull,
    hull,
    previous_inputs,
    random_sequences,
    tolerance_of,
)
from simgap.gap.memory.search import BoundTable, search
from simgap.geometry import Box
from simgap.simulators.body_samples import REST, BodySamples
from simgap.statistics import extrapolated_maximum

V, W = np.round(np.arange(-5, 6) * 0.1, 12), np.round(np.arange(-4, 5) * 0.25, 12)
U = np.array([(v, w) for v in V for w in W])
STATES = ("x", "y", "theta")
LAG = 0.3  # time constant over tau


def lag_paths(sequences, poses=10):
    """Body-frame poses of every step of input sequences (n, L) from rest; speed and turn rate follow with a lag."""
    out = np.empty((*sequences.shape, poses, 3))
    for n, numbers in enumerate(sequences):
        speed = np.zeros(2)
        for k, m in enumerate(numbers):
            pose, fine = np.zeros(3), 20
            for p in range(poses * fine):
                speed += (U[m] - speed) * (1.0 - np.exp(-1.0 / (poses * fine * LAG)))
                pose += np.array([speed[0] * np.cos(pose[2]), speed[0] * np.sin(pose[2]), speed[1]]) / (poses * fine)
                if (p + 1) % fine == 0:
                    out[n, k, p // fine] = pose
    return out


def domain():
    return GapDomain(STATES, ("v", "w"), Box([0, 0, -np.pi], [10, 10, np.pi]), U, (0, 1))


def sampled(sequences, keep=slice(None)):
    before = np.concatenate([np.full((len(sequences), 1), REST), sequences[:, :-1]], axis=1)[:, keep].reshape(-1)
    paths = lag_paths(sequences)[:, keep].reshape(-1, 10, 3)
    return BodySamples.of_paths(sequences[:, keep].reshape(-1), paths, previous=before)


@pytest.fixture(scope="module")
def fitted():
    few = np.arange(0, len(U), 7)  # inputs whose bound is looked at; the others are padded from one of them
    rng = np.random.default_rng(0)
    previous = [U.tolist().index(u.tolist()) for u in previous_inputs([V, W], [3, 3])]
    pairs = np.array([(p, m) for p in previous for m in range(len(U))])
    grid = sampled(pairs, slice(1, 2))
    chains = sampled(random_sequences(U, 12, 40, rng))
    memory = fading(np.stack([lag_paths(s)[:, -1, -1] for s in _suffixes(random_sequences(U, 20, 5, rng))]))
    motion = np.stack([U[:, 0], np.zeros(len(U)), U[:, 1]], axis=1)
    hulls = [HullFit.from_json(json.loads(json.dumps(fit_hull(i, motion, grid, chains).to_json()))) for i in range(3)]
    influences = [HistoryInfluence(memory[:, i], deviation, 10) for i, deviation in enumerate([0.001, 0.002, 0.003])]
    robot = Robot(domain(), motion, 0.001, 0.2, PreviousClasses.single(len(U)))
    return few, motion, assemble_hulls(robot, hulls, influences), grid


def _suffixes(sequences):
    return [sequences[:, -back:] for back in range(2, sequences.shape[1] + 1)]


def test_the_bound_covers_fresh_histories_of_any_length(fitted):
    _, motion, fit, _ = fitted
    fresh = random_sequences(U, 15, 30, np.random.default_rng(99))
    d = lag_paths(fresh)[:, :, -1].reshape(-1, 3) - motion[fresh.reshape(-1)]
    lo, hi = fit.gap.lower[fresh.reshape(-1)], fit.gap.upper[fresh.reshape(-1)]
    assert ((lo <= d) & (d <= hi)).all()


def test_the_swept_box_holds_the_whole_way(fitted):
    _, _, fit, _ = fitted
    fresh = random_sequences(U, 15, 30, np.random.default_rng(98))
    way, m = lag_paths(fresh).reshape(-1, 10, 3)[..., :2], fresh.reshape(-1)
    assert (way >= fit.table.swept[0][0, m, None]).all()
    assert (way <= fit.table.swept[1][0, m, None]).all()
    assert (fit.table.swept[0] <= 0).all()
    assert (fit.table.swept[1] >= 0).all()


def test_it_is_wider_than_from_rest_and_says_what_was_added(fitted):
    _, motion, fit, grid = fitted
    rest = lag_paths(np.arange(len(U))[:, None])[:, 0, -1] - motion
    lower, upper = hull(grid.m, grid.final - motion[grid.m], len(U))
    assert ((fit.gap.lower <= lower) & (upper <= fit.gap.upper)).all()
    assert (fit.gap.upper - fit.gap.lower).mean() > 2 * np.abs(rest).mean()
    assert (fit.margin >= fit.excess).all()
    text = " ".join(t.text for t in fit.gap.tiers)
    assert "estimate" in text
    assert "0.003 for theta" in text


def test_memory_fades_by_the_known_factor(fitted):
    memory = fitted[2].memory
    factor = np.exp(-1.0 / LAG)  # per sample, of the speed that older inputs left
    assert memory[1, 2] <= 1.5 * factor * memory[0, 2]
    assert memory[0, 2] <= 2.0 * LAG * 2.0 * factor  # two samples back: at most that of a reversal at full rate


def test_a_history_that_still_matters_is_refused():
    memory, quiet = np.array([[0.1, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.zeros(3)
    with pytest.raises(BrokenPromise, match=r"gap in x still grows.*0\.05"):
        check_fading(memory, np.array([0.1, 1.0, 1.0]), STATES, 0.1, quiet)
    check_fading(memory, np.array([1.0, 1.0, 1.0]), STATES, 0.1, quiet)


def test_an_influence_that_rises_with_age_is_refused_unless_equal_histories_differ_by_as_much():
    """The robot before its contacts were mended: it passed, being below a tenth of .84 rad at the longest age."""
    memory = np.array([[0.0, 0.0, 0.0117], [0.0, 0.0, 0.0272], [0.0, 0.0, 0.0351], [0.0, 0.0, 0.0]])
    size = np.array([0.3, 0.2, 0.84])
    with pytest.raises(BrokenPromise, match=r"theta does not fall.*more than 1 samples back.*0\.0117.*0\.0272"):
        check_fading(memory, size, STATES, 0.1, np.array([0.003, 0.001, 0.0169]))
    check_fading(memory, size, STATES, 0.1, np.array([0.0, 0.0, 0.04]))
    check_fading(memory[[2, 1, 0, 3]], size, STATES, 0.1, np.zeros(3))


def test_extrapolation_covers_the_end_of_a_uniform_distribution():
    rng = np.random.default_rng(7)
    ends = np.array([extrapolated_maximum(rng.uniform(0, 1, 2000), 1) for _ in range(200)])
    assert (ends >= 1.0).mean() >= 0.9
    assert ends.max() < 1.02
    assert extrapolated_maximum(np.zeros(100), 4) == 0.0


def test_extrapolation_covers_a_peak_over_as_many_coordinates_as_it_is_told():
    """A cone over four coordinates, the tip of which 2,000 uniform samples miss by far more than over one."""
    rng = np.random.default_rng(8)
    samples = [1.0 - np.linalg.norm(rng.uniform(-1, 1, (2000, 4)), axis=1) for _ in range(200)]
    told, not_told = ([extrapolated_maximum(np.maximum(s, 0), a) for s in samples] for a in (4, 1))
    assert (np.array(told) >= 1.0).mean() >= 0.9
    assert (np.array(not_told) >= 1.0).mean() < 0.2
    assert max(told) < 1.6


def test_previous_inputs_hold_the_extremes():
    found = previous_inputs([V, W], [3, 2])
    assert {tuple(u) for u in found} == {(v, w) for v in (-0.5, 0.0, 0.5) for w in (-1.0, 1.0)}
    with pytest.raises(UserError, match="previous values"):
        previous_inputs([V, W], [1, 2])


def test_sequences_repeat_with_their_seed_and_visit_extremes():
    a, b = (random_sequences(U, 20, 50, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(a, b)
    assert (np.abs(U[a.reshape(-1), 0]) == 0.5).mean() > 0.5


def test_tolerances_name_every_state():
    assert tolerance_of(STATES, {"x": 1, "y": 2, "theta": 3}) == {"x": 1.0, "y": 2.0, "theta": 3.0}
    with pytest.raises(UserError, match="no tolerance"):
        tolerance_of(STATES, {"x": 1, "y": 2})


def with_classes(counts):
    """The fit with classes of the previous input, their extremes in the grid of previous inputs."""
    classes = PreviousClasses.of(U, counts)
    previous = [U.tolist().index(u.tolist()) for u in previous_inputs([V, W], [5, 5], counts)]
    grid = sampled(np.array([(p, m) for p in previous for m in range(len(U))]), slice(1, 2))
    chains = sampled(random_sequences(U, 12, 40, np.random.default_rng(0)))
    motion = np.stack([U[:, 0], np.zeros(len(U)), U[:, 1]], axis=1)
    hulls = [fit_hull(i, motion, grid, chains, classes=classes) for i in range(3)]
    influences = [HistoryInfluence(np.array([0.001, 0.0]), 0.001, 10) for _ in range(3)]
    return motion, classes, Robot(domain(), motion, 0.001, 0.2, classes), hulls, influences


@pytest.fixture(scope="module")
def classed():
    return with_classes((3, 3))


def test_a_class_of_the_previous_input_has_a_narrower_bound_that_covers_what_follows_it(classed):
    motion, classes, robot, hulls, influences = classed
    gap = assemble_hulls(robot, hulls, influences).gap
    again = from_json(json.loads(json.dumps(gap.to_json())))
    fresh = random_sequences(U, 15, 30, np.random.default_rng(97))
    d = lag_paths(fresh)[:, :, -1].reshape(-1, 3) - motion[fresh.reshape(-1)]
    before = np.concatenate([np.full((15, 1), REST), fresh[:, :-1]], axis=1).reshape(-1)
    x, u = np.zeros((len(d), 3)), U[fresh.reshape(-1)]
    for own in (gap, again):
        lo, hi = own.bounds_after(x, u, before)
        assert ((lo <= d) & (d <= hi)).all()
    outer_lo, outer_hi = gap.bounds(x, u)
    assert ((outer_lo <= lo + 1e-12) & (hi <= outer_hi + 1e-12)).all()
    assert (hi - lo).mean() < 0.6 * (outer_hi - outer_lo).mean()
    assert classes.count == 9
    assert classes.kind[np.flatnonzero((U == 0).all(axis=1))[0]] == classes.rest


def test_classes_are_intervals_and_the_grid_has_the_extremes_of_each():
    classes = PreviousClasses.of(U, (2, 3))
    found = previous_inputs([V, W], [4, 6], (2, 3))
    for c in range(6):
        own, members = found[[classes.kind[U.tolist().index(u.tolist())] == c for u in found]], U[classes.kind == c]
        assert np.array_equal(own.min(axis=0), members.min(axis=0))
        assert np.array_equal(own.max(axis=0), members.max(axis=0))
    with pytest.raises(UserError, match="classes of an input"):
        PreviousClasses.of(U, (12, 1))


def lag_steps(sequences, headings):
    before = sequences[:, -2]
    return BodySamples.of_paths(sequences[:, -1], lag_paths(sequences)[:, -1], previous=before)


def test_a_directed_search_finds_what_random_sequences_do_not_and_the_margin_covers_it(classed):
    """A hull that is too narrow for one pair of inputs alone: random sequences pass, the search does not."""
    motion, classes, robot, hulls, influences = classed
    fit = assemble_hulls(robot, hulls, influences)
    table = fit.table
    assert search(table, lag_steps, U, 2, 300, np.random.default_rng(1)).outside == 0
    narrow = BoundTable(classes, motion, table.lower.copy(), table.upper.copy(), table.swept)
    middle = 0.5 * (table.lower[:, -1] + table.upper[:, -1])
    narrow.lower[:, -1], narrow.upper[:, -1] = middle, middle
    found = search(narrow, lag_steps, U, 2, 600, np.random.default_rng(2))
    assert found.outside > 0
    assert found.worst[0]["inputs"][-1] == U[-1].tolist()
    attacked = assemble_hulls(robot, hulls, influences, lambda _: found)
    assert (attacked.margin >= found.excess[:3]).all()
    assert (attacked.gap.upper >= fit.gap.upper).all()
    assert "directed search" in attacked.gap.tiers[0].text


def test_sequences_are_counted_not_their_steps():
    excess = np.full((20, 3), -1.0)
    excess[[3, 4], 2] = 0.5  # twice in the first sequence
    check = check_sequences(excess, np.full(20, -1.0), np.arange(0, 20, 5), STATES)
    assert (check.samples, check.violations, check.steps) == (4, 1, 20)
    assert check.upper == pytest.approx(0.7514, abs=1e-3)  # 1 of 4 at 95 %: the p with (1-p)^4 + 4 p (1-p)^3 = 0.05
    assert "4 fresh random sequences (20 steps in all)" in check.tier.text
    path = check_sequences(np.full((20, 3), -1.0), excess[:, 2], np.arange(0, 20, 5), STATES)
    assert path.violations == 1
    assert path.worst["path"] == 0.5


def test_no_tier_says_every_state_beside_violations():
    tiers = [deterministic_tier("inflate"), Tier(2, "An estimate.")]
    clean = FreshCheck(100, 0, {"x": 0}, {"x": 0.0}, 0.03, 0.95)
    broken = FreshCheck(100, 2, {"x": 2}, {"x": 0.25}, 0.06, 0.95)
    assert confirmed(tiers, clean) == tiers
    stated = confirmed(tiers, broken)
    assert "does not hold at every state: 2 of 100" in stated[0].text
    assert "0.25 for x" in stated[0].text
    assert all(tier.level != 1 for tier in stated)
    assert stated[1:] == tiers[1:]
