"""Results of the dimensions are put together only if they were made of this very case, on this grid."""

import pytest

from simgap.errors import UserError
from simgap.io.results import write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.stages.gap_inputs import read_dimensions


@pytest.fixture
def results(vary, tmp_path):
    context, other = Context.load(vary("pendulum", {})), Context.load(vary("pendulum", {"gap.padding": "per_axis"}))

    def write(of, *states, stage="scp", point="eps~0.0022"):
        path = tmp_path / "made.json"
        record = provenance(stage, of.case, of.folder, point=point)
        write_json(path, {"states": {state: {"state": state} for state in states}, "provenance": record})
        return path

    return context, other, write


def test_results_of_this_case_are_taken(results):
    context, _, write = results
    found = read_dimensions(context, "scp", "eps~0.0022", write(context, "x1", "x2"))
    assert sorted(found) == ["x1", "x2"]


def test_results_of_anything_else_are_refused(results):
    context, other, write = results
    for of, given, told in (
        (other, {}, "differs in gap.padding=inflate"),
        (context, {"stage": "lipschitz"}, "not what `scp` makes, but `lipschitz`"),
        (context, {"point": "eps~0.1"}, "of the grid eps~0.1, not eps~0.0022"),
    ):
        path = write(of, "x1", "x2", **given)
        with pytest.raises(UserError, match=told) as caught:
            read_dimensions(context, "scp", "eps~0.0022", path)
        assert caught.value.file == path
    with pytest.raises(UserError, match="no result for x2"):
        read_dimensions(context, "scp", "eps~0.0022", write(context, "x1"))
