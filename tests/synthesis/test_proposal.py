"""Proportions of cells against their definition; what is proposed for a plant is won, and nothing beyond its limits."""

import math
import os
import select
import signal
import subprocess
import sys
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np
import pytest
import sympy as sp

from simgap.deadline import last_within
from simgap.errors import UserError
from simgap.extras.wizard import driven_arm
from simgap.extras.wizard.driven_arm import Proposal, rounded, step_of
from simgap.extras.wizard.posture import posture_of, proportions
from simgap.extras.wizard.proposal import HELD, WINS, Search, _held, propose
from simgap.extras.wizard.propose import Numbers
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import Coordinate, SymbolicModel, Variable, symbol


def pendulum(top=True, push=3.0):
    """A rod of 1 kg and 1 m with a motor, its angle from the upright or from hanging."""
    q, v, u = (symbol(n) for n in ("q", "v", "u"))
    way = 1 if top else -1
    return SymbolicModel(
        (Variable("q", "rad"), Variable("v", "rad/s")), (Variable("u", "N*m"),), {},
        (v, way * 14.715 * sp.sin(q) + push * u), (Coordinate("hinge", "q", "v"),),
    )  # fmt: skip


def sampled(model):
    x, u = (tuple(v.symbol for v in group) for group in (model.states, model.inputs))
    rates = model.numeric()
    return lambda tau: NominalModel(x, u, tuple(s + tau * r for s, r in zip(x, rates, strict=True)), tau)


def test_one_unstable_state_takes_as_many_cells_as_it_grows():
    """|a| r fits into R at best, by an input that cancels what is known: R / r = e^(rate tau)."""
    found = proportions(np.array([[2.0]]), np.array([[1.0]]), 2.0, [0.25])
    assert found.cells[0] == pytest.approx(np.exp(0.5), rel=0.02)


def test_no_errors_of_half_a_cell_lead_out_of_the_box():
    """The plant under its feedback, which sees cells' centres, and the worst that half a cell can add in each step."""
    a, b = np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([[0.0], [1.0]])
    found = proportions(a, b, 1.0, [0.4])
    ch, sh = np.cosh(0.4), np.sinh(0.4)
    ad, bd = np.array([[ch, sh], [sh, ch]]), np.array([[ch - 1.0], [sh]])
    half, rng, largest = found.box / found.cells, np.random.default_rng(0), np.zeros(2)
    for direction in np.array([[1.0, 0.0], [0.0, 1.0]]):
        closed, row = ad - bd @ found.gain, direction.copy()
        reach = 0.0
        for _ in range(500):  # the support of the reachable set in this direction
            reach += np.abs(row @ ad) @ half
            row = row @ closed
        largest[direction.argmax()] = reach
    assert (largest <= found.box * (1 + 1e-3)).all()
    x = np.zeros(2)
    for _ in range(2000):
        x = ad @ x - bd @ (found.gain @ x) + ad @ (half * rng.choice([-1.0, 1.0], 2))
        assert (np.abs(x) <= largest * (1 + 1e-9)).all()


def test_nothing_is_proposed_where_no_feedback_holds():
    assert proportions(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([[1.0], [0.0]]), 1.0) is None


@pytest.mark.parametrize("limit", [None, 0.2, 0.05])
def test_what_is_proposed_is_won_within_the_limits(limit):
    model = pendulum()
    limits = {} if limit is None else {"u": limit}
    found = propose(model, sampled(model), {}, limits, {"v": (-0.9, 0.9)})
    assert found.wins >= WINS
    assert found.against == HELD
    assert found.free == ()
    lo, hi, step = found.U["u"]
    assert lo == -hi
    assert (hi - lo) / step == pytest.approx(14)
    assert hi <= (limit or np.inf)
    assert all(found.X[n][1] <= most for n, most in (("q", 0.25), ("v", 0.9)))
    weight = 14.715 / 3.0 * np.sin(found.X["q"][1])
    assert (hi < weight) == (limit is not None and limit < weight)
    assert found.X["q"][1] == pytest.approx(found.part * 0.25, rel=0.05)
    assert ("X is small" in Numbers(found, {}, 2).small) == (found.X["q"][1] < 0.125)
    assert ("because of the inputs' limits. Tau" in Numbers(found, {}, 2).small) == (limit is not None)
    assert 0.2 / np.sqrt(14.715) * 0.9 <= found.tau <= 0.8 / np.sqrt(14.715) * 1.1


def test_cells_that_win_alone_are_refined_until_they_win_against_a_gap_while_there_is_time():
    def tried(cells, wins):
        return Proposal(0.1, {}, {}, (cells,), wins, (), 1.0)

    class Games(Search):
        def __init__(self):
            super().__init__(None, None, None, None, {}, {})

        def play(self, cells, share, against):
            return tried(cells[0], 0.2 if cells[0] >= 30 else 0.0)

    alone, rounds = [tried(10, 0.2)], [(10,), (20,), (30,), (40,)]
    assert [t.cells for t in _held(Games(), list(alone), 0.1, rounds, lambda words: None)] == [(30,)]
    assert list(_held(Games(), list(alone), 0.1, rounds[:2], lambda words: None)) == []


@pytest.mark.parametrize("limit", np.linspace(0.5, 3.0, 40))
def test_values_that_are_rounded_up_stay_within_what_the_drive_gives(limit):
    """A step of two digits, times half of the values: rounded up it may pass a limit just above what is needed."""
    for half in (limit, limit * 0.998, limit * 0.97):
        assert 0.8 * half < step_of(half, 15, limit) * 7 <= limit


def test_postures_that_do_not_rest_are_refused_with_what_moves():
    q, v, u = (symbol(n) for n in ("q", "v", "u"))
    two = SymbolicModel(
        (Variable("q", "rad"), Variable("v", "rad/s")), (Variable("u", "N*m"),), {}, (v + u, -14.715 * sp.sin(q))
    )
    with pytest.raises(UserError, match=r"no input holds the posture q=0.5, v=0: v changes by -7.05"):
        posture_of(two, {"q": 0.5})
    with pytest.raises(UserError, match="are not states"):
        posture_of(two, {"w": 0.5})
    held = posture_of(pendulum(top=False), {"q": 0.5})
    assert held.u[0] == pytest.approx(14.715 * np.sin(0.5) / 3.0)
    assert held.rate == pytest.approx(np.sqrt(14.715 * np.cos(0.5)))


def test_a_posture_is_solved_for_what_is_not_named():
    """A magnet holds .05 kg at 6 mm with i = z sqrt(m g / k); a current that is named moves by 2 % at most."""
    v, i, z, e = (symbol(n) for n in ("v", "i", "z", "e"))
    levitation = SymbolicModel(
        (Variable("z", "m"), Variable("v", "m/s"), Variable("i", "A")), (Variable("e", "V"),), {},
        (v, 9.81 - 6.53e-5 / 0.05 * i**2 / z**2, (e - 10.0 * i) / 0.4), (Coordinate("ball", "z", "v"),),
    )  # fmt: skip
    holds = 0.006 * np.sqrt(0.05 * 9.81 / 6.53e-5)
    for at in ({"z": 0.006}, {"z": 0.006, "i": 0.521}):
        found = posture_of(levitation, at)
        np.testing.assert_allclose(found.x, [0.006, 0.0, holds], atol=1e-9)
        assert found.u[0] == pytest.approx(10.0 * holds)
    with pytest.raises(UserError, match=r"It rests at z=0.006, i=0.520013"):
        posture_of(levitation, {"z": 0.006, "i": 0.9})


def test_an_input_that_acts_by_its_square_holds_a_posture():
    """Where it is 0 it moves nothing to first order: no step led away from there."""
    v, i, z = (symbol(n) for n in ("v", "i", "z"))
    magnet = SymbolicModel(
        (Variable("z", "m"), Variable("v", "m/s")), (Variable("i", "A"),), {},
        (v, 9.81 - 2.4e-5 / 0.05 * i**2 / z**2), (Coordinate("ball", "z", "v"),),
    )  # fmt: skip
    assert abs(posture_of(magnet, {"z": 0.006}).u[0]) == pytest.approx(0.006 * np.sqrt(0.05 * 9.81 / 2.4e-5))


def test_a_pole_whose_mass_is_not_quite_above_its_hinge_rests_beside_the_place_that_is_named():
    """A centre of mass 1 mm off its axis: at q = 0 it falls. It moves by .02 rad at most."""
    q, v, u = (symbol(n) for n in ("q", "v", "u"))
    for off, rests in ((0.002, True), (0.05, False)):
        pole = SymbolicModel(
            (Variable("q", "rad"), Variable("v", "rad/s")), (Variable("u", "N*m"),), {},
            (v + 0 * u, 9.81 * sp.sin(q + off)), (Coordinate("hinge", "q", "v"),),
        )  # fmt: skip
        if rests:
            np.testing.assert_allclose(posture_of(pole, {"q": 0.0}).x, [-off, 0.0], atol=1e-9)
        else:
            with pytest.raises(UserError, match=r"It rests at q=-0.05"):
                posture_of(pole, {"q": 0.0})


def test_an_input_that_moves_nothing_is_named():
    model = pendulum(push=0.0)
    with pytest.raises(UserError, match="u moves nothing at this posture") as refused:
        propose(model, sampled(model), {}, {}, {})
    assert refused.value.key == "plant.inputs.u"


@pytest.mark.parametrize("top", [True, False])
@pytest.mark.parametrize(("push", "limit"), [(3.0, 1e-6), (3e-6, 1.0)])
def test_inputs_that_move_next_to_nothing_are_the_reason_for_an_X_without_size(top, push, limit):
    model = pendulum(top, push)
    with pytest.raises(UserError, match="the inputs hardly move anything: u ") as refused:
        propose(model, sampled(model), {}, {"u": limit}, {})
    assert refused.value.key == "domain.U"


def test_a_state_without_room_is_the_reason_for_an_X_without_size():
    model = pendulum()
    with pytest.raises(UserError, match="q has no room: its limits are -1e-05 and 1e-05") as refused:
        propose(model, sampled(model), {}, {}, {"q": (-1e-5, 1e-5)})
    assert refused.value.key == "domain.X.q"


def test_an_arm_of_two_motors_has_the_same_reasons():
    model = arm()
    with pytest.raises(UserError, match="the inputs hardly move anything"):
        propose(model, sampled(model), {}, {"u1": 1e-6, "u2": 1e-6}, {})
    with pytest.raises(UserError, match="q1 has no room"):
        propose(model, sampled(model), {}, {"u1": 0.5, "u2": 3.0}, {"q1": (-1e-5, 1e-5)})


def test_an_arm_that_its_motors_do_not_hold_is_told_so_and_not_that_it_lacks_room():
    with pytest.raises(UserError, match=r"^--at: holding the posture takes 0\.\d+ of u1, its limit is 0\.01"):
        propose(arm(), sampled(arm()), {"q2": 1.0}, {"u1": 0.01, "u2": 9.0}, {})


def test_equations_that_are_in_other_units_are_told_from_ones_that_no_input_moves():
    v, u = symbol("v"), symbol("u")
    states = (Variable("q", "rad"), Variable("v", "rad/s"))
    still = SymbolicModel(states, (Variable("u", "N*m"),), {}, (1e-9 * v, 1e-9 * u), (Coordinate("hinge", "q", "v"),))
    with pytest.raises(UserError, match="without input the plant hardly moves"):
        propose(still, sampled(still), {}, {}, {})
    apart = SymbolicModel(states, (Variable("u", "N*m"),), {}, (u, v), ())
    with pytest.raises(UserError, match="what v does is moved by no input"):
        propose(apart, sampled(apart), {}, {}, {})


def test_two_digits():
    assert [rounded(v) for v in (0.0, 0.0456, 1234.0, -0.999)] == [0.0, 0.046, 1200.0, -1.0]
    assert [rounded(v, math.floor) for v in (0.0459, 0.05, 1290.0)] == [0.045, 0.05, 1200.0]


def test_no_step_from_the_proposed_X_ends_at_a_stop():
    """A cart on a short rail: from the worst corner of X and with every input its next place is still on the rail."""
    v, u = symbol("v"), symbol("u")
    model = SymbolicModel(
        (Variable("x", "m"), Variable("v", "m/s")), (Variable("u", "N"),), {}, (v, 2.0 * u),
        (Coordinate("slide", "x", "v"),),
    )  # fmt: skip
    found = propose(model, sampled(model), {}, {}, {"x": (-0.2, 0.2)})
    (_, place), (_, speed), (_, most, _) = found.X["x"], found.X["v"], found.U["u"]
    assert place > 0.02
    assert place + found.tau * speed + 0.5 * found.tau**2 * 2.0 * most < 0.2


def arm(pull=9.0):
    """Two joints with a motor each, one pulling at the other."""
    q2, v1, v2, u1, u2 = (symbol(n) for n in ("q2", "v1", "v2", "u1", "u2"))
    return SymbolicModel(
        (Variable("q1", "rad"), Variable("q2", "rad"), Variable("v1", "rad/s"), Variable("v2", "rad/s")),
        (Variable("u1", "N*m"), Variable("u2", "N*m")), {},
        (v1, v2, 4 * u1 - 3 * u2 - v1, pull * u2 - 3 * u1 - v2 - sp.sin(q2)),
        (Coordinate("shoulder", "q1", "v1"), Coordinate("elbow", "q2", "v2")),
    )  # fmt: skip


def test_an_arm_with_two_motors_gets_a_box_to_reach_within_its_limits():
    model, heard = arm(), []
    found = propose(model, sampled(model), {}, {"u1": 0.5, "u2": 3.0}, {"q1": (-0.5, 0.5)}, heard.append)
    assert found.wins >= WINS
    assert found.free == ("q1",)
    assert found.U["u1"][1] <= 0.5
    (_, place), (_, speed) = found.X["q1"], found.X["v1"]
    assert place + found.tau * speed < 0.5
    for name, (lo, hi) in found.target.items():
        assert found.X[name][0] < lo < hi < found.X[name][1]
    assert any("trying 16 cells along each axis" in words for words in heard)
    assert "the inputs' limits" in found.narrowed


def test_a_stop_nearby_asks_for_weaker_torques(monkeypatch):
    def play(self, half, inputs, cells):
        return (0.5, "") if (half > 0).all() else (None, "no room")

    monkeypatch.setattr(driven_arm.Arm, "play", play)
    model = arm()
    found = propose(model, sampled(model), {}, {"u1": 0.5, "u2": 3.0}, {"q1": (-0.02, 0.5)})
    (_, place), (_, speed) = found.X["q1"], found.X["v1"]
    assert 0.0 < place < 0.02 - found.tau * speed
    assert found.U["u1"][1] < 0.5


def test_a_search_is_ended_when_its_time_is_up_and_the_last_that_it_found_is_taken():
    def search(tell):
        yield 1
        tell("on the way")
        yield 2
        while True:
            pass

    heard, before = [], os.times()
    assert last_within(0.3, search, heard.append) == 2
    after = os.times()
    assert heard == ["on the way"]
    assert 0.2 < after.children_user + after.children_system - before.children_user - before.children_system < 0.6
    assert last_within(0.0, lambda tell: iter(int, 1), heard.append) in (None, 0)
    for model in (pendulum(), arm()):
        with pytest.raises(UserError, match="not found in the time, which does not suffice"):
            propose(model, sampled(model), {}, {}, {}, seconds=0.01)


def test_what_a_search_raises_or_dies_of_is_no_answer():
    def fails(tell):
        raise ZeroDivisionError("within")
        yield 1

    def refuses(tell):
        raise UserError("no such plant", remedy="Give another.")
        yield 1

    with pytest.raises(RuntimeError, match="ZeroDivisionError: within"):
        last_within(10.0, fails, print)
    with pytest.raises(UserError, match="no such plant"):
        last_within(10.0, refuses, print)
    with pytest.raises(UserError, match=r"^the search was ended from outside \(signal 9\)\. Check that its memory"):
        last_within(10.0, lambda tell: os.kill(os.getpid(), signal.SIGKILL), print)


PARENT = """
import os, sys, time
from simgap.deadline import last_within
def search(tell):
    print(os.getpid(), flush=True)
    while True:
        pass
    yield
last_within(60.0, search, print)
"""


def test_a_search_ends_with_the_command_that_is_killed():
    command = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    child = os.pidfd_open(int(command.stdout.readline()))
    command.kill()
    assert select.select([child], [], [], 5.0)[0], "it lives on"
    command.communicate()
    os.close(child)


def test_what_was_found_before_a_search_fails_or_dies_is_its_answer():
    def fails(tell):
        yield 1
        raise ZeroDivisionError("within")

    def dies(tell):
        yield 2
        os.kill(os.getpid(), signal.SIGKILL)

    def refused(tell):
        yield UserError("not yet")
        raise UserError("never")

    assert last_within(math.inf, fails, print) == 1
    with pytest.raises(UserError, match="never"):
        last_within(math.inf, refused, print)
    assert last_within(10.0, dies, print) == 2


@pytest.mark.parametrize("size", [2, 6])
def test_a_search_that_is_ended_while_it_sends_has_found_what_it_sent_before(size):
    """Within the length of a message, and within the message."""

    def search(count):
        def cut(pipe, content):
            os.write(pipe.fileno(), bytes(content)[:size])
            os.kill(os.getpid(), signal.SIGKILL)

        def found(tell):
            yield from range(count)
            Connection._send = cut  # of the process that searches
            yield count

        return found

    assert last_within(10.0, search(3), print) == 2
    with pytest.raises(UserError, match=r"ended from outside \(signal 9\)"):
        last_within(10.0, search(0), print)


def test_a_step_in_which_the_inputs_do_nothing_is_told_from_inputs_that_are_weak():
    """Joints whose damping ends every motion in a thousandth of a second."""
    model = arm()
    heavy = replace(
        model,
        xdot=(*model.xdot[:2], *(e - 1000 * v.symbol for e, v in zip(model.xdot[2:], model.states[2:], strict=True))),
    )
    with pytest.raises(
        UserError, match=r"rate of 1e\+03 1/s, and in the tau of 0.0007 s that this asks for the inputs"
    ):
        propose(heavy, sampled(heavy), {}, {"u1": 0.5, "u2": 3.0}, {})
