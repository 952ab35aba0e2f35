"""An engine that is not installed is one line that names the extra."""

import sys

import pytest

from simgap.errors import UserError, optional


@pytest.mark.parametrize("module", ["pybullet", "mujoco"])
def test_a_missing_engine_names_its_extra(module, root, monkeypatch):
    from simgap.config.load import load_case
    from simgap.simulators.rollouts import make_simulator

    monkeypatch.setitem(sys.modules, module, None)
    cases = root / "configs/cases"
    case = load_case(cases / ("pendulum.yaml" if module == "pybullet" else "pendulum_mujoco.yaml"))
    with pytest.raises(UserError, match=rf"simulator\.engine: .* is not installed\. .*'simgap\[{module}\]'"):
        make_simulator(case, cases)


def test_other_errors_of_an_import_stay():
    with pytest.raises(ValueError, match="broken"), optional("X", "x"):
        raise ValueError("broken")
