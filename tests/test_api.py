"""What `import simgap` offers, called as a person would: in a plain script, with paths as text and points as lists."""

import inspect
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pytest

import simgap
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain
from simgap.geometry import Box
from tests.little_cart import write_cart

PLAIN = """
import simgap
print("begins")
print(simgap.check("cart.yaml").cells)
"""


def test_a_script_without_a_guard_runs_once(tmp_path):
    equations = {"dynamics": {"x": "v", "v": "F - 0.1*v"}}
    simulator = {"engine": "equations", "integrator": "rk4", "equations": equations}
    write_cart(tmp_path, simulator=simulator, gap={"basis": [1]}, grid={"eps": 0.2})
    (tmp_path / "plain.py").write_text(PLAIN)
    done = subprocess.run(
        [sys.executable, "plain.py"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("begins") == 1


def test_a_run_from_a_script_leaves_its_results(tmp_path):
    case = write_cart(tmp_path)
    assert simgap.run(str(case), cores=1, folder=tmp_path) == tmp_path / "results/cart"
    assert (tmp_path / "results/cart/check/check.json").is_file()
    with pytest.raises(simgap.UserError):
        simgap.run(tmp_path / "gone.yaml")


def test_every_path_may_be_text():
    for name in simgap.__all__:
        offered = getattr(simgap, name)
        for given, kind in typing.get_type_hints(offered).items() if inspect.isfunction(offered) else ():
            if given != "return" and Path in typing.get_args(kind):
                assert str in typing.get_args(kind), (name, given)
            assert kind is not Path or given == "return", (name, given)


def test_a_case_is_read_from_a_path_as_text(tmp_path):
    assert simgap.load_case(str(write_cart(tmp_path))).name == "cart"


ONE = (np.array([-1.0, 1.0]), np.array([-1.0, 1.0]))
DOMAIN = GapDomain(("x", "v"), ("F",), Box([-1, -1], [1, 1]), np.array([[0.0], [1.0]]))
TABLE = np.array([[[0.1, 0.2], [0.3, 0.4]]])  # of one cell: two inputs, two states
GAP = CellGap(DOMAIN, (), ONE, -TABLE, TABLE)


def test_points_are_lists_or_arrays(tmp_path):
    lo, hi = GAP.bounds([[0.5, 0.0], [0.0, 0.5]], [[0], [1]])
    np.testing.assert_allclose(hi, [[0.1, 0.2], [0.3, 0.4]], rtol=1e-12)
    np.testing.assert_allclose(lo, -hi, rtol=1e-12)
    after = simgap.load_plant(write_cart(tmp_path)).sampled.step([[0.5, 1], [0, 0.5]], [[0], [1]])
    np.testing.assert_allclose(after, [[0.51, 1.0], [0.005, 0.51]], atol=1e-4)


@pytest.mark.parametrize(
    ("x", "u", "told"),
    [
        ([[0.0]], [[0.0]], r"rows of 2 numbers \(x, v\), not an array of shape \(1, 1\)"),
        ([[0.0, 0.0]], [[0.0], [1.0]], "1 and 2 in number"),
        ([[0.0, 0.0], [0.1]], [[0.0], [1.0]], "rows of numbers, not"),
        ("here", [[0.0]], "rows of numbers, not 'here'"),
    ],
)
def test_points_that_are_none_are_told_and_not_read_beyond_their_end(tmp_path, x, u, told):
    for call in (GAP.bounds, simgap.load_plant(write_cart(tmp_path)).sampled.step):
        with pytest.raises(simgap.UserError, match=told):
            call(x, u)
