"""Hidden states on a plant whose memory is known: a first-order lag of the commanded speed."""

import json

import numpy as np
import pytest

from simgap.errors import BrokenPromise, UserError
from simgap.gap.function import GapDomain
from simgap.gap.hidden_fit import HistoryInfluence, HullFit, assemble_hulls, fit_hull
from simgap.gap.hidden_state import (
    check_fading,
    extrapolated_maximum,
    fading,
    hull,
    previous_inputs,
    random_sequences,
    tolerance_of,
)
from simgap.geometry import Box
from simgap.simulators.body_samples import BodySamples

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
    return BodySamples.of_paths(sequences[:, keep].reshape(-1), lag_paths(sequences)[:, keep].reshape(-1, 10, 3))


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
    return few, motion, assemble_hulls(domain(), hulls, influences, 0.001, 0.2), grid


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
    assert (way >= fit.swept.lower[m, None]).all()
    assert (way <= fit.swept.upper[m, None]).all()
    assert (fit.swept.lower <= 0).all()
    assert (fit.swept.upper >= 0).all()


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
    memory = np.array([[0.1, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(BrokenPromise, match=r"gap in x still grows.*0\.05"):
        check_fading(memory, np.array([0.1, 1.0, 1.0]), STATES, 0.1)
    check_fading(memory, np.array([1.0, 1.0, 1.0]), STATES, 0.1)


def test_extrapolation_covers_the_end_of_a_uniform_distribution():
    rng = np.random.default_rng(7)
    ends = np.array([extrapolated_maximum(rng.uniform(0, 1, 2000)) for _ in range(200)])
    assert (ends >= 1.0).mean() >= 0.9
    assert ends.max() < 1.02
    assert extrapolated_maximum(np.zeros(100)) == 0.0


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
