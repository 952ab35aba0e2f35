"""What tests share: the repository's paths and a way to vary a case."""

import os
from pathlib import Path

import pytest
import yaml

from tests import stale

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def environment():
    """A command that runs in the process of a test keeps later ones of it from importing what lies in their folder."""
    yield
    os.environ.pop("PYTHONSAFEPATH", None)


@pytest.fixture(scope="session")
def root():
    return ROOT


@pytest.fixture
def vary(tmp_path):
    """vary("pendulum", {"grid.eps": 0.05}) -> path of a changed copy whose model paths still hold."""

    def make(name, changes, remove=()):
        content = yaml.safe_load((ROOT / "configs" / "cases" / f"{name}.yaml").read_text())
        plant = content["plant"]
        if plant.get("urdf"):
            plant["urdf"] = str((ROOT / "configs" / "cases" / plant["urdf"]).resolve())
        for key, value in changes.items():
            place = content
            *parents, last = key.split(".")
            for part in parents:
                place = place.setdefault(part, {})
            place[last] = value
        for key in remove:
            place = content
            *parents, last = key.split(".")
            for part in parents:
                place = place[part]
            del place[last]
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return make


def pytest_addoption(parser):
    parser.addoption(
        "--stale", action="store_true", help="of slow tests, only files whose code has changed since they passed"
    )
    parser.addoption("--record", action="store_true", help="keep the code with which files of slow tests passed")


def pytest_ignore_collect(collection_path, config):
    """Files of which no test would run are not even imported: the slow ones of plain `pytest`, others of `-m slow`."""
    whole, marks = [Path(word).resolve() for word in config.args] == [ROOT / "tests"], config.option.markexpr
    if not whole or marks not in ("", "slow") or not collection_path.match("test_*.py"):
        return None
    slow = stale.is_slow(collection_path)
    if marks == "slow" and slow and config.getoption("--stale"):
        return not stale.stale([collection_path]) or None
    return slow == (marks == "") or None


def pytest_collection_modifyitems(config, items):
    slow = {path for path in {item.path for item in items} if stale.is_slow(path)}
    for item in items:
        if item.path in slow:
            item.add_marker("slow")
    left = slow - stale.stale(slow) if config.getoption("--stale") else set()
    config.hook.pytest_deselected(items=[item for item in items if item.path in left])
    items[:] = [item for item in items if item.path not in left]


class Outcomes:
    """Files of tests by how they ended, for the process that gathers the reports."""

    def __init__(self):
        self.passed, self.failed = set(), set()

    def pytest_runtest_logreport(self, report):
        file = ROOT / report.nodeid.partition("::")[0]
        if report.failed:
            self.failed.add(file)
        elif report.passed and report.when == "call":  # a file of which every test was skipped has passed nothing
            self.passed.add(file)

    def pytest_sessionfinish(self):
        stale.record(self.passed - self.failed, self.failed)


def pytest_configure(config):
    if config.getoption("--record") and not hasattr(config, "workerinput"):
        if config.option.keyword or config.option.markexpr != "slow" or config.args != ["tests"]:
            raise pytest.UsageError("--record goes with `pytest -m slow` and nothing else")
        config.pluginmanager.register(Outcomes())
