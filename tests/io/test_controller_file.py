"""Controllers read back the same, and no damaged or impossible one is ever obeyed."""

import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import simgap
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.io import controller_file as controller_content
from simgap.io.atomic import sealed
from simgap.io.controller_file import load_controller, load_controller_of, save_controller, write_arrays
from simgap.specifications.solution import Solution
from simgap.synthesis.controller import Controller

GRID = Grid(Box([0.0, -1.0], [1.0, 1.0]), (4, 3), (1,))
INPUTS = np.array([[-1.0], [0.0], [1.0]])


def reaching(memory=1):
    """A controller made by hand: the first two cells are the target, the last one is lost."""
    target, free, winning = (np.zeros(GRID.size, bool) for _ in range(3))
    target[:2], free[:], winning[:-1] = True, True, True
    value = np.where(target, 0, np.where(winning, 1, -1)).astype(np.int32)
    mask = np.zeros((GRID.size, memory, 1), np.uint8)
    mask[2:-1] = 0b101
    nodes = np.repeat(value, memory), np.repeat(target, memory)
    late = {"first": 1, "late": True} if memory > 1 else {}
    solution = Solution(GRID, winning, mask.reshape(-1, 1), free, *nodes, memory, {"steps": 1}, **late)
    return Controller(INPUTS, ("x", "v"), ("u",), solution, "least_effort", {"seed": 0})


@pytest.fixture
def saved(tmp_path):
    save_controller(reaching(), tmp_path / "controller.npz")
    return tmp_path / "controller.npz"


def parts(path):
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def rewritten(path, about=None, **changes):
    """The file with other content and a checksum that fits it, as a faulty program would write it."""
    arrays = parts(path)
    arrays |= changes
    if about:
        told = json.loads(arrays["about"].tobytes()) | about
        arrays["about"] = np.frombuffer(json.dumps(told).encode(), np.uint8)
    with sealed(path) as temporary:
        write_arrays(temporary, arrays)
    return path


def spoilt(path, arrays):
    """Other arrays under the checksum that the file had."""
    with zipfile.ZipFile(path) as archive:
        stated = archive.comment
    np.savez(path, **arrays)
    with zipfile.ZipFile(path, "a") as archive:
        archive.comment = stated


def refused(path, match):
    with pytest.raises(UserError, match=match) as caught:
        load_controller(path)
    assert caught.value.file == path
    assert "\n" not in str(caught.value)


def test_what_may_act_from_true_cells_is_kept_and_has_to_fit_the_starts(tmp_path):
    """Of a controller that stays by measurements a sample late: winning cells are those where 0, the first, may act."""
    acting = np.array([1, 3, 5, 7, 1, 3, 5, 7, 0, 2, 4, 6], np.uint8)[:, None]
    mask = np.full((GRID.size * 3, 1), 7, np.uint8)
    winning = acting[:, 0] & 1 == 1
    solution = Solution(GRID, winning, mask, np.ones(GRID.size, bool), memory=3, late=True, acting=acting)
    path = tmp_path / "late.npz"
    save_controller(Controller(INPUTS, ("x", "v"), ("u",), solution, "least_effort", {}), path)
    assert np.array_equal(load_controller(path).solution.acting, acting)
    refused(rewritten(path, acting=acting ^ 1), "its first input may act")
    refused(rewritten(path, acting=acting[1:]), "of other cells")


@pytest.mark.parametrize("memory", [1, 3])
def test_it_reads_back_the_same(tmp_path, memory):
    made, path = reaching(memory), tmp_path / "a.npz"
    save_controller(made, path)
    read = load_controller(path)
    for name in ("winning", "mask", "free", "value", "target"):
        assert np.array_equal(getattr(read.solution, name), getattr(made.solution, name)), name
    assert (read.states, read.memory, read.grid.periodic) == (("x", "v"), memory, (1,))
    assert (read.first, read.late) == (made.first, made.late) == ((1, True) if memory == 3 else (0, False))
    save_controller(read, tmp_path / "b.npz")
    assert path.read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_package_offers_it_without_costing_anything_before(saved):
    assert simgap.load_controller(saved).input([0.9, 0.0]).tolist() == [-1.0]
    rooms = "{name for name in sys.modules if name.startswith(('numpy', 'numba', 'simgap.'))}"
    # The two that say where machine code and byte code is kept.
    code = f"import sys, simgap; sys.exit({rooms} != {{'simgap.cache', 'simgap.cache'}})"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    with pytest.raises(AttributeError, match="no attribute 'load_everything'"):
        simgap.load_everything  # noqa: B018


@pytest.mark.parametrize(
    ("about", "changes", "match"),
    [
        ({"memory": 0}, {}, "memory 0 cannot be"),
        ({"memory": -1}, {}, "memory -1 cannot be"),
        ({"memory": True}, {}, "memory True cannot be"),
        ({"memory": 3}, {}, "memory 3 cannot be"),
        ({"memory": 4}, {}, "memory 4 cannot be"),
        ({"memory": 3, "late": True}, {}, "table of inputs has shape"),
        ({"late": 1}, {}, "whether its inputs act late"),
        ({"first": 1}, {}, "begin with memory 1"),
        ({}, {"input_set": np.array([[-1.0], [np.nan], [1.0]])}, "finite numbers with the columns u"),
        ({}, {"input_set": np.array([[-1.0], [0.0]])}, "admits inputs that do not exist"),
        ({}, {"input_set": np.zeros((3, 2))}, "finite numbers with the columns u"),
        ({}, {"cells": np.array([3, 5])}, "shape|size|grid"),
        ({}, {"cells": np.array([4, -3])}, "positive cell counts"),
        ({}, {"box": np.array([[0.0, np.inf], [1.0, 1.0]])}, "box is not 2 x states"),
        ({"periodic": [7]}, {}, "periodic axes"),
        ({"states": ["x"]}, {}, "box is not"),
        ({"states": ["x", "x"]}, {}, "distinct names"),
        ({"rule": "best"}, {}, "no selection rule"),
        ({"statistics": None}, {}, "not a mapping"),
        ({}, {"mask": np.zeros((12, 1), np.uint8)}, "wins cells without an input"),
        ({}, {"mask": np.full((12, 1), 0b1000, np.uint8)}, "admits inputs that do not exist"),
        ({}, {"free": np.zeros(2, np.uint8)}, "wins cells that the specification forbids"),
        ({}, {"winning": np.zeros(3, np.uint8)}, "another size than its grid"),
        ({}, {"value": np.zeros(12, np.int32)}, "values and its inputs differ"),
    ],
)
def test_what_cannot_be_is_refused_even_with_a_checksum_that_fits(saved, about, changes, match):
    refused(rewritten(saved, about, **changes), match)


def test_a_swap_of_two_cells_is_refused(saved):
    arrays = parts(saved)
    arrays["mask"][[2, 11]] = arrays["mask"][[11, 2]]
    spoilt(saved, arrays)
    refused(saved, "checksum does not fit")


def test_a_file_without_checksum_or_with_missing_parts_is_refused(saved):
    arrays = parts(saved)
    np.savez(saved, **arrays)
    refused(saved, "no checksum")
    np.savez(saved, box=arrays["box"])
    refused(saved, "parts of it are missing")
    np.save(saved.with_suffix(".npy"), np.zeros(3))
    refused(saved.with_suffix(".npy"), "not a controller file")
    refused(saved.parent, "not a controller file")


def test_every_flipped_bit_is_refused_or_changes_nothing(saved):
    whole, rng = saved.read_bytes(), np.random.default_rng(14)
    want, seen = parts(saved), 0
    for bit in rng.choice(8 * len(whole), 400, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << (bit % 8)
        saved.write_bytes(damaged)
        try:
            load_controller(saved)
        except UserError:
            seen += 1
        else:
            assert all(np.array_equal(array, want[name]) for name, array in parts(saved).items())
    assert seen > 200


def test_the_domain_is_read_without_the_inputs_and_says_so(saved):
    whole, domain = reaching(), load_controller(saved, whole=False)
    for name in ("winning", "free", "value", "target"):
        assert np.array_equal(getattr(domain.solution, name), getattr(whole.solution, name)), name
    assert domain.contains([[0.9, 0.0]]).tolist() == whole.contains([[0.9, 0.0]]).tolist()
    assert domain.solution.mask.size == 0
    for asked in (lambda: domain.input([0.9, 0.0]), lambda: domain.solution.served):
        with pytest.raises(RuntimeError, match="were not read"):
            asked()


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("name", ["winning", "value", "about", "target"])
def test_a_part_of_another_controller_is_refused_whatever_is_read(saved, tmp_path, whole, name):
    other = reaching()
    other.solution.winning[2], other.solution.value[2], other.solution.target[3] = False, -1, True
    save_controller(replace(other, metadata={"seed": 1}), tmp_path / "other.npz")
    spoilt(saved, parts(saved) | {name: parts(tmp_path / "other.npz")[name]})
    with pytest.raises(UserError, match="checksum does not fit"):
        load_controller(saved, whole)


@pytest.mark.parametrize("whole", [True, False])
def test_an_array_more_or_less_than_the_checksum_has_is_refused(saved, whole):
    arrays = parts(saved)
    spoilt(saved, arrays | {"acting": np.zeros((12, 1), np.uint8)})
    with pytest.raises(UserError, match="checksum does not fit"):
        load_controller(saved, whole)
    spoilt(saved, {n: a for n, a in arrays.items() if n not in ("value", "target")})
    with pytest.raises(UserError, match="checksum does not fit"):
        load_controller(saved, whole)


def test_a_header_that_says_more_than_there_is_is_refused_before_memory_is_taken(saved):
    arrays = parts(saved)
    mask = arrays.pop("mask")
    header = {"descr": "|u1", "fortran_order": False, "shape": (10**12, 1)}
    with sealed(saved) as temporary:
        write_arrays(temporary, arrays)
        with zipfile.ZipFile(temporary, "a") as archive, archive.open("mask.npy", "w") as stream:
            np.lib.format.write_array_header_1_0(stream, header)
            stream.write(mask.tobytes())
    refused(saved, "another size than it says")


def test_what_is_no_state_gets_no_answer():
    controller = reaching()
    for wrong in ([0.1], [0.1, 0.0, 0.0], 0.1, [[[0.1, 0.0]]]):
        with pytest.raises(UserError, match=r"a state is 2 numbers \(x, v\)"):
            controller.input(wrong)
    for wrong in ([np.nan, 0.0], [0.1, np.inf]):
        with pytest.raises(UserError, match="must be finite"):
            controller.input(wrong)
        with pytest.raises(UserError, match="must be finite"):
            controller.contains([wrong])
    for wrong in (1, -1):
        with pytest.raises(UserError, match="pending input is a number from 0 to 0"):
            controller.input([0.9, 0.0], wrong)
    with pytest.raises(UserError, match=r"pending input is the number of an input, not 0\.0"):
        controller.input([0.9, 0.0], 0.0)


class Asked:
    """A case as `load_controller_of` asks for it."""

    def __init__(self, name="c", states=("a", "b"), inputs=("u",), input_set=((-1.0,), (0.0,), (1.0,))):
        self.case = SimpleNamespace(name=name, synthesis=None)
        self.states, self.inputs, self.input_set = list(states), list(inputs), np.array(input_set)
        self.own = print  # takes any record


def test_a_controller_of_another_case_is_refused_by_name(tmp_path):
    grid = Grid(Box([0.0, 0.0], [1.0, 1.0]), (2, 2))
    solution = Solution(grid, np.ones(4, bool), np.full((4, 1), 7, np.uint8), np.ones(4, bool))
    made = Controller(INPUTS, ("a", "b"), ("u",), solution, "least_effort", {"case": "c"})
    path = tmp_path / "controller.npz"
    save_controller(made, path)
    assert load_controller_of(path, Asked()).states == ("a", "b")
    for other, words in (
        (Asked(name="d"), "its case is c, that of this case d"),
        (Asked(states=("a", "v")), r"its states is \['a', 'b'\]"),
        (Asked(input_set=((-1.0,), (0.0,), (2.0,))), "'c' is of another U"),
    ):
        with pytest.raises(UserError, match=words):
            load_controller_of(path, other)


def test_nodes_that_no_table_counts_are_bounded_too(tmp_path, monkeypatch):
    """Pages leave the inputs out: the product of cells and memory alone says how much the rest takes."""
    controller = reaching(memory=3)
    save_controller(controller, tmp_path / "controller.npz")
    load_controller(tmp_path / "controller.npz", whole=False)
    asked = []
    monkeypatch.setattr(controller_content, "require_room", asked.append)
    load_controller(tmp_path / "controller.npz", whole=False)
    assert GRID.size * 3 in asked
