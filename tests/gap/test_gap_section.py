import pytest
from pydantic import ValidationError

from simgap.config.gap import GapSection
from simgap.gap.settings import GapSettings


def test_defaults_are_the_tightest():
    settings = GapSettings.of(GapSection(basis=("x1", "1")))
    assert (settings.objective, settings.sides, settings.padding, settings.bound) == (
        "lexicographic",
        "signed",
        "inflate",
        "scenario",
    )
    assert settings.basis == "expressions"
    assert settings.basis_options == {"terms": ("x1", "1")}


def test_a_kind_with_options():
    settings = GapSettings.of(GapSection(basis={"kind": "blocks", "blocks": [4, 4]}))
    assert settings.basis == "blocks"
    assert settings.basis_options == {"blocks": (4, 4)}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"basis": {"kind": "fourier"}}, "Known bases: monomials"),
        ({"basis": {"kind": "monomials", "harmonics": 2}}, "no option harmonics"),
        ({"basis": []}, "no terms"),
        ({"basis": ["1"], "padding": "none"}, "padding"),
        ({"basis": ["1"], "fresh_samples": 0}, "fresh_samples"),
        ({"basis": ["1"], "colour": "red"}, "colour"),
        ({"basis": ["1"], "bound": "conformal"}, "tolerated_probability above that, such as 0.012; it is 0"),
        ({"basis": ["1"], "bound": "conformal", "tolerated_probability": 0.01}, "tolerated_probability above"),
        ({"basis": ["1"], "bound": "conformal", "tolerated_probability": 0.02, "seed": 3}, "both 3"),
    ],
)
def test_mistakes(content, says):
    with pytest.raises(ValidationError, match=says):
        GapSection(**content)


def test_every_key_is_described():
    schema = GapSection.model_json_schema()
    sections = [schema, *schema["$defs"].values()]
    assert all("description" in key for section in sections for key in section["properties"].values())
