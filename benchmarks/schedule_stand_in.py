"""What stands in for a stage in `schedule.py`; it starts fast because it imports nothing of simgap."""

from __future__ import annotations

import itertools
import json
import time
from pathlib import Path

THEN = 2
"""Workers of the stages that take `--workers`, when their times were measured."""
FILES = {
    "grid": ("states.parquet", "inputs.parquet"),
    "diagnose": ("diagnosis.json", "corrected_case.yaml", "report.html", "residual.rrd", "transitions.parquet"),
}
OUTPUTS = ("--out", "--summary", "--samples", "--traces", "--margins", "--picture", "--figures")


def stand_in(plan: str, words: list[str]) -> None:
    """Sleep as long as the job that writes this log took, then leave what is not there yet."""
    known = json.loads(Path(plan).read_text())
    named = {flag: value for flag, value in itertools.pairwise(words) if flag.startswith("--")}
    log = Path(named["--log"])
    case = str(log.parents[1].relative_to("results"))
    seconds = known["jobs"].get(f"{case}/{log.stem}", 0.0)
    if "--workers" in named and words[0] != "synthesis":
        seconds *= THEN / int(named["--workers"])
    time.sleep(seconds * known["scale"])
    out = Path(named["--out"])
    for name in FILES.get(words[0], ()):
        made = Path(known["results"]) / case / ("diagnosis" if words[0] == "diagnose" else "") / name
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(made.read_bytes() if name == "corrected_case.yaml" else b"")
    for flag in OUTPUTS if words[0] not in FILES else ():
        path = Path(named[flag]) if flag in named else None
        if path is not None and flag == "--figures":
            path.mkdir(parents=True, exist_ok=True)
        elif path is not None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("")
