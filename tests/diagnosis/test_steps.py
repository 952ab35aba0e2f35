"""The steps from the model as declared to the answer."""

from __future__ import annotations

import itertools

import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from tests.diagnosis.plants import block
from tests.diagnosis.test_watch import EFFECTS, _record


@pytest.mark.parametrize(("budget", "extra"), [(None, 0.2), (1e-3, 0.02)])
def test_steps_lead_from_the_declared_model_to_the_answer(budget, extra):
    d = diagnose(block(), _record(extra=extra), DiagnosisSettings(effects=EFFECTS, budget_s=budget))
    taken = [o for s in d.steps for o in s.options if o.taken]
    assert {(o.name, o.on) for o in taken if o.name not in ("late_log",)} == {(e.name, e.on) for e in d.effects}
    assert d.steps[0].chi2_dof == pytest.approx(d.before.chi2_dof, rel=0.01)
    for step, after in itertools.pairwise(d.steps):
        assert [o.taken for o in step.options] == [True] + [False] * (len(step.options) - 1)
        assert after.chi2_dof == step.options[0].chi2_dof
    assert taken[-1].chi2_dof == pytest.approx(d.after.chi2_dof, rel=0.01)
    alone = {(c.name, c.on): c.bic_gain for c in d.candidates if c.bic_gain is not None}
    assert {(o.name, o.on): o.bic_gain for o in d.steps[0].options}.items() <= alone.items()
    if budget is None:
        assert len(d.steps[0].options) > 1  # others were fitted beside what was taken
        assert not any(o.taken for o in d.steps[-1].options)
