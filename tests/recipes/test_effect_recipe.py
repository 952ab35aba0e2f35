"""The recipe of an effect in a distribution: listed, in a corrected model, acted out by an engine."""

import numpy as np
import pytest

from simgap import effects, plugins
from simgap.config.load import load_case
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages.effects import listed, printed
from tests.recipes.scratch import block

PAGE, HEADING = "docs/how-to/plugins.md", "An effect in a distribution"
TAU, C = 0.005, 0.4


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """The distribution, as an installer leaves it; child processes find it too."""
    info = tmp_path / "site/bench_effects-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-effects\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        block(PAGE, HEADING, "toml").replace("project.entry-points.", "").replace('"', "")
    )
    (tmp_path / "site/cubic_drag.py").write_text(block(PAGE, HEADING, "python"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    for cache in (plugins._offered, plugins._installed, effects._instance):
        cache.cache_clear()
    yield
    for cache in (plugins._offered, plugins._installed, effects._instance):
        cache.cache_clear()


def test_an_effect_of_a_distribution(offered, vary):
    assert "cubic_drag" in printed(listed(None))
    drag = {"name": "cubic_drag", "on": "hinge", "parameters": {"c": C}}
    path = vary("pendulum", {"simulator.inertia": "file", "simulator.effects": [drag], "simulator.damping":
                             {"linear": 0.0, "angular": 0.0, "joint": 0.0}})  # fmt: skip
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-0.5, 0.5, (50, 2)), rng.uniform(-1.2, 1.2, (50, 1))
    ((out, _),) = run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])
    q, v = x.T
    felt = v + TAU * 3.0 * (-0.5 * 9.81 * np.sin(q) + u[:, 0] - C * v**3)  # the rod by hand, semi-implicit
    assert np.abs(out - np.stack([q + TAU * felt, felt], axis=1)).max() < 1e-8
    assert effects.effect("cubic_drag").rank == effects.effect("viscous_friction").rank


def test_it_is_gone_with_its_distribution():
    assert "cubic_drag" not in effects.EFFECTS
