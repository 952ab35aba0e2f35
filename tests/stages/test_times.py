"""Where the time of a run went."""

import subprocess
import sys

import pytest

from simgap.errors import UserError
from simgap.io.runs import cpu_seconds_in_log, job_times

HEAD = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"


def test_jobs_of_every_case_are_listed_the_costliest_first(tmp_path):
    for case, job, cpu in (("rod", "grid", "1.5"), ("rod/corrected", "synthesis-gap", "40.25"), ("cart", "fresh", "-")):
        folder = tmp_path / case / "benchmarks"
        folder.mkdir(parents=True)
        (folder / f"{job}.tsv").write_text(f"{HEAD}2.0\t0:00:02\t10.0\t-\t-\t-\t-\t-\t-\t{cpu}\n")
    found = job_times(tmp_path)
    expected = [("rod/corrected", "synthesis-gap", 40.25), ("rod", "grid", 1.5), ("cart", "fresh", 0.0)]
    assert [(j.case, j.job, j.cpu) for j in found] == expected
    assert found[0].memory == 10.0 * 2**20
    assert found[0].wall == 2.0


@pytest.mark.parametrize("text", [None, "", "a\tb\n1\t2\n", f"{HEAD}x\t\t1\t\t\t\t\t\t\t3\n"])
def test_a_folder_without_times_and_a_foreign_file_are_refused(tmp_path, text):
    (tmp_path / "benchmarks").mkdir()
    if text is not None:
        (tmp_path / "benchmarks" / "grid.tsv").write_text(text)
    with pytest.raises(UserError, match=r"has left its times|not a benchmark file"):
        job_times(tmp_path)


def test_what_a_stage_says_of_itself_counts_and_not_when_snakemake_last_looked(tmp_path):
    for folder in ("benchmarks", "logs"):
        (tmp_path / "rod" / folder).mkdir(parents=True)
    (tmp_path / "rod" / "benchmarks" / "audit.tsv").write_text(f"{HEAD}61.0\t0:01:01\t10.0\t-\t-\t-\t-\t-\t-\t30.1\n")
    (tmp_path / "rod" / "logs" / "audit.log").write_text(
        "2026-01-01 00:00:00,000 INFO found nothing\n"
        "argv[0]=\n"
        "2026-01-01 00:01:01,000 INFO spent 118.25 s of CPU time, with its processes\n"
    )
    assert [j.cpu for j in job_times(tmp_path)] == [118.25]


def test_a_stage_counts_the_cpu_time_of_its_processes(tmp_path):
    burn = "import time\nwhile time.process_time() < 0.6: pass"
    stage = (
        "import subprocess, sys\n"
        "from simgap.cli.commands import app\n"
        "from simgap.cli import main, terminal as options\n"
        "@app.command()\n"
        "def burn(log: options.Log = None) -> None:\n"
        f"    options.start_log(log); subprocess.run([sys.executable, '-c', {burn!r}], check=True)\n"
        "main(['burn', '--log', sys.argv[1]])\n"
    )
    log = tmp_path / "burn.log"
    done = subprocess.run([sys.executable, "-c", stage, str(log)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    own = cpu_seconds_in_log(log)
    assert own is not None
    assert own > 0.6
