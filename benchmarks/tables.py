"""The tables of the documentation, from what the benchmarks wrote.

    python benchmarks/tables.py

Rewrites the text between `<!-- table NAME -->` and `<!-- end -->` in docs/*.md; without results a table stays as it is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
HIDDEN = ("ks_p", "refused", "log-likelihood lost by scipy")


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def tightness(data: Mapping[str, Any]) -> str:
    """Objective, sides and padding against suprema, means and winning fractions."""
    blocks = []
    for inertia, rows in data.items():
        if not isinstance(rows, Mapping):
            continue
        table = []
        for name, r in rows.items():
            cells = [f"{r[s]['sup']:.3g} ({r[s]['ratio']:.3f}), {r[s]['mean']:.3g}" for s in ("x1", "x2")]
            won = f"{r['winning']:.3f}" if r["winning"] is not None else "-"
            table.append([name, *cells, won, str(r["violations"])])
        head = ["objective, sides, padding", "x1: sup (over largest sample), mean", "x2: same", "winning", "outside"]
        blocks.append(f"{inertia.capitalize()}:\n\n{markdown(head, table)}")
    return "\n\n".join(blocks)


def lipschitz(data: Mapping[str, Any]) -> str:
    """Estimators against known constants."""
    names = [n for n in next(iter(data["table"].values())) if n not in HIDDEN]
    rows = []
    for function, found in data["table"].items():
        cells = [cell(found.get(n, {})) for n in names]
        rows.append([function, *cells, f"{found['ks_p']['passes']:.2f}", f"{found['refused']['median']:.0f}"])
    return markdown(["function", *names, "KS passes", "grid refused"], rows)


def cell(found: Mapping[str, float]) -> str:
    """Median, and coverage where the true constant is finite."""
    if "median" not in found:
        return "-"
    return f"{found['median']:.3g}" + (f" ({found['coverage']:.2f})" if "coverage" in found else " (no true constant)")


def rollouts(data: Mapping[str, Any]) -> str:
    """Speed of roll-outs against the bare loop."""
    row = [f"{data['rate_per_core_1/s']:,}", f"{data['bare_rate_per_core_1/s']:,}", f"{data['ratio']:.2f}"]
    return markdown(["roll-outs per second and core", "bare PyBullet loop", "ratio"], [row])


def suprema(_: Mapping[str, Any]) -> str:
    """Sup of gamma for every eps of a plain run of the pendulum."""
    rows = []
    paths = (ROOT / "results" / "pendulum" / "gap").glob("eps~*/gap.json")
    for gap in sorted((json.loads(p.read_text()) for p in paths), key=lambda g: -g["eps"]):
        found = [f"{d['sup_size']:.6f}, {d['sup_width']:.2g}" for d in gap["dimensions"]]
        rows.append([f"{gap['eps']:g}", f"{gap['samples']:,}", *found, f"{gap['fresh']['violations']}"])
    head = ["eps", "roll-outs", "x1: sup size, sup width (rad)", "x2: the same (rad/s)", "outside, of 300,000 fresh"]
    return markdown(head, rows)


def undeclared(data: Mapping[str, Any]) -> str:
    """Hidden effects and what was answered."""
    figures = data.get("figures", data)
    shown = (
        "records",
        "exact",
        "listed",
        "one right",
        "two right",
        "attributed",
        "error median",
        "intervals that cover",
    )
    shown = (*shown, "held-out over floor, median")

    def text(value: Any) -> str:
        return "" if value is None else str(value) if isinstance(value, int) else f"{value:.3g}"

    return markdown(["study", *shown], [[n, *(text(f[k]) for k in shown)] for n, f in figures.items()])


TABLES: Mapping[str, tuple[str, Callable[[Mapping[str, Any]], str]]] = {
    "tightness": ("tightness_pendulum.json", tightness),
    "lipschitz": ("lipschitz.json", lipschitz),
    "undeclared": ("undeclared.json", undeclared),
    "rollouts": ("rollouts.json", rollouts),
    "suprema": ("../../results/pendulum/summary.json", suprema),
}


def main() -> None:
    """Rewrite every table whose results are there."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text()
        for name, (file, make) in TABLES.items():
            if (RESULTS / file).is_file():
                table = make(json.loads((RESULTS / file).read_text()))
                pattern = rf"(<!-- table {name} -->\n).*?(\n<!-- end -->)"
                text = re.sub(pattern, lambda m, t=table: m[1] + t + m[2], text, flags=re.S)
        page.write_text(text)
        print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()
