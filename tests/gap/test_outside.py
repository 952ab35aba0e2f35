"""The worst place outside a bound, against a loop over all places, and its words in what fails."""

import numpy as np
import pytest

from simgap.errors import BrokenPromise
from simgap.gap.fitting.acceptance import (
    BorderCheck,
    FreshCheck,
    Outside,
    confirmed,
    none_outside,
    tolerate,
    worst_outside,
)

NAMES = (("q", "v"), ("u",))
PLACE = Outside("v", 0.002, 0.012, -0.01, 0.01, {"q": 0.1, "v": -0.5, "u": 1.0})


def by_loop(x, u, d, lo, hi):
    found = None
    for k in range(len(x)):
        for i in range(2):
            for gap, excess in ((d[0][k, i], lo[k, i] - d[0][k, i]), (d[1][k, i], d[1][k, i] - hi[k, i])):
                share = excess / (hi[k, i] - lo[k, i])
                if excess > 0 and (found is None or share > found[0]):
                    found = share, i, k, gap, excess
    return found


@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_largest_share_of_the_width(seed):
    rng = np.random.default_rng(seed)
    x, u = rng.normal(size=(30, 2)), rng.normal(size=(30, 1))
    least = rng.normal(size=(30, 2))
    most = least + rng.uniform(0.0, 0.5, size=(30, 2))
    lo = rng.uniform(-3.0, -1.0, size=(30, 2))
    hi = rng.uniform(1.0, 3.0, size=(30, 2))
    found, expected = worst_outside(NAMES, x, u, (least, most), lo, hi), by_loop(x, u, (least, most), lo, hi)
    if expected is None:
        assert found is None
        return
    _, i, k, gap, excess = expected
    assert (found.state, found.gap, found.excess) == (NAMES[0][i], gap, excess)
    assert found.at == {"q": x[k, 0], "v": x[k, 1], "u": u[k, 0]}


def test_nothing_outside_is_none():
    zero = np.zeros((3, 2))
    assert worst_outside(NAMES, zero, np.zeros((3, 1)), (zero, zero), zero, zero) is None


def test_a_bound_that_does_not_cover_says_where_and_what_to_change():
    words = (
        r"the worst in v at q = 0\.1, v = -0\.5, u = 1, where the gap is 0\.012 and gamma \[-0\.01, 0\.01\], by 0\.002"
    )
    check = FreshCheck(100, 2, {"q": 0, "v": 2}, {"q": 0.0, "v": 0.002}, 0.06, 0.95, outside=PLACE)
    with pytest.raises(BrokenPromise, match=words):
        tolerate(check, 0.0, "Use a finer grid.")
    with pytest.raises(BrokenPromise, match=rf"{words}\. .*grid\.half_widths"):
        none_outside(BorderCheck(9, 1, 0, {"q": 0.0, "v": 0.002}, PLACE))
    assert "The worst in v at" in confirmed([], check)[0].text
    sequences = FreshCheck(9, 1, {"v": 1}, {"q": 0.0, "v": 0.002}, 0.4, 0.95, steps=90)
    with pytest.raises(BrokenPromise, match=r"by up to 0\.002 in v"):
        tolerate(sequences, 0.0, "Lengthen it.")
