"""``find``, ``explain``, and ``solve`` of a problem without a mode sequence."""

import json

import pytest

WHEEL = """
name: wheel
walker: {model: rimless_wheel, spokes: 10, radius: 1, mass: 1, inertia_ratio: 0.3333333333, gravity: 1, slope: 13 deg}
friction: 0.4
gait: {phases: auto}
"""


@pytest.fixture
def wheel(empty_folder):
    """The file of a wheel without a mode sequence."""
    (empty_folder / "wheel.yaml").write_text(WHEEL)
    return "wheel.yaml"


def test_find_lists_gaits_and_resumes_where_it_stopped(run, wheel, monkeypatch):
    monkeypatch.setattr("gaitopt.search.candidates.MAX_POINTS", 4)
    code, out, err = run("find", wheel, "--starts", "1", "--workers", "1", "--json")
    record = json.loads(out)
    assert code == 0
    assert record["problem"] == "wheel"
    assert [gait["impact"] for gait in record["gaits"]] == ["stick"]
    assert "parts of the search" in err
    code, table, err = run("find", wheel, "--starts", "1", "--workers", "1")
    assert code == 0
    assert "parts of the search" not in err  # all of them are in the run folder
    assert "stick, slip_forward; stick" in table
    assert "stable" in table


@pytest.mark.slow
def test_find_without_a_gait_is_exit_4_with_an_empty_list(run, wheel):
    arguments = ("--set", "walker.slope=-5deg", "--starts", "1", "--workers", "1", "--json", "--quiet")
    code, out, _ = run("find", wheel, *arguments)
    assert code == 4
    assert json.loads(out)["gaits"] == []


def test_show_and_validate_take_an_open_sequence_and_what_needs_a_guess_says_that_it_is_open(run, wheel):
    assert "to be found" in run("show", wheel)[1]
    assert run("validate", wheel)[0] == 0
    code, _, err = run("simulate", wheel)
    assert (code, "gaitopt find" in err) == (3, True)


@pytest.mark.slow
def test_solve_stores_the_gait_under_the_hash_of_the_open_problem(run, wheel):
    code, out, _ = run("solve", wheel, "--json", "--quiet")
    record = json.loads(out)
    digest = json.loads(run("validate", wheel, "--json")[1])["hash"]
    assert code == 0
    assert record["run"].endswith(digest[:8])
    code, out, err = run("verify", wheel, "--json")
    assert code == 0
    assert "taken from" in err
    assert json.loads(out)["phases"] == record["phases"]


def test_explain_prints_the_cause_and_the_end_of_the_family_without_the_search(run, empty_folder):
    code, out, _ = run("explain", "rimless-wheel-stick", "--json", "--quiet")
    assert (code, json.loads(out)["exists"]) == (0, True)
    arguments = ("explain", "rimless-wheel-stick", "--set", "friction=0.8", "--seconds", "0", "--workers", "1")
    code, out, err = run(*arguments)
    assert code == 0
    assert out.count("needs friction 0.9141, has 0.8") == 1
    assert out.count("begins at friction = 0.91412") == 1
    assert "the time was over before the search was complete" in out
    assert err.index("solving") < err.index("searching")
    code, out, _ = run(*arguments, "--json", "--quiet")
    record = json.loads(out)
    assert (code, record["exists"], record["complete"]) == (0, False, False)


def test_find_at_its_time_limit_says_so(run, wheel):
    code, out, _ = run("find", wheel, "--seconds", "0", "--starts", "1", "--workers", "1", "--json", "--quiet")
    assert (code, json.loads(out)["searched"]["complete"]) == (4, False)
    _, out, _ = run("find", wheel, "--seconds", "0", "--starts", "1", "--workers", "1")
    assert "the time was over" in out
