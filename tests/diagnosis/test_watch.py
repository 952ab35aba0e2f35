"""A search with a budget, with progress, and interrupted; and when masking is worth a search of its own."""

from __future__ import annotations

import os

import numpy as np
import pytest

from simgap.diagnosis import diagnose as diagnosing
from simgap.diagnosis import seek
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import explanations, selection
from simgap.diagnosis.search import watch as watching
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.errors import UserError
from tests.diagnosis.plants import block

DT, LATE = 0.01, 0.05
EFFECTS = ("viscous_friction", "input_delay", "spring", "input_bias")


def _record(extra: float = 0.0, late: float = 0.0, before: float = 0.0) -> Record:
    """A mass of 2 with viscous friction 0.8, commands that act `late`, `before` the record a constant one."""
    traces, steps = [], 10
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        t = np.arange(0.0, 6.0, DT)
        waves = zip(rng.uniform(0.5, 1.5, 3), (0.4, 0.9, 1.7), rng.uniform(0, 6, 3), strict=True)
        u = np.asarray(sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves))
        q, v, out, shift = 0.2, 0.1, [], round(late / DT)
        for k, now in enumerate(t):
            out.append(q)
            felt = u[k - shift] if k >= shift else before
            for i in range(steps):
                push = extra * np.sin(2 * np.pi * 3.1 * (now + i * DT / steps))
                v += DT / steps * (felt + push - 0.8 * v) / 2.0
                q += DT / steps * v
        y = np.array(out)[:, None] + 1e-4 * rng.standard_normal((len(t), 1))
        traces.append(Trace(f"run{seed}", t, y, u[:, None]))
    return Record(tuple(traces), ("q",), ("u",))


def stop_at(monkeypatch: pytest.MonkeyPatch, most: int) -> list[int]:
    """Stop searches at so many sets of effects, as a copy that answers on the way is stopped; the sets so far."""
    fitted: list[int] = []

    def counted(self: Watch, anyhow: bool = False) -> None:
        if self.sets >= most and not (self.stopped or self.over):
            self.stopped = "The search was stopped for a test"
            raise Stopped
        fitted.append(self.sets)

    monkeypatch.setattr(Watch, "save", counted)
    return fitted


def test_a_budget_is_kept_whatever_the_search_is_at(monkeypatch):
    """Of a search that takes for ever: what it had saved on its way is the answer, and the time is the budget."""

    concluded = diagnosing._concluded

    def endless(sought):
        while not sought.under.watch.stopped:
            pass
        return concluded(sought)

    record, settings = _record(), DiagnosisSettings(effects=EFFECTS, budget_s=4.0)
    diagnose(block(), record, DiagnosisSettings(effects=EFFECTS))  # compiles
    monkeypatch.setattr(diagnosing, "_concluded", endless)
    before = os.times()
    d = diagnose(block(), record, settings)
    after = os.times()
    assert sum(after[:4]) - sum(before[:4]) == pytest.approx(4.0, rel=0.1)
    assert [e.name for e in d.effects] == ["viscous_friction"]
    assert d.verdict == "attributed"
    assert "measured.budget_s = 4 s" in d.stopped


def test_a_budget_in_which_nothing_is_compared_is_refused():
    with pytest.raises(UserError, match=r"nothing was judged in that time\. Give more than 0\.001 s"):
        diagnose(block(), _record(), DiagnosisSettings(budget_s=1e-3))


def test_a_search_that_breaks_is_no_answer_though_one_was_saved_on_the_way():
    def breaks(tell):
        watch = Watch(60.0, tell)
        seek.looked_again(watch, lambda: watch.save(anyhow=True))  # the copy answers, the search goes on
        if watch.stopped:
            return "none: nothing is missing"
        raise ZeroDivisionError

    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        watching.answered(60.0, breaks, lambda words: None)


def test_progress_names_the_step_and_the_best_answer_so_far():
    said: list[str] = []
    d = diagnose(block(), _record(), DiagnosisSettings(effects=EFFECTS), said.append)
    assert d.verdict == "attributed"
    assert not d.stopped
    assert said[0].startswith("1 set of effects fitted")
    assert "best so far: viscous friction at the slide" in said[-1]  # Euler steps act a little early: a late log too
    assert [e.name for e in d.effects] == ["viscous_friction"]
    assert all(f.fault == "late_log" and f.value < 0.2 * DT for f in d.recording)


def test_an_interrupted_search_reports_its_best():
    said: list[str] = []

    def interrupt(words: str) -> None:
        said.append(words)
        if len(said) == 1:
            raise KeyboardInterrupt

    d = diagnose(block(), _record(extra=0.2), DiagnosisSettings(effects=EFFECTS), interrupt)
    assert "interrupted" in d.stopped
    assert [e.name for e in d.effects] == ["viscous_friction"]
    assert d.verdict == "partial"


def test_an_interrupt_under_a_budget_leaves_the_last_answer():
    def interrupt(words: str) -> None:
        raise KeyboardInterrupt

    d = diagnose(block(), _record(), DiagnosisSettings(effects=EFFECTS, budget_s=60.0), interrupt)
    assert (d.verdict, d.effects) == ("unexplained", ())
    assert "did not come to its end" in d.stopped


def test_a_budget_that_ends_at_any_set_gives_an_answer(monkeypatch):
    """The last sets are fitted to say what else there is; a budget that ended there came out as an exception."""
    record, settings = _record(), DiagnosisSettings(effects=EFFECTS[:2])
    fitted = stop_at(monkeypatch, 10**9)
    assert diagnose(block(), record, settings).verdict == "attributed"
    for most in range(max(fitted), 0, -4):
        stop_at(monkeypatch, most)
        d = diagnose(block(), record, settings)
        assert [e.name for e in d.effects] == ["viscous_friction"], most
        assert d.stopped.startswith("The search was stopped for a test: the answer is the best of"), most


def test_what_is_not_saved_again_has_not_changed(monkeypatch):
    """A copy answers at the first save, and then with another answer alone, a while after the last."""
    left, copies = [10.0], []

    def copied() -> bool:
        copies.append(left[0])
        left[0] -= 0.5
        return False

    monkeypatch.setattr(watching, "copied", copied)
    monkeypatch.setattr(watching, "seconds_left", lambda: left[0])
    watch = Watch(budget_s=10.0)
    for best, spent in (("", 0.0), ("a", 1.0), ("a", 0.5), ("a", 3.0), ("a", 3.0), ("b", 0.0)):
        left[0] -= spent
        watch.best = best
        watch.save()
    assert copies == [10.0, 5.0, 1.5]
    watch.best = "c"
    watch.save(anyhow=True)
    watch.over = True
    watch.save(anyhow=True)
    assert copies == [10.0, 5.0, 1.5, 1.0]


@pytest.mark.parametrize(("extra", "before", "again"), [(0.25, 0.0, False), (0.0, 3.0, False), (0.05, 5.0, True)])
def test_masking_is_searched_anew_only_if_it_tells_more(monkeypatch, extra, before, again):
    """Off the noise floor a second search costs as much as the first, and finds the same where the rest is the rest."""
    calls: list[float] = []
    select = selection.select

    def counted(search, base, most):
        calls.append(base.chi2)
        return select(search, base, most)

    monkeypatch.setattr(selection, "select", counted)
    d = diagnose(block(), _record(extra, LATE, before), DiagnosisSettings(effects=EFFECTS, max_effects=2))
    assert {e.name for e in d.effects} == {"viscous_friction", "input_delay"}
    assert bool(calls) == again


def test_what_is_masked_after_the_end_is_fitted_and_not_searched(monkeypatch):
    """A delay masks what was commanded before the record; a search that has ended does not begin anew for that."""
    begun = []
    select = selection.select

    def once(*given):
        begun.append(1)
        return _ended(select(*given), given[0].watch)

    for module in (seek, selection):
        monkeypatch.setattr(module, "select", once)
    d = diagnose(block(), _record(late=LATE), DiagnosisSettings(effects=("input_delay",)))
    assert len(begun) == 1
    assert "stopped for a test" in d.stopped


def test_what_was_found_outlives_a_stop_in_the_search_after_it(monkeypatch):
    """Commands of before the record are masked once a delay is found: a stop in that search leaves the delay."""

    def stopped(search, *rest):
        _ended(None, search.watch)
        raise watching.Stopped

    monkeypatch.setattr(seek, "carried_over", stopped)
    d = diagnose(block(), _record(late=LATE), DiagnosisSettings(effects=("input_delay",)))
    assert "stopped for a test" in d.stopped
    assert [e.name for e in d.effects] == ["input_delay"]


def _ended(found, watch):
    watch.stopped = "The search was stopped for a test"
    return found


def test_a_fit_that_begins_at_the_same_place_is_made_once(monkeypatch):
    made, of_fit = [], explanations.fit

    def counted(problem, theta, x0, slots, *rest, **more):
        made.append((tuple(slots), theta.tobytes(), x0.tobytes()))
        return of_fit(problem, theta, x0, slots, *rest, **more)

    monkeypatch.setattr(explanations, "fit", counted)
    diagnose(block(), _record(extra=0.3), DiagnosisSettings(effects=EFFECTS, max_effects=2))
    begun = [m for m in made if m[0]]
    assert len(begun) > 10
    assert len(begun) == len(set(begun))


def test_an_answer_at_the_limit_off_the_noise_says_so():
    """Off the noise fewer effects are allowed: the remedy is to allow more."""
    settings = DiagnosisSettings(effects=EFFECTS, max_effects=5, most_off_floor=2)
    d = diagnose(block(), _record(0.3, LATE), settings)
    assert d.after.chi2_dof > 2.0
    assert len(d.effects) == 2
    assert d.at_most == 2
