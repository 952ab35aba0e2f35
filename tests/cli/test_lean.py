"""What a command does not import."""

import subprocess
import sys

CODE = """
import sys
import numpy as np
from simgap.cli.lean import without_pandas
without_pandas()
from simgap.io.parquet import read_parquet, stack, table, write_parquet
from pathlib import Path
path = Path(sys.argv[1])
write_parquet(path, table({"x": np.arange(3.0)}, {}, {"case": "rod", "seed": 1}, {}))
assert stack(read_parquet(path), ["x"]).tolist() == [[0.0], [1.0], [2.0]]
assert "pandas" not in sys.modules
import pandas  # what a plug-in asks for itself
assert pandas.Series([1, 2]).sum() == 3
"""


def test_tables_need_no_pandas_and_a_plugin_gets_it(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(tmp_path / "t.parquet")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
