"""A mistake in an effect, or in the function of a simulator, is told with its full key."""

import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.plants.plant_model import PlantModel
from simgap.simulators.rollouts import engine_of

ROD = {
    "name": "rod",
    "plant": {
        "states": {"q": {"unit": "rad"}, "v": {"unit": "rad/s"}},
        "inputs": {"u": {"unit": "N*m"}},
        "symbolic": {
            "dynamics": {"q": "v", "v": "u"},
            "coordinates": {"hinge": {"position": "q", "velocity": "v", "force_gain": "1"}},
        },
    },
    "domain": {"tau": 0.01, "X": {"q": [-1, 1], "v": [-1, 1]}, "U": {"u": {"min": 0, "max": 1, "step": 1}}},
}
GOOD = {"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.1}}


def case(tmp_path, **sections):
    content = {**ROD, **{k: v for k, v in sections.items() if k != "effects"}}
    content["plant"] = {**ROD["plant"], "effects": sections.get("effects", [])}
    path = tmp_path / "rod.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


WRONG = [
    ({**GOOD, "name": "viscous"}, "name"),
    ({**GOOD, "parameters": {"B": 0.1}}, "parameters"),
    ({**GOOD, "parameters": {"b": -0.1}}, "parameters.b"),
]


@pytest.mark.parametrize(("added", "key"), [*WRONG, ({**GOOD, "on": "hing"}, "on")])
def test_a_mistake_in_an_effect_of_the_plant_has_its_key(tmp_path, added, key):
    path = case(tmp_path, effects=[GOOD, added])
    with pytest.raises(UserError) as refused:
        _ = PlantModel.of(load_case(path), tmp_path).corrected
    assert refused.value.key == f"plant.effects.1.{key}"
    assert refused.value.remedy


@pytest.mark.parametrize(("added", "key"), WRONG)
def test_a_mistake_in_an_effect_of_the_simulator_has_its_key(tmp_path, added, key):
    path = case(tmp_path, simulator={"engine": "equations", "integrator": "rk4", "effects": [GOOD, added]})
    with pytest.raises(UserError) as refused:
        engine_of(load_case(path), tmp_path)
    assert refused.value.key == f"simulator.effects.1.{key}"
    assert refused.value.remedy


def test_a_function_that_is_not_there_is_told_with_its_key_and_what_is(tmp_path):
    (tmp_path / "sim.py").write_text("def step(x, u, tau):\n    return x\n")
    path = case(tmp_path, simulator={"engine": "python", "function": "sim.py:stp"})
    with pytest.raises(UserError, match=r"no function 'stp'.*it has step") as refused:
        load_case(path)
    assert refused.value.key == "simulator.function"
