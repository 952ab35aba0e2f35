"""The table of `strange.py`, for its own results and for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def strange(data: Sequence[Mapping[str, Any]]) -> str:
    """Markdown, one record a row."""
    lines = ["| record | readings | verdict | named | faults | right | CPU s |", "|---" * 7 + "|"]
    for r in data:
        named = ", ".join(f"{n} on {on}" for n, on in r["answer"]) or "-"
        right = "yes" if r["right_names"] and r["right_verdict"] else "names" if r["right_names"] else "no"
        cells = (r["record"], r["rows"], r["verdict"], named, ", ".join(r["faults"]) or "-", right, f"{r['cpu_s']:.3g}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)
