"""The next experiment's numbers, against a least squares of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from simgap.diagnosis.record.conditions import conditioned
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.parts import parts_of
from simgap.effects import AppliedEffect
from simgap.extras.experiment.ask import Question, as_usable, ask, halves, settable, shortest, windows_to_come
from simgap.extras.experiment.propose import Wave, beside, tried, waves
from simgap.extras.experiment.rivals import known_rivals
from simgap.extras.next import paragraph
from simgap.geometry import Box
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol
from simgap.signals import multisine

RATE, SIGMA, MASS = 50.0, 1e-3, 2.0
VISCOUS, SPRING = 0.3, 1.5


def rail():
    """A mass on a rail, m dv/dt = u."""
    m, v, u = (symbol(n) for n in ("m", "v", "u"))
    return SymbolicModel(
        states=(Variable("x", "m"), Variable("v", "m/s")),
        inputs=(Variable("u", "N"),),
        xdot=(v, u / m),
        parameters={"m": Parameter(MASS, "kg")},
        coordinates=(Coordinate("rail", "x", "v", "N"),),
        force_map={"rail": (0, 1 / m)},
        named_parameters={"m": NamedParameter("m", MASS, "kg", {"m": m * symbol("ratio")})},
    )


def moved(u, x0, viscous=0.0, spring=0.0, gain=1.0):
    """Position under held inputs, by SciPy."""
    x = np.zeros((len(u), 2))
    x[0] = x0
    for k in range(len(u) - 1):
        rates = lambda _, s, f=u[k]: [s[1], (gain * f - viscous * s[1] - spring * s[0]) / MASS]  # noqa: E731
        x[k + 1] = solve_ivp(rates, (0.0, 1.0 / RATE), x[k], rtol=1e-9, atol=1e-12).y[:, -1]
    return x


def record(seconds=6.0, **hidden):
    rng = np.random.default_rng(3)
    t = np.arange(round(seconds * RATE)) / RATE
    u = multisine(t, 2.0, 0.3, 3.0, rng)
    y = moved(u, (0.0, 0.0), **hidden)[:, :1] + SIGMA * rng.standard_normal((len(t), 1))
    return Record((Trace("run", t, y, u[:, None]),), ("x",), ("u",))


def question(data, *sets, model=None):
    t = np.arange(round(3.0 * RATE) + 1) / RATE
    return Question(
        model or rail(), data, DiagnosisSettings(), {"x": SIGMA}, sets, t, np.zeros(2),
        Box([-2.0, -5.0], [2.0, 5.0]), np.zeros(1), np.full(1, 2.0),
    )  # fmt: skip


DRAG = (AppliedEffect("viscous_friction", "rail", {"b": VISCOUS}),)
PULL = (AppliedEffect("spring", "rail", {"k": SPRING}),)
GAIN = (AppliedEffect("input_gain", "u", {"ratio": 0.9}),)
HEAVY = (AppliedEffect("parameter_error", "m", {"ratio": 1.0 / 0.9}),)


@pytest.fixture(scope="module")
def friction():
    return record(viscous=VISCOUS)


def test_what_a_wrong_explanation_misses_is_what_a_full_fit_to_both_recordings_leaves(friction):
    asked = question(friction, DRAG, PULL)
    known = known_rivals(asked.model, friction, asked.settings, asked.sets, asked.noise)
    drag, pull = known.rivals
    bench = asked.bench(known, ())
    shape = np.stack([multisine(asked.t, 1.0, 0.3, 2.0, np.random.default_rng(5))], axis=1)
    attempt = tried(bench, Wave("one", shape))
    d = attempt.d[0, 1] * bench.excess
    # the same from its definition: the wrong one's spring and the initial state of each window, free
    truth = moved(attempt.u[:, 0], (0.0, 0.0), viscous=drag.theta[min(drag.steps)])
    assert np.abs(attempt.readings[0][:, 0] - truth[:, 0]).max() < 0.01 * SIGMA
    problem, x0 = bench.recorded(attempt.states[0], attempt.readings[0], attempt.u)
    spans = list(zip(problem.windows.start, problem.windows.stop, strict=True))
    assert len(spans) == np.count_nonzero(bench.tells) < len(bench.windows)  # *confirm* tells nothing
    near = float(pull.theta[min(pull.steps)])

    def misses(z):
        parts = [
            (truth[a:b, 0] - moved(attempt.u[a:b, 0], z[1 + 2 * w : 3 + 2 * w], spring=z[0])[:, 0]) / SIGMA
            for w, (a, b) in enumerate(spans)
        ]
        return np.concatenate([*parts, [np.sqrt(pull.information[0, 0]) * (z[0] - near)]])

    best = least_squares(misses, np.concatenate([[near], x0.ravel()]), x_scale="jac")
    assert 2.0 * best.cost == pytest.approx(d, rel=0.05)
    assert d > 50.0  # they do part, though one of three windows confirms


def test_equal_explanations_are_said_to_be_equal_and_what_parts_them_is_named():
    """Gain and mass of a free mass: no input tells them, a mass that was weighed does."""
    data = record(gain=0.9)
    advice = ask(question(data, GAIN, HEAVY), np.random.default_rng(1))
    z = advice.proposal.bench.margins(advice.proposal.best.d)
    assert z.min() < -2.0
    assert advice.proposal.sure < 0.05
    assert advice.remedy.kind == "condition"
    assert advice.remedy.name == "m"
    assert advice.remedy.probability > 0.99


def test_pairs_that_nothing_tells_do_not_hide_those_that_an_input_does():
    """Of gain, mass and a spring the first two are equal: the input is made for the spring, and the mass is named."""
    data = record(gain=0.9)
    asked = question(data, GAIN, HEAVY, PULL)
    advice = ask(asked, np.random.default_rng(1))
    assert advice.proposal.alike() == [(1, 0)]
    assert advice.proposal.sure > 0.99
    assert advice.remedy.name == "m"
    said = paragraph(asked, advice, {"u": "N"}, "input.csv")
    assert "the others are separated" in said
    assert "the parameter m and the gain of u act alike; to separate these, set m" in said


def test_a_constant_that_no_experiment_can_set_is_not_proposed():
    """A drag that is declared 0.3 too small: its error and viscous friction are equal, and nobody sets a drag."""
    m, v, c = (symbol(n) for n in ("m", "v", "c"))
    plant = replace(
        rail(), xdot=(v, (symbol("u") - c * v) / m),
        parameters={"m": Parameter(MASS, "kg"), "c": Parameter(0.6, "N*s/m")},
        named_parameters={"c": NamedParameter("c", 0.6, "N*s/m", {"c": c * symbol("ratio")})},
    )  # fmt: skip
    more = (AppliedEffect("parameter_error", "c", {"ratio": 1.0 + VISCOUS / 0.6}),)
    data = record(viscous=0.6 + VISCOUS, gain=1.0)
    assert [name for name, _ in settable(plant, (DRAG, more))] == ["m"]
    asked = replace(question(data, DRAG, more, model=plant), brief=False)
    advice = ask(asked, np.random.default_rng(4))
    assert advice.remedy is None
    assert "set c" not in paragraph(asked, advice, {"u": "N"}, "input.csv")


def test_an_input_that_leaves_the_range_is_made_smaller(friction):
    asked = question(friction, DRAG, PULL)
    known = known_rivals(asked.model, friction, asked.settings, asked.sets, asked.noise)
    bench = asked.bench(known, ())
    push = Wave("push", np.ones((len(asked.t), 1)))
    assert tried(bench, Wave("small", 0.01 * push.u)) is not None
    assert tried(bench, push) is None  # 2 N on 2 kg for 3 s: 4.5 m
    advice = ask(question(friction, DRAG, PULL), np.random.default_rng(1))
    assert all(np.all(np.abs(x) <= [2.0, 5.0]) for x in advice.proposal.best.states)
    assert advice.proposal.sure > 0.99
    assert np.abs(advice.proposal.best.u).max() <= 2.0


def test_under_known_conditions_the_better_one_is_proposed_and_said():
    """Two masses may be mounted, one of them was."""
    light = record(viscous=VISCOUS)
    (trace,) = light.traces
    traces = tuple(
        Trace(name, trace.t, trace.y, np.hstack([trace.u, np.full((len(trace.u), 1), mass)]))
        for name, mass in (("light", MASS), ("again", MASS))
    )
    both = Record(traces, ("x",), ("u", "m"))
    asked = question(both, DRAG, PULL, model=conditioned(rail(), ["m"]))
    asked = replace(asked, conditions=((MASS,), (3.0 * MASS,)))
    advice = ask(asked, np.random.default_rng(1))
    held = advice.proposal.bench.held
    assert held in asked.conditions
    assert np.all(advice.proposal.best.u[:, 1] == held[0])
    said = paragraph(asked, advice, {"u": "N", "x": "m"}, "input.csv")
    assert f"with m = {held[0]:g} kg" in said
    assert "(1) viscous friction at the rail; (2) spring at the rail" in said
    # the other condition would have told them less surely
    same = Wave("same", advice.proposal.best.wave)
    other = asked.bench(advice.known, next(c for c in asked.conditions if c != held), len(same.u))
    here, there = tried(advice.proposal.bench, same), tried(other, same)
    assert there is None or there.score <= here.score


def test_waves_keep_to_the_range_and_hold_slow_and_fast_ones():
    t = np.arange(500) / 100.0
    every = list(waves(t, 2, np.random.default_rng(0)))
    assert all(w.u.shape == (500, 2) and np.abs(w.u).max() <= 1.0 + 1e-9 for w in every)
    names = " ".join(w.name for w in every)
    assert all(word in names for word in ("multisine", "chirp", "steps", "ramps", "holds", "all inputs"))


def test_readings_of_one_count_of_an_encoder_make_no_one_surer():
    """A creep of a few counts: what white noise of the same size would tell, less what its readings have in common."""
    step = 0.01
    white = record(viscous=VISCOUS)
    (trace,) = white.traces
    rounded = Record((replace(trace, y=step * np.round(trace.y / step)),), white.measured, white.inputs)
    asked = replace(question(rounded, DRAG, PULL), noise={"x": step / np.sqrt(12.0)})
    known = known_rivals(asked.model, rounded, asked.settings, asked.sets, asked.noise)
    counted = replace(asked.bench(known, ()), allowed=Box([-20.0, -20.0], [20.0, 20.0]))
    assert counted.steps == pytest.approx([step], rel=1e-3)
    plain = replace(counted, steps=np.zeros(1))
    creep, quick = (Wave("held", np.full((len(asked.t), 1), size)) for size in (2e-3, 1.0))
    parted = {}
    for name, bench in (("counted", counted), ("plain", plain)):
        for speed, wave, pace in (("creep", creep, 0.0), ("quick", quick, 1.5)):  # a start from rest is slow at first
            attempt = tried(replace(bench, start=np.array([0.0, pace])), wave)
            assert attempt is not None
            parted[name, speed] = attempt.d[0, 1]
            travel = np.ptp(attempt.states[0][:, 0]) / step
            assert travel > len(asked.t) if speed == "quick" else travel < 0.2 * len(asked.t)
    # readings of a creep stay in one count for n of them and are then worth 1 / (1 + rho (n - 1)) at most
    assert parted["counted", "creep"] < 0.5 * parted["plain", "creep"]
    assert parted["counted", "quick"] == pytest.approx(parted["plain", "quick"], rel=1e-9)  # three counts a reading


def test_of_a_recording_to_come_counts_what_the_diagnosis_will_fit(friction):
    """Its own folds: the new recording stands before the first, and what confirms is not fitted."""
    asked = question(friction, DRAG, PULL)
    windows, tells = windows_to_come(friction, asked.settings, asked.t)
    new = Trace("next", asked.t, np.zeros((len(asked.t), 1)), np.zeros((len(asked.t), 1)))
    parts = parts_of(asked.model, replace(friction, traces=(new, *friction.traces)), asked.settings)[0]
    fitted = parts.known.windows.pick(parts.known.windows.trace == 0)
    assert np.array_equal(windows.pick(tells).start, fitted.start)
    assert np.array_equal(windows.pick(tells).stop, fitted.stop)


def test_a_shorter_recording_is_in_each_fold_that_the_whole_is_in(friction):
    asked = question(friction, DRAG, PULL)
    t = np.arange(round(12.0 * RATE) + 1) / RATE
    assert list(halves(len(t)))[:4] == [301, 151, 76, 38]
    usable = [n for n in range(10, len(t), 5) if as_usable(friction, asked.settings, t, n)]
    assert 2.0 < t[usable[0]] < 4.0  # three windows of 1 s, one of each fold
    new = Trace("next", t[: usable[0]], np.zeros((usable[0], 1)), np.zeros((usable[0], 1)))
    parts = parts_of(asked.model, replace(friction, traces=(new, *friction.traces)), asked.settings)[0]
    assert all(0 in p.windows.trace for p in (parts.fit, parts.choose, parts.confirm))
    several = replace(friction, traces=(*friction.traces, replace(friction.traces[0], name="other")))
    assert as_usable(several, asked.settings, t, 30)  # folds are whole files then: it is in one, however short
    assert not as_usable(several, asked.settings, t, 20)  # less than half a window


@pytest.mark.parametrize(("needed", "found"), [(0, 10), (30, 35), (60, 71), (71, 71), (72, None), (101, None)])
def test_the_shortest_that_is_enough_is_found_between_halves(needed, found):
    counts = [50, 25, 13, 10]
    assert shortest(101, iter(counts), lambda n: n if n >= needed else None) == found


def test_a_shorter_recording_is_proposed_where_it_is_enough_and_the_longer_one_is_told(friction):
    settings = DiagnosisSettings(effects=("viscous_friction", "spring", "coulomb_friction"))
    asked = replace(question(friction, DRAG, PULL), settings=settings, t=np.arange(round(12.0 * RATE) + 1) / RATE)
    advice = ask(asked, np.random.default_rng(1))
    whole = ask(replace(asked, brief=False), np.random.default_rng(1))
    assert len(whole.proposal.best.u) == len(asked.t)
    assert whole.longest is None
    assert len(advice.proposal.best.u) < len(asked.t)
    assert advice.longest.sure == whole.proposal.sure >= advice.proposal.sure >= 0.95
    said = paragraph(asked, advice, {"u": "N"}, "a.csv")
    assert f"{advice.proposal.bench.t[-1]:.3g} s are enough; 12 s would make it" in said
    assert "are enough" not in paragraph(asked, whole, {"u": "N"}, "a.csv")


def test_what_a_hidden_effect_leaves_is_what_another_one_fitted_to_both_recordings_leaves(friction):
    """Beside the friction a spring hides, one standard error large: what a gain would miss of it."""
    settings = DiagnosisSettings(effects=("viscous_friction", "spring", "input_gain"))
    asked = replace(question(friction, DRAG, PULL), settings=settings)
    known = known_rivals(asked.model, friction, settings, asked.sets, asked.noise)
    hides = beside(asked.model, friction, settings, DRAG, known)
    bench = asked.bench(known, ())
    shape = np.stack([multisine(asked.t, 1.0, 0.3, 2.0, np.random.default_rng(5))], axis=1)
    attempt = tried(bench, Wave("one", shape), hides)
    d = hides.missed(bench, attempt.states[0], attempt.readings[0], attempt.u) * bench.excess
    spring, gain = list(hides.columns).index(("spring", "rail")), list(hides.columns).index(("input_gain", "u"))
    # the same by SciPy: the old recording and the new one moved with the hidden spring, the gain and the friction free
    (trace,) = friction.traces
    b = float(known.rivals[0].theta[min(known.rivals[0].steps)])
    k = float(hides.hidden[spring][0]) * 10.0  # ten, so that integration errors are small beside it
    old, x_old = known.problem.windows, moved(trace.u[:, 0], (0.0, 0.0), viscous=b)
    new, x_new = bench.windows.pick(bench.tells), moved(attempt.u[:, 0], (0.0, 0.0), viscous=b)
    spans = [(trace.u[a:e, 0], x_old[a]) for a, e in zip(old.start, old.stop, strict=True)]
    spans += [(attempt.u[a:e, 0], x_new[a]) for a, e in zip(new.start, new.stop, strict=True)]
    truth = [moved(u, x, viscous=b, spring=k)[:, 0] for u, x in spans]

    def misses(z):
        ways = [moved(u, z[2 + 2 * w : 4 + 2 * w], viscous=z[0], gain=z[1])[:, 0] for w, (u, _) in enumerate(spans)]
        return np.concatenate([(t - y) / SIGMA for t, y in zip(truth, ways, strict=True)])

    start = np.concatenate([[b, 1.0], np.concatenate([x for _, x in spans])])
    best = least_squares(misses, start, x_scale="jac", max_nfev=4)
    assert 2.0 * best.cost == pytest.approx(100.0 * d[spring, gain], rel=0.1)
