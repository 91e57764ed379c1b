"""Sweeps: every point solved and verified once, whatever happens in between, and said in a table."""

import csv
import json
import math
from pathlib import Path

import pytest

from gaitopt import load_problem, load_run
from gaitopt.cli.main import main
from gaitopt.errors import StorageError
from gaitopt.requests import Method
from gaitopt.runs import sweep as runs_sweep
from gaitopt.runs.grid import Axis, Grid, axis_of, check_room
from gaitopt.runs.jobs import SOLVED
from gaitopt.runs.sweep import TABLE_FILE, SweepPlan
from gaitopt.store.files import read_lines
from gaitopt.store.run import Run
from gaitopt.workers import jobs as workers
from gaitopt.workers.jobs import FailedJob, Workers

HERE = Workers(count=1)
FRICTIONS = Axis(key="friction", lower=0.36, upper=0.44, count=3)


def wheel_sweep(folder, *axes, **how):
    return SweepPlan(problem=load_problem("rimless-wheel-slip"), grid=Grid(axes or (FRICTIONS,)), folder=folder, **how)


def table(sweep):
    with (sweep.run.path(TABLE_FILE)).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_point_is_solved_and_verified(tmp_path, run):
    sweep = wheel_sweep(tmp_path)
    records = sweep.complete(HERE).records
    assert [record["friction"] for record in records] == [0.36, 0.4, 0.44]
    assert {record["status"] for record in records} == {"converged"}
    assert all(record["verification"]["passed"] for record in records)
    rows = table(sweep)
    assert [float(row["friction"]) for row in rows] == [0.36, 0.4, 0.44]
    assert [float(row["period"]) for row in rows] == [record["period"] for record in records]
    assert {row["modes"] for row in rows} == {"stick slip_forward / stick"}
    code, _, err = run("plot", str(tmp_path))
    assert code == 6
    assert f"give the folder of its result: {sweep.run.result_folder}" in err


def test_what_is_done_is_not_done_again_not_even_by_another_sweep(tmp_path, monkeypatch):
    wheel_sweep(tmp_path).complete(HERE)
    solved = []
    monkeypatch.setattr(
        runs_sweep, "sweep_job", lambda problem, parent=None, **_: solved.append(problem.friction) or {"status": "x"}
    )
    wheel_sweep(tmp_path).complete(HERE)
    assert solved == []
    wheel_sweep(tmp_path, Axis(key="friction", lower=0.36, upper=0.44, count=5)).complete(HERE)
    assert sorted(solved) == pytest.approx([0.38, 0.42])


def test_spokes_are_counted_in_integers(tmp_path):
    spokes = Axis(key="walker.spokes", lower=9, upper=10, count=2)
    records = wheel_sweep(tmp_path, spokes).complete(HERE).records
    assert [record["at"]["walker.spokes"] for record in records] == [9, 10]
    assert records[1]["state"]["theta"] == pytest.approx(-math.pi / 10)


def test_a_killed_sweep_is_unfinished_and_resumes_where_it_stopped(tmp_path, monkeypatch):
    sweep = wheel_sweep(tmp_path)
    done = []
    with pytest.raises(KeyboardInterrupt):
        sweep.complete(HERE, progress=lambda k, n: done.append(k), should_stop=lambda: len(done) == 2)
    with pytest.raises(StorageError, match=r"sweep\.json: missing"):
        load_run(sweep.run.result_folder)
    jobs = tmp_path / SOLVED.name
    with jobs.open("a", encoding="utf-8") as file:
        file.write('{"job": "torn')  # killed in the middle of a line
    whole = wheel_sweep(tmp_path).complete(HERE).records
    assert len(list(read_lines(jobs))) == 3
    afresh = wheel_sweep(tmp_path / "afresh").complete(HERE).records
    assert (sweep.run.path(TABLE_FILE)).read_text() == (
        tmp_path / "afresh" / sweep.run.subfolder / TABLE_FILE
    ).read_text()
    assert [r["state"] for r in whole] == [r["state"] for r in afresh]


def test_warm_and_cold_starts_find_the_same_gaits(tmp_path):
    warm, cold = (wheel_sweep(tmp_path / str(w), warm=w).complete(HERE).records for w in (True, False))
    assert [record["start"] for record in warm] == ["cold", "warm", "warm"]
    assert {record["start"] for record in cold} == {"cold"}
    for first, second in zip(warm, cold, strict=True):
        assert first["period"] == pytest.approx(second["period"], abs=1e-10)


@pytest.mark.parametrize("warm", [False, True])
def test_a_resumed_sweep_has_gaits_of_its_own_method_alone(tmp_path, warm):
    def methods(method):
        plan = wheel_sweep(tmp_path, Axis(key="friction", lower=0.4, upper=0.44, count=2), warm=warm, method=method)
        return plan.run.subfolder, {record["solver"]["method"] for record in plan.complete(HERE).records}

    parts, found = zip(*(methods(method) for method in (Method.AUTO, Method.NEWTON, Method.IPOPT)), strict=True)
    assert len(set(parts)) == 3
    assert found == ({"newton"}, {"newton"}, {"ipopt"})
    assert len(list(read_lines(tmp_path / SOLVED.name))) == 6


def test_neighbour_is_prescribed_by_the_grid_alone(tmp_path):
    sweep = wheel_sweep(tmp_path, FRICTIONS, Axis(key="walker.slope", lower=0.22, upper=0.24, count=2), warm=True)
    keys = [job.key for job in sweep.jobs]
    assert [keys.index(job.parent) if job.parent else None for job in sweep.jobs] == [None, 0, 0, 1, 2, 3]


def test_point_without_a_gait_is_a_row_of_the_table_and_done_too(tmp_path):
    frictions = Axis(key="friction", lower=0.05, upper=0.4, count=2)
    sweep = wheel_sweep(tmp_path, frictions)
    records = sweep.complete(HERE).records
    assert [record["status"] for record in records] == ["infeasible", "converged"]
    assert table(sweep)[0]["period"] == ""
    assert wheel_sweep(tmp_path, frictions).complete(HERE).records == records


def test_job_that_is_set_aside_is_named_and_tried_again_next_time(tmp_path, monkeypatch):
    sweep = wheel_sweep(tmp_path)
    monkeypatch.setattr(
        workers, "run_jobs", lambda task, jobs, *_, **__: ((j.key, FailedJob(reason="dead")) for j in jobs)
    )
    record = sweep.complete(HERE).to_record()
    assert record["statuses"] == {"set_aside": 3}
    assert record["set_aside"][0] == {"at": {"friction": 0.36}, "reason": "dead"}
    monkeypatch.undo()
    assert {r["status"] for r in sweep.complete(HERE).records} == {"converged"}


@pytest.mark.parametrize(("points", "words"), [(10**6, "1,000,000 points need about 6.0 PB"), (10**300, "000.0 YB")])
def test_grid_that_does_not_fit_is_refused_with_its_size(tmp_path, points, words):
    with pytest.raises(StorageError, match=rf"{words} on disk, but .*B are free: choose fewer"):
        check_room(points, tmp_path, disk=6 * 10**9, memory=1)


SWEEP = ("sweep", "rimless-wheel-slip", "--over")


def test_angles_of_a_range_take_degrees():
    axis = axis_of("walker.slope", "0.5deg", "2 deg", 7)
    assert (axis.lower, axis.upper, axis.count) == (pytest.approx(0.00872664626), pytest.approx(0.034906585), 7)


def test_finished_sweep_is_drawn_again_from_its_folder_unless_it_is_broken(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    grid = ("friction=0.38:0.4:2", "--over", "walker.slope=13deg:13.1deg:2")
    assert main([*SWEEP, *grid, "--workers", "1", "--json", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    drawn = [(tmp_path / figure).read_bytes() for figure in record["figures"]]
    assert main(["plot", record["run"], "-o", "again"]) == 0
    assert [(tmp_path / "again" / figure.rpartition("/")[2]).read_bytes() for figure in record["figures"]] == drawn
    assert main(["plot", record["run"], "--what", "speed", "--format", "pdf"]) == 0
    assert (tmp_path / record["run"] / "speed.pdf").read_bytes().startswith(b"%PDF")
    assert main(["plot", record["run"], "--what", "friction"]) == 2
    assert "choose from period" in capsys.readouterr().err
    lines = (tmp_path / record["table"]).read_text().splitlines()
    (tmp_path / record["table"]).write_text("\n".join(lines[:-1]) + "\n")
    Run.at(Path(record["run"])).seal(TABLE_FILE)
    assert main(["plot", record["run"]]) == 6
    assert "has 3 rows for 4 points" in capsys.readouterr().err
