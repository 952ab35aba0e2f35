"""`simgap view` finds the recording that is meant, keeps the viewer on loopback, and leaves no process behind."""

import os
import time

import pytest

from simgap.cli import main, tools
from simgap.errors import UserError


@pytest.fixture
def results(tmp_path):
    for name in ("rod/trace/trace.rrd", "rod/diagnosis/residual.rrd", "found/residual.rrd"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "found/diagnosis.json").write_text("{}")
    return tmp_path


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        ("rod", "rod/trace/trace.rrd"),
        ("rod/diagnosis", "rod/diagnosis/residual.rrd"),
        ("found", "found/residual.rrd"),
        ("found/diagnosis.json", "found/residual.rrd"),
        ("rod/diagnosis/residual.rrd", "rod/diagnosis/residual.rrd"),
    ],
)
def test_the_recording_that_is_meant(results, capsys, asked, meant):
    with pytest.raises(SystemExit) as ended:
        main(["view", str(results / asked), "--print"])
    assert ended.value.code == 0
    words = capsys.readouterr().out.split()
    assert words[1] == str(results / meant)
    assert words[words.index("--bind") + 1] == "127.0.0.1"


def test_the_browser_where_there_is_no_display(results, capsys, monkeypatch):
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for display, browser in (("", True), (":0", False)):
        monkeypatch.setenv("DISPLAY", display)
        with pytest.raises(SystemExit):
            main(["view", str(results / "rod"), "--print"])
        assert ("--web-viewer" in capsys.readouterr().out) == browser


@pytest.mark.parametrize(("asked", "words"), [("nothing", "does not exist"), ("empty", "no recording here")])
def test_a_place_without_a_recording(results, asked, words):
    (results / "empty").mkdir()
    with pytest.raises(UserError, match=words):
        tools.recording_of(results / asked)


def test_what_the_wrapper_started_ends_with_it(tmp_path):
    """The `rerun` on the path starts the viewer and may end before it."""
    told = tmp_path / "process"
    assert tools._until_closed(["sh", "-c", f"sleep 60 & echo $! > {told}; exit 3"]) == 3
    process, until = int(told.read_text()), time.monotonic() + 10
    while _runs(process) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _runs(process)


def _runs(process):
    try:
        with open(f"/proc/{process}/stat") as state:
            return state.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        return not os.path.isdir("/proc/self")
