"""Readers under a fuzzer that follows which lines its inputs reach (atheris, of LLVM's libFuzzer).

    uv run --with atheris python benchmarks/fuzz_guided.py [--runs 10000] [--only WORD] [--folder DIR]

Each reader runs in a process of its own on so many inputs, which begin from whole files and are changed by what
reached new lines of it. A finding is an exception that is no SimgapError, an input over 10 s, or more than 4 GiB. The
counts by kind of fuzz.py come from random changes and grammars, without such a guide; these come on top of them.
Results: benchmarks/results/fuzz_guided.json.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from hostile.cases import ROOT
from hostile.recordings import CSV

RESULT = ROOT / "benchmarks/results/fuzz_guided.json"
FOLLOWED = ["simgap.config.load", "simgap.config.load", "simgap.model.expressions", "simgap.model.tree",
            "simgap.plants.urdf_checks", "simgap.io.results", "simgap.io.recordings.text_file",
            "simgap.io.recordings.tables", "simgap.units"]  # fmt: skip
"""Modules whose lines are followed: pure Python, for compiled kernels cannot be."""
EXPRESSIONS = (b"-m*g*l*sin(x)/I - b*y", b"max(1, x^2) + min(y, 3)", b"atan(x/(1 + abs(y)))")


def whole() -> dict[str, list[bytes]]:
    """Inputs to begin with, by reader."""
    cases = [path.read_bytes() for path in sorted((ROOT / "configs/cases").glob("*.yaml"))]
    return {
        "case files": [case for case in cases if len(case) < 3000],
        "expressions": [*EXPRESSIONS],
        "URDFs": [(ROOT / "configs/models/pendulum.urdf").read_bytes()],
        "CSV recordings": [CSV.encode()],
        "JSON results": [b'{"kind": "linear", "eps": 0.0056, "checksum": "sha256:00"}'],
    }


def readers(folder: Path) -> Mapping[str, Callable[[bytes], object]]:
    """What reads the bytes of an input."""
    from simgap.config.load import load_case
    from simgap.io.recordings.tables import read_recording
    from simgap.io.results import read_json
    from simgap.model.expressions import parse
    from simgap.plants.urdf_checks import check_urdf

    def at(name: str, data: bytes) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return {
        "case files": lambda data: load_case(at("case.yaml", data)),
        "expressions": lambda data: parse(data.decode(errors="replace"), ["x", "y", "m", "g", "l", "I", "b"]),
        "URDFs": lambda data: check_urdf(at("model.urdf", data)),
        "CSV recordings": lambda data: read_recording(at("run.csv", data), ["q", "v"], "t", "trace"),
        "JSON results": lambda data: read_json(at("a.json", data)),
    }


def follow(kind: str, folder: Path, arguments: list[str]) -> None:
    """The process of one reader; libFuzzer ends it."""
    import atheris

    with atheris.instrument_imports(include=FOLLOWED):
        read = readers(folder)[kind]
    from simgap.errors import SimgapError

    def one(data: bytes) -> None:
        told = ""
        try:
            read(data)
        except SimgapError as error:
            told = str(error).replace(str(folder), "")
        if told and not told.isprintable():
            raise AssertionError(f"a message with characters that cannot be printed: {told!r}")

    atheris.Setup([sys.argv[0], *arguments], one)
    atheris.Fuzz()


def main() -> None:
    """Run every reader, count, keep."""
    if sys.argv[1:2] == ["--reader"]:
        follow(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--only", default="")
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-fuzz-guided"))
    asked = parser.parse_args()
    counts, found = {}, {}
    for kind, inputs in whole().items():
        if asked.only not in kind:
            continue
        folder = asked.folder / kind.replace(" ", "-")
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "corpus").mkdir(parents=True)
        for n, data in enumerate(inputs):
            (folder / "corpus" / str(n)).write_bytes(data)
        limits = [f"-runs={asked.runs}", "-seed=14", "-timeout=10", "-rss_limit_mb=4096", "-print_final_stats=1"]
        command = [sys.executable, __file__, "--reader", kind, str(folder), *limits, f"-artifact_prefix={folder}/"]
        done = subprocess.run([*command, str(folder / "corpus")], capture_output=True, check=False)
        said = done.stderr.decode(errors="replace")
        executed = re.search(r"number_of_executed_units: (\d+)", said)
        counts[kind] = int(executed[1]) if executed else 0
        if done.returncode:
            found[kind] = (done.stdout.decode(errors="replace") + said)[-3000:]
            print(kind, found[kind], flush=True)
    content = {"inputs": sum(counts.values()), "findings": len(found), "by_kind": counts}
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
