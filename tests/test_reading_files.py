"""Files are opened through one door, which takes regular files of moderate size and tells of all else in one line."""

import ast
import os
import re
import stat
from pathlib import Path

import pytest

from simgap import reading
from simgap.config.load import load_case
from simgap.config.measured import matching_files
from simgap.errors import UserError
from simgap.io.controller_file import load_controller
from simgap.io.gap_file import load_gap
from simgap.io.recordings.tables import read_recording
from simgap.io.results import MOST, read_json, read_parquet
from simgap.plants.model_file import read_model_file

PACKAGE = Path(reading.__file__).parent
RAW = {"read_bytes", "read_text", "memory_map", "is_file", "resolve"}
"""Methods that open a file by its path, or look for one and take a pipe for none or end on links in a circle."""
OF_STREAMS = {"read_schema", "read_metadata", "read_table", "ParquetFile", "read_csv"}
OWN = {
    "reading.py": "the door",
    "simulators/supervision.py": "memory of this process, from the system",
    "simulators/process.py": "where the engine's words go, and a pipe of its own",
    "cache.py": "its own sources, before the package is imported",
    "cli/start.py": "what check counted, in a process that imports nothing of simgap",
    "io/atomic.py": "its own temporary file",
    "io/results.py": "its own temporary file",
    "io/rerun/scene.py": "its `open` opens no file",
    "io/runs.py": "a lock",
    "extras/engines/fmu.py": "a lock on its own folder",
    "io/controller_file.py": "tables of its own scratch folder",
    "stages/validation.py": "a table of its own scratch folder",
}


def _calls(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            yield node, *name.rpartition(".")[::2]


def _opens(node, of, name):
    if of == "reading":
        return False
    if name == "parse":
        return of in ("ElementTree", "ET", "etree")
    mode = next((ast.unparse(a) for a in node.args[-1:]), "'r'")
    if name == "open":
        return of != "archive" and (of in ("", "os", "io") or not re.search("[wax]", mode))
    if name in OF_STREAMS and of in ("pq", "pcsv"):
        return not ast.unparse(node.args[0]).startswith(("stream", "pa.BufferReader"))
    if name == "load":
        return of in ("np", "numpy", "json", "pickle")
    return name in RAW


def test_nothing_else_in_the_package_opens_a_file_to_read_it():
    files = sorted(path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).as_posix() not in OWN)
    found = [f"{p.relative_to(PACKAGE)}:{node.lineno}" for p in files for node, *of in _calls(p) if _opens(node, *of)]
    assert len(files) > 200
    assert found == []


READERS = {
    "case.yaml": load_case,
    "robot.urdf": read_model_file,
    "run.csv": lambda path: read_recording(path, ["q"], "t", "trace"),
    "run.json": lambda path: read_recording(path, ["q"], "t", "trace"),
    "run.parquet": lambda path: read_recording(path, ["q"], "t", "trace"),
    "gap.json": lambda path: load_gap(path, None),
    "a.json": read_json,
    "b.parquet": read_parquet,
    "c.npz": load_controller,
}


def _loop(path):
    path.symlink_to(path.with_name("other"))
    path.with_name("other").symlink_to(path)


STRANGE = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a socket": lambda path: os.mknod(path, stat.S_IFSOCK),
    "in a circle": _loop,
}


@pytest.mark.parametrize("kind", STRANGE)
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_one_line_at_once(tmp_path, name, kind):
    STRANGE[kind](tmp_path / name)
    with pytest.raises(UserError, match=kind) as told:
        READERS[name](tmp_path / name)
    assert name in str(told.value)


@pytest.mark.parametrize("name", ["case.yaml", "robot.urdf", "run.json", "gap.json", "b.parquet", "c.npz"])
def test_a_file_larger_than_can_be_held_is_refused_before_it_is_read(tmp_path, name):
    """It is sparse: it takes no disk, and reading it would take all of the memory."""
    with (tmp_path / name).open("wb") as stream:
        stream.truncate(MOST + 1 if name == "run.json" else 1 << 42)
    with pytest.raises(UserError, match=r"the most are|more than|not a controller") as told:
        READERS[name](tmp_path / name)
    assert name in str(told.value)


def test_a_result_of_900_mb_is_refused_where_it_would_take_more_than_there_is(tmp_path):
    assert os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 4 >= MOST * 30
    path = tmp_path / "gap.json"
    with path.open("wb") as stream:
        stream.truncate(MOST + 1)
    with pytest.raises(UserError, match=f"has {MOST + 1} bytes"):
        load_gap(path, None)


ENTITIES = "".join(f'<!ENTITY e{k} "&e{k + 1};">' for k in range(200_000))
HOSTILE_XML = {
    "nested entities": f'<?xml version="1.0"?><!-- x --><!DOCTYPE robot [{ENTITIES}]><robot name="a">&e0;</robot>',
    "in UTF-16": '\ufeff<?xml version="1.0"?>\n<!DOCTYPE robot []><robot name="a"/>',
    "large": f'<robot name="{"a" * reading.MOST_XML}"/>',
    "deep": "<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>",
}


@pytest.mark.parametrize("kind", HOSTILE_XML)
def test_xml_that_would_end_the_process_is_refused(tmp_path, kind):
    path = tmp_path / "robot.urdf"
    path.write_text(HOSTILE_XML[kind], encoding="utf-16-le" if "16" in kind else "utf-8")
    with pytest.raises(UserError, match=r"document type|the most are|within each other"):
        read_model_file(path)


def test_what_only_looks_like_a_document_type_is_read(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text("\ufeff<?xml version='1.0'?> <!-- <!DOCTYPE a> --> <?p <!DOCTYPE ?><robot><!--<!DOCTYPE--></robot>")
    assert reading.read_xml(path).tag == "robot"


def test_a_file_of_the_system_that_says_it_is_empty_is(tmp_path):
    """/proc holds files of no size that never end."""
    link = tmp_path / "case.yaml"
    link.symlink_to("/proc/self/smaps")
    assert reading.read_bytes(link) == b""


@pytest.mark.parametrize("pattern", ["/**/*", "../**/*.csv", "a/../../*"])
def test_a_pattern_of_a_case_stays_within_its_folder(tmp_path, pattern):
    with pytest.raises(UserError, match="leads out of the case's folder"):
        matching_files(tmp_path, [pattern])


def test_a_pattern_that_a_person_types_may_lead_anywhere(tmp_path):
    (tmp_path / "a.csv").write_text("t\n")
    assert matching_files(Path(), [f"{tmp_path}/*.csv"], typed=True) == [(0, tmp_path / "a.csv")]
