"""Directional derivatives of the equations of a gait, against differences of their exact Jacobian."""

import numpy as np
import pytest
from named import named

from gaitopt.solver.assembly import solution_of
from gaitopt.solver.jets import Jets, second_derivatives

STEP = 1e-6


@pytest.fixture(scope="module", params=["compass-passive-a", pytest.param("heel-toe", marks=pytest.mark.slow)])
def at(request):
    return solution_of(named(request.param), ("friction", "walker.slope"))


def directions(at, count):
    random = np.random.default_rng(1).standard_normal((count, at.w.size))
    return random * at.units.unknowns


def series(at, *coefficients):
    start = np.broadcast_to(at.w, coefficients[0].shape)
    return Jets(at.equations, at.p, np.stack([start, *coefficients])).equalities()


def difference(function, at, along):
    """Central difference of a function of the unknowns."""
    return (function(at.w + STEP * along) - function(at.w - STEP * along)) / (2 * STEP)


def test_values_and_first_derivatives_are_those_of_the_equations(at):
    a = directions(at, 2)
    values, slopes = series(at, a)
    assert values[0] == pytest.approx(at.residual, abs=1e-13)
    expected = np.array([at.jacobian @ each for each in a])
    assert slopes == pytest.approx(expected, rel=1e-12, abs=1e-12 * np.abs(expected).max())


def test_second_derivatives_are_those_of_the_jacobian(at):
    a, b = directions(at, 2)
    (mixed,) = second_derivatives(at.equations, at.w, at.p, a[None], b[None])
    expected = difference(lambda w: at.equations.linearised(w, at.p)[1] @ a, at, b)
    assert np.abs(mixed - expected).max() < 1e-7 * np.abs(expected).max()


def test_third_coefficients_are_a_sixth_of_the_third_derivatives(at):
    (a,) = directions(at, 1)
    third = series(at, a[None], np.zeros((1, a.size)), np.zeros((1, a.size)))[3, 0]
    expected = difference(lambda w: second_derivatives(at.equations, w, at.p, a[None], a[None])[0], at, a) / 6
    assert np.abs(third - expected).max() < 1e-7 * np.abs(expected).max()
