"""A case in a folder of its own, from states and inputs to the bound of its gap, and what the documentation shows."""

import re
from pathlib import Path

import pytest
import yaml

from simgap.cli import main
from simgap.gap.bounds.load import from_json
from simgap.io.results import read_json

ROOT = Path(__file__).parents[2]


def block(page, heading, language):
    """The first block of a language below a heading of a page."""
    text = (ROOT / page).read_text()
    below = text[text.index(f"\n## {heading}\n") :]
    return re.search(rf"```{language}\n(.*?)```", below, flags=re.S).group(1)


def scratch(folder, case, files):
    """Write a case and the files beside it: -> the path of the case."""
    for name, content in files.items():
        (folder / name).write_text(content)
    path = folder / f"{case['name']}.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    return path


def simgap(command, case, *words):
    """One call of the command line that must succeed, with a log beside the case."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in (command, case, *words, "--log", case.parent / f"{command}.log")])
    assert ended.value.code == 0


def gap_of(case):
    """The stages from the grid to the gap, one shard: -> the gap function; files stand beside the case."""
    out = case.parent
    grid, shard, fresh = out / "grid", out / "shard.parquet", out / "fresh.parquet"
    rolled = ("--grid", grid, "--rollouts", shard)
    simgap("grid", case, "--out", grid)
    simgap("rollouts", case, "--grid", grid, "--shard", 0, "--out", shard)
    simgap("fresh", case, "--out", fresh, "--workers", 1)
    parts, borders = [], ("--borders", out / "borders.parquet")
    simgap("borders", case, "--out", borders[1])
    for stage in ("scp", "lipschitz"):
        made = out / f"{stage}.json"
        simgap(stage, case, *rolled, *(borders if stage == "scp" else ()), "--out", made)
        parts += [f"--{stage}", made]
    result = out / "gap.json"
    simgap(
        "gap", case, *rolled, *parts, *borders, "--fresh", fresh, "--out", result, "--samples", out / "samples.parquet"
    )
    return from_json(read_json(result))
