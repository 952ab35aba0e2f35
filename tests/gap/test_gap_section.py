import json

import pytest
from pydantic import ValidationError

from simgap.config.case import schema_text
from simgap.config.gap import GapSection
from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.gap.bases import Blocks, Expressions


def test_defaults_are_the_tightest():
    settings = GapSection(basis=("x1", "1"))
    assert (settings.objective, settings.sides, settings.padding) == ("lexicographic", "signed", "inflate")
    assert settings.basis == Expressions(terms=("x1", "1"))


def test_a_kind_with_options():
    settings = GapSection(basis={"kind": "blocks", "blocks": [4, 4]})
    assert settings.basis == Blocks(blocks=(4, 4))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"basis": {"kind": "fourier"}}, "no basis is called 'fourier'. Known: expressions, monomials"),
        ({"basis": {"degree": 2}}, "needs the key 'kind', one of expressions, monomials"),
        ({"basis": ["1"], "padding": "none"}, "padding"),
        ({"basis": ["1"], "objective": "min"}, "objective"),
        ({"basis": ["1"], "sides": "both"}, "sides"),
        ({"basis": ["1"], "fresh_samples": 0}, "fresh_samples"),
        ({"basis": ["1"], "colour": "red"}, "colour"),
    ],
)
def test_mistakes(content, says):
    with pytest.raises(ValidationError, match=says):
        GapSection(**content)


@pytest.mark.parametrize(
    ("basis", "says"),
    [
        ({"kind": "monomials", "harmonics": 2}, "gap.basis.harmonics: unknown key. Known: kind, degree."),
        ({"kind": "monomials", "degree": -1}, "gap.basis.degree: the number must be at least 0"),
        ([], "gap.basis.terms: the basis has no terms; list at least the constant 1"),
        ({"kind": "fourier"}, "gap.basis: no basis is called 'fourier'"),
    ],
)
def test_a_wrong_option_is_one_line_with_its_key(vary, basis, says):
    with pytest.raises(UserError) as caught:
        load_case(vary("pendulum", {"gap.basis": basis}))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_key_is_described():
    defs = json.loads(schema_text())["$defs"]
    names = ("GapSection", "RemainderWithin", "LipschitzSection")
    assert all("description" in key for name in names for key in defs[name]["properties"].values())
