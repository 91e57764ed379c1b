"""Equations of motion: the printed matrices of the wheel, hand-derived ones of the others, Newton's law for all."""

from types import SimpleNamespace

import numpy as np
import pytest
from casadi import SX, Function, vertcat
from oracles import CASES, COMPASS, WHEEL, Case, differences, numbers

from gaitopt import Body, Mechanism, Walker, equations_of_motion


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


def test_wheel_has_the_swing_foot_jacobian_of_equation_12_at_touchdown() -> None:
    case = CASES["rimless_wheel"]
    angle = np.pi / WHEEL["spokes"]
    W = matrices(case, np.array([angle, 0.3, 1.0, 0.2])).W_swing
    np.testing.assert_allclose(W, [[0, 1, 0], [-2 * WHEEL["radius"] * np.sin(angle), 0, 1]], atol=1e-15)


def test_compass_has_the_mass_matrix_of_three_points() -> None:
    case = CASES["compass_biped"]
    leg, m, d, mh = (COMPASS[key] for key in ("leg_length", "leg_mass", "leg_com", "hip_mass"))
    for z in case.states():
        t1, t2 = z[:2]
        first, second = m * d + (m + mh) * leg, m * (leg - d)
        M = np.diag([m * d**2 + (m + mh) * leg**2, m * (leg - d) ** 2, 2 * m + mh, 2 * m + mh])
        M[0, 1] = second * leg * np.cos(t1 + t2)
        M[0, 2:] = first * np.cos(t1), -first * np.sin(t1)
        M[1, 2:] = second * np.cos(t2), second * np.sin(t2)
        np.testing.assert_allclose(matrices(case, z).M, np.triu(M) + np.triu(M, 1).T, atol=1e-13)


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


def test_gravity_and_springs_are_the_gradient_of_the_potential_energy(case: Case) -> None:
    for z in case.states():
        q, _ = case.coordinates(z)
        gradient = differences(lambda q: np.atleast_1d(case.oracle.energy(q, np.zeros_like(q))), q)
        np.testing.assert_allclose(matrices(case, z).G.ravel(), gradient.ravel(), atol=1e-8)


def test_mass_matrix_is_positive_definite(case: Case) -> None:
    for z in case.states():
        assert np.linalg.eigvalsh(matrices(case, z).M).min() > 0


def test_weight_is_the_mass_of_all_bodies_times_gravity(case: Case) -> None:
    expected = sum(m.mass for m in case.oracle.masses) * np.linalg.norm(case.oracle.gravity)
    assert numbers(case.system.weight(case.p))[0] == pytest.approx(expected, rel=1e-14)


class Pendulum(Walker):
    """A stilt without a second leg; a frame for walkers that contradict themselves."""

    model = "pendulum"
    shape = ("theta",)
    section = ()

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        bob = vertcat(q.x + q.theta.sin(), q.y + q.theta.cos())
        return Mechanism(
            bodies=(Body(mass=1.0, position=bob),),
            gravity=SX([0.0, -1.0]),
            swing_foot=bob,
            touchdown=q.theta,
            upright=q.theta.cos(),
            relabel=-q.theta,
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[float, ...]:
        return (0.0,)


class Motorless(Pendulum):
    model = "motorless"
    actuators = ("ankle",)
    tracked = ("theta",)


class Astray(Pendulum):
    model = "astray"
    section = ("phi",)


class Adrift(Pendulum):
    model = "adrift"

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        bob = vertcat(q.theta.sin(), q.theta.cos())
        return Mechanism(
            bodies=(Body(mass=1.0, position=bob),),
            gravity=SX([0.0, -1.0]),
            swing_foot=vertcat(q.x, q.y) + bob,
            touchdown=q.theta,
            upright=q.theta.cos(),
            relabel=-q.theta,
        )


@pytest.mark.parametrize(
    ("walker", "words"),
    [
        (Motorless, "Motorless: Mechanism.motors has 0 entries, but actuators has 1"),
        (Astray, "Astray: phi is not a shape coordinate"),
        (Adrift, "Adrift: body 0 does not move along with the stance foot"),
    ],
)
def test_walker_that_contradicts_itself_is_refused(walker: type[Walker], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        equations_of_motion(walker)
