"""Where the time of a run went."""

import pytest

from simgap.errors import UserError
from simgap.stages.times import job_times

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
