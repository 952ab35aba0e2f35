"""The confidence that is printed against the coverage that a law gives, where residuals depend on each other."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from simgap.correction.conformal_bound import Sizes, bound, memory, pieces
from simgap.statistics import attained

LEVEL = 0.95


def correlated(rng, n, rho):
    """Of variance one, neighbours correlated by rho, long after its start."""
    return lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n + 2000))[2000:]


def printed(runs, fitted=()):
    """Bound and confidence from held-out runs, and from others that help to see what lasts and what differs."""
    both = [*fitted, *runs]
    held_out = np.repeat([k >= len(fitted) for k in range(len(both))], [len(r) for r in both])
    piece, by_run = pieces(
        np.concatenate(both)[:, None],
        np.repeat(np.arange(len(both)), [len(r) for r in both]),
        np.concatenate([np.arange(len(r)) for r in both]),
        held_out,
    )
    fresh = Sizes(np.abs(np.concatenate(runs))[:, None], {}, piece[held_out])
    (limit,) = bound(Sizes(np.zeros((0, 1)), {}), fresh, LEVEL)
    return float(limit), attained(fresh.count, LEVEL), by_run


def coverage(draw, scales, count=150):
    """Mean coverage of a further residual, mean confidence, share of the records whose runs were taken to differ."""
    rows = [(limit, *more) for limit, *more in (printed(*draw(k)) for k in range(count))]
    inside = [np.mean(2.0 * norm.cdf(limit / scales) - 1.0) for limit, *_ in rows]
    return np.mean(inside), np.mean([c for _, c, _ in rows]), np.mean([d for *_, d in rows])


def test_neighbours_that_correlate_by_98_percent_are_few_pieces():
    """A hundred of them as a hundred pieces cover 0.86 in the mean and were printed as 0.95."""
    rng = np.random.default_rng(1)
    inside, said, _ = coverage(lambda _: ([correlated(rng, 100, 0.98)],), np.ones(1))
    assert inside >= said + 0.05
    assert said <= 0.85


def test_a_long_record_of_them_keeps_its_confidence():
    rng = np.random.default_rng(2)
    inside, said, _ = coverage(lambda _: ([correlated(rng, 8000, 0.98)],), np.ones(1), 40)
    assert said >= 0.949
    assert inside >= LEVEL


def test_a_record_that_is_shorter_than_what_lasts_is_one_piece_or_two():
    rng = np.random.default_rng(3)
    inside, said, _ = coverage(lambda _: ([correlated(rng, 40, 0.995)],), np.ones(1))
    assert inside >= said


def test_residuals_that_forget_keep_the_level_and_the_width():
    rng = np.random.default_rng(4)
    inside, said, _ = coverage(lambda _: ([rng.standard_normal(200)],), np.ones(1))
    assert said == pytest.approx(LEVEL, abs=1e-12)
    assert LEVEL <= inside + 0.005 <= LEVEL + 0.03


@pytest.mark.parametrize("held_out", [1, 3])
def test_runs_that_differ_are_one_piece_each(held_out):
    rng = np.random.default_rng(5)
    others = np.exp(np.random.default_rng(6).standard_normal(4000))

    def draw(_):
        every = [s * correlated(rng, 100, 0.5) for s in np.exp(rng.standard_normal(held_out + 3))]
        return every[:held_out], every[held_out:]

    inside, said, differ = coverage(draw, others)
    assert differ >= 0.95
    assert said == pytest.approx(held_out / (held_out + 1), abs=0.02)
    assert inside >= said


def test_runs_of_one_size_are_cut_into_blocks():
    rng = np.random.default_rng(7)
    inside, said, differ = coverage(lambda _: ([correlated(rng, 400, 0.9) for _ in range(4)],), np.ones(1))
    assert differ <= 0.25
    assert LEVEL >= said >= 0.9
    assert inside >= said


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_how_long_an_autoregression_remembers(rho):
    rng = np.random.default_rng(8)
    x, holes = np.concatenate([correlated(rng, 20_000, rho) for _ in range(2)]), rng.random(40_000) < 0.7
    run, step = np.repeat([0, 1], 20_000), np.tile(np.arange(20_000), 2)
    assert memory(x, run, step) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.15)
    assert memory(x[holes], run[holes], step[holes]) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.2)
