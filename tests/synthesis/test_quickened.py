"""A game that is played faster: the same cells, torques that stand out against the friction, limits kept."""

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.extras.wizard.driven_arm import Proposal
from simgap.extras.wizard.propose import TIMES, quickened

SLOW = Proposal(
    0.1, {"q": (-0.2, 0.2), "v": (-0.5, 0.5)}, {"u": (-0.2, 0.2, 0.1)}, (37, 37), 0.4, (), 1.0,
    {"q": (-0.06, 0.06), "v": (-0.2, 0.2)}, 0.04,
)  # fmt: skip


def game(proposal, mass=0.3):
    """What a step does in cells and shares of X, for a mass on a table: all that a frictionless arm's game sees."""
    half = {n: hi for n, (_, hi) in proposal.X.items()}
    return (
        half["v"] * proposal.tau / half["q"],
        proposal.U["u"][1] / mass * proposal.tau / half["v"],
        proposal.target["v"][1] / half["v"],
    )


def test_it_is_the_same_game_with_torques_that_are_large_beside_the_friction():
    fast = quickened(SLOW, {"v"}, {"u": 0.5}, {}, {})
    assert fast.U["u"][1] >= TIMES * 0.5 * 0.97  # two digits
    assert fast.tau < SLOW.tau / 3
    assert game(fast) == pytest.approx(game(SLOW), rel=0.06)  # tau and step in two digits
    assert fast.X["q"] == SLOW.X["q"]
    lo, hi, step = fast.U["u"]
    assert (hi - lo) / step == pytest.approx(4)


def test_little_friction_changes_nothing():
    assert quickened(SLOW, {"v"}, {"u": 0.02}, {"u": 0.2}, {}) is SLOW
    assert quickened(SLOW, {"v"}, {}, {}, {}) is SLOW


def test_what_drive_or_joint_does_not_allow_is_refused_with_the_reason():
    with pytest.raises(UserError, match=r"takes u up to 3\.6, and the drive gives 2"):
        quickened(SLOW, {"v"}, {"u": 0.5}, {"u": 2.0}, {})
    with pytest.raises(UserError, match=r"takes v up to 2\.1, and the joint's velocity limit is 1"):
        quickened(SLOW, {"v"}, {"u": 0.5}, {}, {"v": (-1.0, 1.0)})
    held = Proposal(0.1, SLOW.X, SLOW.U, (37, 37), 0.4, (), 1.0)
    with pytest.raises(UserError, match=r"holding the posture takes 0\.2 of u, the dry friction there is 0\.5"):
        quickened(held, {"v"}, {"u": 0.5}, {}, {})
    assert quickened(held, {"v"}, {"u": 0.05}, {}, {}) is held
    assert np.isfinite(held.tau)
