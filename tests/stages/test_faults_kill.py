"""A stage killed within a write is taken up by the same command, to the same bytes; more in benchmarks/kill.py."""

import os
import signal
import subprocess
import sys

import pytest

from tests.little_cart import write_cart

MORE = {"grid": {"eps": 0.5}, "gap": {"basis": ["x", "v", "F", 1]}}


def grid(folder, **environment):
    command = [sys.executable, "-m", "simgap.cli", "grid", "cart.yaml", "--out", "grid", "--log", "grid.log"]
    env = os.environ | environment
    return subprocess.run(command, cwd=folder, env=env, start_new_session=True, check=False).returncode


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    write_cart(folder, **MORE)
    assert grid(folder) == 0
    return {path.name: path.read_bytes() for path in (folder / "grid").iterdir()}


@pytest.mark.parametrize("place", [2, 5])  # half of the first file, half of the second
def test_a_stage_killed_within_a_write_is_taken_up_by_the_same_command(tmp_path, whole, place):
    write_cart(tmp_path, **MORE)
    assert grid(tmp_path, SIMGAP_KILL_AT=str(place)) == -signal.SIGKILL
    left = {path.name for path in (tmp_path / "grid").iterdir()}
    assert len(left) == (place + 1) // 3  # what was finished, and a hidden half
    assert any(name.startswith(".") for name in left)
    assert grid(tmp_path) == 0
    assert {path.name: path.read_bytes() for path in (tmp_path / "grid").iterdir()} == whole
