"""The recipe of a basis in one file, followed in a scratch folder: a gap that ripples, bounded tightly."""

import numpy as np
import pytest
import yaml

from tests.recipes.scratch import block, gap_of, scratch

PAGE = "docs/how-to/plugins.md"
ENGINE, BASIS = "An engine in a file beside the case", "A basis in a file beside the case"
RIPPLE, WAVELENGTH, TAU = 0.2, 0.5, 0.01


@pytest.fixture(scope="module")
def gap(tmp_path_factory):
    """The cart of the other recipe on a rail with a ripple, whose force is a sine of the position."""
    folder = tmp_path_factory.mktemp("basis")
    engine = block(PAGE, ENGINE, "python")
    pushed = engine.replace("(u[0] - ", f"(u[0] + {RIPPLE} * np.sin(2 * np.pi / {WAVELENGTH} * position) - ")
    assert pushed != engine
    case = yaml.safe_load(block(PAGE, ENGINE, "yaml"))
    named = yaml.safe_load(block(PAGE, BASIS, "yaml"))
    case |= {"grid": {"eps": 0.03, "shards": 1}, "gap": case["gap"] | named["gap"]}
    case["simulator"]["friction"] = 0.0
    path = scratch(folder, case, {"my_engine.py": pushed, "my_basis.py": block(PAGE, BASIS, "python")})
    return gap_of(path)


def test_the_terms_are_those_of_the_file(gap):
    omega = 2 * np.pi / WAVELENGTH
    assert gap.upper[1].basis.terms == (f"sin({omega}*x)", f"cos({omega}*x)", "v", "1")


def test_the_bound_covers_the_ripple_and_follows_it(gap):
    rng = np.random.default_rng(1)
    x, u = rng.uniform(-1, 1, (500, 2)), rng.choice([-1.0, 0.0, 1.0], (500, 1))
    lo, hi = gap.bounds(x, u)
    true = TAU * RIPPLE * np.sin(2 * np.pi / WAVELENGTH * x[:, 0])
    assert (lo[:, 1] <= true).all()
    assert (true <= hi[:, 1]).all()
    ripple = gap.upper[1].coefficients[0]
    assert ripple == pytest.approx(TAU * RIPPLE, rel=1e-6)
    # between samples the padding remains: a quarter of the range of the gap, which a constant would bound by all of it
    assert (hi - lo)[:, 1].max() < 0.25 * 2.0 * TAU * RIPPLE
