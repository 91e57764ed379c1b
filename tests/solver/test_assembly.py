"""The way from a solution to its gait and back: arcs that join, exact rest, impacts that lead on, the same unknowns."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from named import named
from samples import sampled

from gaitopt.gait import curves
from gaitopt.solver.assembly import assemble_steps, solution_of

GAITS = ("compass-passive-a", "compass-pd-impact-slip", "compass-passive-two-step", "compass-unequal", "kneed-passive")


@pytest.mark.parametrize("free", [(), ("friction",)])
@pytest.mark.parametrize("name", sampled(GAITS, 3))
def test_unknowns_of_a_gait_solve_its_equations_on_its_own_mesh(name, free):
    gait = named(name)
    solution = solution_of(gait, free)
    assert solution.size < 1e-13
    assert tuple(arc.intervals for arc in solution.equations.mesh.arcs) == gait.shooting.intervals
    assert solution.equations.unpack(solution.w).freed.tolist() == [gait.dynamics.parameter(key) for key in free]


@pytest.mark.parametrize("name", sampled(GAITS, 3))
def test_every_row_of_the_equalities_names_what_it_compares(name):
    solution = solution_of(named(name))
    equations, residual, labels = solution.equations, solution.residual, solution.equations.equality_labels
    assert len(labels) == residual.size == equations.equalities.numel()
    for row in np.linspace(0, len(labels) - 1, 25).astype(int):
        label, (nodes, durations, _) = labels[row], equations.unpack(solution.w.copy())
        if label.coordinate:  # a defect or a reset is this node minus what leads to it
            nodes[equations.system.state_names.index(label.coordinate), label.node] += 1e-3
            moved = equations.violation(equations.pack(nodes, durations), solution.p)
            assert moved[row] - residual[row] == pytest.approx(1e-3, rel=1e-9)
    guards = [label.name for label in labels if not label.coordinate]
    table, cycle = equations.system.transitions, equations.mesh.cycle
    assert guards == [table.between(mode, cycle.after(k)).guard for k, mode in enumerate(cycle.phases)]


def test_unknowns_of_a_gait_without_nodes_are_refused():
    with pytest.raises(ValueError, match=r"compass-passive-a: .* solve it again"):
        solution_of(replace(named("compass-passive-a"), shooting=None))


@pytest.mark.parametrize("name", sampled(GAITS, 3))
def test_arcs_and_steps_follow_each_other_without_a_gap_and_a_foot_at_rest_has_no_slip_velocity_at_all(name):
    gait = named(name)
    for step, after in zip(gait.steps, (*gait.steps[1:], gait.steps[0]), strict=True):
        assert step.arcs[0].start == 0
        np.testing.assert_allclose(step.final_impact.state, after.arcs[0].states[0], rtol=0, atol=1e-11)
        for arc, following in pairwise(step.arcs):
            assert following.start == arc.end
            if arc.mode.locked == following.mode.locked:  # nothing jumps
                np.testing.assert_allclose(following.states[0], arc.states[-1], rtol=0, atol=1e-12)
    for step, first in zip(gait.steps, gait.problem.cycle.first_phases, strict=True):
        for arc, phase in zip(step.arcs, step.arc_phases, strict=True):
            if arc.mode.sticks:
                assert not arc.states[:, -1].any()
            elif gait.problem.cycle.onset_order(first + phase) and arc.start == step.arcs[0].start:
                assert arc.states[0, -1] == 0


def test_an_arc_that_few_points_do_not_resolve_gets_more():
    solution = solution_of(named("compass-passive-a"))
    coarse, fine = assemble_steps(solution, (5,)), assemble_steps(solution, (5, *curves.COUNTS))
    assert {arc.times.size for arc in coarse[0].arcs} == {5}
    assert min(arc.times.size for arc in fine[0].arcs) >= curves.COUNTS[0]
