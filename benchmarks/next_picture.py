"""The picture of `simgap next` in the documentation: the bench of tests/stages/test_next.py.

    python benchmarks/next_picture.py

Writes docs/pictures/next.png and prints the paragraph.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT)]

from simgap.extras import next as stage  # noqa: E402
from simgap.stages import diagnosis  # noqa: E402
from tests.stages.test_next import CASE, RATE, play  # noqa: E402


def main() -> None:
    """A small swing, its diagnosis, and what to record next."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case = folder / "case.yaml"
        case.write_text(CASE)
        small = play(folder / "small.csv", 0.06 * np.sin(2 * np.pi * 0.7 * np.arange(800) / RATE), 0)
        diagnosis.run(case, [small], folder / "found")
        said = stage.run(case, folder / "found", folder / "next")
        shutil.copy(folder / "next" / stage.PICTURE, ROOT / "docs" / "pictures" / stage.PICTURE)
        print(said["paragraph"].replace(f"{folder}/", ""))


if __name__ == "__main__":
    main()
