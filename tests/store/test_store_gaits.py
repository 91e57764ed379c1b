"""A gait survives the way to disk and back, and a table of motion says what the motion was."""

import numpy as np
import pytest
from named import named

from gaitopt import simulate, verify
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


def test_arcs_come_back_to_the_last_digit(gait, restored):
    for ours, theirs in zip(gait.arcs, restored.arcs, strict=True):
        assert (ours.mode, ours.segment) == (theirs.mode, theirs.segment)
        np.testing.assert_array_equal(ours.times, theirs.times)
        np.testing.assert_array_equal(ours.states, theirs.states)
    np.testing.assert_array_equal(gait.multipliers, restored.multipliers)
    known, undefined = ({k: v for k, v in gait.measures.items() if (v is None) is none} for none in (False, True))
    assert {name: restored.measures[name] for name in known} == pytest.approx(known, rel=1e-12)
    assert {name: restored.measures[name] for name in undefined} == undefined


def test_a_restored_gait_passes_the_same_verification(restored):
    assert verify(restored).passed


def test_the_problem_of_a_restored_gait_is_the_same(gait, restored):
    assert restored.problem.digest == gait.problem.digest
    assert restored.problem.text == gait.problem.text


def test_time_runs_on_over_the_steps_of_a_walk(gait):
    walk = simulate(gait, steps=3)
    times = np.array([row[0] for row in trajectory_rows(walk.trajectory.steps)])
    assert (np.diff(times) > -1e-14).all()
    assert times[-1] == pytest.approx(3 * gait.measures["period"], abs=1e-8)
