"""Kernels kept between processes: loaded instead of compiled, and never those of another source or number."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from simgap.cache import kernel_sources, sources

SCRIPT = """
import sys
import numpy as np
from helper import twice
from simgap.model.compile import cached_kernel

def make(factor, table):
    @cached_kernel
    def scaled(x):
        return twice(x) * factor + table[1]
    return scaled

kernel = make(float(sys.argv[1]), np.array([0.0, 0.5]))
value = kernel(3.0)
print(value, kernel.py_func.__module__, sum(kernel.stats.cache_hits.values()))
"""
HELPER = "from numba import njit\n@njit\ndef twice(x):\n    return {} * x\n"


def run(folder: Path, factor: str, home: dict[str, str]) -> list[str]:
    env = {k: v for k, v in os.environ.items() if k not in {"XDG_CACHE_HOME", "HOME"}} | home
    call = subprocess.run(
        [sys.executable, str(folder / "script.py"), factor], env=env, capture_output=True, text=True, check=True
    )
    return call.stdout.split()


def test_kernel_cache_kernels_are_loaded_again_and_never_mistaken(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "helper.py").write_text(HELPER.format("2.0"))
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    value, module, hits = run(tmp_path, "10", home)
    assert (value, hits) == ("60.5", "0")
    assert run(tmp_path, "10", home) == ["60.5", module, "1"]
    assert run(tmp_path, "11", home)[0] == "66.5"
    (tmp_path / "helper.py").write_text(HELPER.format("12.0"))  # the closure's own text is what it was
    assert run(tmp_path, "10", home)[0] == "360.5"


def test_without_a_place_to_keep_them_kernels_are_compiled(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "helper.py").write_text(HELPER.format("2.0"))
    (tmp_path / "file").write_text("")
    value, module, _ = run(tmp_path, "10", {"XDG_CACHE_HOME": str(tmp_path / "file")})
    assert value == "60.5"
    assert not module.startswith("simgap_kernels")


def test_machine_code_of_another_version_of_any_kernel_is_left_aside(tmp_path: Path) -> None:
    """numba looks at the file of a function alone: what it calls from another may have changed."""
    (tmp_path / "inner").mkdir()
    for name in ("outer.py", "inner/called.py"):
        (tmp_path / name).write_text("from numba import njit\n")
    before = kernel_sources(tmp_path)
    (tmp_path / "inner" / "called.py").write_text("from numba import njit  # another\n")
    kernel_sources.cache_clear()
    sources.cache_clear()
    assert kernel_sources(tmp_path) != before
    code = "import simgap, numba; from simgap.gap.bounds import cells; print(numba.config.CACHE_DIR)"
    env = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(tmp_path / "simgap" / "machine_code" / kernel_sources())
