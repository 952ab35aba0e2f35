"""`simgap check`: an X in degrees is told as that, a state that wraps around has to be the same at both ends."""

import math

import pytest
import yaml

from simgap.errors import UserError
from simgap.lint.equations import find_degrees, refuse_seams
from simgap.plants.context import Context
from simgap.plants.model_file import FileJoint

HINGE = FileJoint("revolute", (-2.0, 2.0), None, None, 0.0, 0.0, None, False)


def written(folder, angle, periodic=(), unit="rad", joint=None, **more):
    """A pendulum in equations, its X from `angle`."""
    states = {"q": {"unit": unit}, "w": {"unit": f"{unit}/s"}}
    content = {
        "name": "p",
        "plant": {
            "states": states,
            "inputs": {"u": {"unit": "N*m"}},
            "symbolic": {"parameters": {}, "dynamics": {"q": "w", "w": "-10*sin(q) + u"}},
        },
        "domain": {
            "tau": 0.01, "X": {"q": angle, "w": [-1, 1]}, "U": {"u": {"values": [-1, 1]}}, "periodic": list(periodic),
        },
    } | more  # fmt: skip
    path = folder / "p.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def found(path, joints=()):
    return list(find_degrees(Context.load(path), dict(joints)))


@pytest.mark.parametrize("angle", [[-90, 90], [-15, 15], [0, 360], [-10, 45], [-123.4, 17]])
def test_ends_that_look_like_degrees_are_said_with_their_radians(tmp_path, angle):
    (finding,) = found(written(tmp_path, angle))
    assert finding.key == "domain.X.q"
    assert f"[{math.radians(angle[0]):.4g}, {math.radians(angle[1]):.4g}]" in finding.remedy
    assert "leave it if the angle winds" in finding.remedy


@pytest.mark.parametrize("angle", [[-0.25, 0.25], [-math.pi, math.pi], [-5, 5], [0, 12.6], [-31.4, 31.4], [-8, 9]])
def test_angles_that_wind_are_left_alone(tmp_path, angle):
    assert found(written(tmp_path, angle)) == []


def test_a_length_is_no_angle(tmp_path):
    assert found(written(tmp_path, [-90, 90], unit="m")) == []


def test_what_a_joint_could_do_in_degrees_alone_is_refused(tmp_path):
    path = written(tmp_path, [-90, 90])
    content = yaml.safe_load(path.read_text())
    context = Context.load(path)
    state = context.case.plant.states["q"].model_copy(update={"joint": "hinge"})
    plant = context.case.plant.model_copy(update={"states": {**context.case.plant.states, "q": state}})
    driven = Context(context.case.model_copy(update={"plant": plant}), path)
    with pytest.raises(UserError, match="its joint 'hinge' ends at -2 and 2") as refused:
        list(find_degrees(driven, {"hinge": HINGE}))
    assert refused.value.key == "domain.X.q"
    wide = FileJoint("revolute", (-60.0, 60.0), None, None, 0.0, 0.0, None, False)
    assert len(list(find_degrees(driven, {"hinge": wide}))) == 1  # a joint that winds
    assert content["domain"]["X"]["q"] == [-90, 90]


@pytest.mark.parametrize("angle", [[-math.pi, math.pi], [0, 4 * math.pi]])
def test_whole_turns_wrap(tmp_path, angle):
    assert refuse_seams(Context.load(written(tmp_path, angle, ["q"]))) is None


@pytest.mark.parametrize("angle", [[-3.14, 3.14], [-3.1416, 3.1416], [-180, 180], [-1, 1], [0, math.pi]])
def test_anything_else_does_not(tmp_path, angle):
    with pytest.raises(UserError, match="wraps around, yet the model's rates") as refused:
        refuse_seams(Context.load(written(tmp_path, angle, ["q"])))
    assert refused.value.key == "domain.X.q"
    assert str(math.pi) in refused.value.remedy


@pytest.mark.parametrize("acceleration", ["-10*sin(q) + u - 0.1*q", "-10*sin(q) + u - 0.1*w + cos(3*q)"])
def test_a_known_simulator_has_to_repeat_where_it_wraps_too(tmp_path, acceleration):
    """A spring pulls harder with every turn; friction and a ripple of whole waves a turn do not."""
    equations = {"dynamics": {"q": "w", "w": acceleration}}
    simulator = {"engine": "equations", "integrator": "rk4", "equations": equations}
    context = Context.load(written(tmp_path, [-math.pi, math.pi], ["q"], simulator=simulator))
    if "cos" in acceleration:
        refuse_seams(context)
    else:
        with pytest.raises(UserError, match="wraps around, yet the simulator's steps differ by"):
            refuse_seams(context)
