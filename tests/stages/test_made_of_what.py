"""Results of single dimensions are put together only if they were made of this very case, on this grid."""

import pytest

from simgap.errors import UserError
from simgap.io.documents import write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.stages.gap import by_state


@pytest.fixture
def results(vary, tmp_path):
    context, other = Context.load(vary("pendulum", {})), Context.load(vary("pendulum", {"gap.padding": "per_axis"}))

    def write(of, state, stage="scp", point="eps~0.0022"):
        path = tmp_path / f"{state}-{stage}-{point}-{of is other}.json"
        write_json(path, {"state": state, "provenance": provenance(stage, of.case, of.folder, point=point)})
        return path

    return context, other, write


def test_results_of_this_case_are_taken(results):
    context, _, write = results
    found = by_state(context, "scp", "eps~0.0022", [write(context, "x1"), write(context, "x2")])
    assert sorted(found) == ["x1", "x2"]


def test_results_of_anything_else_are_refused(results):
    context, other, write = results
    own = write(context, "x1")
    for foreign, told in (
        (write(other, "x2"), "differs in gap.padding=inflate"),
        (write(context, "x2", stage="lipschitz"), "not what `scp` makes, but `lipschitz`"),
        (write(context, "x2", point="eps~0.1"), "of the grid eps~0.1, not eps~0.0022"),
    ):
        with pytest.raises(UserError, match=told) as caught:
            by_state(context, "scp", "eps~0.0022", [own, foreign])
        assert caught.value.file == foreign
    with pytest.raises(UserError, match="a second result for x1"):
        by_state(context, "scp", "eps~0.0022", [own, own])
    with pytest.raises(UserError, match="no result for x2"):
        by_state(context, "scp", "eps~0.0022", [own])
