"""Engines' processes end with the run that started them."""

import gc
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from simgap.simulators.process import EngineCrash, engine_pool, run_in_processes

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


def children():
    """Processes that this one started and that run."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            head, _, rest = path.read_text().rpartition(")")
            if int(rest.split()[1]) == os.getpid() and rest.split()[0] != "Z":
                found.add(int(head.split()[0]))
    return found


def interrupted_after(seconds):
    with engine_pool(2) as pool:
        for _ in range(4):
            pool.submit(time.sleep, 60)
        time.sleep(seconds)
        raise KeyboardInterrupt


@pytest.mark.parametrize("seconds", [0.0, 0.3, 3.0])
def test_an_interrupt_ends_the_processes_those_that_are_being_started_too(seconds):
    """The end of the program would wait for them."""
    before = children()
    with pytest.raises(KeyboardInterrupt):
        interrupted_after(seconds)
    assert until(lambda: children() <= before, 20)


def test_results_errors_and_deaths_come_back_each_to_its_own_task(tmp_path):
    with engine_pool(2) as pool:
        good, bad = pool.submit(divmod, 7, 2), pool.submit(divmod, 7, 0)
        assert good.result() == (3, 1)
        with pytest.raises(ZeroDivisionError) as caught:
            bad.result()
        assert "serve" in caught.value.__notes__[0]
    with pytest.raises(EngineCrash, match=rf"an engine process ended: it died; its output is in {tmp_path}"):
        run_in_processes(os._exit, [(1,)], log=tmp_path / "log")


def test_what_processes_share_is_closed_with_them():
    run_in_processes(divmod, [(7, 2)])
    gc.collect()
    before = len(os.listdir("/proc/self/fd"))
    run_in_processes(divmod, [(7, 2)] * 3, workers=2)
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == before
