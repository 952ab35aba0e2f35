"""What a person is told of a run without a controller: the reason of each job that failed, and a page."""

from simgap.cli.workflow import failures, write_failed, write_page
from simgap.io.pages import NO_CONTROLLER
from simgap.io.results import write_json

RUN = """Error in rule check:
    message: None
    jobid: 1
    output: results/p/check/check.json
    log: results/p/logs/check.log (check log file(s) for error details)
    shell:
        simgap check p.yaml
Error in rule scp:
    jobid: 2
    log: results/p/logs/scp.log (check log file(s) for error details)
Error in rule scp:
    jobid: 3
    log: results/p/logs/gone.log (check log file(s) for error details)
Error in rule index:
    jobid: 4
"""


def test_the_last_error_of_each_log_is_told_with_its_place(tmp_path):
    logs = tmp_path / "results/p/logs"
    logs.mkdir(parents=True)
    (tmp_path / "run.log").write_text(RUN)
    stamp = "2026-01-01 10:00:00,000"
    (logs / "check.log").write_text(
        f"{stamp} INFO fine\n{stamp} ERROR p.yaml: grid.eps: too small. Take more.\n{stamp} INFO spent 1 s\n"
    )
    (logs / "scp.log").write_text(f"{stamp} INFO fine\nKilled\n")
    assert [str(f) for f in failures([tmp_path / "run.log"], tmp_path)] == [
        "the rule scp ended without a reason: results/p/logs/scp.log",
        "the rule scp ended without a reason: results/p/logs/gone.log",
        "the rule index failed",
        "p.yaml: grid.eps: too small. Take more. [check, results/p/logs/check.log]",
    ]
    assert failures([tmp_path / "none.log"], tmp_path) == []
    assert write_failed(failures([tmp_path / "run.log"], tmp_path), {}, tmp_path) == []  # `check` has refused the case


def ended(folder, rule, log, told):
    """The page of a run in which this job failed, whose folder holds a bound and what is left of an empty domain."""
    gap = {"dimensions": [{"state": "angle", "largest_sampled_gap": 0.0123, "sup_size": 0.0456, "mean_size": 0.01}]}
    axis = dict.fromkeys(("cell", "step", "moves", "gamma", "gamma_width", "spans", "spans_nominal", "leaves"), 0.5)
    found = {"sentence": "The gap moves angle by more than a cell.", "tries": [], "axes": [{"state": "angle", **axis}]}
    for path, content in (
        ("gap/0.1/gap.json", gap),
        ("synthesis/gap/empty.json", {"model": "with gap", "empty": found}),
    ):
        (folder / "results/p" / path).parent.mkdir(parents=True, exist_ok=True)
        write_json(folder / "results/p" / path, content)
    (folder / "results/p/logs").mkdir(exist_ok=True)
    (folder / "results/p/logs" / log).write_text(f"2026-01-01 10:00:00,000 ERROR {told}\n")
    (folder / "run.log").write_text(
        f"Error in rule {rule}:\n    jobid: 1\n    log: results/p/logs/{log} (check log file(s))\n"
    )
    (page,) = write_failed(failures([folder / "run.log"], folder), {"results/p": "Drives are weak."}, folder)
    assert page.name == NO_CONTROLLER
    return (folder / page).read_text()


def test_whatever_job_fails_a_page_says_why(tmp_path):
    empty = ended(tmp_path, "synthesis", "synthesis-gap.log", "p.yaml: synthesis: nothing wins: too wide.")
    assert "nothing wins: too wide." in empty
    assert "The gap moves angle by more than a cell." in empty
    assert "0.0456" in empty
    early = ended(tmp_path, "scp", "scp-angle.log", "p.yaml: gap.basis: the program is not solved. Take fewer terms.")
    assert "the program is not solved. Take fewer terms." in early
    assert "0.0456" not in early  # of an earlier run
    assert "Drives are weak." in early
    assert "<h1>p: no controller</h1>" in early
    late = ended(tmp_path, "audit", "audit.log", "the engine ended.")
    assert "<h1>p: run not complete</h1>" in late  # the controllers are there
    assert "moves angle by more" not in late


def test_a_case_that_asks_for_no_controller_has_the_page_too(tmp_path):
    page = write_page(tmp_path / "results/p", ["The joints <hardly> move."], bounded=True).read_text()
    assert "The joints &lt;hardly&gt; move." in page
    assert "<h1>p: no controller</h1>" in page


def test_of_the_two_pages_the_last_run_has_left_one(tmp_path):
    results = tmp_path / "results/p"
    results.mkdir(parents=True)
    for earlier in ("report.html", "summary.json"):
        (results / earlier).write_text("of an earlier run")
    write_page(results, ["The joints hardly move."], bounded=True)
    assert [path.name for path in results.iterdir()] == [NO_CONTROLLER]


def test_a_recording_for_rerun_that_fails_takes_no_page_away(tmp_path):
    results = tmp_path / "results/p"
    (results / "logs").mkdir(parents=True)
    (results / "report.html").write_text("of this run")
    (tmp_path / "run.log").write_text("Error in rule trace:\n    jobid: 1\n    log: results/p/logs/trace.log (check)\n")
    assert write_failed(failures([tmp_path / "run.log"], tmp_path), {}, tmp_path) == []
    assert (results / "report.html").is_file()
