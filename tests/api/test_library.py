"""Objects say in a line what they are, draw and tabulate themselves, and survive the disk bit by bit."""

import io
import sys
from base64 import b64decode

import numpy as np
import pytest
from matplotlib.axes import Axes
from named import named, verification
from pictured import gait
from rich.console import Console

import gaitopt as go
from gaitopt.errors import StorageError, UnknownNameError
from gaitopt.gait.gait import Cause
from gaitopt.problem.scalars import SCALARS
from gaitopt.search.explain import Explanation
from gaitopt.show.catalogue import GAIT_FIGURES, figures_of
from gaitopt.show.tables import print_branch

pd, xr = pytest.importorskip("pandas"), pytest.importorskip("xarray")
LONGEST_LINE = 200
WHEEL = "rimless-wheel-slip"

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture(scope="module")
def branch():
    return go.continuation(named(WHEEL), "friction", named(WHEEL).problem.static_friction - 0.01, max_points=4)


@pytest.fixture(scope="module")
def walk():
    return go.simulate(named("compass-passive-a"), {"theta1": -0.15}, steps=20)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "run"
    counts = []
    problem = go.load_problem(WHEEL)
    result = go.sweep(
        problem, {"friction": (0.4, 0.5, 2)}, workers=1, output=folder, progress=lambda done, _: counts.append(done)
    )
    assert counts == [1, 2]
    return result, folder


@pytest.fixture
def everything(branch, walk, swept):
    return [named(WHEEL), branch, walk, walk.trajectory, verification(WHEEL), swept[0], named(WHEEL).problem]


def test_every_result_prints_in_one_line(everything, branch):
    for result in (*everything, branch[0], branch.specials[0], *walk_parts(everything[2])):
        assert "\n" not in repr(result)
        assert len(repr(result)) < LONGEST_LINE
    assert f"radius {named(WHEEL).spectral_radius:.4g}" in repr(named(WHEEL))
    assert "converged" in repr(named(WHEEL))


def test_answers_print_in_one_line_and_report_in_words():
    problem = named(WHEEL).problem
    why = Explanation(
        problem=problem, gait=None, exists=False, causes=(Cause(what="search", description="needs more"),)
    )
    assert repr(why) == f"<Explanation of {WHEEL}: needs more>"
    assert "needs more" in why._repr_html_()
    pytest.importorskip("flint")
    said = []
    proof = go.prove(named("rimless-wheel-stick"), progress=said.append)
    assert repr(proof).startswith("<Proof about rimless-wheel-stick: ")
    assert repr(proof).endswith("claims proved, stable>")


def walk_parts(walk):
    return walk.trajectory.steps[0], walk.trajectory.steps[0].arcs[0]


def test_a_notebook_shows_the_table_of_the_command_line_and_a_picture(everything):
    for result in everything:
        if hasattr(result, "_repr_html_"):
            shown = result._repr_html_()
            assert "<pre" in shown
            assert "<script" not in shown
    shown = named(WHEEL)._repr_html_()
    assert "Floquet multipliers" in shown
    assert b64decode(shown.partition("base64,")[2].partition('"')[0]).startswith(b"\x89PNG")


def test_everything_the_command_line_draws_is_drawn_from_the_objects(branch, walk, swept):
    gaits = [gait("compass-passive-a"), gait("compass-passive-b")]
    assert all(isinstance(gaits[0].plot(word), Axes) for word in GAIT_FIGURES)
    assert isinstance(go.plot(gaits, "force"), Axes)
    assert all(isinstance(branch.plot(word), Axes) for word in figures_of(branch).names)
    assert isinstance(swept[0].plot("speed"), Axes)
    (path,) = go.save_figures(swept[0], "figures", ["speed"], formats=["svg"])
    assert path.read_bytes().startswith(b"<?xml")
    with pytest.raises(UnknownNameError, match="landscape: choose from"):
        go.save_figures(swept[0], "figures", ["landscape"])
    assert isinstance(walk.plot(), Axes)
    with pytest.raises(ValueError, match="choose from portrait"):
        gaits[0].plot("landscape")
    with pytest.raises(TypeError, match="no figures"):
        go.plot(3)


def test_pages_of_objects_need_no_network(branch, walk):
    for page in (named(WHEEL).report(), walk.report(), branch.report(), walk.animate(), named(WHEEL).animate()):
        assert "http" not in page.text.replace("http-equiv", "")
        assert page.save("page.html").read_text() == page.text
        assert page._repr_html_().startswith("<iframe srcdoc=")


def test_the_walk_ends_in_the_picture_where_it_ends(walk):
    assert walk.trajectory.ending == "fall"
    axes = walk.plot("section")
    (end,) = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert end.get_xdata()[0] == len(walk.complete_steps) + 0.5


def test_the_table_of_a_gait_is_that_of_its_run_folder_bit_by_bit():
    ours = named(WHEEL)
    folder = ours.save("run")
    stored = pd.read_csv(folder / "trajectory.csv")
    pd.testing.assert_frame_equal(stored, ours.to_frame(), check_exact=True)
    assert ours.to_frame().attrs["units"]["dtheta"] == "rad/s"


def test_a_bare_trajectory_has_its_states_as_a_table(walk):
    trajectory = walk.trajectory
    frame = trajectory.to_frame()
    np.testing.assert_array_equal(frame[list(trajectory.names)], walk.to_frame()[list(trajectory.names)])
    np.testing.assert_array_equal(trajectory.to_xarray()["dtheta1"], frame["dtheta1"])
    assert (frame.attrs["units"]["dtheta1"], frame["step"].iloc[-1]) == ("rad/s", len(trajectory.steps))
    assert str(trajectory.ending) in trajectory._repr_html_()


@pytest.mark.parametrize("name", ["gait", "walk", "branch", "sweep"])
def test_datasets_survive_a_file_bit_by_bit(name, branch, walk, swept):
    ours = {"gait": named(WHEEL), "walk": walk, "branch": branch, "sweep": swept[0]}[name].to_xarray()
    ours.to_netcdf("data.nc", engine="scipy")
    with xr.open_dataset("data.nc", engine="scipy") as stored:
        for key in ours:
            np.testing.assert_array_equal(stored[key].values, ours[key].values)
            assert stored[key].attrs.get("units") == ours[key].attrs.get("units")


def test_columns_of_a_branch_have_the_units_of_its_scalars(branch):
    frame = branch.to_frame()
    assert frame.attrs["units"]["speed"] == SCALARS["speed"].unit
    np.testing.assert_array_equal(frame["spectral_radius"][: len(branch)], branch.column("spectral_radius"))


def test_a_missing_package_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'gaitopt\[frames\]'"):
        named(WHEEL).to_frame()


def test_runs_come_back_as_what_was_stored(walk, swept):
    ours = named(WHEEL)
    again = go.load_run(ours.save("gait"))
    np.testing.assert_array_equal(again.state, ours.state)
    stored = go.load_run(walk.save("walk"))
    np.testing.assert_allclose(stored.trajectory.section_states, walk.trajectory.section_states, atol=1e-15)
    np.testing.assert_array_equal(stored.gait_states, walk.gait_states)
    assert repr(stored) == repr(walk)
    (place,) = swept[1].glob("sweep-*")
    again = go.load_run(place)
    np.testing.assert_array_equal(again.column("speed"), swept[0].column("speed"))
    assert again.folder == swept[0].folder == place
    assert (place / "table.csv").is_file()
    with pytest.raises(StorageError, match="no gaitopt result"):
        go.load_run("nothing")


def test_special_points_over_an_angle_are_printed_in_degrees_as_well():
    written = io.StringIO()
    special = {"record": "special", "branch": 0, "type": "fold", "value": np.radians(3), "status": "converged"}
    print_branch(Console(file=written, width=100), [special | {"reason": "", "next": []}], "walker.slope")
    assert "rad (3 deg): fold" in written.getvalue()


def test_progress_is_shown_on_a_terminal_and_nowhere_else(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("gaitopt.search.solve.solve", lambda problem, progress, **_: progress(1, 1e-3))
    for screen, shown in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", screen)
        go.solve(go.load_problem(WHEEL))
        assert bool(screen.getvalue()) == shown
    silent = Terminal()
    monkeypatch.setattr(sys, "stderr", silent)
    go.solve(go.load_problem(WHEEL), progress=False)
    assert not silent.getvalue()


@pytest.mark.slow
def test_progress_in_a_notebook_is_a_widget_or_nothing(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    NotebookClient = pytest.importorskip("nbclient").NotebookClient
    pytest.importorskip("ipywidgets")
    program = (
        f"import gaitopt as go\nproblem = go.load_problem('{WHEEL}')",
        "gait = go.solve(problem)\nbranch = go.continuation(gait, 'friction', to=0.8, max_points=3)",
        "gait = go.solve(problem, progress=False)",
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in program])
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert [len(cell.outputs) > 0 for cell in notebook.cells] == [False, True, False]
    widgets = notebook.metadata["widgets"]["application/vnd.jupyter.widget-state+json"]["state"].values()
    shown = [str(widget["state"].get("outputs")) for widget in widgets]
    assert any("solving rimless-wheel-slip" in text for text in shown)
    assert any("continuing" in text for text in shown)
