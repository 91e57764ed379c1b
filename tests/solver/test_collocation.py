"""Direct collocation: polynomials of its intervals, one program for problems that differ in numbers, shared systems."""

import casadi as ca
import numpy as np
import pytest

import gaitopt as go
from gaitopt import Mode
from gaitopt.problem.scalars import SCALARS, Instant
from gaitopt.solver.collocation import Collocation
from gaitopt.solver.collocation_mesh import basis
from gaitopt.systems import build_system

STEP = """
name: compass-step
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 0}
friction: 0.3
control: {type: open_loop, intervals: 2, order: linear}
gait:
  phases: [stick]
  impact: stick
  guess: {step_length: 0.3, duration: 0.7}
objective: torque_squared
constraints: {speed: 0.4}
"""
DURATIONS = np.array([0.7])
KNOWN = STEP.replace("order: linear", "order: linear, duration: SECONDS, ankle: [0.1, 0.2, 0.3], hip: [0.1, 0, 0.1]")
KNOWN = KNOWN.partition("objective")[0]


def known(duration):
    return go.parse_problem(KNOWN.replace("SECONDS", str(duration)))


def collocation(**changes):
    problem = go.parse_problem(STEP).replace(changes)
    return Collocation(problem, build_system(problem), DURATIONS, free={})


def test_polynomials_of_an_interval_reproduce_those_of_their_degree():
    fractions, tau = np.linspace(-0.1, 1.1, 7), np.array([0.0, *ca.collocation_points(5, "radau")])
    coefficients = np.random.default_rng(0).standard_normal(6)
    values = basis(5, fractions) @ np.polyval(coefficients, tau)
    np.testing.assert_allclose(values, np.polyval(coefficients, fractions), rtol=1e-12, atol=1e-12)


def test_problems_that_differ_in_numbers_alone_have_one_program_and_their_own_bounds():
    one, other = collocation(), collocation(**{"constraints.speed": 0.45, "friction": 0.4})
    assert one.program is other.program
    row = one.row_names.index("speed")
    assert (one.lbg[row], other.lbg[row], other.ubg[row]) == (0.4, 0.45, 0.45)
    np.testing.assert_array_equal(np.delete(one.lbg, row), np.delete(other.lbg, row))
    assert one.dynamics.parameter("friction") == 0.3
    assert other.dynamics.parameter("friction") == 0.4


def test_another_objective_or_another_scale_has_a_program_of_its_own():
    assert collocation().program is not collocation(objective="peak_torque").program
    assert collocation().program is not collocation(**{"walker.leg_length": 1.5}).program


def test_laws_of_different_durations_share_the_functions_of_their_systems_but_not_their_times():
    short, long = (build_system(known(duration)) for duration in (0.6, 0.8))
    assert short is not long
    assert short.shared is long.shared
    assert short.torques(Mode.STICK) is long.torques(Mode.STICK)
    assert (short.control.breakpoints, long.control.breakpoints) == ((0.3,), (0.4,))
    z, p = np.zeros(short.n_z), short.values(known(0.6).parameters)
    for system, duration in ((short, 0.6), (long, 0.8)):  # a quarter of the law, half of its first interval
        torque = np.asarray(system.torques(Mode.STICK)(duration / 4, z, p, system.data(0))).ravel()
        np.testing.assert_allclose(torque, [0.15, 0.05], atol=1e-15)


@pytest.mark.parametrize("name", [name for name, scalar in SCALARS.items() if scalar.quotient])
def test_rows_of_an_extremum_hold_exactly_if_it_bounds_all_its_values(name):
    scalar, rng = SCALARS[name], np.random.default_rng(1)
    at = Instant(rng.standard_normal(5), rng.uniform(1, 2, 5), rng.standard_normal(5), rng.standard_normal(5))
    above, below = scalar.quotient(at)
    values = np.concatenate([sign * above / (1 if below is None else below) for sign in scalar.signs])
    extreme = scalar.extremum * (scalar.extremum * values).max()
    assert np.min(scalar.bounded(extreme, at)) == pytest.approx(0.0, abs=1e-15)
    assert np.min(scalar.bounded(extreme - 0.1 * scalar.extremum, at)) < 0
    assert np.min(scalar.bounded(extreme + 0.1 * scalar.extremum, at)) > 0
