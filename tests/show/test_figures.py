"""Figures show what is so: dashes where the foot slips, the cone where friction ends, units on every axis."""

from dataclasses import replace

import numpy as np
import pytest
from legible import faults
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from pictured import SEQUENCES, TORSO, branch, gait

from gaitopt import Mode, Sweep, continuation, load_problem, simulate
from gaitopt.gait.trajectory import Step
from gaitopt.problem.scalars import SCALARS
from gaitopt.runs.grid import Axis, Grid
from gaitopt.show.branches import UNSTABLE, multiplier_paths, multiplier_plane, over_parameter
from gaitopt.show.catalogue import branch_figures, figures_of
from gaitopt.show.gaits import EDGE_DASHES
from gaitopt.show.grids import FAILURES, front_figure, pareto_front, sweep
from gaitopt.show.motion import differences, motion_from_record, motion_of, simulated, thinned
from gaitopt.show.style import MODE_COLOURS, SLIP_DASHES, Parameter, label, parameter_of, save, symbol
from gaitopt.simulation.outcomes import ENDINGS

FRICTION = Parameter(key="friction")


@pytest.fixture(scope="module")
def drawn():
    results = {"driven": figures_of(gait("compass-pd-impact-slip"))}
    results["both"] = figures_of([gait("compass-passive-a"), gait("compass-passive-b")])
    gaits = [((word, name), result.draw(word)) for name, result in results.items() for word in result.usual]
    shown = branch_figures(gait("compass-passive-a").problem, "friction", branch())
    paths = [(word, shown.draw(word)) for word in ("multipliers", "spectral_radius")]
    front = pareto_front({"front": [record for record in branch() if record["record"] == "point"]}, "speed", "period")
    every = dict([*gaits, *paths, ("front", front)])
    for figure in every.values():
        figure.canvas.draw()
    return every


def curves(axes, style):
    return [line for line in axes.lines if line._unscaled_dash_pattern == style and len(line.get_xdata()) > 10]


def test_every_axis_says_what_it_shows_and_in_which_unit(drawn):
    unitless = ("σ", "λ", "cost", "ratio", "μ")
    for name, figure in drawn.items():
        for one in (axes for axes in figure.axes if axes.axison and (axes.lines or axes.collections)):
            words = [text for text in (one.get_xlabel(), one.get_ylabel()) if text]
            assert words, name
            assert all("[" in text or any(word in text for word in unitless) for text in words), (name, words)


def test_no_legend_covers_the_picture_or_leaves_it(drawn):
    for name, figure in drawn.items():
        if name[0] == "postures":  # needs none
            continue
        renderer = figure.canvas.get_renderer()
        (legend,) = figure.legends
        box = legend.get_window_extent(renderer)
        assert box.x0 >= 0, name
        assert box.x1 <= figure.bbox.x1, name
        assert not any(box.overlaps(axes.get_tightbbox(renderer)) for axes in figure.axes), name


@pytest.mark.parametrize("word", ["portrait", "force", "slip"])
def test_the_foot_slips_where_the_curve_is_dashed(word):
    shown = gait("compass-passive-a")
    axes = figures_of(shown).draw(word).axes[0]
    curves_drawn = len(shown.system.walker.shape) if word == "portrait" else 1
    style = EDGE_DASHES if word == "force" else SLIP_DASHES
    assert len(curves(axes, style)) == 2 * curves_drawn
    assert len(curves(axes, (0, None))) == curves_drawn


def test_the_force_ratio_stays_between_the_edges_of_the_cone_and_the_cross_is_the_impulse_ratio():
    shown = gait("compass-passive-a")
    axes = figures_of(shown).draw("force").axes[0]
    levels = sorted(line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "-.")
    assert levels == [-0.14, 0.14]
    ratios = np.concatenate([line.get_ydata() for line in axes.lines if len(line.get_xdata()) > 10])
    assert np.abs(ratios).max() == pytest.approx(0.14, abs=1e-12)
    (cross,) = [line for line in axes.lines if line.get_marker() == "x"]
    assert abs(cross.get_ydata()[0]) == pytest.approx(shown.measures["impulse_ratio"])
    assert cross.get_xdata()[0] == pytest.approx(shown.measures["period"])


@pytest.mark.parametrize("name", [*SEQUENCES, TORSO])
def test_a_record_is_enough_to_draw_the_same_motion(name):
    ours = gait(name)
    again = motion_from_record(ours.dynamics, ours.to_record())
    assert [arc.mode for arc in again.steps[0].arcs] == [arc.mode for arc in ours.steps[0].arcs]
    for one, other in zip(again.steps[0].arcs, ours.steps[0].arcs, strict=True):
        np.testing.assert_allclose(one.states[-1], other.states[-1], atol=1e-9)
    np.testing.assert_allclose(again.steps[-1].impact.state, ours.steps[-1].impact.state, atol=1e-9)


def test_method_comparison_agree_and_a_spoiled_gait_is_seen_to_disagree():
    """Arcs are not compared beyond a different mode."""
    ours = gait("compass-passive-a")
    assert "torques" not in figures_of(ours).usual  # of a passive walker
    assert "torques" in figures_of(gait("compass-pd-impact-slip")).usual
    walked = simulated(ours)
    motion = motion_of(ours)
    assert max(np.abs(gap).max() for _, gap in differences(motion.steps, walked)) < 1e-8
    first, *others = motion.steps[0].arcs
    arcs = [replace(arc, states=arc.states + 1e-4) for arc in (first, *others)]
    spoiled = Step(arcs=tuple(arcs), impact=motion.steps[-1].impact)
    assert max(np.abs(gap).max() for _, gap in differences([spoiled], walked)) > 9e-5
    other = replace(motion.steps[0], arcs=(replace(first, mode=Mode.STICK), *others))
    assert list(differences([other], motion.steps)) == []


def test_at_most_twenty_points_are_marked_from_the_first_to_the_last():
    for count in (3, 20, 39, 65):
        times, states = thinned(np.arange(count), np.arange(count)[:, None])
        assert len(times) == min(count, 20)
        assert (times[0], times[-1]) == (0, count - 1)
        np.testing.assert_array_equal(states[:, 0], times)


def words_of(figure):
    """The texts of the legend of a figure."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_branch_shows_stability_special_points_and_mode_sequences():
    """Stable gaits are thick and unstable ones dotted; special points have a marker and a word."""
    figure = over_parameter({"gait": branch()}, FRICTION)
    axes, words = figure.axes[0], words_of(figure)
    thick = [line for line in axes.lines if line.get_linewidth() > 2]
    assert [len(line.get_xdata()) for line in thick] == [4]  # gait A, stable throughout
    assert max(thick[0].get_ydata()) < 1
    dotted = [line for line in axes.lines if line._unscaled_dash_pattern == UNSTABLE]
    assert [len(line.get_xdata()) for line in dotted] == [3]  # gait B, unstable throughout
    assert min(dotted[0].get_ydata()) > 1
    assert words[0] == "slip forward, stick, slip backward; impact stick"
    assert {"Neimark–Sacker", "branch ends"} <= {*words}
    marks = [line for line in axes.lines if line.get_marker() in ("D", "|")]
    assert sorted(line.get_xdata()[0] for line in marks) == [0.135, 0.16]
    assert len({line.get_color() for line in axes.lines if len(line.get_xdata()) > 2}) > 1


def test_every_scalar_that_gaits_of_a_branch_have_can_be_drawn():
    figures = branch_figures(gait("compass-passive-a").problem, "friction", branch())
    assert {*SCALARS} - {*figures.names} == {"apex_height"}  # of walkers that fly
    assert all(figures.draw(word).axes[0].has_data() for word in figures.names)


def test_values_stand_beside_their_marks_and_cover_no_other():
    """Two special points a hundredth of the axis apart have their values on two sides."""
    point = {"record": "point", "branch": 0, "phases": [{"mode": "stick"}], "impact": "stick"}
    points = [{**point, "index": k, "value": 0.1 * k, "spectral_radius": 0.5} for k in range(11)]
    fold = {"record": "special", "branch": 0, "type": "fold", "status": "converged", "next": [], "gait": {}}
    figure = over_parameter({"gait": [*points, {**fold, "value": 0.5}, {**fold, "value": 0.51}]}, FRICTION)
    figure.canvas.draw()
    first, second = figure.axes[0].texts
    assert (first.get_text(), second.get_text()) == ("0.5", "0.51")
    assert not first.get_window_extent().overlaps(second.get_window_extent())


def test_the_portrait_of_a_walk_marks_at_most_six_states_and_outlines_them():
    axes = simulate("compass-passive-stick", steps=9).plot("portrait")
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    assert [len(line.get_xdata()) for line in marks] == [6, 6]
    assert {line.get_markeredgecolor() for line in marks} == {axes.get_facecolor()}


def test_a_slip_of_less_than_a_pixel_is_marked_in_the_gait_diagram_whose_bars_end_where_phases_do():
    shown = gait("heel-toe-slip")
    axes = shown.plot("contacts")
    (arcs,) = (step.arcs for step in shown.motion)
    drawn = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    np.testing.assert_allclose(drawn, [(arc.start, arc.end) for arc in arcs], atol=1e-12)
    assert {bar.get_linewidth() for bar in axes.patches} == {0.0}
    (mark,) = [line for line in axes.lines if len(line.get_xdata())]
    assert arcs[-1].start < mark.get_xdata()[0] < arcs[-1].end
    assert mark.get_color() == MODE_COLOURS[Mode.SLIP_BACKWARD]


def test_a_way_to_fail_has_its_colour_in_every_basin():
    assert len(set(FAILURES)) == len(FAILURES) == len(ENDINGS) + 1  # and those without an end


@pytest.mark.parametrize("extension", ["svg", "png", pytest.param("pdf", marks=pytest.mark.slow)])
def test_the_same_gait_gives_the_same_bytes(tmp_path, extension):
    shown = [gait("rimless-wheel-slip")]
    (first,) = save(figures_of(shown).draw("portrait"), tmp_path / "first", [extension])
    (second,) = save(figures_of(shown).draw("portrait"), tmp_path / "second", [extension])
    assert first.read_bytes() == second.read_bytes()


def test_symbols_and_units_are_those_of_the_textbook_and_angles_are_in_degrees_where_the_file_has_them():
    assert symbol("theta1") == "θ₁"
    assert symbol("dtheta2") == "θ\u0307₂"
    assert symbol("torso") == "torso"
    assert symbol("dstance_shin") == "rate of stance shin"
    assert str(label("walker.slope")) == "slope [rad]"
    assert str(label("control.hip", load_problem("compass-torque-slip"))) == "hip torque [N m]"
    assert str(label("control.first.drive", load_problem("crawler"))) == "drive motor force [N]"
    problem = load_problem("compass-passive-a")
    shown = parameter_of(problem, "walker.slope")
    assert str(shown.label) == "slope [°]"
    assert shown.shown([{"value": np.pi / 60}, {"value": None}]) == [{"value": pytest.approx(3)}, {"value": None}]
    assert str(parameter_of(problem, "friction").label) == "coefficient of friction μ"
    bare = replace(problem, text=problem.text.replace("1 deg", "0.0175"))
    assert str(parameter_of(bare, "walker.slope").label) == "slope [rad]"


def grid_records(values):
    """Records of a sweep over a grid, with the spectral radius of each point, or None where there is no gait."""
    return [{"status": "infeasible" if v is None else "converged", "spectral_radius": v} for v in values]


def swept(axes, records, phases=None):
    """The sweep of a wheel."""
    problem = load_problem("rimless-wheel-stick").replace({"gait.phases": phases or ["stick"]})
    return Sweep(problem=problem, grid=Grid(tuple(axes)), records=records)


def heat_map(rows):
    """The sweep's figure; rows are friction, columns are slope."""
    axes = (Axis(key="friction", lower=0.1, upper=0.3, count=len(rows)),)
    axes += (Axis(key="walker.slope", lower=0.0, upper=0.02, count=len(rows[0])),)
    return sweep(swept(axes, grid_records([v for row in rows for v in row])), "spectral_radius")


def lines_of(figure):
    return [artist for artist in figure.axes[0].collections if isinstance(artist, ContourSet)]


def test_line_where_stability_is_lost_is_where_the_interpolated_radius_is_one():
    figure = heat_map([[0.85, 0.85, None], [1.05, 1.05, 1.05], [1.25, None, 1.25]])
    (line,) = lines_of(figure)
    (path,) = line.get_paths()
    for rows in ([[0.5, 0.6], [0.7, 0.8]], [[None, None], [None, None]]):
        assert not lines_of(heat_map(rows))
    assert path.vertices[:, 0] == pytest.approx(0.175)
    assert (path.vertices[:, 1].min(), path.vertices[:, 1].max() < 0.02) == (0.0, True)  # not to what has no gait
    assert words_of(figure) == ["spectral radius 1: stability lost", "not with these phases"]


def test_one_gait_of_another_branch_does_not_stretch_the_colours():
    values = [[0.6 + 0.001 * (9 * row + column) for column in range(9)] for row in range(9)]
    smooth, outlying = heat_map(values), heat_map([[50.0, *values[0][1:]], *values[1:]])
    assert smooth.axes[0].collections[0].get_clim() == pytest.approx((0.6, 0.68))
    low, high = outlying.axes[0].collections[0].get_clim()
    assert low == pytest.approx(0.601)
    assert high < 0.8
    low, high = heat_map([[0.7, 0.7 + 1e-16], [0.7 - 1e-16, 0.7]]).axes[0].collections[0].get_clim()
    assert high - low > 0.01  # rounding of a constant


def test_a_sweep_keeps_its_range_marks_failures_and_shows_degrees_where_they_were_given():
    axis = Axis(key="walker.slope", lower=np.radians(1), upper=np.radians(3), count=3, unit="deg")
    figure = sweep(swept([axis], grid_records([0.5, None, None])), "spectral_radius")
    (axes,) = figure.axes
    assert axes.get_xlim()[0] < 1 < 3 < axes.get_xlim()[1]
    assert "°" in axes.get_xlabel()
    (crosses,) = [line for line in axes.lines if line.get_marker() == "x"]
    np.testing.assert_allclose(crosses.get_xdata(), [2, 3])
    assert words_of(figure) == ["not with these phases"]


def test_a_cross_of_a_sweep_claims_no_more_than_is_known():
    axis = Axis(key="friction", lower=0.1, upper=0.3, count=3)
    records = [*grid_records([None, 0.5]), {"status": "not_converged", "spectral_radius": None}]
    for phases, words in ((["stick"], "not with these phases"), ("auto", "no gait")):
        figure = sweep(swept([axis], records, phases), "spectral_radius")
        assert words_of(figure) == [words, "not converged"]


def test_the_stable_line_reaches_the_bifurcation_and_a_requested_end_is_not_marked():
    point = {"record": "point", "branch": 0, "phases": [{"mode": "stick"}], "impact": "stick"}
    points = [{**point, "index": k, "value": 0.1 + 0.01 * k, "spectral_radius": 0.9 + 0.08 * k} for k in range(3)]
    special = {"record": "special", "branch": 0, "status": "converged", "next": []}
    crossing = special | {"type": "fold", "value": 0.1125, "gait": {"spectral_radius": 1 + 1e-12}}
    end = special | {"type": "end", "value": 0.12, "bound": True, "gait": {}}
    figure = over_parameter({"gait": [*points, crossing, end]}, FRICTION)
    (thick,) = [line for line in figure.axes[0].lines if line.get_linewidth() > 2]
    assert thick.get_xdata()[-1] == 0.1125
    assert "branch ends" not in words_of(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["0.1125"]


def test_unstable_gaits_of_a_front_are_hollow_and_requests_without_a_design_are_ticks_with_their_reason():
    points = [record | {"objective": 0.1, "pareto": True} for record in branch() if record["record"] == "point"]
    axes = pareto_front({"front": points}, "speed", "period").axes[0]
    faces = [line.get_markerfacecolor() for line in axes.lines if line.get_marker() == "o"]
    assert faces.count("white") == 3
    reason = "speed at least 9 m/s conflicts with the impact, whose lift velocity would be negative: best reached 0.53"
    failed = {"value": 9.0, "objective": None, "status": "infeasible", "message": reason}
    figure = front_figure(gait("compass-passive-a").problem, "constraints.speed.min", [*points, failed])
    assert f"infeasible: {reason}" in [text.replace("\n", " ") for text in words_of(figure)]


def test_no_text_lies_over_text_or_over_a_curve_or_is_cut_off(drawn):
    assert {name: found for name, figure in drawn.items() if (found := faults(figure))} == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "compass-passive-a", "rimless-wheel-slip", "heel-toe-slip", "inchworm", "flat-foot", "crawler", "bounding",
        "slip-walk", "slip-run-foot", "rabbit-hzd",
    ],
)  # fmt: skip
def test_no_figure_of_other_walkers_has_such_text(name):
    shown = figures_of(gait(name))
    assert {word: found for word in shown.usual if (found := faults(shown.draw(word)))} == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "key", "to"), [("compass-passive-stick", "friction", 0.1), ("slip-walk", "walker.energy", 815)]
)
def test_no_figure_of_a_branch_has_such_text(name, key, to):
    shown = figures_of(continuation(gait(name), key, to, progress=False))
    assert {word: found for word in shown.names if (found := faults(shown.draw(word)))} == {}


def test_text_over_text_over_a_curve_and_beyond_the_edge_is_found():
    figure = Figure(figsize=(3, 3))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.2, 0.2, 0.6, 0.6))
    axes.plot([0, 1], [0, 1])
    assert faults(figure) == []
    figure.canvas.draw()
    axes.text(0.5, 0.5, "on the curve", ha="center", va="center")
    axes.text(0.1, 0.8, "one")
    axes.text(0.12, 0.82, "other")
    axes.text(0.99, 0.1, "too long for this place")
    found = faults(figure)
    assert sorted(words.split("' ")[-1] for words in found) == ["is cut off", "lies over 'other'", "lies over a curve"]


@pytest.mark.parametrize("quantity", ["period", "step_length"])
def test_a_doubled_family_begins_in_the_picture_where_the_period_doubles(quantity):
    """Its first gaits, of two steps, are joined to the gait of one step at the marker."""
    one = {**next(r for r in branch() if r["record"] == "point"), quantity: 0.8}
    points = [{**one, "branch": 0, "index": k, "value": 0.1 + 0.01 * k} for k in range(2)]
    steps = [{**one, "phases": one["phases"], quantity: 0.8 + side * 0.1} for side in (-1, 1)]
    doubled = [{**one, "branch": 1, "index": k, "value": 0.12 + 0.01 * k, "steps": steps} for k in range(2)]
    special = {"record": "special", "branch": 0, "type": "period_doubling", "value": 0.115, "next": [1], "gait": one}
    axes = over_parameter({"cascade": [*points, special, *doubled]}, FRICTION, quantity).axes[0]
    begins = [
        line.get_ydata()[0]
        for line in axes.lines
        if np.ravel(line.get_xdata())[0] == 0.115 and len(line.get_xdata()) > 1
    ]
    assert begins == [0.8, 0.8]


def test_multipliers_far_beyond_the_circle_leave_it_visible_and_are_written_at_the_edge():
    figure = multiplier_plane({"gait": np.array([0.5 + 0.5j, 0.5 - 0.5j, -80.0])})
    (axes,) = figure.axes
    assert axes.get_xlim() == (-2, 2)
    assert [text.get_text() for text in axes.texts] == ["80"]
    points = [{**record, "multipliers": [{"re": 3e4, "im": 0.0}]} for record in branch() if record["record"] == "point"]
    figure = multiplier_paths(points, FRICTION)
    assert figure.axes[0].get_xlim() == (-2, 2)
    assert "at the edge: beyond it, |λ| up to 3e+04" in words_of(figure)


def test_legends_of_long_cascades_stay_inside_and_leave_the_axes_their_height():
    step = {"phases": [{"mode": mode} for mode in ("slip_forward", "stick", "slip_backward")]}
    point = {"record": "point", "index": 0, "spectral_radius": 0.9}
    records = [
        {
            **point,
            "branch": k,
            "value": 0.1 * k,
            "steps": [{**step, "impact": "slip_forward"}] * k + [{**step, "impact": "stick"}],
        }
        for k in range(1, 11)
    ]
    figure = over_parameter({"gait": records}, FRICTION)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    box = figure.legends[0].get_window_extent(renderer)
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
    assert figure.axes[0].get_window_extent(renderer).height > 2 * figure.dpi
    assert len({line.get_color() for line in figure.axes[0].lines}) > 9  # the level of one is a line, too


def test_a_family_that_ends_with_unbounded_multipliers_keeps_its_scale():
    points = [record for record in branch() if record["record"] == "point" and record["branch"] == 0]
    end = {"record": "special", "branch": 0, "type": "end", "value": 0.16, "reason": "", "next": []}
    figure = over_parameter({"gait": [*points, end | {"gait": {"spectral_radius": 1e15}}]}, FRICTION)
    assert figure.axes[0].get_ylim()[1] < 2


def test_the_lock_of_a_knee_is_drawn_as_a_jump():
    shown = gait("kneed-passive")
    figure = figures_of(shown).draw("portrait")
    before, after = (arc.states for arc in shown.steps[0].arcs[:2])
    knee = [shown.system.state_names.index(name) for name in ("theta3", "dtheta3")]
    jumps = [line.get_xydata() for line in figure.axes[0].lines if line.get_linestyle() == ":"]
    assert any(np.allclose(jump, [before[-1, knee], after[0, knee]]) for jump in jumps if len(jump) == 2)
    assert "impact, or a stop locks" in words_of(figure)


def test_a_hopper_shows_its_height_and_what_it_presses_on_the_ground():
    shown = gait("hopper")
    _, normal = figures_of(shown).draw("force").axes
    landed, flying = ([line.get_ydata() for line in normal.lines if line.get_linestyle() == own] for own in ("-", ":"))
    assert max(np.max(force) for force in landed) > 1
    assert all(np.allclose(force, 0) for force in flying)
    assert "y, simulation" in words_of(figures_of(shown).draw("methods"))


def test_rounding_is_not_drawn_as_motion():
    figure = figures_of(simulate(gait("compass-passive-a"), steps=2)).draw("section")
    assert all(np.ptp(axes.get_ylim()) > 0.01 for axes in figure.axes)
