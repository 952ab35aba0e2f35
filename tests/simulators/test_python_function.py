"""A person's function as the simulator: its results, and each way to go wrong named and bounded in time."""

import time

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.named_files import FunctionFile, plugin_copies
from simgap.errors import SimgapError, UserError
from simgap.provenance import sections_digest
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import make_simulator, roll_out
from tests.little_cart import write_cart

GOOD = """
import numpy as np

def step(x, u, tau, friction=0.0):
    return np.array([x[0] + tau * x[1], x[1] + tau * (u[0] - friction * x[1])])

def many(x, u, tau, friction=0.0):
    assert x.ndim == 2 and len(x) == len(u)
    return np.stack([x[:, 0] + tau * x[:, 1], x[:, 1] + tau * (u[:, 0] - friction * x[:, 1])], axis=1)
"""


def written(folder, source, **keys):
    (folder / "my_sim.py").write_text(source)
    return write_cart(folder, simulator={"engine": "python", "function": "my_sim.py:step"} | keys)


def rolled(path, x, u):
    return run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])[0][0]


X, U = np.array([[0.1, 0.2], [-0.3, 0.4], [0.9, -0.9]]), np.array([[1.0], [0.0], [-1.0]])


@pytest.mark.parametrize("keys", [{}, {"function": "my_sim.py:many", "batch": True}])
def test_its_steps_are_those_of_the_function_substeps_included(tmp_path, keys):
    path = written(tmp_path, GOOD, parameters={"friction": 0.3}, substeps=2, **keys)
    expected, h = X.copy(), 0.005
    for _ in range(2):
        q, v = expected.T
        expected = np.stack([q + h * v, v + h * (U[:, 0] - 0.3 * v)], axis=1)
    assert np.abs(rolled(path, X, U) - expected).max() < 1e-15


BROKEN = {
    "fails": ("def step(x, u, tau):\n    if x[0] < 0:\n        raise RuntimeError('no contact')\n    return x",
              ["fails: RuntimeError: no contact (line 3)", "x = -0.3, v = 0.4, F = 0"]),
    "ends its process": ("import os\ndef step(x, u, tau):\n    x[0] < 0 and os.abort()\n    return x",
                         ["it died at", "x = -0.3, v = 0.4"]),
    "hangs": ("def step(x, u, tau):\n    while x[0] < 0:\n        pass\n    return x",
              ["it takes longer than 1 s", "x = -0.3, v = 0.4"]),
    "nan": ("def step(x, u, tau):\n    return x / (x[0] >= 0)", ["gives x = -inf, v = inf", "x = -0.3, v = 0.4"]),
    "shape": ("def step(x, u, tau):\n    return x[:1]", ["gives an array (1,) instead of (2,)"]),
    "words": ("def step(x, u, tau):\n    return 'a'", ["gives 'a', which is not an array of numbers"]),
    "memory": ("n = [0]\ndef step(x, u, tau):\n    n[0] += 1\n    return x + n[0]",
               ["gives two results for the same call"]),
    "relay": ("on = [0]\ndef step(x, u, tau):\n    on[0] = 1 if x[0] > 0.5 else 0 if x[0] < -0.5 else on[0]\n"
              "    return x + tau * on[0]", ["gives two results for the same call", "plant.states", "hidden_state"]),
    "input before": ("before = [0.0]\ndef step(x, u, tau):\n    x = x + tau * before[0]\n    before[0] = u[0]\n"
                     "    return x",
                     ["gives two results for the same call"]),
    "clock": ("import math, time\ndef step(x, u, tau):\n    return x + math.floor(30 * time.monotonic())",
              ["reads a clock"]),
}  # fmt: skip


@pytest.mark.parametrize("fault", BROKEN)
def test_what_goes_wrong_is_named_with_its_call(tmp_path, fault):
    source, said = BROKEN[fault]
    began = time.monotonic()
    with pytest.raises(SimgapError) as caught:
        rolled(written(tmp_path, source, timeout=1), X, U)
    assert all(words in str(caught.value) for words in said), str(caught.value)
    assert time.monotonic() - began < 30


@pytest.mark.parametrize(
    ("function", "said"),
    [("my_sim.py:other", "no function 'other'"), ("../my_sim.py:step", "outside"), ("none.py:step", "does not exist"),
     ("step", "does not name a function")],
)  # fmt: skip
def test_a_function_that_is_not_there_is_told_when_the_case_is_read(tmp_path, function, said):
    with pytest.raises(UserError, match=said):
        load_case(written(tmp_path, GOOD, function=function))


def test_nothing_runs_while_a_case_is_read_and_it_is_told_that_it_is_code(tmp_path, caplog):
    path = written(tmp_path, f"open({str(tmp_path / 'ran')!r}, 'w')\n" + GOOD)
    load_case(path)
    assert not (tmp_path / "ran").exists()
    assert f"{tmp_path / 'my_sim.py'} is code and runs with your permissions" in caplog.text


@pytest.mark.parametrize(
    ("head", "named"),
    [
        ("import beside", "beside.py"),
        ("from lib.beside import A", "lib/beside.py"),  # no __init__.py
        ("import lib.one\nimport other.one", "lib/one/__init__.py"),
        ("import lib.one\nimport other.one", "other/one/__init__.py"),
        ("import lib.inner", "beside.py"),  # by lib/inner.py
        ("TABLE = open(__file__[:-9] + 'table.csv')", "table.csv"),
        ("TABLE = __file__[:-9] + 'data/table.csv'", "data/table.csv"),
    ],
)  # fmt: skip
def test_an_edit_of_the_file_or_of_what_it_needs_beside_it_makes_results_again(tmp_path, head, named):
    for name in ("lib/one/__init__.py", "other/one/__init__.py", "table.csv", "data/table.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "lib/inner.py").write_text("import beside\n")
    (tmp_path / named).write_text("A = 1\n")
    path = written(tmp_path, f"{head}\n{GOOD}")

    def digest():
        return sections_digest(load_case(path), ("simulator",), tmp_path)

    seen = [digest()]
    (tmp_path / named).write_text("A = 2\n")
    seen.append(digest())
    (tmp_path / "unused.py").write_text("A = 3\n")
    assert digest() == seen[-1]
    written(tmp_path, f"{head}\n{GOOD}# an edit\n")
    seen.append(digest())
    assert len(set(seen)) == 3


def test_a_text_that_names_no_file_of_the_folder_is_no_neighbour(tmp_path):
    (tmp_path / "link").symlink_to("link")
    texts = ["/dev/null", "../" * 30 + "etc/hostname", "a" * 300, "x" * 250 + "/y", "", ".", "\0"]
    written(tmp_path, f"NAMED = {texts!r}\n{GOOD}")
    assert FunctionFile.find("my_sim.py:step", tmp_path).neighbours == ()


def test_a_corrected_case_takes_the_file_along(tmp_path):
    (copy,) = plugin_copies(load_case(written(tmp_path, GOOD)), tmp_path, tmp_path / "elsewhere")
    assert copy.section == ("simulator",)
    assert copy.key == "function"
    assert copy.named == f"{copy.file}:step"
    assert copy.content == GOOD.encode()


def test_a_function_that_begins_to_drift_later_is_refused_when_it_does(tmp_path):
    drifts = "n = [0]\ndef step(x, u, tau):\n    n[0] += 1\n    return x + max(0, n[0] - 2000)"
    path = written(tmp_path, drifts)
    simulator = make_simulator(load_case(path), path.parent)
    rng = np.random.default_rng(3)
    x, u = rng.uniform(-1, 1, (900, 2)), np.zeros((900, 1))
    try:
        assert np.array_equal(simulator.rollouts(x, u), x)
        simulator.rollouts(x, u)
        with pytest.raises(UserError, match="two results"):
            simulator.rollouts(x, u)
    finally:
        simulator.close()
