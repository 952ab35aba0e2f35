"""Folders of `benchmarks/hostile_commands.py` for commands of a fraction of a second; what is wrong is found."""

import os
import signal
import sys

import pytest
from hostile import prepare
from hostile.whole import COMMANDS, one, warm

QUICK = [(weight, words) for weight, words in COMMANDS if words[0] in ("new", "certify", "export", "view")]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    root = tmp_path_factory.mktemp("hostile")
    prepare(root / "kept")
    warm()
    return root


def test_a_command_in_a_hostile_folder_keeps_its_promises(place):
    tried = [one(number, "test", place, place / "kept", QUICK) for number in range(24)]
    assert [t for t in tried if t.wrong is not None] == []
    assert {t.status for t in tried} >= {0, 2}
    assert len({name for t in tried for name in t.done}) > 6


def _overwrite(rng, folder):
    folder.first.append(lambda: (folder.outside / "precious").write_text("gone"))


def _run(rng, folder):
    folder.first.append(lambda: (folder.here / "ran").touch())


def _raise(rng, folder):
    folder.first.append(lambda: [].pop())


def _end(rng, folder):
    folder.first.append(lambda: os.kill(os.getpid(), signal.SIGKILL))


def _steer(rng, folder):
    folder.first.append(lambda: sys.stdout.write("\x1b[2J\n"))


BROKEN = {
    "files of somebody else were changed": _overwrite, "code of the folder ran": _run, "status 70": _raise,
    "ended by signal 9": _end, "characters that steer a terminal": _steer,
}  # fmt: skip


@pytest.mark.parametrize("wrong", BROKEN)
def test_a_promise_that_is_broken_is_found(place, wrong):
    found = one(0, "broken", place, place / "kept", QUICK[-1:], [BROKEN[wrong]]).wrong
    assert found is not None
    assert wrong in found
