"""A push in the data that are fitted: it weighs nothing, is told, and nothing else is taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import Windows, cut_at, left_out
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import Hypothesis, under_its_law
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.verdict.faults import gross_spans
from simgap.diagnosis.verdict.words import verdict_parts
from tests.diagnosis.plants import block
from tests.diagnosis.test_watch import stop_at

DT, FINE = 0.01, 100
FRICTION = 0.6


def _run(
    seed: int, pushes: tuple[tuple[float, float], ...] = (), limit: float = np.inf, drag: float = 0.0,
    sigma: float = 5e-4, friction: float = FRICTION,
) -> Trace:  # fmt: skip
    """A mass of 2 under dry friction by small steps; pushes: (from s, N), 0.1 s each; limit of the drive."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, DT)
    waves = zip(rng.uniform(1.0, 2.0, 3), (0.4, 0.9, 1.7), rng.uniform(0, 6, 3), strict=True)
    u = np.asarray(sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves))
    q, v, out = 0.2, 0.1, []
    for k, now in enumerate(t):
        out.append(q)
        hand = sum(force for begin, force in pushes if begin <= now < begin + 0.1)
        for _ in range(FINE):
            v += DT / FINE * (min(max(u[k], -limit), limit) + hand - drag * v) / 2.0
            grip = DT / FINE * friction / 2.0
            v = 0.0 if abs(v) <= grip else v - np.copysign(grip, v)
            q += DT / FINE * v
    return Trace(f"run{seed}", t, np.array(out)[:, None] + sigma * rng.standard_normal((len(t), 1)), u[:, None])


def _answer(*traces: Trace, effects: tuple[str, ...] = ("coulomb_friction", "viscous_friction", "spring")) -> Diagnosis:
    settings = DiagnosisSettings(noise={"q": 5e-4}, effects=effects, held_out_traces=(traces[-1].name,))
    return diagnose(block(), Record(traces, ("q",), ("u",)), settings)


@pytest.mark.parametrize("where", [0, 1])
@pytest.mark.parametrize("force", [20.0, -6.0])
def test_a_push_in_a_window_that_fits_or_chooses_weighs_nothing_and_is_told(where, force):
    runs = [_run(1), _run(2), _run(4)]  # the last one confirms, and goes where the pushed ones do
    runs[where] = _run(where + 1, ((4.23, force),))
    d = _answer(*runs)
    assert d.verdict == "attributed"
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    estimate = d.effects[0].parameters["F_c"]
    assert abs(estimate.value - FRICTION) < 1.5 * 0.5 * (estimate.ci95[1] - estimate.ci95[0])  # three standard errors
    assert estimate.value == pytest.approx(FRICTION, rel=0.01)
    (told,) = d.recording
    assert told.fault == "push"
    assert 0.1 < told.value < 0.5
    assert f"s of run{where + 1} (a push?)" in told.sentence
    spans = (*d.folds["fit"], *d.folds["choose"])
    assert not any(name == f"run{where + 1}" and a < 4.25 < b for name, a, b in spans)
    assert any(name == "run4" and b - a > 9.9 for name, a, b in d.folds["confirm"])


def test_a_push_that_began_where_other_data_were_is_one_wherever_it_went():
    """The block ends up far from where the data that confirm are, and flies there faster than they ever do."""
    d = _answer(_run(1, ((4.23, 60.0),)), _run(2), _run(4))
    assert [f.fault for f in d.recording] == ["push"]
    assert (d.verdict, d.unconfirmed) == ("attributed", ())
    assert [e.name for e in d.effects] == ["coulomb_friction"]


@pytest.mark.parametrize("at", [3.02, 5.94])
def test_a_push_beside_the_edge_of_a_window_is_one(at):
    """What is left of the window beside it is too short for an initial state of its own."""
    d = _answer(_run(1, ((at, 20.0),)), _run(2), _run(4))
    assert [f.fault for f in d.recording] == ["push"]
    assert d.verdict == "attributed"
    assert d.effects[0].parameters["F_c"].value == pytest.approx(FRICTION, rel=0.01)


def test_pushes_in_what_confirms_do_not_hide_what_is_missing():
    """Two of its ten seconds are thrown: what nobody predicts is as improbable with friction as without."""
    d = _answer(_run(1, ((3.02, 20.0),)), _run(2), _run(4, ((2.3, 20.0), (6.4, -20.0))))
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    assert d.verdict == "partial"
    assert d.effects[0].parameters["F_c"].value == pytest.approx(FRICTION, rel=0.02)


@pytest.mark.parametrize(("at", "force"), [(2.3, 6.0), (6.1, -5.0)])
@pytest.mark.parametrize("confirms", [4, 5])
def test_a_push_in_what_confirms_is_told_and_keeps_from_attributed(confirms, at, force):
    d = _answer(_run(1), _run(2), _run(confirms, ((at, force),)))
    assert d.verdict == "partial"
    (told,) = d.recording
    assert told.fault == "push"
    assert f"of run{confirms} (a push?)" in told.sentence
    assert "pushed the plant in the data that confirm" in d.doubts[0] or d.unconfirmed
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    assert d.effects[0].parameters["F_c"].value == pytest.approx(FRICTION, rel=0.01)
    assert d.after.held_out_ratio < 1.05


def test_what_a_wrong_model_misses_in_what_confirms_is_no_push():
    d = _answer(_run(1), _run(2), _run(4, ((2.3, 6.0),)), effects=("spring",))
    assert (d.verdict, d.recording) == ("unexplained", ())


def test_a_right_model_is_right_though_somebody_touched_what_confirms():
    runs = (_run(21, friction=0.0), _run(22, friction=0.0), _run(24, ((6.31, 12.0),), friction=0.0))
    settings = DiagnosisSettings(noise={"q": 5e-4}, held_out_traces=("run24",))
    d = diagnose(block(), Record(runs, ("q",), ("u",)), settings)
    assert d.verdict == "none"
    assert [f.fault for f in d.recording] == ["push"]


@pytest.mark.parametrize("at", [0.0, 9.85])
def test_a_push_at_the_start_or_end_of_a_run_is_one(at):
    """Nothing before the start says when it left the prediction; but it flies on, and needs nothing more there."""
    d = _answer(_run(1, ((at, 60.0),)), _run(2), _run(4))
    assert [f.fault for f in d.recording] == ["push"]
    assert (d.verdict, d.unconfirmed) == ("attributed", ())


def test_a_push_that_two_missing_effects_hide_is_found():
    """Under the declared model friction misses by far more everywhere than the push does where it acts."""
    runs = (_run(1, ((4.23, 3.0),), drag=3.0, sigma=2e-5), *(_run(k, drag=3.0, sigma=2e-5) for k in (2, 4)))
    few = ("coulomb_friction", "viscous_friction", "input_dead_zone", "spring")
    settings = DiagnosisSettings(noise={"q": 2e-5}, held_out_traces=("run4",), effects=few)
    parts, _ = parts_of(block(), Record(runs, ("q",), ("u",)), settings)
    under = under_its_law(Hypothesis.of(parts, settings, {}, Watch()))
    assert {c.effect.name for c in under.found.members} == {"coulomb_friction", "viscous_friction"}
    assert under.search.reached(under.found)
    ((trace, begin, end),) = under.parts.left_out
    assert trace == 0
    assert 4.0 < begin < 4.23
    assert 4.33 < end < 4.6


def test_without_a_push_nothing_is_told_of_one():
    d = _answer(_run(1), _run(2), _run(3))
    assert (d.verdict, d.recording) == ("attributed", ())
    assert sum(b - a for _, a, b in (*d.folds["fit"], *d.folds["choose"])) > 19.9


def test_what_a_drive_that_saturates_now_and_then_misses_is_no_push():
    runs = [_run(k, limit=3.2) for k in (1, 2, 3)]
    d = _answer(*runs, effects=("coulomb_friction", "input_saturation"))
    assert {e.name for e in d.effects} == {"coulomb_friction", "input_saturation"}
    assert not d.recording


def test_a_push_in_every_other_second_is_no_gross_error():
    often = tuple((0.5 + k, 15.0 * (-1) ** k) for k in range(9))
    d = _answer(_run(1, often), _run(2, often), _run(3), effects=("coulomb_friction",))
    assert not any(f.fault == "push" for f in d.recording)
    assert d.verdict != "attributed"


def test_a_search_that_is_stopped_tells_of_no_push(monkeypatch):
    """Whatever stands out under the model as declared may be what it lacks."""
    record = Record((_run(1), _run(2), _run(3)), ("q",), ("u",))
    settings = DiagnosisSettings(noise={"q": 5e-4}, effects=("coulomb_friction",), held_out_traces=("run3",))
    stop_at(monkeypatch, 1)
    assert not diagnose(block(), record, settings).recording


def test_the_sentence_says_why_a_push_may_be_a_stop():
    size = {"value": 0.6, "ci95": [0.59, 0.61], "unit": "N"}
    effect = {"name": "coulomb_friction", "on": "slide", "parameters": {"F_c": size}}
    about = {"explained_share": 1.0, "unconfirmed": ["q"], "error": {"after": {"horizon_rmse": {}, "horizon_s": 0.0}}}
    text = " ".join(verdict_parts({"verdict": "partial", "effects": [effect], **about}))
    assert "where gross errors begin q goes further than in other data" in text
    assert "is left" not in text


def test_the_push_is_in_the_sentence():
    fault = {
        "fault": "push",
        "sentence": "4.2 to 4.4 s of run1 (a push?): 1 % of the time that is fitted was left out.",
    }
    text = " ".join(verdict_parts({"verdict": "none", "effects": [], "candidates": [], "recording": [fault]}))
    assert "4.2 to 4.4 s of run1 (a push?)" in text


def test_where_a_late_log_ends_before_what_acted_nobody_pushed():
    late = 12  # samples
    runs = (_run(1), _run(2), _run(3))
    logged = [Trace(r.name, r.t[late:], r.y[late:], r.u[:-late]) for r in runs]  # each row is what was sent 0.12 s ago
    settings = DiagnosisSettings(noise={"q": 5e-4}, effects=("coulomb_friction",), held_out_traces=("run3",))
    parts, _ = parts_of(block(), Record(tuple(logged), ("q",), ("u",)), settings)
    model = parts.known.model
    theta = model.null.copy()
    theta[list(model.find("coulomb_friction", "slide").slots)] = FRICTION
    theta[list(model.find("late_log", "u").slots)] = late * DT
    assert parts.known.ahead(theta) == pytest.approx(late * DT)
    seen = replace(parts.known.before_the_end(late * DT), usual=parts.known.sigma)
    assert gross_spans(seen, fit(seen, theta, initial_states(seen), [], {})) == ()
    for part in (parts.known, parts.confirm):
        w = part.before_the_end(late * DT).windows
        ends = {k: part.t[w.stop[w.trace == k].max() - 1] for k in set(w.trace.tolist())}
        assert all(
            logged[k].t[-1] - late * DT - 1.5 * DT < end < logged[k].t[-1] - late * DT for k, end in ends.items()
        )


def test_what_stands_out_before_the_record_is_forgotten_was_no_push():
    """A drive with a lag that was switched on as the log began: its own past acts there, and nobody pushed."""
    settings = DiagnosisSettings(noise={"q": 5e-4}, effects=("coulomb_friction",), held_out_traces=("run3",))
    parts, _ = parts_of(block(), Record((_run(1), _run(2), _run(3)), ("q",), ("u",)), settings)
    pushed = replace(parts, left_out=((0, -0.05, 0.13), (1, 0.1, 0.25), (1, 4.0, 4.1)))
    assert pushed.past_the_unknown(0.2).left_out == pushed.left_out[1:]
    assert pushed.past_the_unknown(0.0).left_out == pushed.left_out


def test_windows_are_cut_around_what_is_left_out():
    t = np.concatenate([np.arange(100) * 0.01, np.arange(100) * 0.01])
    at = (np.array(a) for a in ([0, 100, 150], [100, 150, 200], [0, 1, 1]))
    cut = left_out(Windows(*at), t, ((0, 0.295, 0.405), (1, 0.47, 0.515)))
    assert cut.start.tolist() == [0, 41, 100, 152]
    assert cut.stop.tolist() == [30, 100, 147, 200]
    assert cut.trace.tolist() == [0, 0, 1, 1]


def test_windows_are_cut_where_a_push_begins():
    t = np.concatenate([np.arange(100) * 0.01, np.arange(100) * 0.01])
    at = (np.array(a) for a in ([0, 100, 150], [100, 150, 200], [0, 1, 1]))
    cut = cut_at(Windows(*at), t, ((0, 0.295, 0.405), (1, 0.47, 0.9)))  # too near an edge
    assert cut.start.tolist() == [0, 30, 41, 100, 150, 190]
    assert cut.stop.tolist() == [30, 41, 100, 150, 190, 200]
    assert cut.trace.tolist() == [0, 0, 0, 1, 1, 1]


def test_a_part_too_short_for_a_fit_goes_where_it_is_of_a_push_and_stays_where_it_is_not():
    t = np.arange(100) * 0.01
    whole = Windows(*(np.array([k]) for k in (0, 100, 0)))
    at_the_start = cut_at(whole, t, ((0, 0.0, 0.055),))
    assert (at_the_start.start.tolist(), at_the_start.stop.tolist()) == ([6], [100])
    beside_it = cut_at(whole, t, ((0, 0.03, 0.4),))
    assert (beside_it.start.tolist(), beside_it.stop.tolist()) == ([0, 40], [40, 100])


def _stopped(seed: int, stop: float, force: float = 3000.0) -> Trace:
    """A run with a stiff stop that `_run` does not have: what goes past q = stop is driven back."""
    free = _run(seed)
    q, v, out = 0.2, 0.1, []
    for k in range(len(free.t)):
        out.append(q)
        for _ in range(FINE):
            v += DT / FINE * (free.u[k, 0] - force * max(q - stop, 0.0)) / 2.0
            grip = DT / FINE * FRICTION / 2.0
            v = 0.0 if abs(v) <= grip else v - np.copysign(grip, v)
            q += DT / FINE * v
    noise = 5e-4 * np.random.default_rng(seed + 100).standard_normal((len(free.t), 1))
    return Trace(f"run{seed}", free.t, np.array(out)[:, None] + noise, free.u)


def test_a_stop_where_the_data_that_confirm_never_go_is_not_attributed():
    """The first run alone reaches 0.59, once: what is left out there looks like a push, and *confirm* is silent."""
    d = _answer(_stopped(1, 0.591), _run(2), _run(3))
    assert [f.fault for f in d.recording] == ["push"]
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    assert d.verdict == "partial"
    assert d.unconfirmed == ("q",)


def test_a_stop_where_only_the_data_that_confirm_go_is_not_nothing():
    """All else is as declared with the friction that is found, or lacks nothing: what a stop does looks like a push."""
    d = _answer(_run(2), _run(3), _stopped(1, 0.591))
    assert d.verdict == "partial"
    assert d.unconfirmed == ("q",)


def _braked(seed: int, burst: bool, limit: float = 0.7) -> Trace:
    """The mass with a brake of 8 N above a speed, which it reaches where the drive acts hard for a moment."""
    plain = _run(seed)
    t = plain.t
    jolt = 4.0 * ((t > 4.0) & (t < 4.5)) - 4.0 * ((t > 4.5) & (t < 5.0)) if burst else 0.0
    u, q, v, out = np.clip(plain.u[:, 0] + jolt, -4.2, 4.2), 0.2, 0.1, []
    for k in range(len(t)):
        out.append(q)
        for _ in range(FINE):
            v += DT / FINE * (u[k] - 8.0 * np.sign(v) * (abs(v) > limit)) / 2.0
            grip = DT / FINE * FRICTION / 2.0
            v = 0.0 if abs(v) <= grip else v - np.copysign(grip, v)
            q += DT / FINE * v
    noise = 5e-4 * np.random.default_rng(seed + 50).standard_normal((len(t), 1))
    return Trace(f"run{seed}", t, np.array(out)[:, None] + noise, u[:, None])


def test_a_brake_at_a_speed_that_the_data_that_confirm_never_reach_is_not_attributed():
    d = _answer(_braked(1, True), _braked(2, False), _braked(4, False))
    assert [f.fault for f in d.recording] == ["push"]
    assert d.verdict == "partial"
    assert d.unconfirmed == ("q",)


def test_a_brake_that_acts_where_only_the_data_that_confirm_go_is_told_as_such():
    """Nothing else says whether that was a push."""
    d = _answer(_braked(2, False), _braked(4, False), _braked(1, True))
    assert d.verdict == "partial"
    assert [f.fault for f in d.recording] == ["push"]
    assert d.unconfirmed == ("q",)
