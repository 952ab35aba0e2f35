"""What is hashed: sections that a stage reads, code that it reaches, model files by their bytes."""

from simgap.config.load import load_case
from simgap.provenance import _closure, sections_digest
from simgap.stages.reads import READS


def reached(stage):
    return {"/".join(p.parts[-2:]) for p in _closure(f"simgap.stages.{stage}")}


def test_code_that_a_stage_reaches():
    assert "synthesis/invariance.py" in reached("synthesis")
    assert "simulators/pybullet_joints.py" in reached("rollouts")  # imported late, inside a function
    assert not any(name.startswith(("synthesis/", "gap/", "diagnosis/")) for name in reached("rollouts"))
    assert not any(name.startswith("synthesis/inv") for name in reached("gap"))


def test_sections_are_narrow(vary):
    def digests(changes):
        path = vary("pendulum", changes)
        return {stage: sections_digest(load_case(path), read, path.parent) for stage, read in READS.items()}

    base = digests({})
    # the diagnosis copies the whole case into the corrected one, so it reads all of it
    changed = digests({"synthesis.cells": [10, 10]})
    assert {stage for stage in READS if base[stage] != changed[stage]} == {"synthesis", "diagnosis"}
    changed = digests({"validation.seed": 9})
    assert {stage for stage in READS if base[stage] != changed[stage]} == {"validation", "diagnosis"}
    changed = digests({"plant.integrator": "rk4"})
    assert not {"rollouts", "fresh", "rig"} & {stage for stage in READS if base[stage] != changed[stage]}
