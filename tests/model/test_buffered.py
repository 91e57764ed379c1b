"""Functions called through buffers give what CasADi's functions give."""

import numpy as np
from casadi import SX, Function, vertcat
from foot_impacts import foot_impact

from gaitopt import Mode, load_problem
from gaitopt.model.buffered import WIDTH, BufferedFunction, RowMap
from gaitopt.systems import build_system


def test_a_buffered_function_gives_what_the_function_gives() -> None:
    x, y = SX.sym("x", 2), SX.sym("y")
    function = Function("f", [x, y], [vertcat(x[0] * y, SX(1, 1), x[1]), x.T @ x])
    assert function.nnz_out(0) < function.numel_out(0)
    first, second = BufferedFunction(function)([2.0, 3.0], 5.0)
    assert first.tolist() == [10.0, 0.0, 3.0]
    assert second.tolist() == [13.0]


def test_rowwise_function_is_that_of_every_row():
    system = build_system(load_problem("compass-passive-a"))
    rng = np.random.default_rng(0)
    problem = load_problem("compass-passive-a")
    p = system.values(problem.parameters)
    states = rng.uniform(-0.3, 0.3, (WIDTH + 3, system.n_z))
    function = foot_impact(system, Mode.STICK)
    (after, *_) = RowMap(function)(states, p)
    for row, found in zip(states, after, strict=True):
        np.testing.assert_array_equal(found, np.asarray(function(row, p)[0]).ravel())
