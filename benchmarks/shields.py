"""Policies alone and through a shield, in the simulators of two cases whose results are there.

    python benchmarks/shields.py [RESULTS]

Writes the table `shields` of the documentation: `simgap shield` for each case and policy, 100 runs.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tables import RESULTS, ROOT

from simgap.extras import shield

RUNS = 100
POLICIES = {
    "pendulum": {"random": "random", "largest torque": "largest", "toward the nearer border": "toward_the_border"},
    "turtlebot": {"random": "random", "straight at the target": "at_the_target"},
}


def main(results: Path) -> None:
    """Run, print and write after each policy."""
    rows = []
    for case, policies in POLICIES.items():
        made = results / case
        files = made / "synthesis/gap/controller.npz", next((made / "gap").glob("*/gap.json"))
        for words, name in policies.items():
            named = name if name == "random" else f"{ROOT}/benchmarks/shield_policies.py:{name}"
            found = shield.run(ROOT / f"configs/cases/{case}.yaml", named, RUNS, *files)
            rows.append(found | {"policy": words})
            print(json.dumps(rows[-1]), flush=True)
            (RESULTS / "shields.json").write_text(json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("results"))
