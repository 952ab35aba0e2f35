"""What the shipped tasks cost and what their runs did, from the results of `snakemake --cores 2 tasks` with `--full`.

simgap run CASE --cores 2 --full          for each of the cases below
python benchmarks/tasks.py                                   -> benchmarks/results/tasks.json
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path
from typing import Any

from simgap.config.load import load_case

ROOT = Path(__file__).parents[1]
CASES = ("courier", "swing_up", "pick_and_place", "to_and_fro")


def row(case: str, results: Path) -> dict[str, Any]:
    """Figures of one case."""
    own = load_case(ROOT / "configs/cases" / f"{case}.yaml")
    assert own.synthesis is not None
    made = json.loads((results / "synthesis/gap/synthesis.json").read_text())
    cost = next(csv.DictReader((results / "benchmarks/synthesis-gap.tsv").open(), delimiter="\t"))
    evidence = results / "full" if (results / "full").is_dir() else results
    runs = json.loads((evidence / "validation/validation.json").read_text())["controllers"]
    attack = json.loads((evidence / "audit/audit.json").read_text())
    classes = math.prod(own.hidden_state.classes.values()) if own.hidden_state is not None else 1
    gap, nominal = runs["gap"]["simulator"], runs["nominal"]["simulator"]
    return {
        "formula": own.synthesis.specification.formula,
        "cells": made["cells"],
        "inputs": made["inputs"],
        "classes": classes,
        "states": made["statistics"]["states"],
        "wins": made["winning_fraction"],
        "steps": made["statistics"]["steps"],
        "tau": own.domain.tau if own.domain is not None else None,
        "cpu_s": float(cost["cpu_time"]),
        "mib": float(cost["max_rss"]),
        "runs": gap["runs"],
        "violations": gap["runs_that_violated_it"],
        "outside_gamma": gap["steps_outside_gamma"],
        "rounds": [min(gap["rounds"]), max(gap["rounds"])] if gap.get("rounds") else None,
        "nominal_runs": nominal["runs"],
        "nominal_failed": nominal["runs_that_violated_it"],
        "attacked_steps": attack["evaluations"] + sum(own["steps"] for own in attack["closed_loop"].values()),
        "attack_violations": attack["violations"],
    }


def main() -> None:
    """Read what there is below `results` (or the folder given) and write the file."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "results"
    found = {case: row(case, folder / case) for case in CASES if (folder / case / "audit").is_dir()}
    out = ROOT / "benchmarks/results/tasks.json"
    kept = json.loads(out.read_text()) if out.exists() else {}
    out.write_text(json.dumps(kept | found, indent=1) + "\n")


if __name__ == "__main__":
    main()
