"""Erosion by boxes against the definition, cell by cell."""

import itertools

import numpy as np
import pytest

from simgap.synthesis.games.reach import erode, pack_rows

BOXES = np.array([(1, 1, 1, 1), (1, 3, 2, 4), (2, 3, 2, 4), (1, 6, 9, 1), (3, 5, 1, 70), (1, 3, 2, 4), (1, 1, 7, 2)])


def packed(cells):
    rows, count = int(np.prod(cells.shape[:3])), cells.shape[3]
    return pack_rows(cells.reshape(-1), np.arange(rows) * count, 1, count, (count + 63) // 64)


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


@pytest.mark.parametrize("periodic", [(0, 0, 0), (0, 0, 1), (1, 1, 1)])
def test_erosion_by_boxes(periodic):
    cells = np.random.default_rng(5).random((3, 5, 7, 90)) < 0.97
    for box in BOXES:
        found = erode(packed(cells), np.array(cells.shape[:3]), np.array(periodic), box)
        assert np.array_equal(found, packed(by_definition(cells, periodic, box)))
