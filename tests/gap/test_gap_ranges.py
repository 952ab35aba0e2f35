"""Gaps with a range, where a simulator remembers earlier inputs: either end may be the steep one."""

import itertools

import numpy as np
import pytest

from simgap.gap.bases import Blocks, Expressions
from simgap.geometry import Grid
from tests.gap.fit_in_memory import GapSamples, fit_gap
from tests.gap.gap_examples import PAPER, U, X, gap_section

GRID = Grid(X, [30, 30])
KINDS = {
    "per axis": {"padding": "per_axis"},
    "per axis, unsigned": {"padding": "per_axis", "sides": "unsigned"},
    "paper": {"padding": "paper"},
    "paper, unsigned": {"padding": "paper", "sides": "unsigned", "objective": "eta"},
    "constant, per axis": {"basis": Expressions(terms=("1",)), "padding": "per_axis"},
    "blocks, per axis": {"basis": Blocks(blocks=(30, 30)), "padding": "per_axis"},
    "blocks, paper": {"basis": Blocks(blocks=(30, 30)), "padding": "paper"},
    "blocks, inflate": {"basis": Blocks(blocks=(30, 30))},
    "inflate": {},
    "inflate, unsigned": {"sides": "unsigned"},
}


def flat(x):
    return np.zeros(x.shape)


def wavy(x):
    """Twelve cells a wave: the grid resolves it."""
    return np.array([1e-4, 1e-3]) * np.sin(2 * np.pi * (30 / 12) * (x - X.lo) / (X.hi - X.lo))


def ends(steep, x):
    """(lower, upper) of the gap at x: one end flat, the other a wave beyond it."""
    wave = np.array([1e-4, 1e-3])
    return (flat(x), wave + wavy(x)) if steep == "upper" else (-wave + wavy(x), flat(x))


def between(cells=8):
    """Corners, faces and inner points of every cell: the places that are farthest from a sample, and a mesh."""
    part = np.linspace(-1.0, 1.0, cells + 1)
    offsets = np.array(list(itertools.product(part, part))) * GRID.h
    return (GRID.centres()[:, None] + offsets).reshape(-1, 2).clip(X.lo, X.hi)


@pytest.mark.parametrize("steep", ["upper", "lower"])
@pytest.mark.parametrize("name", KINDS)
def test_both_ends_are_covered_between_the_samples(name, steep):
    lower, upper = (np.repeat(end[:, None], len(U), axis=1) for end in ends(steep, GRID.centres()))
    samples = GapSamples(GRID, U, lower, ("x1", "x2"), ("u",), upper)
    options = {"basis": Expressions(terms=PAPER), "extreme_value": False, "rough_limit": 1.0} | KINDS[name]
    function = fit_gap(samples, gap_section(**options)).function
    x = between()
    lower, upper = ends(steep, x)
    lo, hi = function.bounds(x, np.tile(U[:1], (len(x), 1)))
    outside = (lo > lower) | (hi < upper)
    assert not outside.any(), f"{outside.any(axis=1).sum()} of {len(x)} outside"
