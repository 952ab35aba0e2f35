"""`simgap effects CASE`: what the plant can have, and why it cannot have the rest."""

from __future__ import annotations

from pathlib import Path

from simgap.stages.effects import listed, printed
from simgap.stages.reference import reference

CASES = Path(__file__).parents[2] / "configs" / "cases"


def test_a_case_lists_what_its_plant_can_have_and_why_not_the_rest():
    robot = printed(listed(CASES / "turtlebot.yaml"))
    table, *rest = robot.split("\nNot on this plant, which lacks ")
    assert "wheel_mismatch" in table
    assert "viscous_friction" not in table
    reasons = {line.split(":")[0]: line for line in (" ".join(r.split()) for r in rest)}
    friction = next(line for line in reasons.values() if "viscous_friction" in line)
    assert friction.startswith("a coordinate (joints of a URDF, or plant.symbolic.coordinates): viscous_friction,")
    arm = printed(listed(CASES / "pendulum.yaml"))
    assert "which lacks a planar robot on two driven wheels" in " ".join(arm.split())
    assert "viscous_friction" in arm.split("\nNot on this plant")[0]


def test_units_are_words_or_units_and_no_placeholders():
    every = " ".join(printed(listed(None)).split())
    assert "b (viscous coefficient, N m s/rad or N s/m)" in every
    assert "ratio (true over declared value)" in every
    assert "{" not in every
    assert "b (viscous coefficient, N m s/rad)" in " ".join(printed(listed(CASES / "pendulum.yaml")).split())
    page = reference()["effects.md"]
    assert "{" not in page
    assert "`b` viscous coefficient (N m s/rad or N s/m)" in page
