"""Equations of motion: the printed matrices of the wheel, hand-derived ones of the others, Newton's law for all."""

from types import SimpleNamespace

import numpy as np
import pytest
from casadi import Function
from oracles import CASES, WHEEL, Case, numbers

from gaitopt import equations_of_motion


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


def matrices(case: Case, z: np.ndarray) -> SimpleNamespace:
    eom = equations_of_motion(type(case.walker))
    names = ("M", "B", "G", "E", "W_swing", "energy")
    function = Function("matrices", [eom.z, eom.p], [getattr(eom, name) for name in names])
    return SimpleNamespace(**dict(zip(names, (np.asarray(m) for m in function(z, case.numbers)), strict=True)))


def test_wheel_has_the_matrices_of_equation_12() -> None:
    case = CASES["rimless_wheel"]
    m, R, kappa, g, alpha = (WHEEL[key] for key in ("mass", "radius", "inertia_ratio", "gravity", "slope"))
    paper_order = [1, 2, 0]  # (x, y, theta)
    for z in case.states():
        theta, dtheta = z[0], z[2]
        terms = matrices(case, z)
        s, c = np.sin(theta), np.cos(theta)
        M = m * np.array([[1, 0, R * c], [0, 1, -R * s], [R * c, -R * s, R**2 * (1 + kappa)]])
        B = m * R * dtheta**2 * np.array([-s, -c, 0])
        G = m * g * np.array([-np.sin(alpha), np.cos(alpha), -R * np.sin(alpha + theta)])
        np.testing.assert_allclose(terms.M[np.ix_(paper_order, paper_order)], M, atol=1e-14)
        np.testing.assert_allclose(terms.B.ravel()[paper_order], B, atol=1e-14)
        np.testing.assert_allclose(terms.G.ravel()[paper_order], G, atol=1e-13)
        assert terms.E.shape == (3, 0)


def test_compass_is_driven_as_printed_ankle_on_theta1_and_hip_on_both() -> None:
    E = matrices(CASES["compass_biped"], np.zeros(6)).E
    np.testing.assert_array_equal(E, [[1, 1], [0, 1], [0, 0], [0, 0]])


def test_torso_motor_pushes_torso_and_stance_leg_in_opposite_senses() -> None:
    E = matrices(CASES["torso_compass"], np.zeros(8)).E
    np.testing.assert_array_equal(E.ravel(), [-1, 0, 1, 0, 0])


def test_equations_of_motion_are_newtons_law(case: Case) -> None:
    for z in case.states():
        q, dq = case.coordinates(z)
        terms = matrices(case, z)
        np.testing.assert_allclose(terms.M, case.oracle.M(q), atol=1e-13)
        np.testing.assert_allclose(terms.B.ravel(), case.oracle.B(q, dq), atol=1e-12)
        np.testing.assert_allclose(terms.G.ravel(), case.oracle.G(q), atol=1e-11)
        np.testing.assert_allclose(terms.W_swing, case.oracle.swing_foot.jacobian(q), atol=1e-14)
        assert terms.energy.item() == pytest.approx(case.oracle.energy(q, dq), rel=1e-13)


def test_weight_is_the_mass_of_all_bodies_times_gravity(case: Case) -> None:
    expected = sum(m.mass for m in case.oracle.masses) * np.linalg.norm(case.oracle.gravity)
    assert numbers(case.system.weight(case.p))[0] == pytest.approx(expected, rel=1e-14)
