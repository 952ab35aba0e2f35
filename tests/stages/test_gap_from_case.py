"""Every basis, objective, sidedness and padding from the case file to gap.json, on roll-outs whose gap is known."""

import itertools

import numpy as np
import pytest

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.load import from_json
from simgap.gap.fitting.acceptance import check_fresh
from simgap.gap.sampling.borders import directed_samples
from simgap.gap.sampling.points import Points, draw, product
from simgap.gap.sampling.samples import check_drawn
from simgap.geometry import Grid
from simgap.io.results import read_json
from simgap.plants.context import Context
from simgap.stages import fresh, grid
from simgap.stages.gap_inputs import read_samples
from simgap.stages.scp import scp
from tests.stages import road

PAPER = ["x1^2", "x2^2", "x1*x2", "x1", "x2", "u", 1]
BASES = {
    "the paper's": PAPER,
    "the paper's, as it was": (PAPER, {"objective": "eta", "sides": "unsigned", "padding": "paper"}),
    "monomials": {"kind": "monomials", "degree": 3},
    "blocks": {"kind": "blocks", "blocks": [6, 9]},
    "own expressions": {"kind": "expressions", "terms": ["sin(x1)", "tanh(x2/0.2)", "x1*u", "exp(x1)", "u", "1"]},
    "own expressions, listed": ["sin(x1)", "x2^3", "u", 1],
    "constant": [1],
}
EPS = 0.03
QUICK = {"fresh_samples": 4000, "lipschitz": {"extreme_value": False}}


def known(x, u):
    """A gap that no basis here holds; it vanishes on a line, which invites bounds that are upside down."""
    d2 = (0.01 * np.sin(3 * x[:, 0]) - 0.004 * u[:, 0] * x[:, 1]) * x[:, 1]
    return np.stack([0.005 * d2, d2], axis=1)


@pytest.fixture(scope="module")
def inputs():
    return {"u": {"values": [-1.0, 0.0, 0.7]}}


@pytest.fixture
def stage(vary, tmp_path, inputs):
    def run(section):
        removed = ("measured", "simulator")
        path = vary("pendulum", {"gap": QUICK | section, "grid.eps": EPS, "domain.U": inputs}, removed)
        context = Context.load(path)
        model = context.plant.sampled
        pairs = product(Grid.covering(context.box, EPS).centres(), context.input_set)
        for name, (x, u) in (("rollouts", pairs), ("fresh", draw(context.box, context.input_set, 4000, 1))):
            road.made_up(context, tmp_path / f"{name}.parquet", x, u, model.step(x, u) + known(x, u), stage=name)
        road.made_up_borders(context, tmp_path / "borders.parquet", known)
        grid.run(path, f"eps~{EPS}", tmp_path / "grid")
        road.bound(path, tmp_path, [tmp_path / "rollouts.parquet"], tmp_path / "fresh.parquet", tmp_path / "gap.json")
        return context, read_json(tmp_path / "gap.json")

    return run


def check(context, content):
    """0 outside, and lo <= hi on a mesh of X with its borders, for all inputs."""
    function = from_json(content)
    assert content["fresh"]["violations"] == 0
    axes = [np.linspace(lo, hi, 61) for lo, hi in zip(context.box.lo, context.box.hi, strict=True)]
    mesh = np.array(list(itertools.product(*axes)))
    for u in context.input_set:
        lo, hi = function.bounds(mesh, np.tile(u, (len(mesh), 1)))
        assert np.all(lo <= hi)
        d = known(mesh, np.tile(u, (len(mesh), 1)))
        assert np.all((lo <= d) & (d <= hi))
    if content["kind"] == "linear":
        assert np.all(function.narrowest() >= 0.0)
    else:
        assert np.all(function.lower <= function.upper)
    return function


@pytest.mark.parametrize("name", BASES)
def test_bases(stage, name):
    given = BASES[name]
    basis, more = given if isinstance(given, tuple) else (given, {})
    context, content = stage({"basis": basis} | more)
    function = check(context, content)
    if "unsigned" in more.values():
        assert np.all(function.bounds(np.zeros((1, 2)), np.zeros((1, 1)))[1] > 0)


@pytest.mark.parametrize(
    ("objective", "sides", "padding"),
    list(itertools.product(["eta", "lexicographic"], ["signed", "unsigned"], ["paper", "per_axis", "inflate"])),
)
def test_combinations(stage, objective, sides, padding):
    context, content = stage({"basis": PAPER, "objective": objective, "sides": sides, "padding": padding})
    function = check(context, content)
    if sides == "unsigned":
        x = context.box.sample(np.random.default_rng(0), 50)
        lo, hi = function.bounds(x, np.tile(context.input_set[:1], (50, 1)))
        np.testing.assert_allclose(lo, -hi, rtol=1e-9, atol=1e-18)


def rubbing(name, **values):
    return [{"name": name, "on": "hinge", "parameters": values}]


@pytest.mark.parametrize(
    ("x2", "friction"),
    [
        # at rest the engine's friction is 0, at any speed above it pushes back: a jump on the border of X
        ([0.0, 0.5], rubbing("coulomb_friction", F_c=0.05)),
        # a peak that is narrower than a cell and lies between two samples or on the faces of X alone
        ([-0.5, 0.5], rubbing("stribeck_friction", F_c=0.01, F_s=0.06, v_s=1e-4)),
        ([0.0, 0.5], rubbing("stribeck_friction", F_c=0.01, F_s=0.06, v_s=1e-4)),
    ],
)
def test_a_jump_on_the_border_or_a_peak_within_a_cell_is_covered(vary, tmp_path, x2, friction):
    """The oracle is semi-implicit Euler with the friction law itself: v+ = v + 3 tau (u - 4.905 sin a + F(v))."""
    changes = {"simulator.inertia": "file", "simulator.damping": {"linear": 0, "angular": 0, "joint": 0},
               "simulator.effects": friction, "domain.X.x2": x2, "domain.U": {"u": {"values": [-1.0, 0.5]}},
               "grid": {"eps": 0.011, "shards": 1}, "gap.fresh_samples": 3000,
               "gap.lipschitz.extreme_value": False}  # fmt: skip
    path = vary("pendulum", changes, ("measured",))
    drawn, out = (tmp_path / n for n in ("fresh.parquet", "gap.json"))
    shards = road.roll_out(path, tmp_path)
    fresh.run(path, drawn, workers=1)
    road.bound(path, tmp_path, shards, drawn, out)
    content = read_json(out)
    law = friction[0]["parameters"]
    speeds = np.concatenate([np.outer([1e-9, 1e-6, 1e-5, 5e-5, 1e-4, 2e-4, 1e-3, 0.1], [-1, 1]).ravel(), [0.0], x2])
    speeds = speeds[(speeds >= x2[0]) & (speeds <= x2[1])]
    states = np.array(list(itertools.product(np.linspace(-0.2, 0.2, 37), speeds)))
    v = states[:, 1]
    peak = (law.get("F_s", law["F_c"]) - law["F_c"]) * np.exp(-((v / law.get("v_s", 1.0)) ** 2))
    function = from_json(content)
    for u in (-1.0, 0.5):
        d2 = -3 * 0.005 * (law["F_c"] + peak) * np.sign(v)
        lo, hi = function.bounds(states, np.full((len(states), 1), u))
        assert np.all(lo[:, 1] <= d2 + 1e-9)
        assert np.all(d2 <= hi[:, 1] + 1e-9)
    assert content["borders"]["violations"] == 0
    assert content["borders"]["samples"] > 300
    text = " ".join(tier["text"] for tier in content["guarantee"])
    factor = max(side["directed_factor"] for side in content["dimensions"][1]["scenario"].values())
    assert factor > 3.0
    assert f"{factor:.2g} for x2" in text
    assert "declared switching surfaces" in text


def test_dry_friction_in_the_engine_is_covered_by_its_jump(vary, tmp_path):
    """sign(v) friction in PyBullet: not Lipschitz at rest. Local padding covers it and says so, the others refuse."""
    friction = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.05}}]
    changes = {"simulator.inertia": "file", "simulator.effects": friction, "domain.U": {"u": {"values": [-1.0, 0.5]}},
               "grid": {"eps": 0.011, "shards": 1}, "gap.fresh_samples": 3000}  # fmt: skip
    path = vary("pendulum", changes, ("measured",))
    drawn, out = (tmp_path / n for n in ("fresh.parquet", "gap.json"))
    shards = road.roll_out(path, tmp_path)
    fresh.run(path, drawn, workers=1)
    road.bound(path, tmp_path, shards, drawn, out)
    content = read_json(out)
    jump = 2 * 0.05 * 3 * 0.005  # both signs of a torque on the inertia 1/3 for tau
    assert content["fresh"]["violations"] == 0
    found = content["dimensions"][1]["lipschitz"]
    assert found["largest_jump"] == pytest.approx(jump, rel=0.1)
    (layer,) = found["rough_layers"]
    assert (layer["axis"], layer["lo"] < 0.0 < layer["hi"]) == (1, True)
    assert any("The gap jumps in" in tier["text"] for tier in content["guarantee"])
    for padding in ("per_axis", "paper"):
        path = vary("pendulum", changes | {"gap.padding": padding}, ("measured",))
        with pytest.raises(BrokenPromise, match="not Lipschitz at this grid"):
            road.bound(path, tmp_path, shards, drawn, tmp_path / "other.json")
    assert not (tmp_path / "other.json").exists()


@pytest.mark.parametrize("other", [{"domain.X.x2": [-0.6, 0.6]}, {"domain.X.x1": [-0.1, 0.1]}, {"gap.seed": 5}])
def test_fresh_samples_of_another_case_confirm_nothing(vary, other):
    """Those of a larger X lie where there is no bound, which nothing can exceed; they counted as covered."""
    here = Context.load(vary("pendulum", {"gap.fresh_samples": 500}, ("measured",)))
    own = draw(here.box, here.input_set, 500, here.case.gap.seed)
    check_drawn(here, *own)
    there = Context.load(vary("pendulum", {"gap.fresh_samples": 500} | other, ("measured",)))
    with pytest.raises(UserError, match="not those of this case"):
        check_drawn(here, *draw(there.box, there.input_set, 500, there.case.gap.seed))


def test_samples_outside_the_domain_of_a_bound_are_not_covered_by_it(stage):
    context, content = stage({"basis": PAPER})
    function = from_json(content)
    x = np.array([[0.0, 0.0], [0.0, 0.7]])
    with pytest.raises(UserError, match="1 of 2 samples lie outside the X or U"):
        check_fresh(function, x, np.tile(context.input_set[:1], (2, 1)), np.zeros((2, 2)))


def test_borders_of_another_case_or_none_are_refused(vary, tmp_path):
    context = Context.load(vary("pendulum", {"grid.eps": EPS, "gap": QUICK | {"basis": PAPER}}, ("measured",)))
    table = read_samples(context, road.made_up_borders(context, tmp_path / "borders.parquet", known), "borders")
    directed_samples(context, f"eps~{EPS}", table, 0)
    other = Context.load(vary("pendulum", {"grid.eps": EPS, "domain.X.x2": [-0.4, 0.5]}, ("measured",)))
    for case, point in ((other, f"eps~{EPS}"), (context, "eps~0.02")):
        with pytest.raises(UserError, match="another case"):
            directed_samples(case, point, table, 0)
    points = Points(f"eps~{EPS}", Grid.covering(context.box, EPS).centres(), context.input_set)
    with pytest.raises(UserError, match="borders of X and beside switching surfaces are missing"):
        scp(context, points, [], 0)
