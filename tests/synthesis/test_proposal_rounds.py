"""What the wizard says of a plant whose cells are too many, without playing any game."""

import math
from types import SimpleNamespace

from simgap.extras.wizard.proposal import PAIRS, Search, _too_few


def _search(cells: tuple[float, ...]) -> Search:
    shape = SimpleNamespace(cells=cells, size=math.prod(cells), tau=0.06)
    return Search(SimpleNamespace(inputs=(1,)), None, None, shape, {}, {})


def test_cells_that_are_too_many_are_not_tried():
    search = _search((9000.0, 300.0, 2000.0, 17.0))  # an acrobot that stands up, by one motor
    assert list(search.rounds()) == []
    error = _too_few(search, [], "they are beyond a quick search", begin="Give")
    assert error.remedy == "Give it another input or stronger ones, or begin with fewer states."
    assert str(error).startswith("synthesis.cells: by its linear model it takes about")


def test_rounds_grow_to_what_is_affordable():
    found = list(_search((20.0, 20.0)).rounds())
    assert found[0] == (20, 20)
    assert all(a * b * 15 <= PAIRS for a, b in found)
    assert [a * b for a, b in found] == sorted(a * b for a, b in found)
