"""An FMU of a stranger is looked at before it is unpacked."""

import zipfile

import pytest

from simgap import reading
from simgap.errors import UserError
from simgap.extras.engines import fmu as fmu_unit

pytest.importorskip("fmpy")
ABOUT = "modelDescription.xml"
HOSTILE = {
    "leads out": {ABOUT: b"<a/>", "binaries/../../../x": b"x"},
    r"\.\.\\x": {ABOUT: b"<a/>", "..\\x": b"x"},
    "'/tmp/x' in it": {ABOUT: b"<a/>", "/tmp/x": b"x"},
    "parts of": {ABOUT: b"<a/>"} | {f"f{k}": b"" for k in range(fmu_unit.MOST_PARTS)},
    "document type": {ABOUT: b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>'},
    "within each other": {ABOUT: b"<a>" * 1000 + b"</a>" * 1000},
    "not well-formed": {ABOUT: b"<a>"},
    "is not an FMU": {"other.xml": b"<a/>"},
    "the most are 20000000": {ABOUT: bytes(reading.MOST_XML + 1)},
}


@pytest.mark.parametrize("problem", HOSTILE)
def test_what_does_not_unpack_into_a_moderate_folder_is_refused(tmp_path, problem):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in HOSTILE[problem].items():
            archive.writestr(name, content)
    with pytest.raises(UserError, match=problem):
        fmu_unit.Unit(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.fmu"]


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(fmu_unit, "MOST_UNPACKED", 1_000_000)
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(ABOUT, b"<a/>")
        archive.writestr("x", bytes(1_000_001))
    assert path.stat().st_size < 10_000
    with pytest.raises(UserError, match="holds 2 parts"):
        fmu_unit.Unit(path)


def test_what_is_no_archive_at_all_is_told(tmp_path):
    (tmp_path / "a.fmu").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(UserError, match="is not an FMU"):
        fmu_unit.Unit(tmp_path / "a.fmu")
