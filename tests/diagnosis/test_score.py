"""What is scored: predictions of what was not fitted, under a law with heavy tails, sure by the spread over blocks."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from simgap.diagnosis import choosing, conclude
from simgap.diagnosis import diagnose as diagnosing
from simgap.diagnosis.choosing import Chosen
from simgap.diagnosis.conclude import is_borne_out
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.verdict.score import Errors, gained
from simgap.diagnosis.verdict.sets import Rated, density_of_choice, plausible, preferred_of
from simgap.effects import EFFECTS


def _rated(densities, counts, bic, sensors=(0,) * 9):
    every = zip(densities, counts, bic, sensors[: len(counts)], strict=True)
    return [Rated(density, count, b, sensors=s) for density, count, b, s in every]


def _errors(rng: np.random.Generator, scale: float, pushes: np.ndarray, blocks: int = 40, each: int = 25) -> Errors:
    size = scale * rng.standard_normal((blocks * each, 1)) + pushes[:, None]
    return Errors(size, np.repeat(np.arange(blocks), each))


def test_a_push_that_carries_the_squares_does_not_hide_what_is_explained():
    """Four in a hundred errors are a push of fifty: the root mean square falls by 2 %, the scale to a third."""
    rng, pushes = np.random.default_rng(7), np.zeros(1000)
    pushes[::25] = 50.0 * rng.choice([-1.0, 1.0], 40)
    before, after = _errors(rng, 3.0, pushes), _errors(rng, 1.0, pushes)
    assert np.sqrt(np.mean(after.size**2) / np.mean(before.size**2)) > 0.95
    found = gained(before.density(), after.density())
    assert found.sure
    share, low, high = found.share
    assert 0.45 < share < 2.0 / 3.0  # the pushes stay as improbable as they are
    assert low < share < high


def test_of_errors_without_a_push_the_share_is_that_of_their_scale():
    rng, none = np.random.default_rng(8), np.zeros(1000)
    share, low, high = gained(_errors(rng, 3.0, none).density(), _errors(rng, 1.0, none).density()).share
    assert low < 2.0 / 3.0 < high
    assert high - low < 0.1
    assert share == pytest.approx(2.0 / 3.0, abs=0.03)


def test_nothing_gained_is_seldom_sure():
    """Of models that predict alike one in forty looks surely better, if blocks are what depends on itself."""
    rng, sure = np.random.default_rng(9), 0
    for _ in range(200):
        sizes = np.repeat(np.exp(rng.standard_normal((2, 12, 1))), 20, axis=1)
        errors = [Errors(s * rng.standard_normal((240, 1)), np.repeat(np.arange(12), 20)) for s in sizes]
        found = gained(*(e.density() for e in errors))
        sure += found.nats > found.half
    assert sure <= 12


def test_neighbours_that_vary_together_make_a_gain_less_sure():
    """Each block shares half of its errors with the next, as predictions reach over: nothing is gained, 2,000 times."""
    rng = np.random.default_rng(90417)
    sure, independent = 0, 0
    for _ in range(2000):
        own = rng.normal(size=21)
        each = own[1:] + own[:-1]
        gain = gained(np.zeros(20), each)
        sure += abs(gain.nats) > gain.half
        independent += abs(each.mean()) > 2.093 * each.std(ddof=1) / math.sqrt(20)
    assert sure < 0.1 * 2000 < independent


def test_the_scale_is_of_other_blocks_than_those_scored():
    """By hand: one block that misses ten times as far is as improbable as the others say."""
    size = np.concatenate([np.tile([1.0, -1.0], 90), np.tile([10.0, -10.0], 10)])[:, None]
    density = Errors(size, np.repeat(np.arange(10), 20)).density()
    usual = student.pdf(10.0, 4)  # of scale 1, that of a t with 4 degrees of freedom that fits sizes of 1: 5 / (4 + 1)
    gross = 1.0 / (2.0 * 10.0 * (1.0 + 6.0 * math.log(10.0)))  # of any size: each of six decades as likely
    assert density[-1] == pytest.approx(math.log(0.999 * usual + 0.001 * gross), rel=1e-3)


def test_a_quarter_of_the_blocks_that_nobody_predicts_does_not_hide_what_the_others_gain():
    """A model that predicts the rest ten times better does not pay for it where both miss by hundreds of the noise."""
    rng, pushes = np.random.default_rng(10), np.zeros(40)
    pushes[::4] = 300.0
    before, after = (_errors(rng, s, np.repeat(pushes, 25)) for s in (10.0, 1.0))
    found = gained(before.density(), after.density())
    assert found.sure
    assert found.nats > 0.6 * math.log(10.0)  # three quarters of the blocks are no push


def test_of_a_single_block_nothing_is_sure():
    alone = Errors(np.ones((5, 1)), np.zeros(5, dtype=np.int64)).density()
    assert not gained(alone, alone + 9.0).sure


@pytest.fixture
def hypothesis(monkeypatch):
    """Makes a hypothesis of a record from what its choice predicts, which is given."""
    monkeypatch.setattr(diagnosing._Sought, "choice", property(lambda own: own.under.choice))

    def made(predicted, *, sigma=1.0, factor=1.0, heard=1.0, ratio=1.0):
        member = SimpleNamespace(effect=EFFECTS["input_gain"], values=lambda theta: {"ratio": theta[0]})
        put = SimpleNamespace(members=[member], fit=SimpleNamespace(theta=np.array([ratio])))
        held = [(None, SimpleNamespace(sigma=np.array([sigma])))]
        choice = SimpleNamespace(predicted=np.asarray(predicted), kept=put, held=lambda: held)
        ready = SimpleNamespace(factors=np.array([factor]))
        parts = SimpleNamespace(known=SimpleNamespace(heard=np.array([heard])))
        return diagnosing._Sought(ready, SimpleNamespace(parts=parts, choice=choice), (), False)

    return made


def _is_taken(first, other) -> bool:
    """Whether the second hypothesis is taken in the place of the first."""
    return first.likeliest([other]) is not first


@pytest.mark.parametrize(("more", "apart", "above"), [(0.3, 0.1, True), (0.3, 2.0, False), (0.05, 0.01, False)])
def test_two_hypotheses_are_told_apart_on_the_same_blocks(hypothesis, more, apart, above):
    """What varies from block to block, and is the same for both, makes neither unsure."""
    rng = np.random.default_rng(91508)
    common = 3.0 * rng.standard_normal(40)
    own, other = hypothesis(common), hypothesis(common + more + apart * rng.standard_normal(40))
    assert _is_taken(own, other) is above
    assert not _is_taken(other, own)


def test_hypotheses_are_scored_in_the_units_that_were_logged(hypothesis):
    """Degrees read as radians at a noise that is given: both miss by as much, in units of it by 57 times as much."""
    rng = np.random.default_rng(7993)
    missed, turn = np.log(rng.uniform(1.0, 3.0, 30)), 180.0 / np.pi  # logarithms of sizes, in degrees
    radians = hypothesis(-(missed - np.log(2e-3)), sigma=2e-3)
    degrees = hypothesis(-(missed - np.log(turn * 2e-3)), sigma=2e-3, factor=1.0 / turn)
    assert not _is_taken(radians, degrees)
    assert not _is_taken(degrees, radians)


def test_other_blocks_and_channels_are_not_compared(hypothesis):
    own = hypothesis(np.zeros(20))
    assert _is_taken(own, hypothesis(np.ones(20)))
    assert not _is_taken(own, hypothesis(np.ones(19)))
    assert not _is_taken(own, hypothesis(np.ones(20), heard=0.0))


def test_a_ratio_beyond_belief_gives_way_to_what_predicts_as_well(hypothesis):
    rng = np.random.default_rng(7994)
    own, near, worse = (shift + 0.1 * rng.standard_normal(20) for shift in (0.0, 0.0, -1.0))
    assert _is_taken(hypothesis(own, ratio=40.0), hypothesis(near))
    assert not _is_taken(hypothesis(own, ratio=2.0), hypothesis(near))
    assert not _is_taken(hypothesis(own, ratio=40.0), hypothesis(worse))


@pytest.mark.parametrize(
    ("name", "values", "believed"),
    [
        ("input_curve", {"g_0": 0.0, "g_1": 1.2, "g_2": 1.1, "U": 9.0}, True),  # small commands may do nothing
        ("input_curve", {"g_0": 900.0, "g_1": 1000.0, "g_2": 950.0, "U": 9.0}, False),  # a column in another unit
        ("input_directional_gain", {"ratio_p": 1.1, "ratio_m": 0.02}, False),
        ("input_saturation", {"limit": 900.0}, True),
    ],
)
def test_an_effect_is_believed_by_its_ratios(name, values, believed):
    member = SimpleNamespace(effect=EFFECTS[name], values=lambda theta: values)
    put = SimpleNamespace(members=[member], fit=SimpleNamespace(theta=np.zeros(1)))
    assert plausible(put) is believed


@pytest.mark.parametrize(("smaller", "put"), [("steady", "a part"), (None, "what predicts best")])
def test_where_halves_disagree_on_what_is_at_the_noise_sets_compete(smaller, put, monkeypatch):
    monkeypatch.setattr(conclude, "judge", lambda *_: None)
    monkeypatch.setattr(conclude, "_steadier", lambda *_: smaller)
    at_all = SimpleNamespace(at_noise=True)
    told = lambda parts, chosen, *_: SimpleNamespace(agree=chosen == put, corrected=at_all)  # noqa: E731
    monkeypatch.setattr(conclude, "_evidence", told)
    at_noise = SimpleNamespace(
        at_floor=True, full=None, kept=None, base=SimpleNamespace(theta=None), search=SimpleNamespace(watch=Watch()),
        less=lambda _: "a part", competing=lambda: "what predicts best",
    )  # fmt: skip
    _, chosen, evidence = conclude.confirmed(SimpleNamespace(confirm=None, known=None), at_noise, 0.2)
    assert (chosen, evidence.agree) == (put, True)


def test_what_reaches_the_noise_is_scored_as_it_predicts_what_it_was_not_fitted_to(monkeypatch):
    """Sets compete off the noise alone: at it the answer itself is fitted to other blocks than it predicts."""
    monkeypatch.setattr(choosing, "density", lambda put, *other: put)
    full = SimpleNamespace(empty=lambda base: "declared", steps={})
    under = SimpleNamespace(parts=SimpleNamespace(horizon_s=0.2))
    found, nothing = (Chosen(under, None, full, None, None, None, "friction", floor, list) for floor in (True, False))
    assert (found.predicted, nothing.predicted) == ("friction", "declared")


@pytest.mark.parametrize(
    ("gains", "spread", "bic", "chosen"),
    [
        ((0.0, 0.5), 0.1, (100.0, 50.0), 1),  # sure over the blocks
        ((0.0, 0.5), 2.0, (100.0, 50.0), 1),  # the blocks are unsure, the fit is not
        ((0.0, 0.5), 2.0, (100.0, 97.0), 0),  # neither is sure: the smaller
        ((0.0, 0.05), 0.01, (100.0, 50.0), 0),  # sure, and of no size
    ],
)
def test_a_larger_set_is_preferred_where_it_surely_predicts_better_by_a_size_that_matters(gains, spread, bic, chosen):
    rng = np.random.default_rng(3)
    noise = spread * (lambda x: x - x.mean())(rng.standard_normal(12))
    densities = [np.full(12, gains[0]), gains[1] + noise]
    assert preferred_of(_rated(densities, (1, 2), bic), (0, 1))[0] == chosen


@pytest.mark.parametrize("nothing", [np.zeros(1), np.full(1, -np.inf), np.full(9, -np.inf), np.full(9, np.nan)])
def test_where_nothing_is_predicted_the_fits_decide(nothing):
    """One block, or no number in any: the smaller set by far the worse fit is not chosen because it is smaller."""
    assert preferred_of(_rated([nothing] * 3, (0, 1, 2), (900.0, 500.0, 10.0)), (1, 2)) == [2]
    assert preferred_of(_rated([nothing] * 3, (0, 1, 2), (900.0, 12.0, 10.0)), (1, 2)) == [1, 2]


def test_of_sets_as_small_that_predict_as_well_the_one_without_a_sensor_that_is_off_is_named():
    """A sensor off its zero imitates what bends little; it is named where it surely predicts better."""
    level, better = [np.zeros(12), np.full(12, 1.1), np.full(12, 1.0)], [np.zeros(12), np.full(12, 3.0), np.ones(12)]
    offset = (0, 1, 0)
    assert preferred_of(_rated(level, (0, 1, 1), (900.0, 10.0, 11.0), offset), (1, 2))[0] == 2
    assert preferred_of(_rated(better, (0, 1, 1), (900.0, 10.0, 11.0), offset), (1, 2))[0] == 1


@pytest.mark.parametrize("broken", [np.nan, -np.inf])
def test_a_set_whose_prediction_is_no_number_is_not_chosen_beside_one_that_predicts(broken):
    away = np.array([0.5, broken, 0.5])
    assert preferred_of(_rated([np.zeros(3), away, np.ones(3)], (0, 1, 2), (900.0, 10.0, 10.0)), (1, 2)) == [2]


def test_a_single_block_bears_out_what_gets_smaller_in_it_and_is_sure_of_nothing():
    rng = np.random.default_rng(11)
    large, small = (_errors(rng, s, np.zeros(25), 1) for s in (3.0, 1.0))
    assert is_borne_out(large, small)
    assert not is_borne_out(small, large)
    assert not is_borne_out(large, large)
    assert not gained(large.density(), small.density()).sure


def test_a_channel_that_is_predicted_worse_is_not_hidden_by_one_that_is_better():
    rng, none = np.random.default_rng(13), np.zeros(200)
    first, second = ([_errors(rng, s, none, 8) for s in sizes] for sizes in ((3.0, 0.3), (1.0, 1.5)))
    both = [Errors(np.hstack([a.size, b.size]), a.block) for a, b in zip(first, second, strict=True)]
    assert gained(both[0].density(), both[1].density()).sure
    assert not is_borne_out(*both)
    assert is_borne_out(*first)


def test_what_a_choice_gains_is_measured_on_blocks_that_had_no_say():
    """Of eight sets that predict as well as nothing the best seems to gain; of the choice that gain is zero."""
    rng = np.random.default_rng(90423)
    best, choice = [], []
    for _ in range(300):
        sets = [np.zeros(20), *rng.normal(size=(8, 20))]
        rated, among = _rated(sets, [0] + [1] * 8, [0.0] * 9), range(1, 9)
        best.append(sets[preferred_of(rated, among)[0]].mean())
        choice.append(density_of_choice(rated, among).mean())
    assert np.mean(best) > 0.2
    assert abs(np.mean(choice)) < 2.0 * np.std(choice) / math.sqrt(300)


def test_a_choice_that_no_block_can_change_gains_what_its_set_does():
    sets = [np.zeros(15), np.full(15, 2.0), np.full(15, 0.5)]
    assert np.all(density_of_choice(_rated(sets, (0, 1, 1), (0.0, -90.0, 0.0)), (1, 2)) == 2.0)
