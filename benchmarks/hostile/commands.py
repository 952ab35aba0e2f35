"""Command lines."""

from __future__ import annotations

import contextlib
import io
import random
from pathlib import Path

COMMANDS = (
    "check", "grid", "rollouts", "fresh", "borders", "scp", "lipschitz", "gap", "synthesis", "twin",
    "validation", "audit", "replay", "trace", "report", "index", "rig", "effects", "times", "export", "certify",
    "new", "tutorial", "run", "diagnose", "sweep", "point", "sweep-page", "paper", "nothing",
)  # fmt: skip
OPTIONS = (
    "--out", "--log", "--point", "--grid", "--shard", "--rollouts", "--gap", "--controller",
    "--workers", "--samples", "--fresh", "--urdf", "--equations", "--traces", "--nominal", "--gap-aware", "--summary",
    "--cores", "--help", "-x", "--", "--version", "--times", "--witness", "--margins", "--scp", "--lipschitz",
)  # fmt: skip
VALUES = (
    "broken.yaml", "none.yaml", ".", "a.json", "whole.npz", "run.csv", "b.parquet", "out", "out/x.json", "-1", "0",
    "1", "eps~0.1", "x", "nan", "", "\x1b[2J", "a" * 5000, "/dev/full", "/dev/null", "/proc/x", "../../x",
    "no.urdf", "hidden-state", "\udce9", "9" * 30, "cases", "model.urdf",
)  # fmt: skip


def read_command(rng: random.Random, folder: Path) -> None:
    """A command line: an exit status of 0, 1 or 2 and no traceback."""
    from simgap.cli import main

    words = [rng.choice(COMMANDS)]
    if rng.random() < 0.8:
        words.append(rng.choice(VALUES))
    for _ in range(rng.choice((0, 1, 2, 3, 5))):
        words += [rng.choice(OPTIONS)] + [rng.choice(VALUES)] * (rng.random() < 0.9)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            main(words)
        except SystemExit as ended:
            if ended.code not in (0, 1, 2, None):
                raise AssertionError(f"{words}: status {ended.code}") from None
    if "Traceback" in said.getvalue():
        raise AssertionError(f"{words}: a traceback: {said.getvalue()[-300:]}")
