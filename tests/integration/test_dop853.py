"""The compiled step of DOP853: that of scipy, step by step, and no step where there is none."""

import numpy as np
import pytest
from casadi import SX, Function, sin, vertcat
from scipy.integrate import DOP853

from gaitopt import integration as tableau
from gaitopt.integration import CompiledStep, Integration, StepSizeError

RTOL, ATOL = 1e-10, 1e-12


def field(*rates):
    """dy/dt of two states from their expressions."""
    return Function("rate", [T, Y, P, R], [vertcat(*rates)])


T, Y, P, R = SX.sym("t"), SX.sym("y", 2), SX.sym("p", 1), SX.sym("r", 0)
PENDULUM = field(Y[1], -P * sin(Y[0]) + sin(T))
START, STIFFNESS = np.array([1.0, 0.5]), np.array([4.0])


def integration(rate, bound, start=START):
    step = CompiledStep(rate, rate, rtol=RTOL, atol=ATOL)
    step.load(STIFFNESS, np.zeros(0))
    f = np.asarray(rate(0.0, start, STIFFNESS, [])).ravel()
    return Integration(step, 0.0, start, f, bound, 0.01)


def to_the_end(run):
    while not run.finished:
        run.advance()


@pytest.mark.portable
def test_every_step_is_that_of_scipy():
    ours = integration(PENDULUM, 7.0)
    theirs = DOP853(
        lambda t, y: np.asarray(PENDULUM(t, y, STIFFNESS, [])).ravel(), 0.0, START, 7.0, rtol=RTOL, atol=ATOL,
        first_step=0.01,
    )  # fmt: skip
    while not ours.finished:
        ours.advance()
        theirs.step()
        assert ours.t == pytest.approx(theirs.t, rel=1e-5)  # an error estimate at rounding level decides the length
        assert ours.length == pytest.approx(theirs.step_size, rel=1e-4)
    assert theirs.status == "finished"
    np.testing.assert_allclose(ours.y, theirs.y, rtol=0, atol=1e-11)


def test_motion_that_runs_away_has_no_step():
    run = integration(field(Y[0] ** 2, Y[1]), 10.0)
    with pytest.raises(StepSizeError, match="singular"):
        to_the_end(run)
    assert run.t == pytest.approx(1.0, abs=1e-6)


def test_equations_that_are_not_finite_have_no_step():
    with pytest.raises(StepSizeError):
        integration(field(Y[0] ** 0.5, Y[1]), 1.0, np.array([-1.0, 0.0])).advance()


@pytest.mark.parametrize("name", ["A", "B", "C", "E5", "E3", "A_INSIDE", "C_INSIDE", "D"])
def test_coefficients_are_those_that_scipy_publishes(name):
    assert np.array_equal(getattr(tableau, name), getattr(DOP853, name.replace("INSIDE", "EXTRA")))
