"""A gait survives the way to disk and back, and a table of motion says what the motion was."""

import csv
import re
from contextlib import suppress
from itertools import product

import numpy as np
import pytest
from named import named
from samples import sampled

from gaitopt import load_run, simulate, verify
from gaitopt.errors import StorageError
from gaitopt.gait.gait import trajectory_rows
from gaitopt.runs.results import restore_gait, write_result
from gaitopt.store.run import Run


@pytest.fixture(scope="module", params=["compass-passive-a", "compass-pd-impact-slip"])
def gait(request):
    return named(request.param)


@pytest.fixture(scope="module")
def restored(gait, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "run"
    write_result(gait, Run(folder))
    return restore_gait(folder)


def test_a_restored_gait_has_the_same_problem_the_same_arcs_to_the_last_digit_and_passes_verification(gait, restored):
    for ours, theirs in zip(gait.arcs, restored.arcs, strict=True):
        assert (ours.mode, ours.segment) == (theirs.mode, theirs.segment)
        np.testing.assert_array_equal(ours.times, theirs.times)
        np.testing.assert_array_equal(ours.states, theirs.states)
    np.testing.assert_array_equal(gait.multipliers, restored.multipliers)
    known, undefined = ({k: v for k, v in gait.measures.items() if (v is None) is none} for none in (False, True))
    assert {name: restored.measures[name] for name in known} == pytest.approx(known, rel=1e-12)
    assert {name: restored.measures[name] for name in undefined} == undefined
    assert verify(restored).passed
    assert (restored.problem.digest, restored.problem.text) == (gait.problem.digest, gait.problem.text)


def test_time_runs_on_over_the_steps_of_a_walk(gait):
    walk = simulate(gait, steps=3)
    times = np.array([row[0] for row in trajectory_rows(walk.trajectory.steps)])
    assert (np.diff(times) > -1e-14).all()
    assert times[-1] == pytest.approx(3 * gait.measures["period"], abs=1e-8)


def spoil(folder, name, column, change):
    """Change the second row of a table in one column, and enter its checksum."""
    with (folder / name).open(newline="") as file:
        header, *rows = csv.reader(file)
    k = header.index(column)
    rows[1][k] = change(rows[1][k])
    with (folder / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    Run(folder).seal(name)


@pytest.mark.parametrize(
    ("name", "file"), sampled(product(["compass-pd-impact-slip", "heel-toe"], ["trajectory.csv", "walk.csv"]), 3)
)
def test_a_wrong_number_in_any_column_of_a_table_is_detected(name, file, tmp_path):
    """The reader refuses wrong times, modes, forces and torques; the simulation of a gait finds wrong states."""
    result = named(name) if file == "trajectory.csv" else simulate(named(name))
    states = result.system.state_names
    write_result(result, Run(tmp_path / "run"))
    whole, frame = (tmp_path / "run" / file).read_text(), result.to_frame()
    for column in (column for column in frame if column not in states or file == "trajectory.csv"):
        (tmp_path / "run" / file).write_text(whole)
        if column == "mode":
            spoil(tmp_path / "run", file, column, lambda text: text.replace("off", "stick").replace("slip", "flip"))
        else:
            error = 1e-5 * float(frame[column].abs().max() or 1.0)
            spoil(tmp_path / "run", file, column, lambda text, error=error: repr(float(text) + error))
        if column not in states:
            with pytest.raises(StorageError, match=rf"{re.escape(file)}:3 "):
                load_run(tmp_path / "run")
        else:
            with suppress(StorageError):
                assert not verify(load_run(tmp_path / "run")).passed


def test_a_table_with_exchanged_columns_or_without_rows_is_refused(tmp_path):
    folder = tmp_path / "run"
    write_result(named("compass-pd-impact-slip"), Run(folder))
    path = folder / "trajectory.csv"
    text = path.read_text()
    for spoiled, words in (
        (text.replace("f_t,f_n", "f_n,f_t"), r"trajectory\.csv:1 has columns .* f_n, f_t"),
        (f"{text.splitlines()[0]}\n", "does not contain a gait"),
    ):
        path.write_text(spoiled)
        Run(folder).seal(path.name)
        with pytest.raises(StorageError, match=words):
            load_run(folder)
