"""Case files, expressions and model files of strangers."""

from __future__ import annotations

import random
from functools import cache
from pathlib import Path
from typing import Any

from hostile.damage import altered, damaged, expression

ROOT = Path(__file__).parents[2]


def _case(rng: random.Random) -> bytes:
    names = ("dfki_pendulum", "dc_motor", "multiarm_pendulum", "vtol", "dcdc", "pendulum", "turtlebot")
    return damaged((ROOT / f"configs/cases/{rng.choice(names)}.yaml").read_bytes(), rng)


def read_case(rng: random.Random, folder: Path) -> None:
    """A damaged case file; its model file lies where it says."""
    from simgap.config.load import load_case

    path = folder / "cases/case.yaml"
    path.write_bytes(_case(rng))
    load_case(path)


def read_altered_case(rng: random.Random, folder: Path) -> None:
    """A case that is whole YAML with a value that may be wrong."""
    from simgap.config.load import parse_case

    content = _parsed(rng.choice(("dfki_pendulum", "dc_motor", "vtol", "pendulum", "turtlebot", "dcdc")))
    for _ in range(rng.choice((1, 1, 2))):
        content = altered(content, rng)
    parse_case(content, folder / "cases/case.yaml")


@cache
def _parsed(name: str) -> Any:
    from simgap.config.load import read_yaml

    return read_yaml(ROOT / f"configs/cases/{name}.yaml")


def read_expression(rng: random.Random, folder: Path) -> None:
    """An expression, by a grammar, or one that is damaged."""
    from simgap.model.expressions import parse

    text = expression(rng)
    parse(text if rng.random() < 0.8 else damaged(text.encode(), rng).decode(errors="replace"), ["x", "y"])


def read_urdf(rng: random.Random, folder: Path) -> None:
    """A damaged model file."""
    from simgap.plants.urdf_checks import check_urdf, root_link

    path = folder / "model.urdf"
    name = rng.choice(("pendulum", "pendulum", "cart_pole"))
    path.write_bytes(damaged(_model(name), rng))
    check_urdf(path)
    root_link(path)


@cache
def _model(name: str) -> bytes:
    return (ROOT / f"configs/models/{name}.urdf").read_bytes()
