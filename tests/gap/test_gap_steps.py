"""The steps from grid to bound: results of single dimensions survive their files, those of other cases are refused."""

import json

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.gap.bases import Blocks, Expressions
from simgap.gap.checked_bound import assemble
from simgap.gap.fitting.dimension_fit import fit_dimension, fit_from_json
from simgap.gap.lipschitz.estimates import dimension_lipschitz
from simgap.gap.lipschitz.grid import DimensionLipschitz
from simgap.gap.sampling.points import Points, covering_point, cut, product, radius
from simgap.gap.sampling.samples import check_rows
from simgap.geometry import Grid
from tests.gap.fit_in_memory import fit_gap
from tests.gap.gap_examples import PAPER, U, X, gap_section, off_grid, on_grid, smooth

SETTINGS = {
    "inflate": {"rough_limit": 1.0},
    "per_axis": {"padding": "per_axis", "sides": "unsigned"},
    "blocks": {"basis": Blocks(blocks=(4, 5))},
    "blocks, paper": {"basis": Blocks(blocks=(4, 5)), "padding": "paper"},
    "constant": {"basis": Expressions(terms=("1",))},
}


def through_a_file(result):
    return json.loads(json.dumps(result.to_json()))


@pytest.mark.parametrize("name", SETTINGS)
def test_a_bound_made_of_saved_results_is_the_same(name):
    settings = gap_section(**({"basis": Expressions(terms=PAPER)} | SETTINGS[name]))
    samples = on_grid(smooth, eps=0.04)
    parts = [samples.dimension(i) for i in (0, 1)]
    fits = [fit_from_json(through_a_file(fit_dimension(part, settings))) for part in parts]
    known = [DimensionLipschitz.from_json(through_a_file(dimension_lipschitz(part, settings))) for part in parts]
    made, whole = assemble(samples.where, settings, fits, known), fit_gap(samples, settings)
    assert made.to_json() == whole.to_json()
    x, u, _ = off_grid(smooth, 300)
    for one, other in zip(made.function.bounds(x, u), whole.function.bounds(x, u), strict=True):
        assert np.array_equal(one, other)


def test_no_padding_but_inflate_enters_the_program():
    samples = on_grid(smooth, eps=0.04).dimension(1)
    per_axis, paper, inflate = (
        through_a_file(fit_dimension(samples, gap_section(basis=Expressions(terms=PAPER), padding=name)))
        for name in ("per_axis", "paper", "inflate")
    )
    assert per_axis == paper
    assert inflate["sides"]["upper"]["padding"] > 0.0 == paper["sides"]["upper"]["padding"]


def test_shards_in_order_are_the_grid():
    grid = Grid.covering(X, 0.1)
    points = Points(covering_point(0.1), grid.centres(), U)
    rows = [points.states[cut(grid.size, k, 3)] for k in range(3)]
    assert np.array_equal(np.concatenate(rows), points.states)
    check_rows(points, 0, *product(rows[0], U))
    check_rows(points, len(rows[0]), *product(rows[1], U))
    with pytest.raises(UserError, match="out of order"):
        check_rows(points, 0, *product(rows[1], U))
    x, u = product(rows[0], U)
    u[5] += 1e-9
    with pytest.raises(UserError, match="not one of the grid"):
        check_rows(points, 0, x, u)


def test_the_name_of_a_point_is_its_radius():
    assert radius(covering_point(0.0022)) == 0.0022
    for name in ("eps~", "eps~-1", "eps~nan", "eps~inf", "hidden-state", "0.1"):
        with pytest.raises(UserError, match="not a point of this case"):
            radius(name)
