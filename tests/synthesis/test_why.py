"""Why a state wins or loses, on a mover of one axis whose successors are counted by hand."""

import numpy as np
import pytest

from simgap.geometry import Box
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller
from simgap.synthesis.explain import why
from simgap.synthesis.margins import one_step_margins
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.synthesis.synthesis_plants import constant_gap, pendulum

GAP = (0.0002, 0.002)
SPACE = Space(("x1", "x2"), Box([0.0, -0.5], [0.2, 0.5]))


@pytest.fixture(scope="module")
def made():
    """The pendulum held in x1 <= 0.2, |x2| <= 0.5, with a gap that costs some cells and without one."""
    model, inputs = pendulum()
    section = Invariance(kind="invariance", safe={"x1": (0.0, 0.2), "x2": (-0.5, 0.5)})
    posed = SynthesisProblem(model, section, SPACE, (200, 100), inputs, constant_gap(*GAP))
    alone = SynthesisProblem(model, section, SPACE, (200, 100), inputs)
    names = (("x1", "x2"), ("u",))
    aware, nominal = (Controller(inputs, *names, synthesise(p), "least_effort", {}) for p in (posed, alone))
    won = aware.solution
    about = model, won.grid, inputs, posed.gap, won.winning, won.mask
    return posed, aware, one_step_margins(*about, losing=~won.winning), nominal


def test_a_state_that_wins_has_as_many_inputs_as_the_controller_says(made):
    x = made[1].grid.centres()[np.flatnonzero(made[1].solution.winning)[-1]]
    (said,) = why(*made[:3], x)
    assert f"It wins: {len(made[1].inputs(x))} of {len(made[1].input_set)} inputs are admissible." in said
    factor = made[2].factor[made[1].grid.index(x[None])[0]]
    assert f"grow by a factor of {factor:.4g} " in said


def test_a_state_outside_is_said_to_be_outside_along_its_axis(made):
    assert why(*made[:3], np.array([0.3, -0.6])) == ("Outside the region of the specification: x1, x2.",)


def test_a_state_that_loses_by_the_gap_alone_says_so_and_counts_its_inputs(made):
    posed, aware, margins, nominal = made
    lost = np.flatnonzero(nominal.solution.winning & ~aware.solution.winning)
    assert lost.size
    for cell in lost[:: max(1, lost.size // 20)]:
        x = aware.grid.centres()[cell]
        first, *said, last = why(posed, aware, margins, x)
        assert "no input keeps every successor" in first
        assert ("Gamma costs it" in last) == (0.0 <= margins.factor[cell] < 1.0)
        step = np.array([posed.model.step(x[None], u[None])[0] for u in aware.input_set])
        out = np.any((step + np.array(GAP) > SPACE.box.hi) | (step - np.array(GAP) < SPACE.box.lo), axis=1)
        told = sum(int(s.split(" inputs ")[1].split()[0]) for s in said if s.startswith("Of "))
        assert told >= out.sum()  # of the whole cell, not of its centre alone


def test_a_state_that_no_controller_holds_is_not_blamed_on_the_gap(made):
    x = np.array([0.2 - 1e-4, 0.5 - 1e-4])
    assert not made[3].contains(x)[0]
    assert "The cells that it leads to lose" in why(*made[:3], x)[-1]


def test_a_state_next_to_those_that_win_can_be_won_with_a_narrower_gamma(made):
    lost = np.flatnonzero((made[2].factor >= 0.0) & (made[2].factor < 1.0))
    assert lost.size
    x = made[1].grid.centres()[lost[0]]
    assert f"at {made[2].factor[lost[0]]:.3g} times its width" in why(*made[:3], x)[-1]
