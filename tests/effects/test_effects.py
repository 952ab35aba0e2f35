"""Every effect: vanishes at its null, has the names and units it promises, changes the model as its formula says."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp

from simgap.effects import EFFECTS, AppliedEffect, apply_effects, delays_and_lags, effect
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel, symbol
from tests.effects.plants import unicycle
from tests.undeclared.plant import pendulum

SYMBOLS = {
    "viscous_friction": ["b"], "coulomb_friction": ["F_c"], "stribeck_friction": ["F_c", "F_s", "v_s"],
    "quadratic_drag": ["c"], "spring": ["k"], "cubic_spring": ["k3"], "cogging": ["A", "n", "phase"],
    "input_gain": ["ratio"], "input_bias": ["bias"], "input_delay": ["delay"], "input_lag": ["T"],
    "input_dead_zone": ["width"], "input_saturation": ["limit"], "sensor_offset": ["offset"],
    "parameter_error": ["ratio"], "gravity_tilt": ["tilt"], "wheel_mismatch": ["ratio"], "lateral_slip": ["ratio"],
    "reflected_inertia": ["I"], "constant_force": ["F_0"], "directional_friction": ["F_p", "F_m"],
    "dahl_friction": ["F_c", "d"], "lugre_friction": ["F_c", "d", "rise", "v_s", "sigma_1"], "load_friction": ["mu"],
    "input_directional_gain": ["ratio_p", "ratio_m"], "torque_speed_limit": ["T_s", "k"],
    "sensor_gain": ["ratio"], "input_curve": ["g_0", "g_1", "g_2", "U"],
    "payload": ["m_p", "r"], "rolling_resistance": ["loss"],
    "joint_elasticity": ["I", "k", "c"], "backlash": ["b", "I"],
    "elasticity_behind_encoder": ["I", "k", "c"],
    "force_curve": [*(f"F_{k}" for k in range(11)), "low", "high"],
}  # fmt: skip
VALUES = {
    "b": 0.1, "F_c": 0.1, "F_s": 0.2, "v_s": 0.1, "c": 0.1, "k": 0.3, "k3": 0.2, "A": 0.05, "n": 6.0, "phase": 0.4,
    "ratio": 1.2, "bias": 0.1, "delay": 0.01, "T": 0.02, "width": 0.2, "limit": 1.5, "offset": 0.05, "tilt": 0.1,
    "I": 0.15, "F_0": 0.12, "F_p": 0.1, "F_m": 0.2, "d": 0.05, "mu": 0.25, "ratio_p": 1.2, "ratio_m": 0.7,
    "T_s": 1.6, "g_0": 1.1, "g_1": 0.8, "g_2": 0.5, "U": 2.5,
    "m_p": 0.3, "r": 0.8, "loss": 0.05, "rise": 0.6, "sigma_1": 0.02,
    "low": -0.5, "high": 2.0, **{f"F_{k}": 0.02 * (k - 4) ** 2 for k in range(1, 11)},
}  # fmt: skip
AT = {"angle": 0.7, "rate": -0.6, "torque": 1.9}


def acceleration(model: SymbolicModel, **at: float) -> float:
    values = {symbol(k): v for k, v in {**AT, **at}.items()}
    return float(model.numeric()[1].subs(values))


def declared(**at: float) -> float:
    """The rod's own acceleration, by hand: I a = u - m g l sin(q)."""
    values = {**AT, **at}
    return 3.0 * values["torque"] - 1.5 * 9.81 * math.sin(values["angle"])


def test_names_and_symbols_are_the_agreed_ones():
    assert {name: [p.symbol for p in e.parameters] for name, e in EFFECTS.items()} == SYMBOLS


def rod(at):
    """The rod of `tests.undeclared.plant.pendulum`, by hand: dq/dt, dv/dt."""
    return [at["rate"], declared(**at)]


def robot(at):
    """The unicycle by hand."""
    return [at["speed"] * math.cos(at["heading"]), at["speed"] * math.sin(at["heading"]), at["turn"]]


@pytest.mark.parametrize(("plant", "by_hand"), [(pendulum, rod), (unicycle, robot)])
@pytest.mark.parametrize("name", EFFECTS)
def test_vanishes_at_its_null(name, plant, by_hand):
    """Motion, readings and timing are those of the bare plant, at random states and inputs."""
    e, model, rng = EFFECTS[name], plant(), np.random.default_rng(0)
    nulls = {p.symbol: p.null for p in e.parameters}
    for on in e.targets(model):
        null = e.apply(model, on, nulls)
        values, memory = null.values(), e.memory_state(on)
        assert all(float(sp.sympify(seconds).subs(values)) == 0.0 for seconds in null.delays.values())
        assert delays_and_lags([AppliedEffect(name, on, nulls)]).get(on, (0.0, 0.0)) == (0.0, 0.0)
        for _ in range(20):
            at = {n: rng.uniform(-2.0, 2.0) for n in (*model.state_names, *model.input_names)}
            here = {symbol(n): v for n, v in at.items()} | ({symbol(memory): at[on]} if memory else {})
            here |= {
                symbol(v.name): rng.uniform(-1.0, 1.0) for v in null.states[len(model.states) :] if v.name != memory
            }
            rows = null.xdot[: len(model.states)]  # a lag of 0 s has no rate of its own, its limit is the command
            moved = [float(sp.sympify(row).subs(values).subs(here)) for row in rows]
            assert moved == pytest.approx(by_hand(at), rel=1e-12, abs=1e-12)
            read = {s: float(sp.sympify(y).subs(values).subs(here)) for s, y in null.outputs.items()}
            assert read == pytest.approx({s: at[s] for s in read}, rel=1e-15)


def test_every_effect_acts_on_a_plant_of_these_tests():
    for e in EFFECTS.values():
        assert e.targets(pendulum()) or e.targets(unicycle())


def test_effects_enter_from_the_plant_outwards_and_commands_backwards():
    path = ["torque_speed_limit", "input_lag", "input_saturation", "input_dead_zone", "input_bias", "input_gain"]
    path += ["input_directional_gain", "input_curve", "input_delay"]
    order = sorted(EFFECTS.values(), key=lambda e: e.rank)
    assert [e.name for e in order][-len(path) :] == path
    assert [e.kind for e in order[:4]] == ["parameter", "plant", "plant", "plant"]
    assert order[-len(path) - 1].kind == "state"


@pytest.mark.parametrize("name", EFFECTS)
def test_becomes_named_parameters_with_units(name):
    e = EFFECTS[name]
    for model in (pendulum(), unicycle()):
        for on in e.targets(model):
            grown = e.apply(model, on, {p.symbol: VALUES[p.symbol] for p in e.parameters})
            for p in e.parameters:
                added = grown.parameters[f"{on}.{name}.{p.symbol}"]
                assert added.value == VALUES[p.symbol]
                assert added.unit == e.units(model, on)[p.symbol]
                assert "{" not in added.unit


@pytest.mark.parametrize(
    ("name", "on", "torque"),
    [
        ("viscous_friction", "hinge", -0.1 * -0.6),
        ("coulomb_friction", "hinge", 0.1),
        ("stribeck_friction", "hinge", 0.1 + 0.1 * math.exp(-36.0)),
        ("quadratic_drag", "hinge", 0.1 * 0.36),
        ("spring", "hinge", -0.3 * 0.7),
        ("cubic_spring", "hinge", -0.2 * 0.343),
        ("cogging", "hinge", 0.05 * math.sin(4.2 + 0.4)),
        ("constant_force", "hinge", 0.12),
        ("directional_friction", "hinge", 0.2),
        ("load_friction", "torque", 0.25 * 1.9),
        ("input_directional_gain", "torque", 0.2 * 1.9),
        ("torque_speed_limit", "torque", 1.6 + 0.3 * 0.6 - 1.9),  # it brakes: more than at rest
        ("input_gain", "torque", 0.2 * 1.9),
        ("input_bias", "torque", 0.1),
        ("input_dead_zone", "torque", -0.2),
        ("input_saturation", "torque", -0.4),
        ("gravity_tilt", "plant", -4.905 * (math.sin(0.8) - math.sin(0.7))),
    ],
)
def test_adds_the_torque_of_its_formula(name, on, torque):
    e = EFFECTS[name]
    changed = e.apply(pendulum(), on, {p.symbol: VALUES[p.symbol] for p in e.parameters})
    assert acceleration(changed) == pytest.approx(declared() + 3.0 * torque, rel=1e-12)


def test_a_gain_curve_is_the_integral_of_its_slope():
    """By quadrature, over both knots and beyond, the same for both signs."""
    values = {"g_0": 1.1, "g_1": 0.8, "g_2": 0.5, "U": 2.5}
    changed = EFFECTS["input_curve"].apply(pendulum(), "torque", values)
    for command in (-4.0, -2.0, -0.7, 0.0, 0.7, 2.0, 2.5, 4.0):
        w = np.linspace(0.0, abs(command), 20001)
        slope = np.interp(w**2, [0.0, 1.25**2, 2.5**2], [1.1, 0.8, 0.5])
        felt = math.copysign(np.trapezoid(slope, w), command)
        assert acceleration(changed, torque=command) == pytest.approx(declared(torque=felt), abs=1e-6)


def test_a_sensor_s_gain_scales_its_reading_and_leaves_the_motion():
    some = [
        AppliedEffect("sensor_offset", "angle", {"offset": 0.05}), AppliedEffect("sensor_gain", "angle", {"ratio": 1.2})
    ]  # fmt: skip
    changed = apply_effects(pendulum(), some)
    assert acceleration(changed) == declared()
    read = sp.sympify(changed.outputs["angle"]).subs(changed.values()).subs(symbol("angle"), 0.7)
    assert float(read) == pytest.approx(1.2 * 0.75, rel=1e-12)


def test_a_payload_changes_inertia_and_gravity_at_once():
    """(I + m r^2) a = u - (m_rod l / 2 + m r) g sin(q)."""
    changed = EFFECTS["payload"].apply(pendulum(), "rod", {"m_p": 0.3, "r": 0.8})
    by_hand = (1.9 - 9.81 * (0.5 + 0.24) * math.sin(0.7)) / (1.0 / 3.0 + 0.3 * 0.64)
    assert acceleration(changed) == pytest.approx(by_hand, rel=1e-12)


def test_errors_of_centre_and_inertia_are_a_payload_where_one_link_moves():
    some = [
        AppliedEffect("parameter_error", "rod.com", {"ratio": 1.48}),
        AppliedEffect("viscous_friction", "hinge", {"b": 0.1}),
        AppliedEffect("parameter_error", "rod.inertia", {"ratio": 1.576}),
    ]
    places, values = EFFECTS["payload"].restates(pendulum(), "rod", some, ())
    assert places == {0, 2}
    assert values == pytest.approx({"m_p": 0.3, "r": 0.8}, rel=1e-9)
    lighter = [AppliedEffect("parameter_error", "rod.com", {"ratio": 0.9}), *some[1:]]
    assert EFFECTS["payload"].restates(pendulum(), "rod", lighter, ()) is None


def test_reflected_inertia_slows_every_force():
    """(J + I) a = torques, with friction inserted before or after it."""
    some = [
        AppliedEffect("viscous_friction", "hinge", {"b": 0.1}),
        AppliedEffect("reflected_inertia", "hinge", {"I": 0.15}),
    ]
    by_hand = (1.9 + 0.06 - 4.905 * math.sin(0.7)) / (1.0 / 3.0 + 0.15)
    assert acceleration(apply_effects(pendulum(), some)) == pytest.approx(by_hand, rel=1e-12)


def test_dahl_friction_is_a_state_that_turns_round_over_a_distance():
    changed = EFFECTS["dahl_friction"].apply(pendulum(), "hinge", {"F_c": 0.1, "d": 0.05})
    assert changed.state_names == ("angle", "rate", "hinge_dahl_friction")
    at = {symbol("hinge_dahl_friction"): 0.5, **{symbol(k): v for k, v in AT.items()}}
    _, rate, bending = (float(e.subs(at)) for e in changed.numeric())
    assert rate == pytest.approx(declared() - 3.0 * 0.1 * 0.5, rel=1e-12)
    assert bending == pytest.approx((-0.6 - 0.6 * 0.5) / 0.05, rel=1e-12)


def test_lugre_friction_is_larger_near_rest_and_damps_the_bending():
    """By hand from sigma_0 = F_c / d and g(v) = F_c + (F_s - F_c) exp(-(v/v_s)^2), a bristle bent by d / 2."""
    numbers = {"F_c": 0.1, "d": 0.05, "rise": 0.6, "v_s": 0.9, "sigma_1": 0.02}
    changed = EFFECTS["lugre_friction"].apply(pendulum(), "hinge", numbers)
    at = {symbol("hinge_lugre_friction"): 0.5, **{symbol(k): v for k, v in AT.items()}}
    _, rate, bending = (float(e.subs(at)) for e in changed.numeric())
    stiff, bent = 0.1 / 0.05, 0.5 * 0.05
    bends = -0.6 - stiff * 0.6 * bent / (0.1 + 0.06 * math.exp(-((0.6 / 0.9) ** 2)))
    assert bending == pytest.approx(bends / 0.05, rel=1e-12)
    assert rate == pytest.approx(declared() - 3.0 * (stiff * bent + 0.02 * bends), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "values", "twist", "rate", "torque"),
    [
        ("joint_elasticity", {"I": 0.02, "k": 40.0, "c": 0.1}, 0.03, -0.5, 40.0 * 0.03 + 0.1 * -0.5),
        ("backlash", {"b": 0.04, "I": 0.02}, 0.019, 3.0, 0.0),
        ("backlash", {"b": 0.04, "I": 0.02}, 0.03, 0.0, 0.02 * 500.0**2 * 0.01),
        ("backlash", {"b": 0.04, "I": 0.02}, -0.03, 0.0, -0.02 * 500.0**2 * 0.01),
        ("backlash", {"b": 0.04, "I": 0.02}, -0.021, 9.0, 0.0),
        ("elasticity_behind_encoder", {"I": 0.02, "k": 40.0, "c": 0.1}, 0.03, -0.5, 40.0 * 0.03 + 0.1 * -0.5),
    ],
)
def test_a_motor_behind_a_joint_has_states_of_its_own(name, values, twist, rate, torque):
    """The link feels what comes through, the motor the drive less that; a stop that is left does not pull."""
    changed = EFFECTS[name].apply(pendulum(), "hinge", values)
    assert changed.state_names == ("angle", "rate", "hinge_motor", "hinge_motor_rate")
    motor = {"hinge_motor": AT["angle"] + twist, "hinge_motor_rate": AT["rate"] + rate}
    at = {symbol(k): v for k, v in {**AT, **motor}.items()}
    link = {**AT, "torque": torque}
    expected = [AT["rate"], declared(**link), motor["hinge_motor_rate"], (AT["torque"] - torque) / 0.02]
    assert [float(e.subs(at)) for e in changed.numeric()] == pytest.approx(expected, rel=1e-9)
    numbers = {**at, **changed.values()}
    read = [float(sp.sympify(changed.outputs.get(n, symbol(n))).subs(numbers)) for n in ("angle", "rate")]
    side = motor.values() if name.endswith("_behind_encoder") else (AT["angle"], AT["rate"])
    assert read == pytest.approx(list(side), rel=1e-9)


def test_parameter_errors_scale_what_they_name():
    q, u = AT["angle"], AT["torque"]
    weight = 4.905 * math.sin(q)
    expected = {
        "rod.mass": 3.0 * u / 1.2 - 3.0 * weight,
        "rod.com": 3.0 * (u - 1.2 * weight),
        "rod.inertia": 3.0 * (u - weight) / 1.2,
        "rod.length": 3.0 * (u - 1.2 * weight) / 1.44,
        "gravity": 3.0 * (u - 1.2 * weight),
    }
    for on, value in expected.items():
        changed = EFFECTS["parameter_error"].apply(pendulum(), on, {"ratio": 1.2})
        assert acceleration(changed) == pytest.approx(value, rel=1e-12)


def test_lag_and_delay_enlarge_the_model():
    lagged = EFFECTS["input_lag"].apply(pendulum(), "torque", {"T": 0.02})
    assert lagged.state_names == ("angle", "rate", "torque_lagged")
    delayed = EFFECTS["input_delay"].apply(pendulum(), "torque", {"delay": 0.01})
    assert float(sp.sympify(delayed.delays["torque"]).subs(delayed.values())) == 0.01


def test_several_effects_enter_in_one_order_whatever_order_they_are_given_in():
    some = [
        AppliedEffect("input_bias", "torque", {"bias": 0.1}),
        AppliedEffect("input_gain", "torque", {"ratio": 1.2}),
        AppliedEffect("parameter_error", "rod.inertia", {"ratio": 0.75}),
        AppliedEffect("viscous_friction", "hinge", {"b": 0.1}),
    ]
    one, other = apply_effects(pendulum(), some), apply_effects(pendulum(), some[::-1])
    by_hand = (1.2 * 1.9 + 0.1 + 0.06 - 4.905 * math.sin(0.7)) * 4.0
    assert acceleration(one) == acceleration(other) == pytest.approx(by_hand, rel=1e-12)


def test_an_effect_can_be_applied_twice():
    e = EFFECTS["viscous_friction"]
    twice = e.apply(e.apply(pendulum(), "hinge", {"b": 0.1}), "hinge", {"b": 0.2})
    assert acceleration(twice) == pytest.approx(declared() + 3.0 * 0.3 * 0.6, rel=1e-12)


def test_wheels_of_different_size_turn_the_robot():
    changed = EFFECTS["wheel_mismatch"].apply(unicycle(), "plant", {"ratio": 1.1})
    at = {symbol("speed"): 0.2, symbol("turn"): 0.5, symbol("heading"): 0.0}
    right, left = 1.1 * (0.2 + 0.5 * 0.15), 0.2 - 0.5 * 0.15
    x, _, turn = (float(sp.sympify(e).subs(at)) for e in changed.numeric())
    assert x == pytest.approx((right + left) / 2)
    assert turn == pytest.approx((right - left) / 0.3)


@pytest.mark.parametrize(("speed", "turn"), [(0.2, 0.5), (0.02, 1.5), (-0.03, 0.1), (0.0, -1.0)])
def test_each_wheel_loses_its_speed_to_rolling_resistance(speed, turn):
    """Wheel by wheel: on, at a stand, and backwards."""
    wheels = [speed + side * turn * 0.15 for side in (-1.0, 1.0)]
    left, right = (0.0 if abs(s) < 0.05 else s - math.copysign(0.05, s) for s in wheels)
    e = EFFECTS["rolling_resistance"]
    changed = e.apply(unicycle(), "plant", {"loss": 0.05})
    at = {symbol("speed"): speed, symbol("turn"): turn, symbol("heading"): 0.0}
    x, _, rate = (float(sp.sympify(row).subs(at)) for row in changed.numeric())
    assert x == pytest.approx((right + left) / 2)
    assert rate == pytest.approx((right - left) / 0.3)
    assert e.turned(*wheels, {"loss": 0.05}) == pytest.approx((left, right))


def test_units_follow_the_target():
    assert EFFECTS["viscous_friction"].units(pendulum(), "hinge")["b"] == "N*m*s/rad"
    assert EFFECTS["sensor_offset"].units(pendulum(), "rate")["offset"] == "rad/s"


def test_refusals_name_what_is_known():
    with pytest.raises(UserError, match="viscous_friction"):
        effect("viscosity")
    with pytest.raises(UserError, match="hinge"):
        EFFECTS["viscous_friction"].apply(pendulum(), "elbow", {"b": 0.1})
    with pytest.raises(UserError, match="not physical"):
        EFFECTS["viscous_friction"].apply(pendulum(), "hinge", {"b": -0.1})
    with pytest.raises(UserError, match="not physical"):
        EFFECTS["stribeck_friction"].apply(pendulum(), "hinge", {"F_c": 0.2, "F_s": 0.1, "v_s": 0.1})
    with pytest.raises(UserError, match="F_c"):
        EFFECTS["coulomb_friction"].apply(pendulum(), "hinge", {"F": 0.1})


BESIDE_A_BIAS = [
    (None, True),
    (AppliedEffect("input_gain", "torque", {"ratio": 1.2}), True),
    (AppliedEffect("input_directional_gain", "torque", {"ratio_p": 1.2, "ratio_m": 0.7}), True),
    (AppliedEffect("input_dead_zone", "torque", {"width": 0.1}), False),
    (AppliedEffect("input_saturation", "torque", {"limit": 1.0}), False),
    (AppliedEffect("torque_speed_limit", "torque", {"T_s": 1.0, "k": 0.5}), False),
    (AppliedEffect("load_friction", "torque", {"mu": 0.1}), False),
    (AppliedEffect("backlash", "hinge", {"b": 0.1, "I": 0.15}), False),
]


@pytest.mark.parametrize(("beside", "says"), BESIDE_A_BIAS)
@pytest.mark.parametrize("name", ["directional_friction", "constant_force"])
def test_a_bias_is_a_force_where_nothing_bends_the_command_after_it(name, beside, says):
    found = [
        AppliedEffect("coulomb_friction", "hinge", {"F_c": 0.1}),
        AppliedEffect("input_bias", "torque", {"bias": 0.05}),
        *([beside] if beside else []),
    ]
    same = EFFECTS[name].restates(pendulum(), "hinge", found, ())
    assert (same is not None) is says
    if same is not None:
        places, values = same
        other = [a for k, a in enumerate(found) if k not in places] + [AppliedEffect(name, "hinge", values)]
        for at in ({"rate": -0.6, "torque": 1.9}, {"rate": 0.8, "torque": -0.7}):
            one, two = (acceleration(apply_effects(pendulum(), effects), **at) for effects in (found, other))
            assert one == pytest.approx(two, rel=1e-12)
