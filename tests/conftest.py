"""What tests share: the repository's paths and a way to vary a case."""

from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]


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
