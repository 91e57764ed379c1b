"""Atlases of named problems: curves and regions against closed forms and branches, resumption, refusals."""

from math import degrees, radians, tan

import numpy as np
import pytest

import gaitopt as go
from gaitopt.errors import StorageError
from gaitopt.gait.regions import NO_GAIT
from gaitopt.runs.atlas import ATLAS_JOBS, begun_curves, read_atlas, slice_job
from gaitopt.runs.grid import Axis

WHEEL = {"friction": (0.85, 1.0), "walker.slope": ("12.6 deg", "13.4 deg")}


def wheel(folder, **options) -> go.Atlas:
    return go.atlas(
        "rimless-wheel-stick", WHEEL, slices=3, refinements=0, workers=1, output=folder, progress=False, **options
    )


@pytest.mark.slow
def test_an_atlas_goes_on_after_an_interruption_and_is_read_back_as_it_was(tmp_path) -> None:
    whole = wheel(tmp_path / "whole")
    polls = iter(range(10**6))
    with pytest.raises(KeyboardInterrupt):
        wheel(tmp_path / "stopped", should_stop=lambda: next(polls) > 40)
    resumed = wheel(tmp_path / "stopped")
    assert resumed.to_record()["curves"] == whole.to_record()["curves"]
    assert read_atlas(resumed.folder).to_record() == resumed.to_record()
    (curve,) = whole.arrangement.curves
    at_13 = np.interp(radians(13), curve.points[:, 1], curve.points[:, 0])
    assert at_13 == pytest.approx(0.914120783896, abs=1e-6)  # the friction that the wheel needs to stick, closed form
    assert {region["verification"] is not None for region in (r["gait"] for r in whole.to_record()["regions"])} == {
        True
    }
    assert (resumed.folder / ATLAS_JOBS.name).is_file()
    assert len(whole.to_frame()) == len(whole.arrangement.regions) == 2
    axes = whole.plot()
    assert axes.get_xlim() == (0.85, 1.0)
    assert axes.get_ylim() == pytest.approx((12.6, 13.4))


@pytest.mark.slow
def test_the_wheel_has_no_gait_where_friction_is_below_the_tangent_of_the_slope(tmp_path) -> None:
    over = {"friction": (0.2, 0.5), "walker.slope": ("13 deg", "15 deg")}
    found = go.atlas("rimless-wheel-slip", over, slices=3, refinements=0, workers=1, output=tmp_path, progress=False)
    for each in found.slices:
        assert min(special["value"] for special in each.specials) == pytest.approx(tan(each.value), abs=1e-8)


@pytest.mark.slow
def test_the_atlas_of_the_compass_has_its_resonances_and_regions(tmp_path) -> None:
    over = {"friction": (0.08, 0.2), "walker.slope": ("0.5 deg", "2.5 deg")}
    found = go.atlas("compass-passive-a", over, slices=5, refinements=5, workers=1, output=tmp_path, progress=False)
    located = {
        point["type"]: (point["values"]["friction"], degrees(point["values"]["walker.slope"]))
        for point in found.to_record()["points"]
        if point["status"] == "converged"
    }
    assert located["resonance_1_4"] == pytest.approx((0.0930353699, 0.651308567), abs=1e-8)
    assert located["resonance_1_3"] == pytest.approx((0.1301103020, 1.598828734), abs=1e-8)
    assert located["resonance_1_2"] == pytest.approx((0.1450186084, 2.248926926), abs=1e-8)
    assert sum(region.area for region in found.arrangement.regions) == pytest.approx(found.area, rel=1e-3)
    (torus,) = [curve for curve in found.arrangement.curves if curve.type == "neimark_sacker"]
    at_1 = np.interp(radians(1), torus.points[:, 1], torus.points[:, 0])
    assert at_1 == pytest.approx(0.1103495808, abs=1e-4)


@pytest.mark.slow
def test_branches_are_added_until_curves_explain_their_differences(tmp_path) -> None:
    over = {"friction": (0.05, 0.08), "walker.slope": ("0.2 deg", "1 deg")}
    few, enough = (
        go.atlas("compass-passive-a", over, slices=3, refinements=n, workers=1, output=tmp_path, progress=False)
        for n in (0, 3)
    )
    assert degrees(few.unexplained[0][1]) == pytest.approx(0.6)
    assert not enough.unexplained
    short = min((c for c in enough.arrangement.curves if c.type == "period_doubling"), key=lambda c: c.points[-1, 1])
    ends = np.array([(0.05, 0.004065045317), (0.0593237022, 0.005704587)])  # of the trace from a branch at 0.32 deg
    assert short.points[[0, -1]] == pytest.approx(ends, abs=1e-9)


PLACES = {
    "compass-torque-stick": ({"friction": (0.12, 0.3), "control.ankle": (1.2, 2.0)}, 9, 4),
    "heel-toe": ({"friction": (0.24, 0.32), "walker.toe": (0.03, 0.05)}, 5, 4),
    "rabbit-hzd": ({"friction": (0.48, 0.62), "control.gains.kp": (60.0, 140.0)}, 3, 2),
}
"""Ranges and number of branches of the atlases of the documentation, and the number of their mode sequences."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PLACES)
def test_the_atlases_of_the_documentation_have_its_curves_and_verified_gaits(name, tmp_path) -> None:
    over, slices, sequences = PLACES[name]
    found = go.atlas(name, over, slices=slices, workers=1, output=tmp_path, progress=False)
    regions, points = (found.to_record()[key] for key in ("regions", "points"))
    assert not found.unexplained
    assert sum(region["area"] for region in regions) == pytest.approx(1, rel=1e-3)
    walked = [region for region in regions if region["modes"] != NO_GAIT]
    assert all(region["gait"]["verification"]["passed"] for region in walked)
    assert len({region["modes"] for region in walked}) == sequences
    if name == "compass-torque-stick":
        (crossing,) = (point for point in points if point["type"] == "margin_crossing")
        assert [*crossing["values"].values()] == pytest.approx((0.148600305, 1.78688005), abs=1e-8)
        assert {"period_doubling", "impact_change"} <= {curve.type for curve in found.arrangement.curves}
    elif name == "heel-toe":
        (strike,) = (curve for curve in found.arrangement.curves if curve.type == "impact_change")
        assert np.interp(0.04, strike.points[:, 1], strike.points[:, 0]) == pytest.approx(0.25873, abs=1e-4)
        assert {region["stable"] for region in walked if "heel slip_forward" in region["modes"]} == {True, False}
    else:
        (slips,) = found.arrangement.curves
        assert slips.points[:, 0] == pytest.approx(0.566667, abs=1e-6)
        assert all(region["stable"] for region in regions)


OLDER = {"job": "1", "value": 0.1, "segments": [], "specials": [{"type": "end", "value": 0.2, "status": "converged"}]}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ({"at": {}, "gait": None}, ":3 .*job: is missing"),
        ({"specials": 5}, ":3 .*specials"),
        (OLDER, "earlier version: delete it and repeat the command"),
    ],
)
def test_a_line_without_its_key_with_another_type_or_of_an_earlier_version_is_named(line, words, tmp_path) -> None:
    with pytest.raises(StorageError, match=words):
        ATLAS_JOBS.check(line, tmp_path / ATLAS_JOBS.name, 3)


@pytest.mark.slow
def test_a_branch_has_the_doubled_gaits_of_its_period_doublings() -> None:
    problem = go.load_problem("compass-passive-a")
    mass = problem.parameters["walker.hip_mass"]
    ranges = {"walker.slope": (0.03, 0.045), "walker.hip_mass": (mass, mass + 0.1)}
    first, second = (Axis(key=key, lower=low, upper=high, count=2) for key, (low, high) in ranges.items())
    branch = slice_job(problem, (first, second), mass, 400, 2, None)
    (doubled,) = branch["doubled"]
    (doubling,) = (special for special in branch["specials"] if special["type"] == "period_doubling")
    assert doubled["specials"][0] == doubling
    assert all(len(point["steps"]) == 2 for segment in doubled["segments"] for point in segment)
    assert not doubled["doubled"]


def test_every_curve_that_begins_at_a_codimension_two_point_is_traced_once() -> None:
    doubled, place = {"type": "margin", "gait": {"steps": [{}, {}]}}, {"friction": 0.1, "walker.slope": 0.03}
    flips = {
        "type": "margin_period_doubling",
        "values": place,
        "gait": {},
        "next": [{"type": "period_doubling"}, doubled],
    }
    margin = {"type": "impact_change", "steps": 1, "trace": [[0.1, 0.01], [0.1, 0.05]], "located": [flips]}

    def begun(traces: dict, most: int = 1) -> list[str]:
        curves = begun_curves(traces, np.array([0.3, 0.08]), most)
        return [special["next"][number]["type"] for special, number in curves]

    assert begun({"margin": margin}) == ["period_doubling"]
    assert begun({"margin": margin}, most=2) == ["period_doubling", "margin"]
    back = {**flips, "next": [{"type": "margin"}]}
    known = {"type": "period_doubling", "steps": 1, "trace": [[0.1, 0.03], [0.2, 0.05]], "located": [back]}
    assert begun({"margin": margin, "flips": known}) == []
    assert begun({"margin": margin, "flips": {**known, "steps": 2}}) == ["period_doubling"]
    assert begun({"margin": margin, "same": {**margin, "type": "fold"}}) == ["period_doubling"]
