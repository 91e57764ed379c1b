"""Scans of the return map: what they rule out, no other method finds."""

import numpy as np
import pytest

import gaitopt as go
from gaitopt.runs.grid import Axis, Grid
from gaitopt.runs.sweep import SweepPlan
from gaitopt.search.scan import _crossings, _may_vanish, possible_gaits, scanned
from gaitopt.search.solve import solve
from gaitopt.workers.jobs import Workers


def test_a_defect_may_vanish_next_to_its_zeros_and_folds_and_nowhere_else():
    x = np.linspace(-1, 1, 41)
    for defect in (x - 0.013, (x - 0.013) ** 2, np.where(x < 0.5, x - 0.51, np.nan)):
        assert _may_vanish(defect[:, None]).any()
    for defect in (x + 3, 0.1 + (x - 0.013) ** 2, np.where(x < 0.5, x - 1, np.nan), np.full_like(x, np.nan)):
        assert not _may_vanish(defect[:, None]).any()
    alone = np.where(np.arange(41) == 7, 5.0, np.nan)
    assert _may_vanish(alone[:, None]).any()  # nothing says how it varies


def test_a_plane_defect_vanishes_where_both_of_its_parts_do():
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), indexing="ij")
    assert _may_vanish(np.stack([x - 0.2, y + 0.3], axis=-1)).any()
    assert not _may_vanish(np.stack([x - 0.2, 3 + y], axis=-1)).any()


def test_crossings_are_interpolated():
    x = np.linspace(0, 1, 5)
    assert list(_crossings(x, x - 0.3)) == pytest.approx([0.3])


def test_the_gait_of_the_wheel_is_among_what_the_scan_finds():
    """The wheel has one gait on 13 deg, and none at a friction that does not hold it."""
    problem = go.load_problem("rimless-wheel-stick")
    assert scanned(problem)
    possible, starts = possible_gaits(problem)
    assert possible
    rate = solve(problem).to_record()["state"]["dtheta"]
    assert min(abs(start["dtheta"] - rate) for start in starts) < 0.02
    assert not scanned(go.load_problem("compass-passive-a"))  # a section of three coordinates
    assert not scanned(go.load_problem("slip-run").replace({"gait.phases": "auto"}))


def runner_sweep(folder, attacks, stiffnesses):
    grid = Grid(
        (
            Axis(key="walker.attack", lower=np.radians(58), upper=np.radians(78), count=attacks),
            Axis(key="walker.stiffness", lower=8, upper=40, count=stiffnesses),
        )
    )
    return SweepPlan(problem=go.load_problem("slip-run"), grid=grid, folder=folder)


@pytest.mark.slow
def test_no_place_is_reported_empty_at_which_solve_finds_a_gait(tmp_path):
    """The gaits of the runner fill a narrow band over its angle of attack and its stiffness."""
    plan = runner_sweep(tmp_path, 21, 9)
    swept = plan.complete(Workers(count=1))
    missed = list[dict[str, float]]()
    for record, job in zip(swept.records, plan.jobs, strict=True):
        for problem in (job.argument, job.argument.from_guess()):
            if record["status"] != "converged" and solve(problem).converged:
                missed.append(record["at"])
    assert not missed
    found = [record for record in swept.records if record["status"] == "converged"]
    assert all(record["verification"]["passed"] for record in found)
    assert any(record["start"] == "scan" for record in swept.records if record["status"] != "converged")


def test_a_sweep_counts_the_gaits_of_a_place(tmp_path):
    """At 68 deg and a stiffness of 20 the runner has a stable and an unstable gait of the same energy."""
    swept = go.sweep("slip-run", {"walker.attack": ("68deg", "69deg", 2)}, workers=1, output=tmp_path, progress=False)
    assert swept.records[0]["gaits"] == 2
    assert swept.to_record()["several"] >= 1
    problem = go.load_problem("slip-run")
    _, starts = possible_gaits(problem)
    guesses = [problem.replace({"walker.attack": "68deg", "gait.guess.state.dtheta": s["dtheta"]}) for s in starts]
    rates = [solve(guess).to_record()["state"]["dtheta"] for guess in guesses]
    assert len(rates) == 2
    assert np.ptp(rates) > 0.01
    assert go.load_run(swept.folder).records[0]["gaits"] == 2


def test_a_closer_look_rules_out_what_nearly_has_a_gait_and_separates_two_gaits():
    """On either side of the fold of the runner's gaits the defect is small along a large part of the section."""
    place = go.load_problem("slip-run").replace({"walker.stiffness": 19.43})
    assert possible_gaits(place.replace({"walker.attack": "67.3deg"})) == (False, [])
    possible, starts = possible_gaits(place.replace({"walker.attack": "67.375deg"}))
    assert possible
    assert len(starts) == 2
