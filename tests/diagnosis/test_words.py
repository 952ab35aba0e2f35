"""The sentence that a person acts on."""

import pytest

from simgap.diagnosis.verdict.words import describe, phrase, verdict_sentence
from simgap.notation import pretty_unit, with_error


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (0.19, 0.01, "0.19 ± 0.01 N m"),
        (0.1912, 0.0123, "0.191 ± 0.012 N m"),
        (0.75, 0.031, "0.75 ± 0.03 N m"),
        (15.02, 0.4, "15.0 ± 0.4 N m"),
        (1234.0, 35.0, "1234 ± 35 N m"),
        (15.2, 0.0, "15.2 N m"),
        (2.0, float("nan"), "2 N m"),
    ],
)
def test_digits_follow_the_uncertainty(value, half, text):
    assert with_error(value, half, "N*m") == text


def test_units():
    assert pretty_unit("N*m*s/rad") == "N m s/rad"
    assert pretty_unit("kg*m^2") == "kg m²"
    assert pretty_unit("m*s**-2") == "m s⁻²"
    assert pretty_unit("1") == ""


def effect(name, on, alternatives=(), **numbers):
    parameters = {s: {"value": v, "ci95": [v - h, v + h], "unit": u} for s, (v, h, u) in numbers.items()}
    return {"name": name, "on": on, "parameters": parameters, "alternatives": list(alternatives)}


FRICTION = effect("coulomb_friction", "hinge", F_c=(0.19, 0.01, "N*m"))
MASS = effect("parameter_error", "rod.mass", [[{"name": "input_gain", "on": "torque"}]], ratio=(0.75, 0.001, "1"))


def document(verdict, effects, **more):
    error = {"horizon_s": 0.2, "horizon_rmse": {"q": 0.02}, "fit_rmse": {"q": 0.01}}
    return {
        "verdict": verdict,
        "effects": effects,
        "explained_share": 0.84,
        "error": {"before": error, "after": error, "noise_floor": error},
        "candidates": effects,
        "warnings": [],
        "units": {"q": "rad"},
        **more,
    }


def test_every_effect_of_the_library_has_words():
    from simgap.effects import EFFECTS

    for e in EFFECTS.values():
        numbers = {p.symbol: (0.5, 0.01, p.unit) for p in e.parameters}
        text = describe(effect(e.name, "hinge", **numbers))
        assert "0.5" in text or "50" in text or "500" in text or "28.6" in text or e.name == "cogging", text
        assert "_" not in text.replace("F_c", "").replace("F_s", "")
        assert "_" not in phrase({"name": e.name, "on": "hinge"})


def test_sentences():
    assert (
        verdict_sentence(document("attributed", [FRICTION]))
        == "Coulomb friction of 0.19 ± 0.01 N m at the hinge explains 84 % of the excess error."
    )
    both = verdict_sentence(document("attributed", [FRICTION, MASS]))
    assert "a mass of the rod that is 25.0 ± 0.1 % below its declared value together explain 84 %" in both
    assert "the mass of the rod and the gain of torque cannot be told apart from this data" in both
    partial = verdict_sentence(document("partial", [FRICTION], remainder=None))
    assert "An error of 0.02 rad in q is left 0.2 s ahead that nothing in the library explains" in partial
    assert "gamma" not in partial
    assert "no effect is missing" in verdict_sentence(document("none", []))
    nothing = verdict_sentence(document("unexplained", [], candidates=[FRICTION]))
    assert "nearest is Coulomb friction at the hinge" in nothing
