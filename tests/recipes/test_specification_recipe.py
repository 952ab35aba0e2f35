"""The recipe of a specification in one file, as the documentation shows it: synthesis and validation in the engine."""

import re

import numpy as np
import pytest
import yaml

from simgap.config.gap import GapSection, LipschitzSection
from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.gap.bases import Expressions
from simgap.gap.sampling.points import product
from simgap.geometry import Grid
from simgap.io.controller_file import load_controller
from simgap.io.results import read_json, write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.report.scene import limits
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import synthesis, validation
from tests.gap.fit_in_memory import GapSamples, fit_gap


@pytest.fixture
def case(vary, root):
    page = (root / "docs/how-to/specifications.md").read_text()
    python, section = (re.search(rf"```{kind}\n(.*?)```", page, flags=re.S).group(1) for kind in ("python", "yaml"))
    asked = yaml.safe_load(section)["specification"]
    changes = {
        "synthesis": {"cells": [400, 200], "specification": asked},
        "domain.U": {"u": {"min": -1.2, "max": 1.2, "step": 0.3}},
        "validation": {"starts": 20, "steps": 200, "seed": 2},
    }
    path = vary("pendulum", changes, remove=["measured"])
    (path.parent / "avoid.py").write_text(python)
    return path


def bound(path, out):
    context = Context.load(path)
    grid = Grid.covering(context.box, 0.03)
    x, u = product(grid.centres(), context.input_set)
    ((following, _),) = run_in_processes(roll_out, [(context.case, context.folder, x, u)])
    d = following - context.plant.sampled.step(x, u)
    samples = GapSamples(grid, context.input_set, d.reshape(grid.size, -1, 2), ("x1", "x2"), ("u",))
    terms = ("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
    settings = GapSection(basis=Expressions(terms=terms), lipschitz=LipschitzSection(extreme_value=False))
    record = provenance("gap", context.case, context.folder)
    write_json(out, fit_gap(samples, settings).function.to_json() | {"provenance": record})


def test_one_file_is_a_specification(case, tmp_path):
    gap, made, figures = (tmp_path / name for name in ("gap.json", "controller.npz", "synthesis.json"))
    bound(case, gap)
    synthesis.run(case, gap, made, figures, 1)
    assert 0.3 < read_json(figures)["winning_fraction"] < 1
    controller = load_controller(made)
    centres = controller.grid.centres()
    inside = np.all((centres > [0.05, -0.1]) & (centres < [0.1, 0.1]), axis=1)
    assert inside.any()
    assert not controller.contains(centres[inside]).any()
    validation.run(case, made, made, gap, tmp_path / "v.json", tmp_path / "traces.parquet", 1)
    tally = read_json(tmp_path / "v.json")["controllers"]["gap"]["simulator"]
    assert tally["ends"] == {"stayed": 20}
    assert (tally["steps"], tally["steps_outside_gamma"]) == (4000, 0)


def test_its_words_and_limits_are_those_of_the_file(case):
    asked, space = specification_of(load_case(case)), Space.of(load_case(case))
    assert asked.sentence(space) == "never enter x1 in [0.05, 0.1] rad, x2 in [-0.1, 0.1] rad/s"
    assert asked.words.promise == "stays out of the box for ever"
    assert limits(Context.load(case)).hi.tolist() == [0.2, 0.5]


def test_a_wrong_key_of_it_is_told_like_any_other(case):
    content = yaml.safe_load(case.read_text())
    content["synthesis"]["specification"]["bx"] = content["synthesis"]["specification"].pop("box")
    case.write_text(yaml.safe_dump(content))
    with pytest.raises(UserError, match=r"synthesis\.specification\.bx: unknown key. Did you mean 'box'"):
        load_case(case)
