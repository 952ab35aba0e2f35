"""Processes of the validation map a controller's tables: none reads its file or makes its choices again."""

import pickle
from unittest import mock

import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.io.arrays_on_disk import Mapped
from simgap.specifications.solution import Solution
from simgap.synthesis.controller import Controller


def mapped(array):
    """True if the numbers of an array are those of a file."""
    while isinstance(array, np.ndarray) and not isinstance(array, np.memmap):
        array = array.base.obj if isinstance(array.base, memoryview) else array.base
    return isinstance(array, np.memmap) and not array.flags.writeable


@pytest.fixture
def controller():
    rng = np.random.default_rng(5)
    grid, inputs = Grid(Box([0.0, 0.0], [1.0, 1.0]), (20, 30)), np.linspace(-1.0, 1.0, 11)[:, None]
    mask = rng.integers(0, 256, (grid.size * 2, 2)).astype(np.uint8) & np.array([255, 7], np.uint8)
    winning = rng.random(grid.size) < 0.5
    kind = (np.arange(11) > 5).astype(np.int64)
    solution = Solution(grid, winning, mask, np.ones(grid.size, bool), memory=2, first=1, kind=kind)
    return Controller(inputs, ("a", "b"), ("u",), solution, "least_effort", {})


def test_a_shared_controller_answers_as_the_one_that_was_read(controller, tmp_path):
    shared = pickle.loads(pickle.dumps(Mapped.of(controller, tmp_path / "tables")))
    with mock.patch("simgap.synthesis.controller.preferred", side_effect=AssertionError("made again")):
        found = shared.read()
        x, pending = np.random.default_rng(1).uniform(-0.1, 1.1, (500, 2)), np.arange(500) % 2
        answers = found.lookup(x, pending)
    assert np.array_equal(answers, controller.lookup(x, pending))
    assert len({*answers.tolist()}) > 5
    assert mapped(found.choice)
    assert mapped(found.solution.mask)
    assert np.array_equal(found.solution.winning, controller.solution.winning)
    assert (found.memory, found.first, found.rule) == (2, 1, "least_effort")
    assert len(pickle.dumps(shared)) < controller.solution.mask.nbytes


def test_the_next_chunk_of_a_worker_maps_nothing_anew(controller, tmp_path):
    sent = pickle.dumps(Mapped.of(controller, tmp_path / "tables"))
    assert pickle.loads(sent).read() is pickle.loads(sent).read()
