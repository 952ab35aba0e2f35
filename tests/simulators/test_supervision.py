"""Engines of others that misbehave: each fault is named with its call, bounded in time, and the run fails cleanly."""

import time

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.errors import SimgapError
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from tests.little_cart import write_cart

ENGINE = """
import ctypes, os, time
import numpy as np
from simgap.simulators.base import Engine
from simgap.config.simulator import EngineSection

class Mine(Engine):
    Settings = EngineSection
    nx, nu, engine = 2, 1, "mine"
    count = 0

    @classmethod
    def build(cls, case, folder):
        return cls()

    def reset(self, x):
        self.x = np.array(x)

    def advance(self, u):
        Mine.count += 1
        x = self.x
        print("chatter " * 100)
        if x[0] < 0:
            FAULT
        self.x = np.array([x[0] + 0.01 * x[1], x[1] + 0.01 * u[0]])
        return self.x
"""
X, U = np.array([[0.1, 0.2], [-0.3, 0.4], [0.9, -0.9], [0.5, 0.0]]), np.array([[1.0], [0.0], [-1.0], [1.0]])
AT = "x = -0.3, v = 0.4, F = 0"


def rolled(folder, fault, timeout=1.0):
    (folder / "mine.py").write_text(ENGINE.replace("FAULT", fault))
    path = write_cart(folder, simulator={"engine": "mine.py:Mine", "timeout": timeout})
    job = (load_case(path), folder, X, U)
    return run_in_processes(roll_out, [job], log=folder / "engine.log")[0]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("os._exit(0)", f"it died at {AT}"),
        ("ctypes.string_at(0)", f"it died at {AT}"),
        ("time.sleep(600)", f"it takes longer than 1 s, at {AT}"),
        ("ctypes.PyDLL(None).sleep(600)", f"it takes longer than 1 s, at {AT}"),  # C code that holds the interpreter
        ("return x * np.nan", f"'mine.py:Mine' gives x = nan, v = nan, at {AT}"),
        ("return x[:1]", f"gives an array (1,) instead of (2,), at {AT}"),
        ("return x + Mine.count", "the simulator gives two results for the same call, at x = -0."),
    ],
)
def test_a_fault_of_an_engine_is_named_with_its_call_and_bounded_in_time(tmp_path, fault, said):
    began = time.monotonic()
    with pytest.raises(SimgapError) as caught:
        rolled(tmp_path, fault)
    assert said in str(caught.value), str(caught.value)
    assert time.monotonic() - began < 60


def test_an_engine_that_behaves_is_left_as_it_is_and_its_chatter_goes_to_the_log(tmp_path, capfd):
    following, name = rolled(tmp_path, "pass")
    assert name == "mine"
    assert np.array_equal(following, np.stack([X[:, 0] + 0.01 * X[:, 1], X[:, 1] + 0.01 * U[:, 0]], axis=1))
    assert "chatter" in (tmp_path / "engine.log").read_text()
    assert "chatter" not in capfd.readouterr().out


def test_an_engine_that_grows_too_large_is_ended_and_told(tmp_path):
    grown = "import simgap.simulators.supervision as w; w.LARGEST = 1; time.sleep(30)"
    with pytest.raises(SimgapError, match=r"its memory grew beyond the limit of a stage, at x = -0.3"):
        rolled(tmp_path, grown, timeout=30.0)
