"""Which of the effects that a diagnosis found the simulator of the corrected case acts out: what the recordings say.

The recordings are of a pendulum with Coulomb friction (`diagnosis_example`, integrated there). One simulator has that
friction already, others are the nominal model or other numbers without it.
"""

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.measured import MeasuredSection
from simgap.correction import corrected_case as acted_out
from simgap.correction.corrected_case import ActedOut
from simgap.correction.transitions import followed, stray
from simgap.diagnosis.record.survey import survey
from simgap.diagnosis.result import WindowPrediction
from simgap.effects import AppliedEffect
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.simulators.process import EngineCrash
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

DOMAIN = "domain: {tau: 0.02 s, X: {q: [-1, 1], v: [-3, 3]}, U: {u: {min: -2, max: 2, step: 1}}}\n"
TWIN = "simulator: {engine: equations, integrator: rk4, substeps: 4}\n"
EQUATIONS = """\
simulator:
  engine: equations
  integrator: semi_implicit_euler
  substeps: 40
  equations:
    parameters: {{w: {{value: 1.5}}, J: {{value: 0.25}}, F: {{value: {friction}}}}}
    dynamics: {{q: v, v: (u - w*sin(q) - F*tanh(v/0.001)) / J}}
    coordinates: {{hinge: {{position: q, velocity: v, force_gain: 1/J}}}}
"""
OWN, OTHER = EQUATIONS.format(friction=0.19), EQUATIONS.format(friction=0.0)
HARDWARE = "measured: {rig: hardware%s}\n"


def concluded(folder, more):
    """What the stage makes of the diagnosis: -> document, corrected case, its text."""
    (folder / "case.yaml").write_text(example.CASE + DOMAIN + more)
    context = Context.load(folder / "case.yaml")
    model = PlantModel.of(context.case, folder).corrected
    data = example.record()
    found, reading = example.diagnosis(model, data), example.reading(data)
    section = context.case.measured or MeasuredSection()
    given = (found, reading, survey(data, model), [folder / "bench.csv"], folder / "out")
    content = stage.conclude(context, section, *given)
    path = folder / "out" / "corrected_case.yaml"
    return content, load_case(path), " ".join(path.read_text().replace("\n# ", " ").split())


@pytest.mark.parametrize(
    ("simulator", "twice"), [(OWN, False), (TWIN, True), (OTHER, True)], ids=["own", "twin", "other"]
)
def test_a_simulator_that_has_the_friction_does_not_get_it_again(tmp_path, simulator, twice):
    content, case, text = concluded(tmp_path, simulator + HARDWARE % "")
    assert [e.name for e in case.plant.effects] == ["coulomb_friction"]
    assert [e.name for e in case.simulator.effects] == ["coulomb_friction"] * twice
    errors = {len(t["effects"]): t["error"] for t in content["simulator"]["tried"]}
    right, wrong = (errors[1], errors[0]) if twice else (errors[0], errors[1])
    assert right < 3.0  # times the noise; what is left is the start, which is a noisy reading
    assert wrong > 5.0 * right
    assert content["simulator"]["reason"] in text
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Where the effects go" in page
    assert content["simulator"]["reason"] in page
    assert ("includes Coulomb friction at the hinge" if twice else "stays as it is") in content["simulator"]["reason"]


@pytest.mark.parametrize(
    ("simulator", "key", "on_top"), [(OWN, "true", True), (TWIN, "false", False), (TWIN, "true", True)]
)
def test_the_case_may_decide(tmp_path, simulator, key, on_top):
    content, case, text = concluded(tmp_path, simulator + HARDWARE % f", into_simulator: {key}")
    assert [e.name for e in case.simulator.effects] == ["coulomb_friction"] * on_top
    assert content["simulator"]["tried"] == []
    assert "as measured.into_simulator says" in text


def test_recordings_of_the_simulator_itself_leave_it_as_it_is(tmp_path):
    content, case, _ = concluded(tmp_path, TWIN + "measured: {rig: simulator}\n")
    assert case.simulator.effects == ()
    assert len(case.plant.effects) == 1
    assert "recordings are of the case's own simulator" in content["simulator"]["reason"]


OWN_PROGRAM = """
import numpy as np

def step(x, u, tau):
    return np.array([x[0] + tau * x[1], x[1] + tau * (u[0] - 1.5 * np.sin(x[0])) / 0.25])
"""


def test_a_program_that_cannot_act_them_out_stays_as_it_is_and_that_is_said(tmp_path):
    """It got effects before that its engine refuses as soon as the corrected case runs."""
    (tmp_path / "mine.py").write_text(OWN_PROGRAM)
    content, case, text = concluded(tmp_path, "simulator: {engine: python, function: 'mine.py:step'}\n" + HARDWARE % "")
    assert case.simulator.effects == ()
    assert len(case.plant.effects) == 1
    assert "It cannot simulate coulomb friction" in text
    assert content["simulator"]["effects"] == []


def test_a_simulator_whose_process_died_ends_the_diagnosis(tmp_path, monkeypatch):
    """Without its simulator the corrected case would be another one, and nobody told."""

    def died(*_, **__):
        raise EngineCrash("an engine process ended: it died")

    monkeypatch.setattr(acted_out, "run_in_processes", died)
    with pytest.raises(EngineCrash):
        concluded(tmp_path, TWIN + HARDWARE % "")


def test_without_a_simulator_nothing_is_said(tmp_path):
    content, case, _ = concluded(tmp_path, HARDWARE % "")
    assert content["simulator"] is None
    assert case.simulator is None


def test_a_window_as_a_run_by_hand():
    """u holds from each stamp to the next: of 1, 2, 3, ... at 0.1 s its means over 0.25 s are 1.8, 4.2, ..."""
    t = 5.0 + 0.1 * np.arange(11)
    states = np.stack([t, np.ones(11)], axis=1)
    w = WindowPrediction(
        "a",
        True,
        t,
        states[:, :1] + 0.5,
        0 * t[:, None],
        states[:, :1] + 0.5,
        states,
        1.0 + np.arange(11)[:, None],
        np.ones((11, 1)),
    )
    (run,) = followed([w], ["v", "q"], ["u"], ["q", "v"], ["q"], {}, 0.25)
    assert run.start.tolist() == [1.0, 5.0]
    areas = [1 + 2 + 1.5, 1.5 + 4 + 5, 6 + 7 + 4, 4 + 9 + 10]  # tenths of a second
    np.testing.assert_allclose(run.inputs[:, 0], np.array(areas) / 2.5)
    np.testing.assert_allclose(run.t, [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(run.read[:, 0], 5.0 + run.t)  # the sensor's offset of 0.5 is taken off
    (later,) = followed([w], ["v", "q"], ["u"], ["q", "v"], ["q"], {"u": (0.25,)}, 0.25)
    np.testing.assert_allclose(later.inputs[1:, 0], run.inputs[:-1, 0])
    path = np.stack([np.ones(5), 5.0 + run.t + 0.2], axis=1)
    assert stray([run], [path], [1], np.array([0.1]), 0.25) == pytest.approx(2.0)


def test_a_simulator_that_follows_with_no_set_gets_what_its_engine_suggests():
    """It strays for a reason of its own: leaving out an effect that was found may look better and says nothing."""
    one, two = (AppliedEffect(name, "hinge", {}) for name in ("coulomb_friction", "viscous_friction"))
    told = ActedOut((one, two), "made of the model", rest=" It cannot simulate delay.")
    sets = [(one, two), (), (one,), (two,)]
    judged = acted_out._judged(told, sets, [31.0, 182.0, 27.3, 60.0])
    assert judged.effects == (one, two)
    assert "It follows them with none of these sets" in judged.reason
    assert judged.reason.endswith("It cannot simulate delay.")
    assert acted_out._judged(told, sets, [31.0, float("nan"), 1.3, 60.0]).effects == (one,)
    followed_it = acted_out._judged(told, sets, [31.0, 182.0, 1.3, 60.0])
    assert followed_it.effects == (one,)
    assert "another reason" not in followed_it.reason
