"""Gaits as data: statuses, phases across breakpoints, and multipliers that are told apart and paired."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from named import named

import gaitopt as go
from gaitopt import Mode
from gaitopt.errors import SolveError
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.gait.trajectory import Arc, Step


def arc(mode: Mode, start: float, end: float, segment: int = 0) -> Arc:
    dynamics = named("rimless-wheel-stick").dynamics
    times, states = np.array([start, end]), np.zeros((2, dynamics.system.n_z))
    return Arc(dynamics=dynamics, mode=mode, segment=segment, times=times, states=states)


def test_arcs_of_one_mode_across_a_breakpoint_are_one_phase() -> None:
    arcs = (arc(Mode.SLIP_FORWARD, 0, 0.1), arc(Mode.STICK, 0.1, 0.3), arc(Mode.STICK, 0.3, 0.6, segment=1))
    step = Step(arcs=arcs, impact=None)
    assert step.phases == ((Mode.SLIP_FORWARD, 0.1), (Mode.STICK, pytest.approx(0.5)))
    assert step.period == 0.6


def test_only_a_converged_gait_may_be_trusted() -> None:
    gait = named("rimless-wheel-stick")
    assert gait.converged
    assert gait.status is go.Status.CONVERGED
    for status in set(go.Status) - {go.Status.CONVERGED}:
        failed = replace(gait, status=status, steps=())
        assert not failed.converged
        with pytest.raises(SolveError, match=f"rimless-wheel-stick is {status}, so there is no motion"):
            _ = failed.state


def test_verification_is_kept_with_the_gait() -> None:
    gait = named("rimless-wheel-stick")
    assert gait.to_record()["verification"] is None
    record = go.verify(gait).to_record()
    assert gait.verified(record).to_record()["verification"] == record


def test_multipliers_come_largest_first_and_pairs_in_one_order() -> None:
    blocks = np.array([[0.1, 0, 0, 0], [0, 0, -0.8, 0], [0, 0.8, 0, 0], [0, 0, 0, -2.0]])
    assert floquet_multipliers(blocks) == pytest.approx([-2.0, 0.8j, -0.8j, 0.1], abs=1e-14)
    first, second = np.array([1.0, 0.5, 0.5j]), np.array([0.5j, 1.0, 0.6])
    assert multiplier_distance(first, second) == pytest.approx(0.1)  # of the worst pair


matrices = st.lists(st.floats(-3, 3), min_size=9, max_size=9).map(lambda entries: np.reshape(entries, (3, 3)))


@given(matrices, st.permutations([0, 1, 2]))
def test_distance_of_multipliers_does_not_depend_on_their_order(matrix, order) -> None:
    values = floquet_multipliers(matrix)
    assert multiplier_distance(values, values[list(order)]) == 0
    assert np.all(np.diff(np.abs(values)) < 1e-9)


def test_arrays_of_results_cannot_be_written_to_but_those_they_came_from_can() -> None:
    gait = named("rimless-wheel-stick")
    walk = go.simulate(gait, steps=1)
    own = gait.arcs[0].states
    for values in (own, gait.p, gait.multipliers, gait.shooting.states, gait.steps[0].impact.state, walk.p):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0
    times = np.array([0.0, 1.0])
    assert not replace(gait.arcs[0], times=times).times.flags.writeable
    times[0] = 0.5
    assert times.flags.writeable
