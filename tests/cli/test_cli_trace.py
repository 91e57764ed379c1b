"""``gaitopt trace``: what it prints, what it keeps, how it goes on, and what it refuses."""

import json
from pathlib import Path

import pytest

from gaitopt.runs.trace import TRACE_FILE
from gaitopt.store.files import read_lines

BRANCH = ("continue", "rimless-wheel-stick", "--param", "friction", "--to", "0.9", "-o", "branch", "--quiet")
TRACE = ("trace", "branch@special.0", "--param", "walker.slope", "--to", "12.8 deg", "-o", "trace", "--quiet")

pytestmark = pytest.mark.usefixtures("empty_folder")


def records(out):
    return [json.loads(line) for line in out.splitlines()]


def test_what_is_no_special_point_is_refused_before_anything_is_computed(run):
    code, _, err = run("trace", "rimless-wheel-stick", "--param", "walker.slope", "--to", "0.2")
    assert code == 2
    assert "write RUN@special.K" in err


@pytest.mark.slow
def test_json_is_one_record_per_line_the_same_on_the_disk_and_goes_on_with_more_points(run):
    assert run(*BRANCH)[0] == 0
    code, out, _ = run(*TRACE, "--json", "--max-points", "4")
    printed = records(out)
    assert code == 0
    assert printed == list(read_lines(Path("trace") / TRACE_FILE))[1:]
    *points, end = printed
    assert [point["index"] for point in points] == [0, 1, 2, 3]
    assert [*points[0]["values"]] == ["friction", "walker.slope"]
    assert points[0]["values"]["friction"] == pytest.approx(0.914120783896, abs=1e-9)
    assert points[0]["verification"]["passed"]
    assert (end["record"], end["type"], end["open"], end["codimension"]) == ("special", "end", True, 1)
    more = records(run(*TRACE, "--json", "--max-points", "6")[1])
    assert more[:4] == points
    assert len(more) == 7
    code, out, _ = run(*TRACE, "--max-points", "6")
    assert "friction from" in out
    assert "run: trace" in out
    code, _, err = run("trace", "trace@special.0", "--param", "walker.slope", "--to", "0.2")
    assert (code, "no other curve begins at a special point of type end" in err) == (3, True)
    code, _, err = run("trace", "branch@special.7", "--param", "walker.slope", "--to", "0.2")
    assert (code, "has no special point '7'" in err) == (2, True)
    code, _, err = run(*TRACE[:5], "0.3", *TRACE[6:])
    assert (code, "contains another trace" in err) == (6, True)
