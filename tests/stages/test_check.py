"""`simgap check`: planted surprises of model files are found and are real, costs refuse before anything long runs."""

import copy
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.io.results import read_parquet
from simgap.lint import costs, engine, equations
from simgap.lint.controller import refuse_specification
from simgap.lint.gap import find_jumps_at_rest, refuse_basis
from simgap.model.sampled import NominalModel
from simgap.plants.context import Context
from simgap.simulators.base import Simulator
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import check, grid, synthesis

LINK = """<link name="rod"><inertial><origin xyz="0 0 -0.5" rpy="0 0 0"/><mass value="1.0"/>
<inertia ixx="0.0833" ixy="{ixy}" ixz="0" iyy="0.0833" iyz="0" izz="0.02"/></inertial>{visual}</link>"""
URDF = (
    """<?xml version="1.0"?><robot name="r"><link name="base"/>"""
    + LINK
    + """{more}<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><origin xyz="0 0 0"/>
<axis xyz="{axis}"/><limit {range} effort="{effort}" velocity="{velocity}"/>
<dynamics damping="{damping}" friction="{friction}"/>{inside}</joint>{gear}</robot>"""
)
PLAIN = {
    "ixy": 0, "visual": "", "more": "", "axis": "0 1 0", "range": 'lower="-12" upper="12"', "effort": 100,
    "velocity": 1000, "damping": 0, "friction": 0, "inside": "", "gear": "",
}  # fmt: skip
TIP = """<link name="tip"/><joint name="fixed" type="fixed"><parent link="rod"/><child link="tip"/>
<origin xyz="0 0 -1"/></joint>"""
ARM = """<link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="other" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>"""
TWO = {
    "plant.states": {
        "q": {"joint": "hinge", "quantity": "position", "unit": "rad"},
        "w": {"joint": "hinge", "quantity": "velocity", "unit": "rad/s"},
        "p": {"joint": "other", "quantity": "position", "unit": "rad"},
        "v": {"joint": "other", "quantity": "velocity", "unit": "rad/s"},
    },
    "domain.X": {"q": [-0.2, 0.2], "w": [-0.5, 0.5], "p": [-1, 1], "v": [-1, 1]},
}
GEAR = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="hinge"/><actuator name="m"><mechanicalReduction>50</mechanicalReduction>
</actuator></transmission>"""
CASE = {
    "name": "rod",
    "plant": {
        "urdf": "rod.urdf",
        "states": {
            "q": {"joint": "hinge", "quantity": "position", "unit": "rad"},
            "w": {"joint": "hinge", "quantity": "velocity", "unit": "rad/s"},
        },
        "inputs": {"u": {"joint": "hinge", "unit": "N*m"}},
    },
    "domain": {"tau": 0.01, "X": {"q": [-0.2, 0.2], "w": [-0.5, 0.5]}, "U": {"u": {"min": -1, "max": 1, "step": 1}}},
    "simulator": {"engine": "pybullet", "inertia": "file", "damping": {"linear": 0, "angular": 0, "joint": 0}},
    "grid": {"eps": 0.05},
    "gap": {"basis": ["q", "w", "u", 1]},
}


def written(folder, urdf=(), case=()):
    """A case and its model file, varied: urdf replaces parts of the file, case dotted keys."""
    (folder / "rod.urdf").write_text(URDF.format(**PLAIN).format(**PLAIN) if not urdf else _filled(urdf))
    content = copy.deepcopy(CASE)
    for key, value in dict(case).items():
        *parents, last = key.split(".")
        place = content
        for part in parents:
            place = place.setdefault(part, {})
        place[last] = value
    path = folder / "rod.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def _filled(parts):
    return URDF.format(**{**PLAIN, **dict(parts)})


def step(path, x, u):
    """One step in the engine itself: -> (n, 2)."""
    ((out, _),) = run_in_processes(
        roll_out, [(load_case(path), path.parent, np.atleast_2d(x).astype(float), np.array([[u]], dtype=float))]
    )
    return out[0]


def findings(path):
    """Without the nominal model, which takes Drake seconds to build."""
    context = Context.load(path)
    return engine.of_engine(context, engine.model_file(context))[0]


def test_a_plain_file_has_no_surprise(tmp_path):
    assert check.run(written(tmp_path)).findings == []


SURPRISES = [
    ("inertia", {}, {"simulator.inertia": "engine"}, "simulator.inertia", "principal moments"),
    ("damping", {"damping": 0.3}, {}, "simulator.damping.joint", "replaces the damping 0.3"),
    ("links", {}, {"simulator.damping": {"linear": 0.04}}, "simulator.damping", "damps every link"),
    ("friction", {"friction": 0.5}, {}, "joint 'hinge'", "neither Drake nor the engine simulates its friction"),
    ("stop", {"range": 'lower="-0.1" upper="0.1"'}, {}, "domain.X.q", "the engine stops it"),
    ("near", {"range": 'lower="-0.204" upper="0.3"'}, {}, "domain.X.q", "the stops at -0.204 and 0.3"),
    ("locked", {"range": 'lower="0" upper="0"'}, {}, "domain.X.q", "the engine stops it"),
    ("effort", {"effort": 0.5}, {}, "domain.U.u", "limited to 0.5"),
    ("velocity", {"velocity": 0.1}, {}, "domain.X.w", "limited to 0.1"),
    ("fastest", {}, {"domain.X": {"q": [-0.2, 0.2], "w": [-150, 150]}, "grid.eps": 9}, "domain.X.w", "speed to 100"),
    ("mimic", {"inside": '<mimic joint="other"/>', "more": ARM}, TWO, "joint 'hinge'", "follow joint 'other'"),
    ("gear", {"gear": GEAR}, {}, "joint 'hinge'", "a gear or a rotor's inertia"),
]


@pytest.mark.parametrize(("name", "urdf", "case", "key", "said"), SURPRISES, ids=[s[0] for s in SURPRISES])
def test_a_planted_surprise_is_found_alone(tmp_path, name, urdf, case, key, said):
    (finding,) = findings(written(tmp_path, urdf, case))
    assert finding.key == key
    assert said in finding.problem
    assert finding.remedy


def test_what_is_said_of_the_engine_is_true_of_it(tmp_path):
    """Each in PyBullet itself, against the plain file."""
    plain = step(written(tmp_path), [0.1, 1.0], 1.0)
    for same in ({"friction": 0.5}, {"effort": 0.1}, {"velocity": 0.5}, {"damping": 5.0}, {"gear": GEAR}):
        assert np.array_equal(step(written(tmp_path, same), [0.1, 1.0], 1.0), plain), same
    stopped = written(tmp_path, {"range": 'lower="-1" upper="0.1"'})
    assert step(stopped, [0.1, 1.0], 1.0)[0] < plain[0] - 0.005
    locked = written(tmp_path, {"range": 'lower="0" upper="0"'})
    assert abs(step(locked, [0.1, 1.0], 1.0)[1]) < 1e-9
    assert step(written(tmp_path), [0.1, 150.0], 0.0)[1] == pytest.approx(100.0)


def test_a_frame_without_mass_weighs_nothing(tmp_path):
    """PyBullet alone gives a link without <inertial> 1 kg and 1, 1, 1 kg m^2; sensors' frames are written like that."""
    plain = step(written(tmp_path), [0.1, 0.5], 1.0)
    with_frame = written(tmp_path, {"more": TIP})
    assert np.abs(step(with_frame, [0.1, 0.5], 1.0) - plain).max() < 1e-12
    assert findings(with_frame) == []


def test_an_axis_of_another_length_is_refused(tmp_path):
    """PyBullet alone takes a hinge with axis 0 2 0 for a hundred times the inertia."""
    with pytest.raises(UserError, match="has length 2") as refused:
        check.run(written(tmp_path, {"axis": "0 2 0"}))
    assert refused.value.key == "joint 'hinge': <axis> xyz"


def test_the_nominal_model_takes_frames_without_mass(tmp_path):
    x, u = np.array([[0.1, 0.5]]), np.array([[1.0]])
    plain = Context.load(written(tmp_path)).plant.sampled.step(x, u)
    assert np.abs(Context.load(written(tmp_path, {"more": TIP})).plant.sampled.step(x, u) - plain).max() < 1e-15


def test_a_missing_mesh_is_refused(tmp_path):
    visual = '<visual><geometry><mesh filename="rod.stl"/></geometry></visual>'
    with pytest.raises(UserError, match="the mesh does not exist"):
        check.run(written(tmp_path, {"visual": visual}))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"grid.eps": 1e-9}, "grid.eps"),
        ({"grid.eps": 1e-5}, "grid.eps"),
        ({"domain.U": {"u": {"min": -1, "max": 1, "step": 1e-12}}}, "grid.eps"),
        (
            {
                "synthesis": {
                    "cells": [1_000_000, 1_000_000],
                    "specification": {"kind": "invariance", "safe": {"q": [0, 0.2]}},
                }
            },
            "synthesis.cells",
        ),
        ({"budget": {"time": "1 min"}, "grid.eps": 2e-4}, "grid.eps"),
        ({"gap.basis": {"kind": "monomials", "degree": 24}}, "gap.basis"),
        ({"budget": {"memory": "300 MiB"}, "grid.eps": 1e-3}, "grid.eps"),
    ],
)
def test_what_costs_too_much_is_refused_with_its_key(tmp_path, changes, key):
    with pytest.raises(UserError, match="the budget is") as refused:
        check.run(written(tmp_path, case=changes))
    assert refused.value.key == key
    assert refused.value.file == tmp_path / "rod.yaml"


def test_a_degree_of_millions_of_terms_is_refused_at_once(tmp_path):
    with pytest.raises(UserError, match="degree 9999 has") as refused:
        check.run(written(tmp_path, case={"gap.basis": {"kind": "monomials", "degree": 9999}}))
    assert refused.value.key == "gap.basis.degree"


@pytest.mark.parametrize(
    ("term", "words"),
    [
        ("max(q, w)", "'max(q, w)' is not twice differentiable"),
        ("sin(20*q)/(20*q)", "'1/q' divides by what may be 0"),
        ("log(q)", "'log(q)' is not shown to be bounded"),
    ],
)
def test_a_term_of_a_basis_is_refused_before_the_roll_outs_for_what_it_is(tmp_path, term, words):
    with pytest.raises(UserError) as refused:
        refuse_basis(Context.load(written(tmp_path, case={"gap.basis": [term, 1]})))
    assert (refused.value.key, words in refused.value.problem) == ("gap.basis", True), str(refused.value)


def test_cells_are_told_as_the_cause_of_what_they_cost(tmp_path):
    """An audit of 400 million cells holds gigabytes, however few steps it makes."""
    specification = {"kind": "invariance"}
    for cells, key in ((20_000, "synthesis.cells"), (100, "audit.evaluations")):
        case = {"synthesis": {"cells": [cells, cells], "specification": specification}, "budget.memory": "1 TiB"}
        found = {c.stage: c for c in costs.costs(Context.load(written(tmp_path, case=case)), rollout=1e-3)}
        assert found["audit"].key == key
    assert found["audit"].of == "steps of the adversary"


def test_the_stages_refuse_it_too(tmp_path):
    path = written(tmp_path, case={"grid.eps": 1e-9})
    with pytest.raises(UserError, match="the budget is"):
        grid.run(path, None, tmp_path / "grid")
    with pytest.raises(UserError, match="the budget is"):
        grid.run(written(tmp_path), "eps~1e-9", tmp_path / "grid")
    specification = {"kind": "invariance", "safe": {"q": [0, 0.2], "w": [-0.5, 0.5]}}
    large = {"synthesis": {"cells": [1_000_000, 1_000_000], "specification": specification}}
    with pytest.raises(UserError, match="the budget is"):
        synthesis.run(written(tmp_path, case=large), None, tmp_path / "controller.npz", tmp_path / "synthesis.json")
    assert {p.name for p in tmp_path.iterdir()} == {"rod.yaml", "rod.urdf"}


def test_a_symbol_of_the_basis_that_does_not_exist_is_found_before_the_rollouts(tmp_path):
    with pytest.raises(UserError, match="'qq' names 'qq', which is not known") as refused:
        check.run(written(tmp_path, case={"gap.basis": ["qq", 1]}))
    assert refused.value.key == "gap.basis"


def test_what_is_being_done_is_said(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr(check.engine, "of_engine", lambda *given: (None, None))
    check.run(written(tmp_path), tell=said.append)
    assert said == ["building the nominal model of 2 states", "querying the engine pybullet"]


def test_the_counts_are_those_of_the_stages(tmp_path):
    path = written(tmp_path)
    found = {cost.stage: cost for cost in check.run(path, tmp_path / "check.json").costs}
    grid.run(path, None, tmp_path / "grid")
    states, inputs = (read_parquet(tmp_path / "grid" / f"{name}.parquet").num_rows for name in ("states", "inputs"))
    assert found["rollouts"].count == states * inputs == found["gap"].count
    assert found["workflow"].count >= len(found) - 1 + 4  # a small run is mostly this: jobs that begin, page, recording
    assert found["workflow"].seconds > 10.0
    assert (tmp_path / "check.json").is_file()


def test_a_fair_baseline_of_samples_alone_is_refused_before_anything_runs(vary):
    path = vary("pendulum", {"validation.fair_baseline": True})
    with pytest.raises(UserError, match="this one is about sampling instants alone") as caught:
        check.run(path)
    assert caught.value.key == "validation.fair_baseline"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"synthesis.specification": {"kind": "invariance", "safe": {"q": [0, 0.2], "w": [-0.5, 0.5]}}}, "to be held"),
        ({"synthesis.rule": "middle"}, "the rule `middle`"),
        ({"sensing": {"latency": 1}}, "the input under way"),
    ],
)
def test_one_input_a_cell_is_refused_before_anything_runs_where_it_cannot_be_kept(tmp_path, changes, what):
    aim = {"kind": "reach_avoid", "target": {"q": [0.1, 0.2], "w": [-0.5, 0.5]}}
    plain = {"synthesis": {"cells": [10, 10], "specification": aim, "record": "one"}}
    refuse_specification(Context.load(written(tmp_path, case=plain)))
    with pytest.raises(UserError, match=what) as refused:
        refuse_specification(Context.load(written(tmp_path, case=plain | changes)))
    assert refused.value.key == "synthesis.record"


class Twin(Simulator):
    """A simulator of which only the time of its roll-outs matters."""

    def reset(self, x):
        raise NotImplementedError

    advance = reset


@pytest.mark.parametrize(("rests", "least", "most"), [([0.01], 0.01, 0.02), ([0.0, 0.05, 0.0], 0.0, 0.01)])
def test_what_an_engine_costs_is_not_what_a_busy_machine_makes_of_it(monkeypatch, rests, least, most):
    """Waiting in every roll-out is the engine's; in some, it is others that run meanwhile."""

    class Slow(Twin):
        calls = 0

        def rollouts(self, x, u):
            for _ in x:
                time.sleep(rests[self.calls % len(rests)])
                self.calls += 1

    monkeypatch.setattr("simgap.simulators.rollouts.make_simulator", lambda case, folder: Slow())
    _, seconds = engine.ask_engine(SimpleNamespace(is_random=False), None, np.zeros((3, 2)), np.zeros((3, 1)))
    assert least <= seconds < most


def test_what_an_engine_costs_is_that_of_many_rollouts_at_once(monkeypatch):
    """As the stages ask for them: what is spent once a call is shared."""

    class Vectorised(Twin):
        def rollouts(self, x, u):
            end = time.process_time() + 2e-3
            while time.process_time() < end:
                pass

    monkeypatch.setattr("simgap.simulators.rollouts.make_simulator", lambda case, folder: Vectorised())
    _, seconds = engine.ask_engine(SimpleNamespace(is_random=False), None, np.zeros((3, 2)), np.zeros((3, 1)))
    assert seconds < 2e-5


@pytest.mark.parametrize("case", ["dc_motor", "pendulum", "two_link"])
def test_what_building_a_model_takes_counts_in_every_stage_that_builds_it(case):
    context = Context.load(Path(__file__).parents[2] / "configs" / "cases" / f"{case}.yaml")
    without, built = ({c.stage: c.seconds for c in costs.costs(context, 1e-6, build=b)} for b in (0.0, 10.0))
    more = {stage: (built[stage] - without[stage]) / 10.0 for stage in built}
    times = {"rollouts": 0, "fresh": 0, "borders": 1, "scp": 1, "lipschitz": 1, "gap": 1, "synthesis": 2}
    assert {s: round(n, 6) for s, n in more.items() if s in times} == times
    assert more["validation"] >= 1
    assert more["audit"] >= 1


def test_a_machine_that_is_twice_as_slow_takes_twice_as_long_but_for_what_was_measured_on_it(tmp_path):
    context = Context.load(written(tmp_path))
    slow, usual = ({c.stage: c.seconds for c in costs.costs(context, 1e-3, build=3.0, slower=s)} for s in (2.0, 1.0))
    samples = context.case.gap.fresh_samples
    assert usual["fresh"] == pytest.approx(costs.START + samples * 1e-3)
    assert slow["fresh"] == pytest.approx(2.0 * costs.START + samples * 1e-3)
    assert slow["workflow"] == pytest.approx(2.0 * usual["workflow"])
    assert 0.1 < costs.slowness() < 100.0


@pytest.mark.parametrize(("terms", "told"), [(50, False), (400, True)])
def test_a_step_of_very_many_operations_is_told(terms, told, monkeypatch):
    monkeypatch.setattr(equations, "HEAVY", 500)  # so many as the number says take SymPy a minute
    x = sp.Symbol("x")
    step = sum((sp.sin(k * x) for k in range(1, terms)), sp.Integer(0))
    plant = SimpleNamespace(sampled=NominalModel((x,), (), (step,), 0.1))
    found = list(equations.find_heavy_steps(SimpleNamespace(case=SimpleNamespace(synthesis=object()), plant=plant)))
    assert [finding.key for finding in found] == ["plant"] * told
    assert list(equations.find_heavy_steps(SimpleNamespace(case=SimpleNamespace(synthesis=None), plant=plant))) == []


def test_a_check_ends_with_what_a_run_takes(tmp_path):
    path = written(tmp_path)
    found = check.run(path)
    seconds = sum(cost.seconds for cost in found.costs)
    assert check.conclusion(found, path) == (
        f"The case is in order. A run takes about {costs.duration(seconds)} of CPU time, and "
        f"{costs.size(max(cost.bytes for cost in found.costs))}: simgap run {path}"
    )


def test_the_total_says_what_stages_may_take_that_usually_end_earlier(tmp_path):
    """What reaches a target ends earlier than the steps that it may take; a stage that is shown is in the total."""
    found = [
        costs.StageCost("synthesis", 10, "pairs", 30.0, 1e8, "synthesis.cells"),
        costs.StageCost("validation", 20, "closed-loop steps at most", 600.0, 3e8, "validation.starts", at_most=True),
    ]
    said = check.conclusion(check.Checked(found, {}, [], False), tmp_path / "a.yaml")
    assert "about 30 s of CPU time and at most 10 min more for validation, and 286 MiB" in said


def test_a_term_along_a_symmetry_is_refused_before_anything_runs_and_listed_bases_leave_it_out(tmp_path):
    symmetry = {"group": "translation", "along": ["q"], "tolerance": {"q": 1e-9, "w": 1e-9}}
    along = {"symmetry": symmetry, "grid": {"half_widths": {"w": 0.1}}}
    with pytest.raises(UserError, match="the term 'q' depends on q, along which a symmetry is declared"):
        check.run(written(tmp_path, case=along))
    check.run(written(tmp_path, case=along | {"gap": {"basis": {"kind": "monomials", "degree": 2}}}))


def test_friction_that_the_simulator_is_told_of_is_no_surprise(tmp_path):
    effects = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.5}}]
    found = findings(written(tmp_path, {"friction": 0.5}, {"simulator.effects": effects}))
    assert found == []


def test_advice_for_joints_of_two_dampings_does_not_contradict_itself(tmp_path):
    """Followed, each joint has its own: what the key gives all and what an effect adds to one."""
    other = ARM.replace("</joint>", '<dynamics damping="0.002"/></joint>')
    found = findings(written(tmp_path, {"damping": 0.4, "more": other}, TWO))
    assert [f.key for f in found] == ["simulator.damping.joint"] * 2
    of_hinge, of_other = (next(f.remedy for f in found if f"'{n}' by" in f.problem) for n in ("hinge", "other"))
    assert "set it to 0.002" in of_hinge
    assert "viscous_friction of 0.398" in of_hinge
    assert "to 0.002" in of_other


def running_away(folder, tau, rate="30*v + F"):
    """dv/dt = 30 v + F, say: within half of a long step it may be anywhere."""
    path = folder / "run.yaml"
    target = {"kind": "reach_avoid", "target": {"q": [0.5, 0.9]}, "obstacles": []}
    path.write_text(yaml.safe_dump({
        "name": "run",
        "plant": {"states": {"q": {"unit": "m"}, "v": {"unit": "m/s"}}, "inputs": {"F": {"unit": "N"}},
                  "symbolic": {"dynamics": {"q": "v", "v": rate}}},
        "domain": {"tau": tau, "X": {"q": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 1]}}},
        "simulator": {"engine": "equations", "integrator": "explicit_euler", "slopes": "sampled",
                      "equations": {"dynamics": {"q": "v", "v": rate}}},
        "grid": {"eps": 0.1}, "gap": {"basis": ["v", 1]},
        "synthesis": {"cells": [20, 20], "specification": target},
    }))  # fmt: skip
    return path


def test_a_path_without_bound_is_refused_before_anything_runs_with_a_tau_that_has_one(tmp_path):
    """By hand: r = tau/2 (30 (1 + r) + 1) is 15.5 tau / (1 - 15 tau), .5 (a quarter of X) at .0217 s."""
    kinked = "30*abs(v) + F"
    for tau, said in (
        (0.1, "the motion of v between samples has no bound"),
        (0.045, f"v may stray by {15.5 * 0.045 / (1 - 15 * 0.045):.3g} m/s"),  # a run would win nothing
    ):
        with pytest.raises(UserError, match=said) as refused:
            check.run(running_away(tmp_path, tau, kinked))
        assert refused.value.key == "domain.tau"
        assert refused.value.file is not None
        assert "to about 0.021 s" in str(refused.value)
    check.run(running_away(tmp_path, 0.021, kinked))


def test_a_smooth_path_is_bounded_by_how_its_rate_changes(tmp_path):
    """By hand: r = tau^2/8 30 (30 (1 + r) + 1) is 116.25 tau^2 / (1 - 112.5 tau^2), .5 at .0538 s."""
    with pytest.raises(UserError) as refused:
        check.run(running_away(tmp_path, 0.1))
    shorter = float(str(refused.value).split("Shorten domain.tau to about ")[1].split(" s")[0])
    assert 0.045 < shorter <= 0.0538
    check.run(running_away(tmp_path, 0.045))


FRICTION = {"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.3}}
LOAD = {"name": "load_friction", "on": "u", "parameters": {"mu": 0.2}}


@pytest.mark.parametrize("added", [FRICTION, LOAD])
def test_dry_friction_that_the_model_lacks_is_told_with_what_it_does_to_the_gap(tmp_path, added):
    context = Context.load(written(tmp_path, case={"simulator.effects": [added]}))
    (finding,) = find_jumps_at_rest(context)
    assert finding.key == "simulator.effects.0"
    assert "switches at rest" in finding.problem
    assert "more than 0.1 of the cells" in finding.problem
    assert "plant.effects" in finding.remedy
    assert "gap.lipschitz.rough_limit" in finding.remedy


@pytest.mark.parametrize(
    "case",
    [
        {"simulator.effects": [FRICTION], "plant.effects": [FRICTION]},
        {"simulator.effects": [FRICTION], "domain.X": {"q": [-0.2, 0.2], "w": [0.1, 0.5]}},
        {"simulator.effects": [{"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.3}}]},
        {"simulator.effects": [{"name": "constant_force", "on": "hinge", "parameters": {"F_0": 0.3}}]},
    ],
)
def test_what_is_smooth_or_known_or_outside_x_is_not_told_as_a_jump(tmp_path, case):
    assert list(find_jumps_at_rest(Context.load(written(tmp_path, case=case)))) == []
