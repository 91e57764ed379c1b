"""`gaitopt plot` and `gaitopt report` write what they are asked for, and leave what is not a run alone."""

import shutil
from pathlib import Path

import pytest

from gaitopt.cli.main import main

PROBLEM = "rimless-wheel-slip"
CONTINUE = ("continue", "compass-passive-a", "--param")

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture(scope="module")
def stored_branch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored") / "branch"
    assert main([*CONTINUE, "friction", "--to", "0.02", "--max-points", "14", "-o", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture
def branch_run(stored_branch, tmp_path):
    return Path(shutil.copytree(stored_branch, tmp_path / "results" / "branch"))


@pytest.mark.slow
def test_plot_solves_stores_and_draws_what_tells_something(tmp_path, capsys):
    assert main(["plot", PROBLEM, "--quiet"]) == 0
    paths = capsys.readouterr().out.split()
    assert all((tmp_path / path).stat().st_size > 1000 for path in paths)
    names = {path.rpartition("/")[2] for path in paths}
    assert {"portrait.svg", "portrait.png", "force.svg", "methods.png", "animation.html"} <= names
    assert "torques.svg" not in names


def test_a_stored_run_is_drawn_without_solving_it_again_and_with_another_in_a_folder_of_their_own(tmp_path, capsys):
    main(["solve", PROBLEM, "--quiet"])
    assert main(["plot", PROBLEM, "--what", "portrait", "--format", "pdf", "-o", "drawn"]) == 0
    said = capsys.readouterr()
    assert "taken from" in said.err
    assert said.out.endswith("drawn/portrait.pdf\n")
    assert main(["plot", PROBLEM, "--quiet", "--what", "nonsense"]) == 2
    assert "nonsense" in capsys.readouterr().err
    assert main(["plot", PROBLEM, "rimless-wheel-stick", "--what", "portrait", "--quiet"]) == 0
    assert "comparison/portrait.svg" in capsys.readouterr().out
    assert (tmp_path / "comparison" / "portrait.png").is_file()


def test_report_of_a_run_of_two_and_of_one_that_is_not_solvable(tmp_path, capsys):
    assert main(["report", PROBLEM, "--quiet"]) == 0
    assert "<!DOCTYPE html>" in (tmp_path / capsys.readouterr().out.strip()).read_text()
    assert main(["report", PROBLEM, "rimless-wheel-stick", "-o", "both.html", "--quiet"]) == 0
    assert "rimless-wheel-stick" in (tmp_path / "both.html").read_text()
    assert main(["report", "rimless-wheel-stick", "--set", "friction=0.5", "--quiet"]) == 4


def test_a_branch_is_drawn_and_reported_from_its_folder_without_a_torn_last_line(branch_run, capsys):
    with (branch_run / "branch.jsonl").open("a") as lines:
        lines.write('{"record": "poi')
    assert main(["plot", str(branch_run), "--what", "speed"]) == 0
    assert (branch_run / "figures" / "speed.svg").is_file()
    assert main(["report", str(branch_run)]) == 0
    assert "Neimark" in (branch_run / "report.html").read_text()
    assert main(["plot", str(branch_run), "--what", "portrait"]) == 2
    assert "spectral_radius" in capsys.readouterr().err


@pytest.mark.slow
def test_branches_over_one_parameter_share_a_picture(branch_run, tmp_path, capsys):
    other = shutil.copytree(branch_run, tmp_path / "other")
    assert main(["plot", str(branch_run), str(other), "--what", "speed", "--format", "svg"]) == 0
    assert capsys.readouterr().out.split() == ["comparison/speed.svg"]
    slope = tmp_path / "slope"
    assert main([*CONTINUE, "walker.slope", "--to", "0.0176", "-o", str(slope), "--quiet"]) == 0
    assert main(["plot", str(branch_run), str(slope)]) == 2
    assert "branches over friction and walker.slope have no common axis" in capsys.readouterr().err
