"""The sentence that a person acts on."""

import itertools
import math

import pytest

from simgap.diagnosis.verdict.words import describe, phrase, verdict_parts
from simgap.notation import from_to, pretty_unit, with_error


def said(document):
    return " ".join(verdict_parts(document))


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (0.19, 0.01, "0.19 ± 0.01 N m"),
        (0.1912, 0.0123, "0.191 ± 0.012 N m"),
        (0.75, 0.031, "0.75 ± 0.03 N m"),
        (15.02, 0.4, "15.0 ± 0.4 N m"),
        (1234.0, 35.0, "1234 ± 35 N m"),
        (15.2, 0.0, "15.2 N m"),
        (4e-4, 3e-8, "(4.0000 ± 0.0003)·10⁻⁴ N m"),
        (0.0, 3e-9, "(0 ± 3)·10⁻⁹ N m"),
        (150128007.0, 81915.0, "(1.5013 ± 0.0008)·10⁸ N m"),
        (2.0, float("nan"), "2 N m"),
    ],
)
def test_digits_follow_the_uncertainty(value, half, text):
    assert with_error(value, half, "N*m") == text


@pytest.mark.parametrize(
    ("start", "stop", "text"),
    [(4.1, 4.3, "4.1 to 4.3 s"), (12.34123, 12.34821, "12.3412 to 12.3482 s"), (0.0, 1234.4, "0 to 1234 s")],
)
def test_digits_of_times_follow_how_long_they_last(start, stop, text):
    assert from_to(start, stop) == text


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


def _errors(size):
    return {"horizon_s": 0.2, "horizon_rmse": {"q": size}, "fit_rmse": {"q": 0.5 * size}}


ERROR = {"before": _errors(0.05), "after": _errors(0.02), "noise_floor": _errors(0.005)}


def document(verdict, effects, **more):
    return {
        "verdict": verdict,
        "effects": effects,
        "explained_share": 0.84,
        "error": ERROR,
        "candidates": effects,
        "warnings": [],
        "units": {"q": "rad"},
        **more,
    }


# effect -> on, its numbers (value, half width, unit), with numbers, without
SAID = {
    "viscous_friction": (
        "hinge", {"b": (0.5, 0.01, "N*m*s/rad")},
        "viscous friction of 0.50 ± 0.01 N m s/rad at the hinge", "viscous friction at the hinge",
    ),
    "coulomb_friction": (
        "hinge", {"F_c": (0.19, 0.01, "N*m")},
        "Coulomb friction of 0.19 ± 0.01 N m at the hinge", "Coulomb friction at the hinge",
    ),
    "stribeck_friction": (
        "hinge", {"F_c": (0.1, 0.02, "N*m"), "F_s": (0.3, 0.05, "N*m"), "v_s": (0.2, 0.1, "rad/s")},
        "Stribeck friction at the hinge (0.30 ± 0.05 N m to break away, 0.10 ± 0.02 N m when sliding)",
        "Stribeck friction at the hinge",
    ),
    "dahl_friction": (
        "hinge", {"F_c": (0.19, 0.01, "N*m"), "d": (0.02, 0.001, "rad")},
        "Dahl friction of 0.19 ± 0.01 N m at the hinge that turns round over 0.020 ± 0.001 rad",
        "Dahl friction at the hinge",
    ),
    "lugre_friction": (
        "hinge",
        {
            "F_c": (0.19, 0.01, "N*m"), "d": (0.02, 0.001, "rad"), "rise": (0.6, 0.03, "1"),
            "v_s": (0.1, 0.01, "rad/s"), "sigma_1": (0.02, 0.01, "N*m*s/rad"),
        },
        "LuGre friction of 0.19 ± 0.01 N m at the hinge, 60 ± 3 % more below 0.10 ± 0.01 rad/s, "
        "that turns round over 0.020 ± 0.001 rad",
        "LuGre friction at the hinge",
    ),
    "joint_elasticity": (
        "hinge", {"I": (0.02, 0.001, "kg*m^2"), "k": (40.0, 1.0, "N*m/rad"), "c": (0.1, 0.01, "N*m*s/rad")},
        "elasticity of the hinge (40 ± 1 N m/rad) before a motor of 0.020 ± 0.001 kg m²", "elasticity of the hinge",
    ),
    "elasticity_behind_encoder": (
        "hinge", {"I": (0.02, 0.001, "kg*m^2"), "k": (40.0, 1.0, "N*m/rad"), "c": (0.1, 0.01, "N*m*s/rad")},
        "elasticity of the hinge (40 ± 1 N m/rad) behind the encoder of a motor of 0.020 ± 0.001 kg m²",
        "elasticity of the hinge behind its encoder",
    ),
    "backlash": (
        "hinge", {"b": (0.02, 0.001, "rad"), "I": (0.02, 0.001, "kg*m^2")},
        "backlash of 0.020 ± 0.001 rad at the hinge, crossed by a motor of 0.020 ± 0.001 kg m²",
        "backlash of the hinge",
    ),
    "directional_friction": (
        "hinge", {"F_p": (0.2, 0.01, "N*m"), "F_m": (0.3, 0.01, "N*m")},
        "directional friction at the hinge (0.20 ± 0.01 N m forwards, 0.30 ± 0.01 N m backwards)",
        "directional friction at the hinge",
    ),
    "load_friction": (
        "torque", {"mu": (0.12, 0.01, "1")},
        "load-dependent friction of 12 ± 1 % of the torque", "load-dependent friction of the torque",
    ),
    "constant_force": (
        "hinge", {"F_0": (0.5, 0.01, "N*m")},
        "a constant force of 0.50 ± 0.01 N m at the hinge", "constant force at the hinge",
    ),
    "input_directional_gain": (
        "torque", {"ratio_p": (1.2, 0.01, "1"), "ratio_m": (0.9, 0.01, "1")},
        "a gain of torque that differs with the sign (20 ± 1 % above for positive, 10 ± 1 % below for negative "
        "commands)",
        "the directional gain of torque",
    ),
    "payload": (
        "rod", {"m_p": (0.3, 0.01, "kg"), "r": (0.8, 0.02, "m")},
        "a payload of 0.30 ± 0.01 kg on the rod, 0.80 ± 0.02 m from its joint", "a payload on the rod",
    ),
    "sensor_gain": (
        "angle", {"ratio": (1.05, 0.01, "1")},
        "a gain of the sensor of angle that is 5 ± 1 % above the declared one", "the gain of the sensor of angle",
    ),
    "input_curve": (
        "torque", {n: (v, 0.01, "1") for n, v in (("g_0", 1.0), ("g_1", 0.8), ("g_2", 0.5), ("U", 3.0))},
        "a gain of torque that changes with its size (1.00 ± 0.01 at small, 0.80 ± 0.01 at half, 0.50 ± 0.01 at full "
        "command, of the declared one)",
        "the gain curve of torque",
    ),
    "torque_speed_limit": (
        "torque", {"T_s": (2.1, 0.1, "N*m"), "k": (0.3, 0.01, "N*m*s/rad")},
        "a torque-speed limit of torque (2.1 ± 0.1 N m at rest, less 0.30 ± 0.01 N m s/rad times the speed)",
        "the torque-speed limit of torque",
    ),
    "reflected_inertia": (
        "hinge", {"I": (0.02, 0.001, "kg*m^2")},
        "a reflected inertia of 0.020 ± 0.001 kg m² at the hinge", "reflected inertia at the hinge",
    ),
    "quadratic_drag": (
        "hinge", {"c": (0.5, 0.01, "N*m*s^2/rad^2")},
        "quadratic drag of 0.50 ± 0.01 N m s²/rad² at the hinge", "quadratic drag at the hinge",
    ),
    "spring": (
        "hinge", {"k": (0.5, 0.01, "N*m/rad")},
        "a spring of 0.50 ± 0.01 N m/rad at the hinge", "spring at the hinge",
    ),
    "cubic_spring": (
        "hinge", {"k3": (0.5, 0.01, "N*m/rad^3")},
        "a cubic spring of 0.50 ± 0.01 N m/rad³ at the hinge", "cubic spring at the hinge",
    ),
    "cogging": (
        "hinge", {"A": (0.05, 0.01, "N*m"), "n": (6.0, 0.0, "1/rad"), "phase": (0.4, 0.1, "rad")},
        "cogging of 0.05 ± 0.01 N m with 6 periods a turn at the hinge", "cogging at the hinge",
    ),
    "input_gain": (
        "torque", {"ratio": (1.2, 0.01, "1")},
        "a gain of torque that is 20 ± 1 % above the declared one", "the gain of torque",
    ),
    "input_bias": (
        "torque", {"bias": (-0.5, 0.01, "N*m")},
        "a bias of -0.50 ± 0.01 N m on torque", "the bias of torque",
    ),
    "input_delay": (
        "torque", {"delay": (0.0073, 0.0002, "s")},
        "a delay of 7.3 ± 0.2 ms on torque", "the delay of torque",
    ),
    "input_lag": ("torque", {"T": (0.5, 0.01, "s")}, "a lag of 500 ± 10 ms on torque", "the lag of torque"),
    "input_dead_zone": (
        "torque", {"width": (0.5, 0.01, "N*m")},
        "a dead zone of ±(0.50 ± 0.01 N m) on torque", "the dead zone of torque",
    ),
    "input_saturation": (
        "torque", {"limit": (1.5, 0.03, "N*m")},
        "a limit of 1.50 ± 0.03 N m on torque", "the saturation of torque",
    ),
    "sensor_offset": (
        "angle", {"offset": (0.5, 0.01, "rad")},
        "an offset of 0.50 ± 0.01 rad of the sensor of angle", "an offset of the sensor of angle",
    ),
    "parameter_error": (
        "rod.com", {"ratio": (0.8, 0.01, "1")},
        "a centre of mass of the rod that is 20 ± 1 % below its declared value", "the centre of mass of the rod",
    ),
    "gravity_tilt": (
        "plant", {"tilt": (math.pi / 60, math.pi / 1800, "rad")},
        "a base tilted by 3.0 ± 0.1 deg", "a base tilt",
    ),
    "wheel_mismatch": (
        "plant", {"ratio": (1.05, 0.01, "1")},
        "a right wheel whose radius is 5 ± 1 % above the declared one", "unequal wheels",
    ),
    "rolling_resistance": (
        "plant", {"loss": (0.02, 0.001, "m/s")},
        "rolling resistance that takes 0.020 ± 0.001 m/s from the speed of each wheel",
        "rolling resistance of the wheels",
    ),
    "force_curve": (
        "hinge",
        {f"F_{k}": (0.1 * k, 0.01, "N*m") for k in range(11)} | {"low": (-1.0, 0.0, "rad"), "high": (3.0, 0.0, "rad")},
        "a force at the hinge that depends on the place (0.00 ± 0.01 N m at -1, 0.50 ± 0.01 N m at 1, "
        "1.00 ± 0.01 N m at 3; a table of eleven values)",
        "a force at the hinge that depends on the place",
    ),
    "lateral_slip": ("plant", {"ratio": (0.05, 0.01, "1")}, "sideways slip of 5 ± 1 % of the speed", "sideways slip"),
}  # fmt: skip


def test_every_effect_of_the_library_has_words():
    from simgap.effects import EFFECTS

    assert set(SAID) == set(EFFECTS)


@pytest.mark.parametrize("name", SAID)
def test_an_effect_is_told_with_its_numbers(name):
    on, numbers, told, named = SAID[name]
    assert describe(effect(name, on, **numbers)) == told
    assert phrase({"name": name, "on": on}) == named


def test_sentences():
    assert (
        said(document("attributed", [FRICTION]))
        == "Coulomb friction of 0.19 ± 0.01 N m at the hinge explains 84 % of the excess error 0.2 s ahead."
    )
    both = said(document("attributed", [FRICTION, MASS]))
    assert "a mass of the rod that is 25.0 ± 0.1 % below its declared value together explain 84 %" in both
    assert "The mass of the rod and the gain of torque cannot be distinguished by these data" in both
    partial = said(document("partial", [FRICTION], remainder=None))
    assert "An error of 0.02 rad in q is left 0.2 s ahead for which no explanation in the library was found" in partial
    assert "gamma" not in partial
    loud = {**ERROR, "noise_floor": _errors(0.02)}
    assert "is no larger than the noise of the readings" in said(document("partial", [FRICTION], error=loud))
    assert "no effect is missing" in said(document("none", []))
    nothing = said(document("unexplained", [], candidates=[FRICTION]))
    assert nothing.startswith("No effect of the library explains the difference between model and data. Look for ")
    assert "Coulomb" not in nothing  # the first of the list may explain next to nothing


def test_the_limit_on_the_number_of_effects_is_no_end_of_the_library():
    size = {"value": 0.2, "ci95": [0.19, 0.21], "unit": "N*m"}
    effect = {"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": size}}
    document = {"verdict": "partial", "effects": [effect], "explained_share": 0.6, "error": ERROR, "left_over": [],
                "units": {"q": "rad"}, "at_most": 1}  # fmt: skip
    assert "with 1 effects, as many as were sought: allow more by measured.max_effects" in said(document)
    assert "nothing in the library" not in said(document)
    nearest = {"effects": [effect], "explained_share": 0.3, "reasons": ["it explains less than half"]}
    text = said({"verdict": "unexplained", "effects": [], "nearest": nearest, "at_most": 3, "error": ERROR})
    assert "Allow more than 3 effects (measured.max_effects), or look" in text


@pytest.mark.parametrize("count", [1, 2, 3])
def test_what_else_would_help_is_said_however_many_there_are(count):
    """One alone ended the stage with a traceback, on a recording of a real pendulum."""
    over = [{**FRICTION, "share": 0.3}, {**MASS, "share": 0.2}, {**FRICTION, "on": "elbow", "share": 0.1}][:count]
    document = {"verdict": "partial", "effects": [MASS], "explained_share": 0.6, "error": ERROR, "left_over": over,
                "units": {"q": "rad"}}  # fmt: skip
    text = said(document)
    assert "would remove 30 % of it" in text
    assert ("Coulomb friction at the elbow" in text) == (count > 2)
    assert ("(or " in text) == (count > 1)


TOO_MUCH = {"fault": "hum", "channel": "q", "sentence": "A hum of 50 Hz was taken out of q."}
AT = {"from": 1.0, "to": 1.2, "trace": "run"}
CHOICES = {
    "verdict": ("none", "attributed", "partial", "unexplained"),
    "effects": ([], [MASS], [MASS, FRICTION]),
    "left_over": (None, [], [{**FRICTION, "share": 0.3}], [{**FRICTION, "share": 0.3}, {**MASS, "share": 0.2}]),
    "nearest": (None, {"effects": [FRICTION], "explained_share": 0.3, "reasons": ["it is a guess"]}),
    "candidates": ([], [FRICTION]),
    "recording": ([], [TOO_MUCH, TOO_MUCH]),
    "at_most": (None, 3),
    "stopped": ("", "The search was interrupted: the answer is the best of 3 sets of effects."),
    "unconfirmed": ([], ["q", "u"]),
    "faint_memory": ([], ["q"]),
    "doubts": ([], ["Halves of the data give different numbers."]),
    "concentrated": (None, {"stretches": [AT], "explained_share_without": 0.7, "error_share": 0.9}),
    "remainder": (None, {"bounded": False, "reason": "the case has no `gap:` section", "asked": False}),
}


def test_every_answer_has_its_sentences():
    """Of all combinations of what a document may hold: no traceback, no gap, nothing that is no word."""
    seen = set()
    for values in itertools.product(*CHOICES.values()):
        document = {**dict(zip(CHOICES, values, strict=True)), "explained_share": 0.6, "error": ERROR, "warnings": []}
        if bool(document["effects"]) == (document["verdict"] in ("attributed", "partial")):
            seen.add(said(document))
    assert len(seen) > 100
    for text in seen:
        assert text[0].isupper()
        assert text.endswith(".")
        assert ".." not in text
        assert "  " not in text
        assert "None" not in text
        assert "[" not in text


def test_sets_of_several_effects_that_do_as_well_are_kept_apart():
    others = [[{"name": "input_bias", "on": "u"}], [FRICTION, {"name": "parameter_error", "on": "g"}]]
    text = said(document("attributed", [{**MASS, "alternatives": others}]))
    assert "These data do not tell the mass of the rod from " in text
    assert ", or from" not in text
    assert " or from Coulomb friction at the hinge with the parameter g" in text


@pytest.mark.parametrize(
    ("verdict", "begins"), [("attributed", ": Rows are missing. The"), ("partial", ", no surer than the effects: The")]
)
def test_a_fault_that_was_fitted_is_no_surer_than_the_verdict(verdict, begins):
    drifts = {"fault": "drift", "sentence": "The recording has a sensor of q that drifts by 1 rad/s."}
    lost = {"fault": "missing_rows", "sentence": "Rows are missing."}
    text = said(document(verdict, [FRICTION], recording=[lost, drifts]))
    assert "About the recording: Rows are missing." in text
    assert f"About the recording{begins} recording has a sensor of q that drifts" in text


@pytest.mark.parametrize(
    ("tried", "told"),
    [(["viscous_friction"], True), (["viscous_friction", "lugre_friction"], False), (["input_gain"], False)],
)
def test_what_is_sought_by_name_alone_is_told_where_it_could_be(tried, told):
    """A heater has no friction, and who has named an effect need not be told to."""
    document = {"verdict": "unexplained", "effects": [], "candidates": [{"name": name} for name in tried]}
    assert ("lugre_friction" in said(document)) is told
