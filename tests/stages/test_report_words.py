"""What a page says of older inputs and of recordings that are too noisy to be checked against gamma."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.config.controller import ValidationSection
from simgap.gap.bounds.function import PROVEN
from simgap.gap.fitting.dimension_fit import deterministic_tier
from simgap.geometry import Box, Grid
from simgap.io.traces import Trace
from simgap.notation import interval, powers
from simgap.report import content, tables
from simgap.report.content import little_won, unproven
from simgap.report.diagnosis_document import arm_sentence
from simgap.specifications.solution import Solution
from simgap.synthesis.controller import RULES, Controller


def test_an_influence_that_rises_with_age_is_told_from_a_memory_of_the_robot():
    headings = [1.5e-4, 4e-4]
    risen = {"memory": [[1.3e-4, 3e-4], [1.4e-4, 2e-4], [0.0, 0.0]], "heading_deviation": headings}
    assert tables.unsettled(risen)
    assert not tables.unsettled(risen | {"memory": [[1.3e-4, 3e-4], [1.2e-4, 2e-4], [0.0, 0.0]]})  # it falls
    assert not tables.unsettled(risen | {"memory": [[5e-3, 3e-4], [6e-3, 2e-4]]})  # larger than headings explain
    assert not tables.unsettled({"memory": risen["memory"]})


def test_transitions_whose_noise_leaves_gamma_are_not_counted():
    def page(before: float, after: float) -> SimpleNamespace:
        inside = {
            side: {"share": 0.3, "noise_alone": noise, "transitions": 202.0}
            for side, noise in (("before", before), ("after", after))
        }
        return SimpleNamespace(corrected=SimpleNamespace(inside=inside), diagnosis=None)

    assert "202 held-out transitions" in tables.too_noisy(page(0.0, 0.1))
    assert list(tables._measured(page(0.0, 0.1))) == []
    assert tables.too_noisy(page(0.0, 0.9)) == ""
    assert [before for _, before, _, _ in tables._measured(page(0.0, 0.9))] == [0.3, 0.0]


def test_the_index_counts_every_step_of_the_adversary():
    audit = {"violations": 0, "evaluations": 30_000, "steps": 10_014, "steps_against_the_disturbance": 10_177}
    loop = {"runs": 1, "runs_that_kept_the_specification": 1, "steps_outside_gamma": 0, "steps": 5}
    summary = {"closed_loop": {"gap": {"simulator": loop}}, "sup_gamma": [{"eps": None, "states": {}}], "eps": None,
               "winning_fraction": {}, "audit": audit}  # fmt: skip
    assert tables.overview(summary)["evaluations"] == 30_000 + 10_014 + 10_177


def test_a_promise_that_ends_beside_its_target_is_no_praise():
    """An arm that won cells one step from its target alone had 100 of 100 runs, in 100 steps, under "promise kept"."""
    assert "within one sample of the target" in little_won(1)
    assert "within 2 samples of the target" in little_won(2)
    assert "domain.U" in little_won(2)
    assert little_won(3) == ""
    assert little_won(None) == ""  # nowhere to go


def test_a_proven_bound_is_not_said_to_rest_on_samples():
    assert unproven({"guarantee": [deterministic_tier("inflate").to_json()]}) == "samples alone cannot prove"
    said = unproven({"guarantee": [PROVEN.to_json()]})
    assert "samples" not in said
    assert "the bound of whole steps" in said


def test_shares_of_both_controllers_are_of_the_same_cells():
    """What a motion sweeps between samples takes cells from the gap-aware controller alone: .994 stood beside .990."""
    syntheses = {
        "gap": {"winning_cells": 7952, "free_cells": 8000, "winning_fraction": 0.994},
        "nominal": {"winning_cells": 9900, "free_cells": 10000, "winning_fraction": 0.99},
    }
    m = SimpleNamespace(syntheses=syntheses)
    assert content.common_free(syntheses) == 10000
    assert content._won(m, "gap") == "79.5 % (7,952 cells)"
    assert content._won(m, "nominal") == "99.0 % (9,900 cells)"
    assert "8,000 of them stay free between samples, of which it wins 99.4 %" in content._own_share(m)
    same = SimpleNamespace(syntheses={k: s | {"free_cells": 10000} for k, s in syntheses.items()})
    assert content._own_share(same) == ""


def test_a_table_is_signed_where_its_sides_differ():
    def table(lower, upper):
        return {"kind": "cells", "gap": {"q": {"lower": lower, "upper": upper}}, "dimensions": [{"scenario": {}}]}

    assert tables.is_signed(table([[-1.0, -2.0]], [[1.0, 3.0]]))
    assert not tables.is_signed(table([[-1.0, -2.0]], [[1.0, 2.0]]))


def test_the_headline_says_what_its_number_of_runs_excludes():
    def page(runs: int, bad: int, first: int = 0, starts: int | None = None) -> SimpleNamespace:
        section = ValidationSection(starts=starts, first=({},) * first)
        tally = {"runs": runs, "runs_that_violated_it": bad}
        case = SimpleNamespace(validation=section)
        return SimpleNamespace(context=SimpleNamespace(case=case), tally=lambda kind: tally)

    plain = content._sample(page(300, 0))
    assert "at most 1 % fail" in plain  # 1 - 0.05^(1/300) = 0.9936 %
    assert plain.endswith("starts, of a full run, would make it 0.3 %.")  # 0.2992 %
    assert content._sample(page(1000, 0)) == "Of starts drawn like these at most 0.3 % fail, with 95 % confidence."
    assert "full run" not in content._sample(page(20, 0, starts=20))  # a full run takes no more than the case says
    assert "at most 14 %" in content._sample(page(21, 0, first=1, starts=21))  # 13.91 %: a given start is not drawn
    assert "at most 2.1 %" in content._sample(page(300, 2))  # 0.0209: rounded up


def test_many_effects_of_an_arm_are_told_by_kind():
    def friction(kind, symbol, joint):
        found = {"value": 2.0, "ci95": [1.9, 2.1], "unit": "N*m"}
        return {"name": kind, "on": joint, "parameters": {symbol: found}}

    joints = ("j1", "j2", "j3")
    kinds = {"coulomb_friction": "F_c", "viscous_friction": "b"}
    effects = [friction(kind, symbol, j) for kind, symbol in kinds.items() for j in joints]
    told = {"verdict": "partial", "recording": [], "payloads": [], "explained_share": 0.8, "explained_error": None}
    told["error"] = {"after": {"horizon_s": 0.0, "horizon_rmse": {}}}
    rows = [{"joint": j, "input": f"u_{j}", "link": f"link_{j}"} for j in ("j1", "j2", "j3", "j4")]
    few, many, every = (
        arm_sentence(told | {"effects": effects[:n], "joints": rows[:k]}) for n, k in ((2, 4), (6, 4), (6, 3))
    )
    assert every.startswith("Coulomb friction at the joints and viscous friction at the joints together ")
    some = arm_sentence(told | {"effects": effects[:5], "joints": rows[:3]})
    assert some.startswith("Coulomb friction at the joints and viscous friction at the joints j1 and j2 together ")
    assert few.startswith("Coulomb friction of 2.0 ± 0.1 N m at the j1 and Coulomb friction of 2.0 ")
    assert many.startswith("Coulomb friction at the joints j1, j2 and j3 and viscous friction at the joints j1, j2 ")


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((1.29903, 1.30049), "1.2990 to 1.3005"),
        ((1.29998, 1.30002), "1.299980 to 1.300020"),
        ((-0.01, 0.02), "-0.010 to 0.020"),
        ((3.0, 240.0), "3 to 240"),
        ((1.5e7, 1.6e7), "1.5·10⁷ to 1.6·10⁷"),
        ((1e-8, 3e-8), "10⁻⁸ to 3·10⁻⁸"),
        ((0.5, 0.5), "0.5 to 0.5"),
    ],
)
def test_the_ends_of_an_interval_differ_in_print(ends, said):
    """An interval of a gain stood on a page as "1.3 to 1.3"."""
    assert interval(ends) == said


def test_powers_of_ten_in_a_text_are_those_of_tables():
    assert powers("q: 7.25e-05, 0.0003 and 1e-08; 3 cells") == "q: 7.25·10⁻⁵, 0.0003 and 10⁻⁸; 3 cells"


def test_why_the_gap_aware_controller_may_fail_on_the_nominal_model():
    """A page said safe in 300 of 300, and further down 300 of 300 failures without a word."""

    def said(bad: int, sides: tuple[str, ...] = ("lower", "upper")) -> str:
        case = SimpleNamespace(simulator=SimpleNamespace(inertia="engine"))
        return content.on_model(
            SimpleNamespace(
                tally=lambda kind, plant: {"runs_that_violated_it": bad, "runs": 300},
                gap={"dimensions": [{"scenario": {side: {} for side in sides}}]},
                context=SimpleNamespace(case=case),
            )
        )

    assert said(300, ("size",)) == "On the nominal model itself, 300 of 300 runs of the gap-aware controller fail."
    assert "whose inertia the engine computes" in said(300)
    assert "There, 300 of 300 runs fail" in said(300)
    assert said(0) == ""


def _ended(cells: str, end: float = 1.7, gap: float = 0.5) -> SimpleNamespace:
    """Winning cells (x) of a nominal controller, of four over [0, 2], and a run of it whose last step has a gap."""
    won = np.array([c == "x" for c in cells])
    solution = Solution(Grid(Box([0.0], [2.0]), (4,)), won, won[:, None].astype(np.uint8), np.ones(4, dtype=bool))
    steps = [np.array([[v]]) for v in (0.0, gap, gap - 1.0, gap + 1.0)]
    run = Trace.of(("nominal", "simulator", 0), 0.1, np.array([[0.2], [end]]), steps, np.ones(2, dtype=bool))
    return SimpleNamespace(
        controllers={"nominal": Controller(np.zeros((1, 1)), ("q",), ("u",), solution, RULES[0], {})},
        traces=[run],
        tally=lambda kind: {"runs_that_violated_it": 1},
        context=SimpleNamespace(states=("q",), units={"q": "rad"}, case=None),
    )


def test_the_step_that_ends_a_nominal_run_is_told_with_its_gap():
    said = content.failure(_ended("xxx."))
    assert "ends at q = 1.7 rad, outside its winning domain" in said
    assert "(0.5 rad in q) is the cause" in said
    assert content.failure(_ended("xxx.", end=1.2)) == ""  # it ends inside: something else ended it
    assert content.failure(_ended("xxx.", gap=0.1)) == ""  # the model alone leaves too
    kept = _ended("xxx.")
    kept.tally = lambda kind: {"runs_that_violated_it": 0}
    assert content.failure(kept) == ""


@pytest.mark.parametrize(("verdict", "rig", "lacking", "words"), [
    ("attributed", "hardware", [{"name": "coulomb_friction", "on": "shaft"}], "lacks the same effects"),
    ("unexplained", "hardware", [], "no effect of the library"),
    ("attributed", "hardware", [], ""),  # the simulator has them: gamma covers what the model lacks
    ("attributed", "simulator", [], ""),
    ("none", "hardware", [], ""),
])  # fmt: skip
def test_a_promise_in_a_simulator_that_recordings_contradict_says_so_first(verdict, rig, lacking, words):
    """A motor's law failed in 138 of 284 starts on the plant, under a green "promise kept"."""
    context = SimpleNamespace(case=SimpleNamespace(measured=SimpleNamespace(rig=rig)))
    said = content.contradicted(SimpleNamespace(context=context, diagnosis={
        "verdict": verdict, "simulator": {"effects": lacking},
    }))  # fmt: skip
    assert words in said
    assert bool(said) == bool(words)
