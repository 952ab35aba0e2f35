"""An empty winning domain explains itself: the reason is planted, the explanation has to find it."""

import numpy as np
import pytest

from simgap.geometry import Box
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.explain import GammaParts, explain
from simgap.synthesis.synthesise import EmptyDomain, SynthesisProblem, synthesise
from tests.synthesis.synthesis_plants import constant_gap, pendulum

SPACE = Space(("x1", "x2"), Box([0.0, -0.5], [0.2, 0.5]))
SAFE = {"x1": (0.0, 0.2), "x2": (-0.5, 0.5)}


def problem(cells, gap=None, inputs=None, safe=None):
    model, all_inputs = pendulum()
    section = Invariance(kind="invariance", safe=SAFE if safe is None else safe)
    return SynthesisProblem(model, section, SPACE, cells, all_inputs if inputs is None else inputs, gap)


def explained(posed, retimed=None):
    with pytest.raises(EmptyDomain):
        synthesise(posed)
    return explain(posed, retimed)


def test_a_gap_larger_than_what_the_state_can_move_is_the_reason():
    found = explained(problem((200, 100), constant_gap(0.003, 0.001)))  # tau * 0.5 = .0025 is the largest step of x1
    assert found.cause == "gap"
    assert found.first == "x1"
    x1 = found.axes[0]
    assert x1.step == pytest.approx(0.005 * 0.495)  # at the outermost centres
    assert (x1.gamma, x1.gamma_width) == pytest.approx((0.003, 0.006))
    assert x1.moves == 0.0  # no input reaches x1 within a step
    assert found.axes[1].moves == pytest.approx(0.005 * 3.0 * 2.4)
    assert x1.leaves > 0
    by = {t.what: t.wins for t in found.tries if not t.with_gap or "none" in t.what}
    assert by["with none of the gap's width"] > 0.5
    assert all(wins > 0.5 for what, wins in by.items() if what == "the nominal model")


def test_cells_that_are_too_large_are_the_reason():
    found = explained(problem((3, 4)))
    assert found.cause == "cells"
    better = next(t for t in found.tries if t.wins > 0)
    assert not better.with_gap
    synthesise(problem(better.cells))  # what it says helps does help


def test_inputs_that_cannot_meet_the_specification_are_the_reason():
    safe = {"x1": (0.15, 0.2)}  # gravity is 2.2 rad/s^2 there, the inputs give none
    found = explained(problem((40, 40), inputs=np.zeros((1, 1)), safe=safe), lambda times: pendulum(0.005 * times)[0])
    assert found.cause == "specification"
    assert all(t.wins == 0 for t in found.tries)
    assert "cannot meet" in found.sentence
    assert {t.key for t in found.tries} == {"synthesis.cells", "domain.tau"}


def test_what_gamma_is_made_of_is_named_by_size_with_what_shrinks_the_largest():
    """Of 1.0 in all: .1 at samples, .2 between them, .7 left by recordings."""
    words = GammaParts(0.1, 0.3, 0.7).words("v")
    assert words.index("0.7 is what the recordings leave") < words.index("0.2 is what may lie") < words.index("0.1 is")
    assert "shrinks with longer or less noisy recordings" in words
    late = GammaParts(0.5, 0.6, 0.0, ("input_lag of u",)).words("v")
    assert "input_lag of u, which the model does not carry" in late
    assert "recordings" not in late
