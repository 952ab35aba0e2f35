"""What the figures of the main report show, read back from the figures themselves."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.patches import Circle

from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.load import from_json
from simgap.geometry import Box, Grid
from simgap.io import figure_style as style
from simgap.io.controller_file import load_controller
from simgap.io.rerun.closed_loop import domains_image, to_pixels
from simgap.io.results import stack
from simgap.io.traces import BASELINE, GAP_AWARE, NOMINAL, shown, split
from simgap.plants.context import Context
from simgap.report.case_figures import problem_figure, surroundings
from simgap.report.diagnosis_page import steps_figure
from simgap.report.figures import cells as figures_cells
from simgap.report.figures import gap as figures_gap
from simgap.report.figures import runs as figures_runs
from simgap.report.figures.cells import margins_figure
from simgap.report.figures.gap import followed_axis
from simgap.synthesis.margins import LARGEST_FACTOR, shown_layers
from tests.stages import loop_example as example

UNITS = example.UNITS["pendulum"]
LABELS = ("X", "target", "obstacle")


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    folder = tmp_path_factory.mktemp("pendulum")
    example.pendulum(root, folder)
    traces = split(pq.read_table(folder / "validation/traces.parquet"), ["x1", "x2"], ["u"])
    controllers = {kind: load_controller(folder / kind / "controller.npz") for kind in (NOMINAL, GAP_AWARE)}
    return from_json(example.read_json(folder / "gap.json")), traces, controllers, folder


@pytest.mark.parametrize(
    ("largest", "unit", "expected"),
    [
        (2.2e-4, "rad", (1e6, "µrad")),
        (0.011, "rad/s", (1e3, "mrad/s")),
        (1.5, "m", (1.0, "m")),
        (3e-12, "m", (1e9, "nm")),
        (2.0, "1", (1.0, "")),
    ],
)
def test_units_get_prefixes(largest, unit, expected):
    factor, text = figures_gap.scaled(largest, unit)
    assert text == expected[1]
    assert factor == pytest.approx(expected[0])


def test_samples_lie_within_the_drawn_band(made):
    gap, _, _, folder = made
    samples = pq.read_table(folder / "samples.parquet")
    x, u, d = stack(samples, ["x1", "x2"]), stack(samples, ["u"]), stack(samples, ["gap_x1", "gap_x2"])
    with style.figure_style():
        figure = figures_gap.bound_figure(gap, x, u, d, UNITS)
        panels = figure.axes[2:]
        assert len(panels) == 2
        for panel in panels:
            points = panel.collections[-1].get_offsets()
            assert len(points) == len(x)
            assert np.abs(points[:, 1]).max() <= 1 + 1e-9


def test_trajectories_show_the_violation(made):
    _, traces, _, _ = made
    runs = {kind: shown(traces, kind) for kind in (NOMINAL, GAP_AWARE)}
    safe = Box([0.0, -0.5], [0.2, 0.5])
    with style.figure_style():
        figure = figures_runs.trajectories_figure(runs, traces, safe, ["x1", "x2"], ["u"], UNITS)
        torque = figure.axes[-1].lines[0].get_ydata()
        assert np.array_equal(torque[:-1], runs[GAP_AWARE].u[: len(torque) - 1, 0])
        first = figure.axes[0]
        crosses = [line for line in first.lines if line.get_marker() == "X"]
        assert len(crosses) == 1
        assert crosses[0].get_ydata()[0] == runs[NOMINAL].x[-1, 0] < 0.0
        assert first.get_ylim()[0] < runs[NOMINAL].x[-1, 0]
        assert not [line for line in figure.axes[1].lines if line.get_marker() == "X"]


def test_regions_of_a_task_are_bands_on_the_runs_that_pass_them(made):
    _, traces, _, _ = made
    runs = {kind: shown(traces, kind) for kind in (NOMINAL, GAP_AWARE)}
    safe, bands = Box([-np.inf, -np.inf], [np.inf, np.inf]), ([("home", 0.0, 0.2), ("far", 5.0, 6.0)], [])
    with style.figure_style():
        figure = figures_runs.trajectories_figure(runs, traces, safe, ["x1", "x2"], ["u"], UNITS, 0.0, bands)
        said = [text.get_text() for axis in figure.axes for text in axis.texts]
        assert said == ["home"]
        left, right = figure.axes[:2]
        assert left.get_ylim() == right.get_ylim()
        for axis, kind in ((left, NOMINAL), (right, GAP_AWARE)):
            x = runs[kind].x[runs[kind].t <= axis.get_xlim()[1], 0]
            assert axis.get_ylim()[0] < x.min() <= x.max() < axis.get_ylim()[1]


def test_domains_are_drawn_where_they_win(made):
    _, traces, controllers, _ = made
    with style.figure_style():
        figure = figures_cells.domains_figure(controllers, traces, UNITS)
        for axis, kind in zip(figure.axes, (NOMINAL, GAP_AWARE), strict=False):
            image = axis.images[0].get_array()
            winning = controllers[kind].solution.winning.reshape(controllers[kind].grid.cells)
            np.testing.assert_array_equal(~np.ma.getmaskarray(image), winning.T)


def test_the_image_of_the_recording_agrees_with_the_controllers(made):
    _, _, controllers, _ = made
    image = domains_image(controllers[GAP_AWARE], controllers[NOMINAL])
    grid = controllers[GAP_AWARE].grid
    rng = np.random.default_rng(5)
    for x in grid.box.sample(rng, 50):
        column, row = np.floor(to_pixels(x[None], grid.box, image.shape[:2])[0]).astype(int)
        both = [bool(controllers[kind].contains(x)[0]) for kind in (GAP_AWARE, NOMINAL)]
        expected = {(True, True): "#C9D3DC", (False, False): "#FFFFFF", (True, False): style.BLUE,
                    (False, True): style.VERMILLION}[tuple(both)]  # fmt: skip
        assert "#{:02X}{:02X}{:02X}".format(*image[row, column]) == expected.upper()


def test_a_body_that_only_feels_its_input_is_shown_over_inputs(tmp_path):
    example.robot(tmp_path)
    gap = from_json(example.read_json(tmp_path / "gap.json"))
    bounds = figures_gap.over_inputs(gap)
    if bounds is None:
        pytest.fail("the bound of the example depends on v and w alone")
    with style.figure_style():
        figure = figures_gap.inputs_figure(gap, *bounds, example.UNITS["robot"])
        table = figure.axes[0].collections[0].get_array().reshape(5, 5)
        assert np.ptp(table, axis=0).max() < 1e-3 * table.max()  # the bound of x follows v, drawn along the columns
        assert table[0, 2] < 0.01 * table[0, 0]


def test_the_promised_time_stands_beside_the_times_of_every_controller():
    with style.figure_style():
        figure = figures_runs.times_figure({GAP_AWARE: [10, 20], BASELINE: [15], NOMINAL: [30]}, 0.5, 40)
        (axis,) = figure.axes
        assert [line.get_xdata()[0] for line in axis.lines] == [20.0]
        labels = [text.get_text() for text in figure.legends[0].get_texts()]
        assert len(labels) == 4
        assert any("20 s" in label and "promised" in label for label in labels)


def test_times_are_in_seconds():
    with style.figure_style():
        figure = figures_runs.times_figure({GAP_AWARE: [10, 20, 30], NOMINAL: []}, 0.5)
        (axis,) = figure.axes
        assert axis.get_xlim() == pytest.approx((0.0, 15.0))
        (label,) = [text.get_text() for text in figure.legends[0].get_texts()]  # nothing is said of no runs
        assert label.endswith("3 runs, median 10 s, longest 15 s")
        filled, line = axis.patches
        width = 15.0 / 40
        for corners in (filled.get_xy(), line.get_xy()):
            inside = corners[corners[:, 1] > 0.0]
            assert set(inside[:, 1]) == {1.0}  # one run a bar
            left = np.unique(inside[:, 0])[::2]
            np.testing.assert_allclose(np.unique(inside[:, 0])[1::2] - left, width)
            times = np.array([5.0, 10.0, 15.0])
            assert left.shape == times.shape
            assert np.all((left <= times + 1e-9) & (times <= left + width + 1e-9))


def test_a_bound_over_states_is_not_shown_over_inputs(made):
    assert figures_gap.over_inputs(made[0]) is None


def test_maps_of_margins_show_the_layers_that_have_some_and_say_where_a_bar_ends():
    grid = Grid(Box([0.0, 0.0, -3.0], [1.0, 1.0, 3.0]), (40, 40, 48), (2,))
    factor = np.full(grid.cells, np.nan)
    layers = shown_layers(48, 3)
    factor[:, :, layers] = np.geomspace(1.01, 50.0, 40)[:, None, None]
    lost = np.zeros(grid.cells, np.uint8)
    lost[0, :, 0] = 3
    figure = margins_figure(grid, factor.reshape(-1), lost, ("x", "y", "theta"), {"x": "m", "y": "m", "theta": "rad"})
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert titles == [f"theta = {-3.0 + (k + 0.5) / 8:.2f} rad" for k in (0, 16, 32)]
    names = [label.get_text() for label in figure.axes[-1].get_yticklabels()]
    assert not any("\u2265" in name for name in names)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["lost to the cells around it"]
    factor[0, 0, 0] = LARGEST_FACTOR
    figure = margins_figure(grid, factor.reshape(-1), 0 * lost, ("x", "y", "theta"), {})
    names = [label.get_text() for label in figure.axes[-1].get_yticklabels()]
    assert names[-1] == "\u2265 10,000"


def test_each_step_runs_from_the_error_before_it_to_the_error_with_each_option():
    """Of two effects that look alike alone, one takes a step of its own once the first is there."""

    def option(name: str, left: float, gain: float, taken: bool = False) -> dict[str, object]:
        return {"name": name, "on": "hinge", "chi2_dof": left, "bic_gain": gain, "taken": taken}

    steps = [
        {"chi2_dof": 3087.0, "options": [option("spring", 22.0, 9e6, True), option("viscous_friction", 3028.0, 2e5)]},
        {"chi2_dof": 22.0, "options": [option("viscous_friction", 1.04, 4860.0, True)]},
        {"chi2_dof": 1.04, "options": [option("cogging", 1.039, -7.0)]},
    ]
    figure = steps_figure(steps)
    axis, numbers = figure.axes
    names = [label.get_text().split(" at ")[0] for label in axis.get_yticklabels()]
    assert names[:3] == ["step 1, from 3087", "spring", "viscous friction"]
    assert names[3:] == ["step 2, from 22", "viscous friction", "nothing more taken", "cogging"]
    spans = [line.get_xdata() for line in axis.lines if len(line.get_xdata()) == 2 and line.get_ydata()[0] >= 1]
    np.testing.assert_allclose(spans, [(3087.0, 22.0), (3087.0, 3028.0), (22.0, 1.04), (1.04, 1.039)])
    said = [t.get_text() for t in numbers.texts]
    assert said[:4] == ["22", "9,000,000", "3028", "200,000"]
    assert said[6:8] == ["1.039", "\u22127"]


def test_the_question_shows_x_the_specification_and_every_input(root):
    context = Context.load(root / "configs/cases/turtlebot.yaml")
    names = context.states, context.inputs
    with style.figure_style():
        figure = problem_figure(
            context.box, context.input_set, names, context.units, lambda pair, own: surroundings(context, pair)(own)
        )
        floor, heading, drives = figure.axes
        boxes = {label: [p.get_bbox().extents for p in floor.patches if p.get_label() == label] for label in LABELS}
        assert [len(found) for found in boxes.values()] == [1, 1, 4]
        assert boxes["X"][0].tolist() == [0.0, 0.0, 10.0, 10.0]
        x, y = context.case.synthesis.specification.target.values()
        assert boxes["target"][0].tolist() == [x[0], y[0], x[1], y[1]]
        assert heading.patches[0].get_bbox().intervaly.tolist() == [context.box.lo[2], context.box.hi[2]]
        dots = np.column_stack(drives.lines[0].get_data())
        assert {tuple(u) for u in dots.tolist()} == {tuple(u) for u in context.input_set.tolist()}


def test_a_plug_in_may_draw_any_patch(root):
    context = Context.load(root / "configs/cases/pendulum.yaml")
    names = context.states, context.inputs
    with style.figure_style():
        figure = problem_figure(
            context.box, context.input_set, names, context.units,
            lambda pair, own: own.add_patch(Circle((0.0, 0.0), 0.9, label="a circle")),
        )  # fmt: skip
        lo, hi = figure.axes[0].get_ylim()
        assert lo < -0.9 < 0.9 < hi


def test_a_gap_is_shown_along_the_state_that_it_follows_and_never_along_a_free_one():
    """A table that turns round with the second of three states, and a translation along the first."""
    box, inputs = Box([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]), np.array([[0.0]])
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (400, 3))
    d = np.stack([-np.sign(x[:, 1]), 0.1 * x[:, 2], np.zeros(400)], axis=1)
    domain = GapDomain(("a", "b", "c"), ("u",), box, inputs, free=(0,))
    edges = (np.array([-1.0, 1.0]), np.array([-1.0, 0.0, 1.0]), np.array([-1.0, 1.0]))
    middle = np.array([[[1.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]])
    gap = CellGap(domain, (Tier(1, "made up"),), edges, middle - 0.2, middle + 0.2)
    assert [followed_axis(gap, x, d[:, i]) for i in (0, 1)] == [1, 2]
    figure = figures_gap.bound_figure(gap, x, np.zeros((400, 1)), d, {"a": "m", "b": "m/s", "c": "rad"})
    assert [axes.get_xlabel().split()[0] for axes in figure.axes[3:5]] == ["b", "c"]
    hull = figure.axes[0].collections
    assert len(hull) > 20  # a part of X each, and the samples


@pytest.mark.parametrize("dots", [62, 170])
def test_a_legend_is_no_wider_than_its_figure(dots):
    with style.figure_style():
        figure, axes = style.panels(1, 2, 3.0)
        for label in ("winning domain", "outline of the other domain", "run in the simulator", "leaves the safe set"):
            for axis, colour in zip(axes[0], ("b", "r"), strict=True):
                axis.plot([0, 1], color=colour, marker="o", label=label)
        style.legend(figure)
        assert len(figure.legends[0].get_texts()) == 4, "a label of both panels stands once"
        figure.set_dpi(dots)
        figure.canvas.draw()
        assert figure.legends[0].get_window_extent().x1 <= figure.bbox.x1
