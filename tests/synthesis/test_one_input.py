"""A controller that records one input a cell, from the case's key to the certificate: the one that it would apply."""

import runpy
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from simgap.attack.campaign import ControlLaw
from simgap.config.controller import SynthesisSection
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.io.arrays_on_disk import Mapped
from simgap.io.controller_file import export_controller, load_controller, save_controller
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller
from simgap.synthesis.input_sets import unpack
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.synthesis.synthesis_plants import constant_gap, unicycle

ROBOT = Space(("x", "y", "t"), Box([0, 0, -np.pi], [4, 4, np.pi]), (2,))
INPUTS = np.array([(v, w) for v in (-0.5, 0.0, 0.5) for w in (-1.0, -0.5, 0.0, 0.5, 1.0)])
KEYS = {"target": {"x": (3.0, 3.8), "y": (3.0, 3.8)}, "obstacles": [{"x": (1.5, 2.0), "y": (0.0, 2.0)}]}


def problem(one, specification=None, **more):
    task = ReachAvoid(kind="reach_avoid", **KEYS) if specification is None else specification
    return SynthesisProblem(
        unicycle(), task, ROBOT, (40, 44, 32), INPUTS, constant_gap(0.005, 0.005, 0.01), (), one=one, **more
    )


def controller(one, rule="least_effort"):
    solution = synthesise(problem(one))
    return Controller(INPUTS, ROBOT.states, ("v", "w"), solution, rule, {"case": "robot"})


@pytest.fixture(scope="module")
def both():
    return controller(False), controller(True)


def test_it_is_the_least_of_all_admissible_inputs(both):
    every, one = both
    admissible = unpack(every.solution.mask, len(INPUTS))
    effort = np.round((INPUTS**2 / np.abs(INPUTS).max(axis=0) ** 2).sum(axis=1), 12)
    cheapest = np.array([min(np.flatnonzero(row), key=lambda m: (effort[m], m), default=-1) for row in admissible])
    assert np.array_equal(one.solution.chosen, cheapest)
    assert len({*cheapest.tolist()}) > 8
    assert one.solution.mask.size == 0
    for name in ("value", "winning", "target", "free", "served"):
        assert np.array_equal(getattr(one.solution, name), getattr(every.solution, name))


def test_controllers_apply_the_same_from_the_file_and_in_exports(both, tmp_path):
    every, one = both
    for own, name in ((every, "every"), (one, "one")):
        save_controller(own, tmp_path / f"{name}.npz")
        export_controller(load_controller(tmp_path / f"{name}.npz"), tmp_path / name / "robot.py")
    assert (tmp_path / "one.npz").stat().st_size < (tmp_path / "every.npz").stat().st_size
    laws = [runpy.run_path(str(tmp_path / name / "robot.py")) for name in ("one", "every")]  # the second has a shield
    assert laws[0]["CHOICE"] == [laws[1]["CHOICE"][row] for row in laws[1]["ROW"]]
    found = load_controller(tmp_path / "one.npz")
    x = np.random.default_rng(0).uniform([-0.2, -0.2, -9.0], [4.2, 4.2, 9.0], (4000, 3))
    chosen = every.lookup(x)
    assert np.array_equal(found.lookup(x), chosen)
    for state, m in zip(x[:300], chosen, strict=False):
        assert np.array_equal(found.inputs(state), INPUTS[[m]] if m >= 0 else INPUTS[:0])


def test_its_only_input_is_what_an_adversary_meets(both, tmp_path):
    shared = Mapped.of(both[1].solution, tmp_path / "tables").read()
    assert not shared.chosen.flags.owndata
    x = np.random.default_rng(0).uniform(ROBOT.box.lo, ROBOT.box.hi, (500, 3))
    options = ControlLaw(shared, INPUTS, np.zeros(3)).options(x, np.zeros(500, np.int64))
    chosen = both[0].lookup(x)
    assert np.array_equal(options.inputs, (np.arange(len(INPUTS)) == chosen[:, None]) & (chosen >= 0)[:, None])


@pytest.mark.parametrize(
    "wrong", [lambda c: c[:-1], lambda c: c.astype(np.int32), lambda c: np.where(c >= 0, 15, c).astype(np.int16)]
)
def test_inputs_that_cannot_be_are_refused(both, tmp_path, wrong):
    one = both[1]
    save_controller(replace(one, solution=replace(one.solution, chosen=wrong(one.solution.chosen))), tmp_path / "a.npz")
    with pytest.raises(UserError, match="not a controller file"):
        load_controller(tmp_path / "a.npz")


def test_what_one_input_does_not_serve_is_refused():
    for case in (problem(True, ReachAndStay(kind="reach_and_stay", **KEYS)), problem(True, latency=1)):
        with pytest.raises(UserError, match="one input a cell") as refused:
            synthesise(case)
        assert refused.value.key == "synthesis.record"
    with pytest.raises(UserError, match="least_effort"):
        controller(True, rule="middle")


def test_the_key_leaves_cases_that_do_not_set_it_as_they_were():
    keys = {"cells": [2], "specification": {"kind": "invariance", "safe": {"x1": (0.0, 1.0)}}}
    assert "record" not in SynthesisSection(**keys).model_dump()
    assert SynthesisSection(**keys, record="one").model_dump()["record"] == "one"
    with pytest.raises(ValidationError):
        SynthesisSection(**keys, record="two")
