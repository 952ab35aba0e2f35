"""Where a small part of the time carries most of the error, the answer says where, and what it is worth without it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.verdict.held_out import HorizonError, concentrated
from simgap.diagnosis.verdict.words import verdict_parts
from tests.diagnosis.plants import block

DT, STEPS = 0.01, 10
PUSHED = (14.1, 14.3)


def said(document):
    return " ".join(verdict_parts(document))


def _run(seed: int, push: float, seconds: float) -> Trace:
    """A mass of 2 with viscous friction 0.8, by small Euler steps; a push for a fifth of a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    waves = zip(rng.uniform(0.5, 1.5, 3), (0.4, 0.9, 1.7), rng.uniform(0, 6, 3), strict=True)
    u = np.asarray(sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves))
    q, v, out = 0.2, 0.1, []
    for k, now in enumerate(t):
        out.append(q)
        for _ in range(STEPS):
            v += DT / STEPS * (u[k] + push * (PUSHED[0] <= now < PUSHED[1]) - 0.8 * v) / 2.0
            q += DT / STEPS * v
    return Trace(f"run{seed}", t, np.array(out)[:, None] + 1e-3 * rng.standard_normal((len(t), 1)), u[:, None])


@pytest.mark.parametrize(("push", "verdict"), [(20.0, "partial"), (0.0, "attributed")])
def test_a_push_beside_what_is_at_the_noise_is_left_out(push, verdict):
    traces = (_run(1, 0.0, 6.0), _run(2, 0.0, 6.0), _run(3, push, 30.0))
    settings = DiagnosisSettings(noise={"q": 1e-3}, effects=("viscous_friction", "spring"), held_out_traces=("run3",))
    d = diagnose(block(), Record(traces, ("q",), ("u",)), settings)
    assert (d.verdict, d.concentrated) == (verdict, None)
    assert [f.fault for f in d.recording] == ["push"] * bool(push)
    assert [e.name for e in d.effects] == ["viscous_friction"]
    assert d.effects[0].parameters["b"].value == pytest.approx(0.8, rel=0.05)


def test_a_few_large_errors_are_located_and_the_rest_is_judged_without_them():
    """What somebody moves between 14.1 and 14.3 s is missed under both models; the corrected one halves the rest."""
    rng, t = np.random.default_rng(5), DT * np.arange(3000)
    begin = np.arange(0, 2900, 10)
    end = begin + 50
    pushed = (t[end] > PUSHED[0]) & (t[begin] < PUSHED[1])
    noise = rng.standard_normal((len(begin), 1))

    def held(size):
        error = size * noise + 100.0 * pushed[:, None]
        return SimpleNamespace(at_noise=False, horizon=HorizonError(error, begin, end, lambda: np.array([0.5])))

    confirm = SimpleNamespace(
        sigma=np.ones(1), t=t, firsts=np.array([0]), model=SimpleNamespace(measured=("q",)),
    )  # fmt: skip
    found = concentrated(confirm, ["run3"], held(10.0), held(5.0))
    ((trace, first, last),) = found.stretches
    assert trace == "run3"
    assert PUSHED[0] - 0.5 < first < PUSHED[1]
    assert PUSHED[0] < last < PUSHED[1] + 0.5
    assert found.error_share >= 0.5
    assert found.excess_share_without == pytest.approx(0.5, abs=0.02)
    assert found.median_after["q"] == pytest.approx(0.5 * found.median_before["q"], rel=0.1)


@pytest.mark.parametrize("shape", ["gaussian", "sine"])
def test_an_error_that_is_spread_is_not_in_one_place(shape):
    n, rng = 400, np.random.default_rng(4)
    size = rng.standard_normal(n) if shape == "gaussian" else np.sin(0.1 * np.arange(n))
    at = np.arange(n)
    ahead = HorizonError(30 * size[:, None], 10 * at, 10 * at + 50, lambda: np.array([1e-3]))
    held = SimpleNamespace(at_noise=False, horizon=ahead)
    confirm = SimpleNamespace(sigma=np.ones(1))
    assert concentrated(confirm, ["a"], held, held) is None


def test_the_sentence_says_where():
    place = {
        "stretches": [{"trace": "run2", "from": 4.1, "to": 4.3}],
        "error_share": 0.62,
        "explained_share_without": 0.93,
    }
    text = said({"verdict": "unexplained", "effects": [], "candidates": [], "concentrated": place})
    assert text.endswith(
        "62 % of what is left lies at 4.1 to 4.3 s of run2 (a push?); without them the effects explain 93 %."
    )
