"""A disk that takes no more is one line, within seconds, and nothing is left half-written."""

import subprocess
import sys

import pytest

WRITERS = {
    "recording": """
with recording_file(path, "simgap", "full") as recording:
    plot(recording, "x", np.arange(1e5), np.random.default_rng(0).random(100_000), "#000000", 1.0)
""",
    "table": """
write_parquet(path, table({"x": np.random.default_rng(0).random(100_000)}, {}, {}, {}))
""",
    "document": """
write_json(path, {"x": list(range(100_000))})
""",
    "controller": """
with atomic(path) as temporary:
    np.savez(temporary.open("wb"), x=np.zeros(100_000))
""",
}
PROGRAM = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from simgap.cli import main
from simgap.io.atomic import atomic
from simgap.io.results import write_json
from simgap.io.results import table, write_parquet
from simgap.io.rerun.recording import plot, recording_file
from simgap.cli.commands import app
path = Path(sys.argv[1])
sys.dont_write_bytecode = True  # Python 3.11 leaves half of it where the disk is full, and believes it later
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

@app.command()
def fill():
WRITE

main(["fill"])
"""


@pytest.mark.parametrize("kind", WRITERS)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, kind):
    body = WRITERS[kind].strip().replace("\n", "\n    ")
    path = tmp_path / "out.bin"
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.replace("WRITE", f"    {body}"), str(path)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("simgap: ")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


LOGGED = """
import errno, logging, os, sys
from pathlib import Path
from simgap.cli import main
from simgap.cli.commands import app
from simgap.cli.terminal import start_log

@app.command()
def fill():
    start_log(Path(sys.argv[1]))
    logging.getLogger("simgap").info("the first line fits nowhere")
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "results/a.json")

main(["fill"])
"""


def test_a_log_on_the_full_disk_says_no_more_than_the_result(tmp_path):
    """The log of a stage stands beside its results: here it is a device that takes nothing."""
    done = subprocess.run(
        [sys.executable, "-c", LOGGED, "/dev/full"], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("simgap: results/a.json: No space left on device.")
    assert done.stderr.count("\n") == 1
