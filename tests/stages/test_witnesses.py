"""A history of a robot that leaves gamma is kept as a witness and shown again."""

import re

import numpy as np
import pytest
import yaml

from simgap.attack.witness import Witness
from simgap.attack.worst_step import HistoryProblem, search_histories
from simgap.config.load import case_content
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.io.results import write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.simulators.rollouts import make_simulator
from simgap.stages import replay
from tests.io.recorded import read_curves


@pytest.mark.parametrize("order", [("x", "y", "theta"), ("theta", "x", "y")])
def test_a_history_outside_gamma_is_shown_again(root, tmp_path, order):
    """The robot under a bound that is far too narrow, whatever the order of its states."""
    content = case_content(root / "configs/cases/turtlebot.yaml")
    content["simulator"]["urdf"] = str(root / "configs/models/turtlebot.urdf")
    content["plant"]["states"] = {name: content["plant"]["states"][name] for name in order}
    case = tmp_path / "turtlebot.yaml"
    case.write_text(yaml.safe_dump(content, sort_keys=False))
    context = Context.load(case)
    count = len(context.input_set)
    domain = GapDomain(tuple(context.states), tuple(context.inputs), context.box, context.input_set)
    pose = tuple(order.index(name) for name in ("x", "y", "theta"))
    gap = BodyFrameGap(domain, (Tier(2, "Narrow."),), -np.full((1, count, 3), 1e-3), np.full((1, count, 3), 1e-3), pose)
    robot = make_simulator(context.case, context.folder)
    try:
        asked = HistoryProblem.of(context, robot, gap, 2)
        found = search_histories(asked, 40, np.random.default_rng(1), np.empty((0, 3), np.int64))
    finally:
        robot.close()
    late = [step for step in found.outside if len(step.history) == 2]
    assert found.violations > 10
    assert late
    witness = Witness.of_step(late[0]).to_json()
    record = provenance("audit", context.case, context.folder)
    write_json(tmp_path / "witness.json", witness | {"case": case.name, "gap": gap.to_json(), "provenance": record})
    shown = replay.run(tmp_path / "witness.json", tmp_path / "seen.rrd")
    assert " *" in shown
    off = float(re.search(r"what the audit saw is (\S+)\.\Z", shown)[1])
    assert off < 1e-12  # a frame turned there and back
    assert len(read_curves(tmp_path / "seen.rrd")["runs/gap-aware/simulator/run-0/gap/theta/actual"][1]) == 3
