"""What is told last of a run that failed: the reason of each job, from its own log."""

from simgap.cli.workflow import reasons

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
    assert reasons([tmp_path / "run.log"], tmp_path) == [
        "the rule scp ended without a reason: results/p/logs/scp.log",
        "the rule scp ended without a reason: results/p/logs/gone.log",
        "the rule index failed",
        "p.yaml: grid.eps: too small. Take more. [check, results/p/logs/check.log]",
    ]
    assert reasons([tmp_path / "none.log"], tmp_path) == []
