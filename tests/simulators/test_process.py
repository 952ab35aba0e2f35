"""Engines' processes end with the run that started them."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simgap.simulators.process import engine_pool

PARENT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from simgap.simulators.process import engine_pool
from tests.simulators.test_process import wait_for_long
if __name__ == "__main__":
    with engine_pool(2) as pool:
        for k in range(2):
            pool.submit(wait_for_long, Path(sys.argv[1]), k)
"""


def wait_for_long(folder, k):
    (folder / f"{k}.half").write_text(str(os.getpid()))
    (folder / f"{k}.half").rename(folder / f"{k}.pid")
    time.sleep(300)


def runs(pid):
    """Whether a process runs; one that is dead and not yet collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(holds, seconds):
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.1)
    return holds()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_killed_run_leaves_no_engine_behind(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    run = subprocess.Popen([sys.executable, str(script), str(tmp_path), str(Path(__file__).parent)])
    try:
        assert until(lambda: len([*tmp_path.glob("*.pid")]) == 2, 240)
        engines = [int(path.read_text()) for path in tmp_path.glob("*.pid")]
        assert all(runs(pid) for pid in engines)
    finally:
        run.send_signal(signal.SIGKILL)
        run.wait()
    gone = until(lambda: not any(runs(pid) for pid in engines), 30)
    for pid in engines:
        if runs(pid):
            os.kill(pid, signal.SIGKILL)
    assert gone


def named_memory(pid):
    """Files below /dev/shm that a process maps, and that still have a name."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {path for line in lines if (path := line[73:]).startswith("/dev/shm/") and not path.endswith(" (deleted)")}


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
def test_a_killed_group_leaves_no_semaphore_or_memory_with_a_name(tmp_path):
    """As a batch system kills: the run, its engines and what would have tidied up after them, all at once."""
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    command = [sys.executable, str(script), str(tmp_path), str(Path(__file__).parent)]
    run = subprocess.Popen(command, start_new_session=True)
    try:
        assert until(lambda: len([*tmp_path.glob("*.pid")]) == 2, 240)
        engines = [int(path.read_text()) for path in tmp_path.glob("*.pid")]
        shared = named_memory(run.pid).union(*map(named_memory, engines))
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    assert until(lambda: not any(runs(pid) for pid in engines), 30)
    left = {path for path in shared if Path(path).exists()}
    for path in left:
        os.unlink(path)
    assert left == set()


def interrupted_while_starting(started):
    """Ctrl-C while a worker is being started: the pool has not noted it yet."""
    before = set(multiprocessing.active_children())
    with engine_pool(2) as pool:
        for _ in range(2):
            pool.submit(time.sleep, 60)
        started |= set(multiprocessing.active_children()) - before
        del pool._processes[max(child.pid for child in started)]
        raise KeyboardInterrupt


def test_an_interrupt_ends_a_worker_that_the_pool_does_not_know_yet():
    """The end of the program would wait for it."""
    started = set()
    with pytest.raises(KeyboardInterrupt):
        interrupted_while_starting(started)
    assert len(started) == 2
    assert until(lambda: not any(child.is_alive() for child in started), 20)
