"""Erosion by boxes and dilation of flags against the definition, cell by cell."""

import itertools

import numpy as np
import pytest

from simgap.synthesis.games.reach_rows import BoxErosion, dilate, pack_rows

BOXES = np.array([(1, 1, 1, 1), (1, 3, 2, 4), (2, 3, 2, 4), (1, 6, 9, 1), (3, 5, 1, 70), (1, 3, 2, 4), (1, 1, 7, 2)])


def packed(cells):
    rows, count = int(np.prod(cells.shape[:3])), cells.shape[3]
    bits = np.zeros((rows, (count + 63) // 64), np.uint64)
    pack_rows(cells.reshape(-1).astype(np.uint8), np.arange(rows) * count, 1, count, bits)
    return bits


def by_definition(cells, periodic, extent):
    out = np.ones_like(cells)
    for offset in itertools.product(*(range(e) for e in extent)):
        moved = cells
        for axis, by in enumerate(offset):
            n = cells.shape[axis]
            if axis < 3 and periodic[axis]:
                moved = np.roll(moved, -by, axis)
            else:
                padded = np.concatenate([moved, np.zeros_like(moved)], axis)
                moved = np.take(padded, np.minimum(np.arange(n) + by, 2 * n - 1), axis)
        out &= moved
    return out


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("periodic", [(0, 0, 0), (0, 0, 1), (1, 1, 1)])
def test_erosion_by_boxes(periodic, threads):
    rng = np.random.default_rng(5)
    cells = rng.random((3, 5, 7, 90)) < 0.97
    erode = BoxErosion(np.array(cells.shape[:3]), np.array(periodic), BOXES)
    bits = packed(cells)
    eroded, grew = np.zeros((len(BOXES), *bits.shape), np.uint64), np.zeros((len(BOXES), len(bits)), np.uint8)
    erode(bits, eroded, grew, threads)
    for box, found, flags in zip(BOXES, eroded, grew, strict=True):
        wanted = packed(by_definition(cells, periodic, box))
        assert np.array_equal(found, wanted)
        assert np.array_equal(flags, wanted.any(axis=1))
    erode(bits, eroded, grew, threads)
    assert not grew.any()


@pytest.mark.parametrize("periodic", [(0, 0, 0), (0, 1, 1)])
@pytest.mark.parametrize(
    ("lower", "upper"), [((0, -2, -1), (0, 1, 3)), ((-4, -9, 1), (1, 9, 2)), ((0, 0, -8), (0, 0, 8))]
)
def test_dilation(periodic, lower, upper):
    lengths = np.array([3, 5, 7])
    flags = (np.random.default_rng(2).random(105) < 0.04).astype(np.uint8)
    wanted = np.zeros(105, np.uint8)
    shaped = flags.reshape(lengths)
    for r, place in enumerate(np.ndindex(*lengths)):
        for offset in itertools.product(*(range(a, b + 1) for a, b in zip(lower, upper, strict=True))):
            at = [p + o for p, o in zip(place, offset, strict=True)]
            at = [a % n if wraps else a for a, n, wraps in zip(at, lengths, periodic, strict=True)]
            if all(0 <= a < n for a, n in zip(at, lengths, strict=True)):
                wanted[r] |= shaped[tuple(at)]
    assert np.array_equal(dilate(flags, lengths, np.array(periodic), np.array(lower), np.array(upper)), wanted)
