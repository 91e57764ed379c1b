"""A report is one offline page that says everything about a gait, a branch or a comparison, and nothing false."""

import base64
import gzip
import json
import re
from dataclasses import replace
from shutil import which
from subprocess import run

import pytest
from pictured import branch, gait
from samples import sampled

import gaitopt as go
from gaitopt import Status
from gaitopt.show.pages import branch_report, comparison_report, labels, walks_page


def data_of(page):
    packed = re.search(r'<script type="text/plain" id="data">(.*?)</script>', page, re.DOTALL)[1]
    return json.loads(gzip.decompress(base64.b64decode(packed)))


@pytest.fixture(scope="module")
def written():
    problem = gait("compass-passive-a").problem
    return {
        "gait": comparison_report([gait("compass-passive-a")]),
        "two": comparison_report([gait("compass-passive-a"), gait("compass-pd-impact-slip")]),
        "branch": branch_report(problem, "friction", branch()),
    }


def test_a_page_names_no_address(written):
    for page in written.values():
        assert not re.search(r"https?:|//\w+\.|@import|url\(|src=", page)
        assert "default-src 'none'" in page


@pytest.mark.skipif(which("node") is None, reason="needs Node.js")
def test_the_scripts_of_a_page_are_free_of_syntax_errors(written, tmp_path):
    for name, page in written.items():
        scripts = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
        assert scripts, name
        (file := tmp_path / f"{name}.mjs").write_text("\n".join(scripts))
        run(["node", "--check", file], check=True)


def test_a_report_has_the_numbers_of_the_gait_its_claims_its_derivatives_and_its_problem_verbatim(written):
    (shown,) = data_of(written["gait"])["gaits"]
    problem, record = gait("compass-passive-a").problem, gait("compass-passive-a").to_record()
    for key, value in shown["scalars"].items():
        assert value == (None if record[key] is None else pytest.approx(record[key], rel=1e-8))
    assert {"period", "speed", "spectral_radius", "impulse_ratio"} <= shown["scalars"].keys()
    assert shown["state"].keys() == record["state"].keys()
    for claim in gait("compass-passive-a").verification["claims"]:
        assert f'<th scope="row">{claim["name"]}</th>' in written["gait"]
    provenance = (problem.digest, "phases: [slip_forward, stick, slip_backward]", "casadi")
    for text in ("passed</span>", "Derivatives in the parameters", "radius at +1 %", *provenance):
        assert text in written["gait"]


def test_a_failed_verification_is_said_plainly():
    ours = gait("compass-passive-a")
    record = dict(ours.verification)
    record["passed"] = False
    record["claims"] = [{**record["claims"][0], "passed": False, "figure": None}, *record["claims"][1:]]
    page = comparison_report([ours.verified(record)])
    assert "failed</span>" in page
    assert 'class="bad">FAILED' in page
    assert data_of(page)["gaits"][0]["passed"] is False


def test_a_failed_attempt_and_a_branch_without_points_have_no_report():
    failed = replace(gait("compass-passive-a"), status=Status.INFEASIBLE, steps=())
    with pytest.raises(ValueError, match="converged"):
        comparison_report([failed])
    with pytest.raises(ValueError, match="no points"):
        branch_report(failed.problem, "friction", [])


def test_gaits_of_one_name_are_distinguished():
    ours = gait("compass-passive-a")
    other = replace(ours, problem=ours.problem.replace({"friction": 0.145}))
    names = [shown["film"]["name"] for shown in data_of(comparison_report([ours, other]))["gaits"]]
    assert len(set(names)) == 2


def test_every_point_and_special_point_of_a_branch_is_on_its_page(written):
    data = data_of(written["branch"])
    points = [record for record in branch() if record["record"] == "point"]
    assert [shown["value"] for shown in data["gaits"]] == [point["value"] for point in points]
    assert [special["type"] for special in data["specials"]] == ["neimark_sacker", "end"]
    films = [shown["film"] for shown in data["gaits"]]  # which move with their own parameter
    assert [film["contacts"][0]["friction"] for film in films] == [0.15, 0.145, 0.14, 0.135, 0.16, 0.15, 0.14]


@pytest.mark.parametrize("name", sampled(["compass-passive-a", "compass-passive-two-step"]))
def test_two_hundred_points_stay_under_three_hundred_kilobytes(name):
    point = {"record": "point", "branch": 0, **gait(name).to_record()}
    many = [{**point, "index": k, "value": 0.1 + 1e-4 * k, **moved(point, 1 + 1e-4 * k)} for k in range(60)]
    some, more = (len(branch_report(gait(name).problem, "friction", many[:n]).encode()) for n in (20, 60))
    assert some + (more - some) * (200 - 20) / (60 - 20) < 300_000


def moved(point, factor):
    """States of a point and of its steps, each a little different, as along a branch."""
    state = {key: factor * value for key, value in point["state"].items()}
    steps = [{**step, "state": {k: factor * v for k, v in step["state"].items()}} for step in point.get("steps", ())]
    return {"state": state, **({"steps": steps} if steps else {})}


def test_a_name_cannot_smuggle_markup_into_a_page():
    ours = gait("compass-passive-a")
    hostile = replace(ours.problem, about="<b>bold</b>", text="# </pre><script>alert(1)</script>")
    page = comparison_report([replace(ours, problem=hostile)])
    assert "<b>bold" not in page
    assert "<script>alert" not in page


def test_the_height_of_a_foot_that_flies_has_its_unit():
    shown = labels([{"shape": ["shortening"]}], [], go.load_problem("slip-run"))
    assert [shown["units"][name] for name in ("shortening", "y", "dy", "x")] == ["m", "m", "m/s", "m"]


def test_walks_to_choose_from_start_where_they_say_and_end_as_they_do():
    shown = gait("compass-passive-a")
    starts = {f"{a}, {b}": {"dtheta1": a, "dtheta2": b} for a in (0.7, 0.71, 0.9) for b in (-0.52, -0.5)}
    walks = {label: go.simulate(shown, state, steps=3) for label, state in starts.items()}
    page = walks_page(shown, walks, "about", ("dtheta1", "dtheta2"))
    data = data_of(page)
    assert [walk["title"] for walk in data["walks"]] == [*starts]
    assert [walk["start"][0] for walk in data["walks"]] == [0.7, 0.7, 0.71, 0.71, 0.9, 0.9]
    assert [walk["ending"] for walk in data["walks"]] == [str(walk.trajectory.ending) for walk in walks.values()]
    assert data["plane"]["gait"] == pytest.approx(shown.state[[3, 4]], rel=1e-6)
    assert data["walks"][data["first"]]["ending"] == "completed"
    assert not {"frames", "phases"} & data["common"].keys()
    assert data_of(walks_page(shown, walks, "about"))["plane"] is None
