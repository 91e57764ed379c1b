"""The nonlinear program as its users have it: labels, bounds, quantities, solvers of CasADi, gaits."""

import copy
import pickle

import casadi as ca
import numpy as np
import pytest
from named import named
from samples import sampled

import gaitopt as go
from gaitopt import Mode
from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.modes import CONTACTS
from gaitopt.solver.newton import Solution

NAMES = [name for name in go.problem_names() if name not in ("rabbit-optimal", "rabbit-tracked")]
"""Open-loop torques are unknowns of another program, which a law that tracks them needs first."""
FEW = ("compass-passive-a", "compass-pd-impact-slip", "compass-torque-efficient", "kneed-passive", "slip-run-foot")
QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
MUTE_SQP = dict.fromkeys(("print_time", "print_header", "print_iteration", "print_status"), False) | {
    "qpsol": "qrqp", "qpsol_options": {"print_iter": False, "print_header": False},
}  # fmt: skip
SOLVERS = {
    "ipopt": QUIET,
    "ipopt with spral": {**QUIET, "ipopt.linear_solver": "spral"},
    "ipopt with secants": {**QUIET, "ipopt.hessian_approximation": "limited-memory"},
    "sqpmethod": MUTE_SQP,
    "fatrop": {"print_time": False, "fatrop.print_level": 0},
}


def solved(nlp, solver="ipopt", more=None):
    """The solution of a program, and the solver's word."""
    run = ca.nlpsol("solver", solver.partition(" ")[0], nlp.casadi() | (more or {}), SOLVERS[solver])
    end = run(**nlp.arguments())
    return np.asarray(end["x"]).ravel(), run.stats()["success"]


@pytest.mark.parametrize("name", sampled(NAMES, 5))
def test_every_unknown_and_constraint_has_bounds_and_a_label_with_its_place_and_unit(name):
    nlp = go.nlp(name)
    cycle, mesh = nlp.equations.mesh.cycle, nlp.equations.mesh
    for size, labels, numbers in (
        (nlp.x.numel(), nlp.x_labels, (nlp.lbx, nlp.ubx, nlp.x0, nlp.x_sizes)),
        (nlp.g.numel(), nlp.g_labels, (nlp.lbg, nlp.ubg, nlp.g_sizes)),
    ):
        assert len(labels) == size
        assert {values.size for values in numbers} == {size}
        assert (numbers[0] <= numbers[1]).all()
        for label in labels:
            assert label.unit
            assert label.phase is None or label.mode is cycle.phases[label.phase]
            assert label.node is None or 0 <= label.node < mesh.n_nodes
            assert 0 <= label.step < len(cycle.steps)
    assert len(nlp.p_labels) == nlp.p.numel() == nlp.p0.size
    units = {label.name: label.unit for label in nlp.x_labels}
    assert units["duration"] == "s"
    assert (units["x"], units["dx"]) == ("m", "m/s")
    equations = int((nlp.lbg == nlp.ubg).sum())
    if nlp.problem.free or nlp.problem.objective or nlp.equations.free:
        assert equations >= nlp.equations.w.numel() - len(nlp.equations.free)
    else:
        assert equations == nlp.x.numel()
        assert float(ca.Function("f", [nlp.x, nlp.p], [nlp.f])(nlp.x0, nlp.p0)) == 0.0


@pytest.mark.parametrize("name", FEW)
def test_expressions_are_the_equations_of_newton_which_are_computed_without_casadi(name):
    nlp = go.nlp(name)
    at = Solution(nlp.equations, nlp.x0[: nlp.equations.w.numel()], nlp.p0)
    rows = np.array([label.name == "defect" for label in nlp.g_labels])
    columns = slice(0, at.w.size)
    g = ca.Function("g", [nlp.x, nlp.p], [nlp.g, ca.jacobian(nlp.g, nlp.x)])
    values, jacobian = (np.asarray(ca.DM(out)) for out in g(nlp.x0, nlp.p0))
    np.testing.assert_allclose(values.ravel()[rows], at.residual[: rows.sum()], rtol=0, atol=1e-12)
    newton = np.array([at.jacobian @ axis for axis in np.eye(at.w.size)]).T[: rows.sum()]
    np.testing.assert_allclose(jacobian[rows, columns], newton, rtol=1e-9, atol=1e-9 * np.abs(newton).max())


@pytest.mark.parametrize("name", FEW)
def test_quantities_are_packed_again_and_expressions_have_the_same_values(name):
    nlp = go.nlp(name)
    quantities = nlp.unpack(nlp.x0)
    np.testing.assert_array_equal(nlp.pack(quantities), nlp.x0)
    assert {label.name for label in nlp.x_labels} == quantities.keys() - {"time"}
    np.testing.assert_allclose(quantities["time"], nlp.equations.mesh.node_times(quantities["duration"]), atol=1e-15)
    symbols = nlp.unpack(nlp.x)
    same = ca.Function("same", [nlp.x], [ca.vertcat(*(ca.vec(symbols[key]) for key in quantities))])
    np.testing.assert_allclose(np.asarray(same(nlp.x0)).ravel(), np.concatenate([*quantities.values()]), atol=1e-15)


def test_pack_replaces_what_is_given_and_refuses_other_names():
    nlp = go.nlp("compass-passive-a")
    changed = nlp.unpack(nlp.pack({"duration": [0.1, 0.2, 0.3]}))
    np.testing.assert_array_equal(changed["duration"], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(changed["theta1"], nlp.unpack(nlp.x0)["theta1"])
    with pytest.raises(UnknownNameError, match="no quantity of compass-passive-a is theta3; there are"):
        nlp.pack({"theta3": 0.0})
    for name, key, unit in (
        ("compass-pd-designed", "control.reference.theta1.1", "rad"),
        ("compass-torque-efficient", "control.hip", "N m"),
    ):
        assert {label.name: label.unit for label in go.nlp(name).x_labels}[key] == unit


@pytest.mark.parametrize("solver", sampled(SOLVERS, 3))
def test_solvers_of_casadi_find_the_gait_which_the_simulation_verifies(solver):
    if not ca.has_nlpsol(solver.partition(" ")[0]):
        pytest.skip(f"CasADi has no {solver} here")
    nlp = go.nlp("compass-passive-a")
    w, success = solved(nlp, solver)
    gait, known = nlp.gait(w), named("compass-passive-a")
    assert success
    assert gait.converged
    assert gait.solver["method"] == "external"
    np.testing.assert_allclose(gait.state, known.state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(nlp.unpack(w)["duration"], [d for _, d in known.phases], rtol=0, atol=1e-6)
    assert go.verify(gait).passed


def test_one_program_serves_other_parameters():
    nlp = go.nlp("compass-passive-a")
    p = nlp.p0.copy()
    p[nlp.p_labels.index("friction")] = 0.135
    run = ca.nlpsol("solver", "ipopt", nlp.casadi(), QUIET)
    gait = nlp.gait(run(**nlp.arguments() | {"p": p})["x"], p)
    assert gait.problem.parameters["friction"] == 0.135
    assert go.verify(gait).passed
    known = go.solve(nlp.problem.replace({"friction": 0.135}), progress=False)
    np.testing.assert_allclose(gait.state, known.state, rtol=0, atol=1e-11)


def lifted_foot(nlp, height):
    """The height of the swing foot at a node, and the solution of a program in which it is at least ``height``."""

    def foot(w):
        q = nlp.unpack(w)
        return nlp.problem.walker.leg_length * (ca.cos(q["theta1"][13]) - ca.cos(q["theta2"][13]))

    more = {"g": ca.vertcat(nlp.g, foot(nlp.x))}
    bounds = {"lbg": np.append(nlp.lbg, height), "ubg": np.append(nlp.ubg, np.inf)}
    secants = SOLVERS["ipopt with secants"]
    run = ca.nlpsol("solver", "ipopt", nlp.casadi() | more, secants | {"ipopt.constr_viol_tol": 1e-10})
    return foot, np.asarray(run(**nlp.arguments() | bounds)["x"]).ravel()


def test_a_constraint_of_ones_own_lifts_the_foot_at_the_expense_of_the_objective():
    nlp, height = go.nlp("compass-torque-efficient"), 0.0092
    foot, lifted = lifted_foot(nlp, height)
    _, least = lifted_foot(nlp, -np.inf)
    assert foot(least) < height
    assert foot(lifted) == pytest.approx(height, abs=1e-7)
    free, bound = nlp.gait(least), nlp.gait(lifted)
    assert bound.scalar("foot_clearance") >= height - 1e-7 > free.scalar("foot_clearance")
    assert bound.solver["objective"] > free.solver["objective"]
    assert free.solver["objective"] == pytest.approx(named("compass-torque-efficient").solver["objective"], rel=1e-6)
    assert go.verify(bound).passed


def test_points_that_are_no_gait_are_refused_in_words():
    nlp = go.nlp("compass-passive-a")
    start = nlp.gait(nlp.x0)
    assert start.status is go.Status.NOT_CONVERGED
    assert start.message == "not periodic: dtheta2 after the impact is off by 0.0369"
    w, _ = solved(nlp)
    moved = nlp.unpack(w)
    moved["dtheta1"][5] += 0.1
    assert "the motion does not close" in nlp.gait(nlp.pack(moved)).message
    assert not nlp.gait(np.full(w.size, np.nan)).converged
    with pytest.raises(ValueError, match=r"a point has 99 entries, not 98; x_labels names them"):
        nlp.gait(w[1:])
    with pytest.raises(ValueError, match=r"p has 1 entries instead of 7; p_labels names them"):
        nlp.gait(w, np.array([0.14]))
    design = go.nlp("compass-torque-efficient")
    slow = design.gait(design.x0)
    assert slow.message == "speed is 0.315998, must be at least 0.4"
    assert slow.causes[0].needed == pytest.approx(0.4)
    with pytest.raises(ProblemError, match="state the phases"):
        go.nlp(go.load_problem("compass-passive-a").replace({"gait.phases": "auto"}))


def test_margins_that_a_solver_was_not_told_of_are_checked():
    nlp = go.nlp(go.load_problem("compass-passive-stick").replace({"friction": 0.17}))
    run = ca.nlpsol("solver", "ipopt", nlp.casadi(), QUIET)
    free = np.where(nlp.lbg == nlp.ubg, nlp.lbg, -np.inf)
    gait = nlp.gait(run(**nlp.arguments() | {"lbg": free})["x"])
    assert gait.status is go.Status.INFEASIBLE
    assert "needs friction 0.17" in gait.message


def test_margins_of_the_program_state_the_complementarity_of_friction():
    nlp = go.nlp("compass-passive-a")
    names = {mode: {label.name for label in nlp.g_labels if label.mode is mode} for mode in CONTACTS}
    assert {"cone_forward", "cone_backward", "normal_force"} <= names[Mode.STICK]
    assert {"slip_velocity", "normal_force"} <= names[Mode.SLIP_BACKWARD]
    w, _ = solved(nlp)
    g = np.asarray(ca.Function("g", [nlp.x, nlp.p], [nlp.g])(w, nlp.p0)).ravel()
    cone = np.array([label.name.startswith("cone") for label in nlp.g_labels])
    slippery = nlp.p0.copy()
    slippery[nlp.p_labels.index("friction")] = 0.05
    less = np.asarray(ca.Function("g", [nlp.x, nlp.p], [nlp.g])(w, slippery)).ravel()
    assert (g[cone] >= -1e-7).all()
    assert (less[cone] < 0).any()


def test_picture_shows_every_nonzero_entry_by_phase():
    nlp = go.nlp("compass-passive-a")
    axes = nlp.plot()
    drawn = sum(line.get_xdata().size for line in axes.lines if line.get_marker() == "s")
    assert drawn == ca.jacobian_sparsity(nlp.g, nlp.x).nnz()
    words = [text.get_text() for text in (*axes.get_xticklabels(), *axes.get_yticklabels())]
    assert "nodes of phase 2\nstick" in words
    assert "margins, phase 3" in words
    assert "cone_forward" in nlp._repr_html_()
    assert repr(nlp) == "<NonlinearProgram compass-passive-a: 99 unknowns, 155 constraints, 16 nodes>"


@pytest.mark.slow
def test_a_switch_that_passes_a_breakpoint_of_the_control_is_refused_with_the_remedy():
    problem = go.load_problem("compass-pd-impact-slip").replace({"gait.guess.durations": [0.0204, 0.6]})
    nlp = go.nlp(problem)
    words = nlp.gait(solved(nlp)[0]).message
    assert "state gait.guess.durations: [0.02044, 0.649]" in words
    again = go.nlp(problem.replace({"gait.guess.durations": [0.02044, 0.649]}))
    assert again.gait(solved(again)[0]).converged


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_point_that_is_not_finite_is_named(value):
    nlp = go.nlp("compass-passive-a")
    point = nlp.x0.copy()
    point[[7, 9]] = value
    gait = nlp.gait(point)
    assert gait.status is go.Status.NOT_CONVERGED
    assert gait.message == f"the point is not finite: theta2 is {value} at node 1, and 1 more"
    assert nlp.gait(value).message == f"the point is not finite: it is {value}"
    assert nlp.gait([1.0, value]).message == f"the point is not finite: entry 1 is {value}"
    parameters = nlp.p0.copy()
    parameters[0] = value
    with pytest.raises(ValueError, match=r"p: walker\.leg_length is .*, which is not a finite number"):
        nlp.gait(nlp.x0, parameters)
    with pytest.raises(ValueError, match="a point is an array of numbers, not str"):
        nlp.gait("x0")


def test_a_program_is_not_pickled_and_says_what_is():
    nlp = go.nlp("rimless-wheel-stick")
    with pytest.raises(pickle.PicklingError, match=r"send its problem, nlp\.problem, and call gaitopt\.nlp there"):
        pickle.dumps(nlp)
    assert copy.deepcopy(nlp) is copy.copy(nlp) is nlp
