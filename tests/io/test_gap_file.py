"""A gap file decides which controller is called safe: anything but a whole bound of this very case is refused."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.linear import Basis, LinearGap, make_form
from simgap.geometry import Box
from simgap.io.gap_file import load_gap
from simgap.io.results import write_json
from simgap.plants.context import Context
from simgap.stages.synthesis import pose_problem

X, U = Box([-1.0, -2.0], [1.0, 2.0]), np.array([[-1.0], [0.0], [1.0]])
CASE = SimpleNamespace(states=["x", "v"], inputs=["u"], box=X, input_set=U, periodic=(), own=print)
DOMAIN, TIERS = GapDomain(("x", "v"), ("u",), X, U), (Tier(1, "It holds."),)


def linear():
    basis = Basis(("x", "u", "1"), ("x", "v"), ("u",))
    return LinearGap.unsigned(DOMAIN, TIERS, [make_form(basis, X, U, [0.1, 0.0, 0.2]) for _ in "xv"])


def cells():
    edges = (np.linspace(-1, 1, 3), np.linspace(-2, 2, 3))
    low = np.full((4, 3, 2), -0.1)
    return CellGap(DOMAIN, TIERS, edges, low, -low)


PLANE = Box([0.0, 0.0, -3.0], [4.0, 4.0, 3.0])
ROBOT = SimpleNamespace(states=["x", "y", "heading"], inputs=["u"], box=PLANE, input_set=U, periodic=(), own=print)


def body():
    domain = GapDomain(("x", "y", "heading"), ("u",), PLANE, U, (0, 1))
    return BodyFrameGap(domain, TIERS, np.full((1, 3, 3), -0.1), np.full((1, 3, 3), 0.1))


MADE = {"linear": (linear, CASE), "cells": (cells, CASE), "body_frame": (body, ROBOT)}


@pytest.mark.parametrize("kind", MADE)
def test_a_checked_bound_comes_back(tmp_path, kind):
    made, case = MADE[kind]
    write_json(tmp_path / "gap.json", made().to_json() | {"eps": 0.1})
    read = load_gap(tmp_path / "gap.json", case)
    assert read.function.to_json() == made().to_json()
    assert read.content["eps"] == 0.1
    assert read.swept is None


def put(content, where, value):
    *above, last = where
    for key in above:
        content = content[key]
    if value is ...:
        del content[last]
    else:
        content[last] = value


EVERYWHERE = [
    (["guarantee"], [], "does not say what it rests on"),
    (["guarantee"], [{"tier": 9, "text": "?"}], "tier that does not exist"),
    (["guarantee"], ..., "guarantee"),
    (["kind"], "none", "none"),
    (["domain", "input_set"], [], "U is empty|not a saved gap bound"),
    (["domain", "inputs"], ["w"], "of another case|'w'|not known"),
    (["domain", "states", "x"], [0.0, 1.0], "of another case, which differs in states|do not cover X"),
    (["domain", "states", "x"], [1.0, 0.0], "upside down"),
    (["domain", "states", "x"], [None, 1.0], "upside down|not a table"),
    (["domain"], None, "not a saved gap bound"),
]
WRONG = {
    "linear": [
        (["gap", "v"], ..., "'v'"),
        (["gap", "v", "upper", "coefficients", "x"], "inf", "coefficients is not a table of finite numbers"),
        (["gap", "v", "upper", "coefficients", "x"], None, "not a saved gap bound"),
        (["gap", "v", "upper", "coefficients", "x"], ..., "different bases"),
        (["gap", "v", "lower", "offset"], 0.5, "lower side is above its upper side"),
        (["gap", "v", "lower", "offset"], "nan", "offset is not a finite number"),
    ],
    "cells": [
        (["edges", "x"], [-1.0, 0.5, 0.9], "do not cover X"),
        (["edges", "x"], [-1.0, 1.0, 1.0], "do not follow"),
        (["gap", "x", "upper"], [[-1.0] * 3] * 4, "lower side is above"),
        (["gap", "x", "upper"], [[0.1] * 3] * 3, "not a saved gap bound"),
        (["gap", "x", "upper"], [["inf"] * 3] * 4, "upper side is not a table"),
    ],
    "body_frame": [
        (["pose"], ["x", "y", "x"], "pose is not"),
        (["gap", "x", "upper"], [0.1, 0.1], "not a saved gap bound"),
        (["gap", "x", "upper"], [0.1, 0.1, -5.0], "lower side is above"),
        (["gap", "x", "upper"], [0.1, 0.1, None], "upper side is not a table"),
        (["swept_boxes"], {"lower": [[0.0, 0.0]] * 3, "upper": [[-1.0, 0.0]] * 3}, "swept boxes"),
        (["swept_boxes"], {"lower": [[0.0, 0.0]] * 2, "upper": [[1.0, 0.0]] * 2}, "swept boxes"),
        (["swept_boxes"], None, "swept boxes"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "where", "value", "match"),
    [(kind, *one) for kind, own in WRONG.items() for one in (*EVERYWHERE, *own)],
)
def test_a_bound_that_is_incomplete_or_nonsense_is_refused_with_its_file(tmp_path, kind, where, value, match):
    made, case = MADE[kind]
    content, path = json.loads(json.dumps(made().to_json())), tmp_path / "gap.json"
    put(content, where, value)
    write_json(path, content)
    with pytest.raises(UserError, match=match) as caught:
        load_gap(path, case)
    assert caught.value.file == path
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change", [{"input_set": U * 2}, {"box": Box([-1.0, -2.0], [1.0, 3.0])}, {"states": ["v", "x"]}]
)
def test_the_bound_of_another_case_is_refused(tmp_path, change):
    write_json(tmp_path / "gap.json", linear().to_json())
    with pytest.raises(UserError, match="gap bound is of another case"):
        load_gap(tmp_path / "gap.json", SimpleNamespace(**(vars(CASE) | change)))


@pytest.mark.parametrize("text", ["{}", "[]", "null", "", '{"checksum": ""}'])
def test_no_bound_is_never_taken_for_the_nominal_model(root, tmp_path, text):
    path = tmp_path / "gap.json"
    path.write_text(text)
    with pytest.raises(UserError, match="damaged"):
        pose_problem(Context.load(root / "configs/cases/pendulum.yaml"), path)
    write_json(path, {})
    with pytest.raises(UserError, match="not a saved gap bound"):
        pose_problem(Context.load(root / "configs/cases/pendulum.yaml"), path)
