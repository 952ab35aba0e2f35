"""A plant that changes in mid-record: when, what, and no change where there is none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis import diagnose as diagnosing
from simgap.diagnosis.change import Change
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import watch as watching
from tests.diagnosis.plants import point_pendulum
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import Hidden, oscillator, pendulum

FEW = ("viscous_friction", "coulomb_friction", "parameter_error", "input_bias")


def _diagnosed(plant, hidden, traces=1, seconds=24.0):
    made = record(plant, hidden, 2, seconds=seconds, traces=traces)
    return diagnose(nominal(plant.name), made, DiagnosisSettings(effects=FEW))


def _changes(d):
    return [f for f in d.recording if f.fault == "plant_changed"]


def test_friction_that_doubles_at_an_instant_is_told_with_both_numbers():
    d = _diagnosed(oscillator(), Hidden(viscous={"slide": 0.3}, after=(0, 14.0), later=Hidden(viscous={"slide": 0.6})))
    (change,) = _changes(d)
    assert change.value == pytest.approx(14.0, abs=1.0)
    assert d.verdict == "attributed"
    # m v' = u - d v - k q - b v with d = 0.4 declared: b and another d are one motion, so either name is right, and
    # the other must be told. A d of 0.4 + 0.3 is 75 % above, then of 0.4 + 0.6 150 % above.
    (found,) = d.effects
    lo, hi = (0.4 * (v - 1.0) if found.name == "parameter_error" else v for v in _only(found).ci95)
    assert lo <= 0.3 <= hi  # of what came before, which is longer
    names = [{(found.name, found.on)}, *({(a.name, a.on) for a in other.effects} for other in d.alternatives)]
    assert {("viscous_friction", "slide")} in names
    assert {("parameter_error", "d")} in names
    first, second = change.sentence.split(" before, ")
    assert ("parameter d that is 75" if found.name == "parameter_error" else "viscous friction of 0.3") in first
    assert ("parameter d that is 2.5" if found.name == "parameter_error" else "viscous friction of 0.6") in second
    assert "viscous friction at the slide" in change.sentence


@pytest.mark.parametrize("instant", [13.2, 13.5, 13.9])
def test_a_change_within_a_window_is_told_to_that_window_before_sets_of_effects_are_sought(monkeypatch, instant):
    """The window that holds it follows neither number; it costs as much as single effects do."""

    def never(plain):
        raise AssertionError("sets of effects are sought")

    monkeypatch.setattr(diagnosing, "under_its_law", never)
    hidden = Hidden(viscous={"slide": 0.3}, after=(0, instant), later=Hidden(viscous={"slide": 0.6}))
    (change,) = _changes(_diagnosed(oscillator(), hidden))
    assert change.value == pytest.approx(instant, abs=0.5 + 0.02)


CHANGED = Hidden(viscous={"slide": 0.3}, after=(0, 13.5), later=Hidden(viscous={"slide": 0.6}))


def test_a_change_is_told_under_a_budget(monkeypatch):
    """The best so far is saved whenever it is another, in the midst of the question as well."""
    monkeypatch.setattr(watching, "_SAVED_EVERY", 0.0)
    made = record(oscillator(), CHANGED, 2, seconds=24.0, traces=1)
    d = diagnose(nominal("oscillator"), made, DiagnosisSettings(effects=FEW, budget_s=60.0))
    assert _changes(d)
    assert not d.stopped


@pytest.mark.parametrize("told", [1, 3, 6])
def test_an_interrupt_in_the_midst_of_the_question_ends_the_search(told):
    said = []

    def interrupt(words):
        said.append(words)
        if len(said) == told:
            raise KeyboardInterrupt

    made = record(oscillator(), CHANGED, 2, seconds=24.0, traces=1)
    d = diagnose(nominal("oscillator"), made, DiagnosisSettings(effects=FEW), interrupt)
    assert len(said) >= told
    assert "interrupted" in d.stopped
    assert not _changes(d)


def test_friction_that_nearly_stops_the_motion_is_told():
    hidden = Hidden(viscous={"hinge": 0.1}, after=(0, 13.0), later=Hidden(viscous={"hinge": 0.9}))
    d = _diagnosed(pendulum(), hidden)
    (change,) = _changes(d)
    assert change.value == pytest.approx(13.0, abs=1.0)
    assert "viscous friction of 0.90" in change.sentence.split(" before, ")[1]
    assert _only(d.effects[0]).value == pytest.approx(0.1, rel=0.01)


def test_sides_that_name_different_effects_are_no_change():
    """Neither set is what the plant lacks, then: an effect that no number of the library describes acts in both."""
    was, now = Hidden(viscous={"slide": 0.5}), Hidden(coulomb={"slide": 0.6})
    d = _diagnosed(oscillator(), replace(was, after=(0, 12.0), later=now))
    assert not _changes(d)
    assert d.verdict != "attributed"


def _only(found):
    (estimate,) = found.parameters.values()
    return estimate


def test_a_load_that_is_added_is_told_beside_a_model_that_was_right():
    d = _diagnosed(pendulum(), Hidden(after=(0, 9.0), later=Hidden(factors={"m": 1.2})))
    (change,) = _changes(d)
    assert change.value == pytest.approx(9.0, abs=1.0)
    assert d.verdict == "attributed"
    sets = [{(e.name, e.on) for e in d.effects}, *({(e.name, e.on) for e in a.effects} for a in d.alternatives)]
    assert {("parameter_error", "I")} in sets


def test_a_change_in_the_second_of_two_short_runs_leaves_four_fitted_windows_after_it():
    hidden = Hidden(viscous={"hinge": 0.15}, after=(1, 4.3), later=Hidden(viscous={"hinge": 0.375}))
    d = _diagnosed(pendulum(), hidden, traces=2, seconds=10.0)
    (change,) = _changes(d)
    assert "viscous friction of 0.37" in change.sentence.split(" before, ")[1]
    (found,) = d.effects
    assert (d.verdict, found.name) == ("attributed", "viscous_friction")
    assert _only(found).value == pytest.approx(0.15, rel=0.01)


def test_a_change_near_the_end_is_told_though_what_follows_it_is_too_short_for_a_diagnosis_of_its_own():
    hidden = Hidden(viscous={"hinge": 0.15}, after=(1, 7.3), later=Hidden(viscous={"hinge": 0.375}))
    d = _diagnosed(pendulum(), hidden, traces=2, seconds=10.0)
    (change,) = _changes(d)
    assert change.value == pytest.approx(7.3, abs=1.0)
    now = change.sentence.split(" before, ")[1]
    assert "viscous friction of 0.37" in now
    assert [(e.name, _only(e).value) for e in d.effects] == [("viscous_friction", pytest.approx(0.15, rel=0.01))]


@pytest.mark.parametrize(("begin", "end"), [(17.3, 19.3), (0.4, 2.4)])
@pytest.mark.parametrize("plant", [oscillator(), pendulum()], ids=lambda p: p.name)
def test_a_hand_that_leans_on_the_plant_for_two_seconds_near_an_end_changes_no_number(plant, begin, end):
    """Whatever acts on two windows, several numbers together bend to it."""
    (where,) = plant.positions
    hidden = Hidden(viscous={where: 0.3}, pushes=((0, begin, end, where, 0.4),))
    d = diagnose(nominal(plant.name), record(plant, hidden, 3, seconds=20.0, traces=1), DiagnosisSettings())
    assert _changes(d) == []


def test_a_change_beside_a_second_effect_is_no_push():
    """One effect does not explain most, so sets are sought first, by a law under which what follows weighs little."""
    hidden = Hidden(coulomb={"hinge": 0.3}, gain={"torque": 0.6})
    hidden = replace(hidden, after=(1, 10.5), later=replace(hidden, coulomb={"hinge": 0.4}))
    made = record(pendulum(), hidden, 6, seconds=15.0, traces=2)
    d = diagnose(nominal("pendulum"), made, DiagnosisSettings(effects=(*FEW, "input_gain")))
    (change,) = _changes(d)
    assert change.value == pytest.approx(10.5, abs=1.0)
    assert "Coulomb friction of 0.30" in change.sentence
    assert {e.name: _only(e).value for e in d.effects} == {
        "coulomb_friction": pytest.approx(0.3, rel=0.01), "input_gain": pytest.approx(0.6, rel=0.01),
    }  # fmt: skip


def test_of_a_load_that_is_added_each_number_is_told_and_those_that_stay_are_not():
    """Gravity grows by 30 %, inertia by 10 %; a gain would do for one of them, with another friction."""
    plant, hidden = pendulum(), Hidden(viscous={"hinge": 0.15})
    rates = plant.rates
    loaded = replace(
        plant, rates=lambda x, u, f, r: rates(x, u, f - 3.0 * (r.get("m", 1.0) - 1.0) * 4.905 * np.sin(x[0]), r)
    )
    hidden = replace(hidden, after=(0, 8.0), later=replace(hidden, factors={"m": 1.1}))
    d = diagnose(nominal("pendulum"), record(loaded, hidden, 3, seconds=20.0, traces=1), DiagnosisSettings())
    (change,) = _changes(d)
    assert "viscous" not in change.sentence
    assert "gain" not in change.sentence
    assert "m that is 30" in change.sentence


@pytest.mark.parametrize(("change", "counts"), [(Change(1, 0.8, 2.1), (5, 2)), (Change(1, 0.3, 0.3), (4, 4))])
def test_a_change_that_is_known_to_a_few_samples_divides_the_windows(change, counts):
    """It was found on every fifth sample, or before the first window that was searched."""
    start = np.arange(0, 80, 10)
    windows = Windows(start, start + 10, np.repeat([0, 1], 4))
    problem = SimpleNamespace(t=np.tile(np.arange(40), 2) * 0.1, windows=windows)
    assert tuple(map(len, change.windows(problem))) == counts


def test_a_change_in_the_run_that_confirms_is_told():
    """Of three runs the last one confirms; the others lack nothing."""
    hidden = Hidden(after=(2, 5.0), later=Hidden(viscous={"hinge": 0.2}))
    d = _diagnosed(pendulum(), hidden, traces=3, seconds=12.0)
    (change,) = _changes(d)
    assert (d.verdict, d.effects) == ("none", ())
    assert change.value == pytest.approx(5.0, abs=1.0)
    assert "viscous friction of 0.2" in change.sentence.split(" before, ")[1]


def test_a_plant_that_stays_as_it_is_did_not_change():
    d = _diagnosed(oscillator(), Hidden(viscous={"slide": 0.3}))
    assert (d.verdict, _changes(d)) == ("attributed", [])


class _Drifting(Hidden):
    """Friction that grows all the time."""

    def at(self, trace, t):
        return Hidden(viscous={"slide": 0.3 + 0.02 * t})


def test_friction_that_grows_slowly_is_no_change():
    assert _changes(_diagnosed(oscillator(), _Drifting())) == []


@pytest.mark.parametrize("steps", [0.5, 0.65, 0.8])
def test_a_spring_outside_the_library_is_no_change_where_the_motion_grows_at_an_instant(steps):
    plant = oscillator()
    rates, command = plant.rates, plant.command
    plant = replace(
        plant,
        rates=lambda x, u, f, r: rates(x, u, f - 80.0 * x[0] ** 3, r),
        command=lambda rng, t: command(rng, t) * np.where(t < 12.0, steps, 1.0)[:, None] * 1.5,
    )
    assert _changes(_diagnosed(plant, Hidden())) == []


@pytest.mark.parametrize("torque", [0.0, 1e-6])
def test_damping_that_grows_with_the_swing_is_no_change_between_large_and_small_ones(torque):
    """Nothing drives the pendulum; a torque that is logged with noise drives it as little."""
    rng, runs = np.random.default_rng(71107), []
    for k, begin in enumerate((1.5, 1.3, 1.4, 1.6, 0.25, 0.22, 0.27, 0.3)):
        q, v, out = begin, 0.0, []
        for _ in range(400):
            out.append(q)
            for _ in range(20):
                energy = 0.15 * v * v + 4.905 * (1.0 - np.cos(q))
                v += 5e-4 * (-4.905 * np.sin(q) - (0.12 if energy > 0.25 else 0.03) * v) / 0.3
                q += 5e-4 * v
        y = np.array(out)[:, None] + 1e-3 * rng.standard_normal((400, 1))
        runs.append(Trace(f"r{k}", 0.01 * np.arange(400), y, torque * rng.standard_normal((400, 1))))
    model = point_pendulum(1.0, 0.5, 0.3)
    record = Record(tuple(runs), ("angle",), ("torque",))
    d = diagnose(model, record, DiagnosisSettings(effects=("viscous_friction",)))
    assert (d.verdict, _changes(d)) == ("unexplained", [])


def _about_two_places(force):
    """An oscillator with a hidden force of (place, speed), and what it says; from 15 s on it moves about another place.

    m v' = u - d v - k q is declared.
    """
    rng, t, dt = np.random.default_rng([1, 0, 78]), np.arange(2400) / 100.0, 1e-3
    hz, phase, x = rng.uniform(1.0, 4.0, 6), rng.uniform(0.0, 2.0 * np.pi, 6), rng.uniform(-0.1, 0.1, 2)
    u = 4.0 / np.sqrt(6.0) * np.sin(2.0 * np.pi * np.outer(t, hz) + phase).sum(axis=1) + np.where(t < 15.0, 0.0, 2.7)

    def rate(x, felt):
        return np.array([x[1], (felt - 0.4 * x[1] - 20.0 * x[0] + force(*x)) / 1.5])

    q = []
    for felt in u:
        q.append(x[0])
        for _ in range(10):
            a = rate(x, felt)
            b = rate(x + dt / 2 * a, felt)
            c = rate(x + dt / 2 * b, felt)
            x = x + dt / 6 * (a + 2 * b + 2 * c + rate(x + dt * c, felt))
    y = np.array(q)[:, None] + 5e-4 * rng.standard_normal((len(t), 1))
    return diagnose(nominal("oscillator"), Record((Trace("run1", t, y, u[:, None]),), ("q",), ("u",)))


def test_an_effect_that_acts_on_one_side_alone_is_no_change():
    """Dry friction and a hard spring all the time, of which the spring is felt about the other place alone."""
    d = _about_two_places(lambda q, v: -0.5 * np.tanh(v / 1e-3) - 20.0 * q**3)
    assert not _changes(d)
    assert d.verdict == "attributed"
    assert {e.name for e in d.effects} == {"coulomb_friction", "cubic_spring"}


def test_where_a_change_goes_with_another_place_it_is_not_sure():
    """Dry friction everywhere, and a rail that is dirty about the other place: no number changed."""
    d = _about_two_places(lambda q, v: -0.5 * np.tanh(v / 1e-3) - 2.0 * v * (q > 0.07))
    assert d.verdict == "partial"
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    assert any("q moved elsewhere" in why for why in d.doubts)


def test_a_force_outside_the_library_is_no_change():
    pushes = tuple((0, 1.0 + 2 * j, 2.0 + 2 * j, "slide", 3.0) for j in range(11))
    d = _diagnosed(oscillator(), Hidden(pushes=pushes))
    assert d.verdict != "attributed"
    assert _changes(d) == []
