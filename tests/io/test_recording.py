"""Recordings hold what the table of traces holds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from simgap.errors import UserError
from simgap.io.rerun.recording import JointScene, lean, share_of_bound
from simgap.io.traces import GAP_AWARE, NOMINAL, shown, split, twin
from simgap.stages import trace as stage
from tests.io.recorded import read_curves
from tests.stages import loop_example as example


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    """(folder, case) of the pendulum with its recording written."""
    folder = tmp_path_factory.mktemp("pendulum")
    case = example.pendulum(root, folder)
    record(folder, case)
    return folder


def record(folder, case):
    controllers = folder / "nominal/controller.npz", folder / "gap/controller.npz"
    stage.run(case, *controllers, folder / "validation/traces.parquet", folder / "trace.rrd")


def table(folder):
    return pq.read_table(folder / "validation/traces.parquet")


def test_every_number_of_the_table_is_in_the_recording(made):
    """Read without this package's notion of a trace: rows of the table against curves by name."""
    curves = read_curves(made / "trace.rrd")
    frame = table(made).to_pylist()
    parts = {"actual": "gap", "lower": "lo", "upper": "hi"}
    columns = {f"state/{n}": n for n in ("x1", "x2")} | {"input/u": "u"}
    columns |= {f"gap/{n}/{p}": f"{c}_{n}" for n in ("x1", "x2") for p, c in parts.items()}
    for controller, title in (("gap", "gap-aware"), ("nominal", "nominal-only")):
        for plant in ("simulator", "nominal model"):
            for run in (0, 1):
                key = (controller, plant, run)
                rows = [r for r in frame if (r["controller"], r["plant"], r["run"]) == key]
                for name, column in columns.items():
                    entity = f"runs/{title}/{plant.replace(' ', '_')}/run-{run}/{name}"
                    wanted = np.array([(r["sim_time"], r[column]) for r in rows if np.isfinite(r[column])])
                    t, values = curves[entity]
                    np.testing.assert_array_equal(values, wanted[:, 1])
                    np.testing.assert_allclose(t, wanted[:, 0], rtol=0, atol=1e-9)


def test_the_pendulum_swings_about_its_hinge(made):
    """The rod's transform in the recording is a rotation by the angle about the URDF's axis (0, 1, 0)."""
    from rerun.chunk import RrdReader

    turned = {}
    for chunk in RrdReader(made / "trace.rrd").store().stream().to_chunks():
        if str(chunk.entity_path).strip("/") == "body_gap_simulator/joints/hinge":
            batch = chunk.to_record_batch()
            times = batch.column("sim_time").cast("int64").to_pylist()
            turned |= dict(zip(times, batch.column("Transform3D:quaternion").to_pylist(), strict=True))
    run = shown(split(table(made), ["x1", "x2"], ["u"]), GAP_AWARE)
    quaternions = np.array([turned[k][0] for k in sorted(turned)])
    assert len(quaternions) == len(run.t)
    np.testing.assert_allclose(2.0 * np.arctan2(quaternions[:, 1], quaternions[:, 3]), run.x[:, 0], atol=1e-6)
    np.testing.assert_allclose(quaternions[:, [0, 2]], 0.0, atol=1e-7)


def test_a_run_that_ends_early_is_shown_where_none_is_unsafe(made):
    """A controller without an admissible input stops in safe states: that is a failure that a reader should see."""
    traces = [replace(t, safe=np.ones_like(t.safe)) for t in split(table(made), ["x1", "x2"], ["u"])]
    last = [t for t in traces if t.controller == NOMINAL and twin(traces, t) not in (None, t)][-1]
    traces = [replace(t, t=t.t[:2]) if t is last else t for t in traces if t.controller != NOMINAL or t.run == last.run]
    earlier = [replace(t, run=t.run + 50, t=last.t) for t in traces if t.controller == NOMINAL]
    assert shown([*earlier, *traces], NOMINAL).run == last.run


def test_shown_runs_are_the_telling_ones(made):
    traces = split(table(made), ["x1", "x2"], ["u"])
    worst, best = shown(traces, NOMINAL), shown(traces, GAP_AWARE)
    assert worst.violates
    assert not worst.safe[-1]
    assert not best.violates
    assert best.run == worst.run  # from the same start, where the gap-aware controller has a run from it
    elsewhere = [replace(t, run=t.run + 50) if t.controller == GAP_AWARE else t for t in traces]
    assert shown(elsewhere, GAP_AWARE).run == min(t.run for t in elsewhere if t.controller == GAP_AWARE)
    model = twin(traces, best)
    assert model is not None
    assert (model.plant, model.run) == ("nominal model", best.run)
    with pytest.raises(UserError, match="no trace of the gap controller"):
        shown([t for t in traces if t.controller != GAP_AWARE], GAP_AWARE)


def test_share_of_the_bound(made):
    """lo = d - 1e-3 and hi = d + 2e-3: the gap lies a third of the half-width below the middle."""
    share = share_of_bound(shown(split(table(made), ["x1", "x2"], ["u"]), GAP_AWARE))
    np.testing.assert_allclose(share[:-1], -1.0 / 3.0, rtol=1e-9)
    assert np.isnan(share[-1]).all()


def test_a_table_that_is_no_trace_is_refused(made):
    with pytest.raises(UserError, match="no column safe"):
        split(table(made).drop_columns(["safe"]), ["x1", "x2"], ["u"])


def test_the_camera_looks_at_the_plant_where_it_stands(root):
    """The tutorial's upright rod stood above the view, which looked for a hanging one."""
    scene = JointScene(root / "docs/tutorial/rod.urdf", {"hinge": 0})

    def content(q: float) -> SimpleNamespace:
        return SimpleNamespace(shown={"gap": SimpleNamespace(x=np.array([[q, 0.0]]))})

    assert lean(content(0.0), scene) == pytest.approx(1.0)
    assert lean(content(np.pi), scene) == pytest.approx(-1.0)
    assert lean(content(np.pi / 2), scene) == pytest.approx(0.0, abs=1e-12)
