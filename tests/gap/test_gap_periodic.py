"""Bounds on periodic axes: boxes across the seam and any number of turns away, for every kind of bound."""

import json
from dataclasses import replace
from fractions import Fraction
from math import floor

import numpy as np
import pytest

from simgap.gap.bases import Blocks, Expressions
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, Tier, parts
from simgap.gap.bounds.load import from_json
from simgap.geometry import Box
from tests.gap.fit_in_memory import fit_gap
from tests.gap.gap_examples import gap_section, on_grid, smooth

PI = np.pi
POSE, POSES = Box([0.0, 0.0, -PI], [10.0, 10.0, PI]), np.array([[0.0, 0.0], [0.5, -1.0], [0.5, 1.0]])
TERMS = Expressions(terms=("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1"))


def periodic(name):
    """A bound with periodic axes, the same without, and a state width 1 turn along each axis."""
    if name == "body frame":
        rng = np.random.default_rng(3)
        lower = rng.uniform(-0.3, 0.1, (3, 3))
        domain = GapDomain(("x", "y", "theta"), ("v", "w"), POSE, POSES, (0, 1))
        upper, axes = lower + rng.uniform(0.0, 0.3, (3, 3)), (2,)
        plain = BodyFrameGap(domain, (Tier(1, "Made up."),), lower[None], upper[None])
    else:
        basis, axes = {"linear": (TERMS, (0,)), "linear, both axes": (TERMS, (0, 1)), "blocks": (Blocks(), (0,))}[name]
        settings = gap_section(basis=basis, extreme_value=False)
        plain = fit_gap(on_grid(smooth, eps=0.03), settings).function
    return replace(plain, domain=replace(plain.domain, periodic=axes)), plain, axes


def boxes(box, axes, n=300):
    """Boxes inside X along the other axes and anywhere, up to a turn and a half wide, along the periodic ones."""
    rng, width = np.random.default_rng(5), box.hi - box.lo
    half = width * rng.uniform(0.0, 0.05, (n, box.size))
    centre = rng.uniform(box.lo + half, box.hi - half)
    for j in axes:
        near = rng.random(n) < 0.6
        seam = box.lo[j] + rng.uniform(-0.05, 0.05, n) * width[j]
        centre[:, j] = np.where(near, seam, centre[:, j]) + rng.integers(-3, 4, n) * width[j]
        half[rng.random(n) < 0.1, j] = 0.8 * width[j]
    return centre - half, centre + half


def wrapped(x, box, axes):
    x = x.copy()
    for j in axes:
        x[:, j] = box.lo[j] + np.mod(x[:, j] - box.lo[j], box.hi[j] - box.lo[j])
    return x


@pytest.mark.parametrize("name", ["linear", "linear, both axes", "blocks", "body frame"])
def test_a_box_across_the_seam_has_the_bound_of_its_parts(name):
    function, plain, axes = periodic(name)
    box, inputs = function.domain.box, function.domain.input_set
    lo, hi = boxes(box, axes)
    rng = np.random.default_rng(6)
    u = inputs[rng.integers(0, len(inputs), len(lo))]
    below, above = function.box_bounds(lo, hi, u)
    assert np.isfinite([below, above]).all()
    kernel, low, high = function.kernel(), np.empty(box.size), np.empty(box.size)
    for k in range(len(lo)):
        kernel(lo[k], hi[k], u[k], low, high)
        np.testing.assert_allclose(low, below[k], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(high, above[k], rtol=1e-9, atol=1e-12)
        points = rng.uniform(lo[k], hi[k], (400, box.size))
        points[:2] = lo[k], hi[k]
        at_lo, at_hi = plain.bounds(wrapped(points, box, axes), np.tile(u[k], (400, 1)))
        assert (low <= at_lo.min(axis=0) + 1e-12).all()
        assert (high >= at_hi.max(axis=0) - 1e-12).all()
    inside = ((lo > box.lo) & (hi < box.hi)).all(axis=1)
    assert inside.any()
    for one, other in zip(function.box_bounds(lo[inside], hi[inside], u[inside]),
                          plain.box_bounds(lo[inside], hi[inside], u[inside]), strict=True):  # fmt: skip
        assert np.array_equal(one, other)


def test_the_parts_are_no_larger_than_they_need_to_be():
    function, plain, _ = periodic("linear")
    box, u = function.domain.box, function.domain.input_set[:1]
    lo, hi = np.array([[0.19, 0.1]]), np.array([[0.23, 0.2]])
    found = function.box_bounds(lo, hi, u)
    one = plain.box_bounds(lo, np.array([[0.2, 0.2]]), u)
    other = plain.box_bounds(np.array([[-0.2, 0.1]]), np.array([[-0.17, 0.2]]), u)
    np.testing.assert_allclose(found[0], np.minimum(one[0], other[0]), rtol=1e-9)
    np.testing.assert_allclose(found[1], np.maximum(one[1], other[1]), rtol=1e-9)
    assert box.hi[0] == 0.2


@pytest.mark.parametrize("name", ["linear", "body frame"])
def test_there_is_no_bound_beyond_the_other_axes_nor_for_what_is_no_number(name):
    function, _, axes = periodic(name)
    box = function.domain.box
    kernel, low, high = function.kernel(), np.empty(box.size), np.empty(box.size)
    for broken in (np.nan, np.inf):
        for j in axes:
            lo, hi = box.lo + 0.01, box.lo + 0.02
            hi[j] = broken
            kernel(lo, hi, function.domain.input_set[0], low, high)
            found = function.box_bounds(lo[None], hi[None], function.domain.input_set[:1])
            # a box of infinite width is all of the axis; one that is no number is nothing
            assert np.isinf(low).all() == np.isinf(found[0]).all() == bool(np.isnan(broken))
    if name == "linear":
        lo, hi = np.array([[0.3, 0.49]]), np.array([[0.31, 0.51]])
        kernel(lo[0], hi[0], function.domain.input_set[0], low, high)
        assert np.isinf(low).all()
        assert np.isinf(function.box_bounds(lo, hi, function.domain.input_set[:1])[0]).all()


def test_the_file_keeps_periodic_axes():
    function, _, axes = periodic("body frame")
    again = from_json(json.loads(json.dumps(function.to_json())))
    assert again.domain.periodic == axes
    lo, hi = np.array([[1.0, 1.0, 3.0]]), np.array([[1.1, 1.1, 3.3]])
    for one, other in zip(again.box_bounds(lo, hi, POSES[:1]), function.box_bounds(lo, hi, POSES[:1]), strict=True):
        assert np.array_equal(one, other)


def test_the_parts_of_a_box_hold_its_ends_in_exact_arithmetic():
    box, rng = Box([0.1], [0.8]), np.random.default_rng(6)
    turn, lo = Fraction(0.8) - Fraction(0.1), Fraction(0.1)
    start = rng.uniform(-9.0, 9.0, (200, 1))
    end = start + rng.uniform(0.01, 0.3, start.shape)
    found = parts(start, end, box, (0,))
    for k, ends in enumerate(zip(start[:, 0], end[:, 0], strict=True)):
        own = [(a[i, 0], b[i, 0]) for rows, a, b in found for i in np.flatnonzero(rows == k)]
        for x in map(Fraction, ends):
            at = x - floor((x - lo) / turn) * turn
            assert any(Fraction(a) <= at <= Fraction(b) for a, b in own), (k, float(x))
