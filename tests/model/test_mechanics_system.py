"""Equations of motion and the compiled hybrid system against Newton's law, NumPy's solver and central differences."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import SX, Function, densify, vertcat
from foot_impacts import foot_impact
from oracles import CASES, Case, differences, directional, numbers, state_for
from samples import sampled

from gaitopt import ImpactLaw, Mode, Walker, equations_of_motion, load_problem
from gaitopt.model.buffered import WIDTH, BufferedFunction, RowMap
from gaitopt.model.contacts import NORMAL, TANGENTIAL, constraint_structure
from gaitopt.model.control import NoControl
from gaitopt.model.curve import BeyondEnd, Piece, continued
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import COULOMB, shared_friction
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.model.walkers.flat_foot import FlatFoot
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.slip_walker import SlipWalker
from gaitopt.model.walkers.torso import TorsoWalker
from gaitopt.systems import build_system

Array = np.ndarray
MODES = CONTACTS


def tracking_compass() -> tuple[HybridSystem, Array, Array]:
    """A compass whose torques depend on time, with parameters and segment data."""
    piece = Piece(start=0.0, end=0.6, rows=((0.1, 0.2, 0.05), (-0.1, 0.1, 0.0)))
    control = ProportionalDerivative(
        kp=15.0, kd=4.0, reference=continued(CompassBiped.tracked, [piece], 0.6, BeyondEnd.LINEAR)
    )
    return HybridSystem(CompassBiped, control), np.append(CASES["compass_biped"].p, [15.0, 4.0]), control.data(0)


def systems() -> dict[str, tuple[Case, HybridSystem, Array, Array]]:
    passive = {name: (case, case.system, case.p, np.zeros(0)) for name, case in CASES.items()}
    return {**passive, "tracking_compass": (CASES["compass_biped"], *tracking_compass())}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", systems())
def test_rates_of_margins_are_their_derivatives_along_the_flow(name: str, mode: Mode) -> None:
    case, system, p, r = systems()[name]

    def margins(tz: Array) -> Array:
        return numbers(system.margins(mode)(tz[0], tz[1:], p, r))[0]

    for z in case.states(4):
        tz = np.concatenate([[0.2], state_for(mode, z)])
        (dz,) = numbers(system.flow(mode)(tz[0], tz[1:], p, r))
        values, rates = numbers(system.events(mode)(tz[0], tz[1:], p, r))
        np.testing.assert_allclose(values, margins(tz), rtol=1e-13, atol=1e-13)
        expected = directional(margins, tz, np.concatenate([[1.0], dz]))
        np.testing.assert_allclose(rates, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", systems())
def test_derivatives_agree_with_central_differences(name: str, mode: Mode) -> None:
    case, system, p, r = systems()[name]

    def evaluated(function: Callable[..., object]) -> Callable[[Array], Array]:
        return lambda z: numbers(function(0.2, z, p, r))[0]

    for z in case.states(4):
        z = state_for(mode, z)
        n = z.size
        (dy,) = numbers(system.variational(mode, n)(0.2, np.concatenate([z, np.eye(n).ravel()]), p, r))
        np.testing.assert_allclose(dy[:n], evaluated(system.flow(mode))(z), rtol=1e-12, atol=1e-12)
        A, (dz, gradients, rates) = dy[n:].reshape(n, n).T, numbers(system.linearized(mode)(0.2, z, p, r))
        np.testing.assert_allclose(dz, dy[:n], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rates, numbers(system.events(mode)(0.2, z, p, r))[1], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(A, differences(evaluated(system.flow(mode)), z), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(gradients, differences(evaluated(system.margins(mode)), z), rtol=1e-6, atol=1e-6)


def test_lift_has_the_jacobian_of_its_central_differences() -> None:
    for case in CASES.values():
        xi = np.random.default_rng(3).normal(size=case.system.lift.size1_in(0))
        expected = differences(lambda xi, case=case: numbers(case.system.lift(xi, case.p))[0], xi)
        np.testing.assert_allclose(case.system.lift_jacobian(xi, case.p), expected, atol=1e-9)


def matrices(case: Case, z: np.ndarray) -> SimpleNamespace:
    eom = equations_of_motion(type(case.walker))
    names = ("M", "B", "G", "E", "W_swing", "energy")
    function = Function("matrices", [eom.z, eom.p], [getattr(eom, name) for name in names])
    return SimpleNamespace(**dict(zip(names, (np.asarray(m) for m in function(z, case.numbers)), strict=True)))


def test_compass_is_driven_as_printed_ankle_on_theta1_and_hip_on_both_and_the_torso_against_the_stance_leg() -> None:
    for name, expected in (
        ("compass_biped", [[1, 1], [0, 1], [0, 0], [0, 0]]),
        ("torso_compass", [[-1], [0], [1], [0], [0]]),
    ):
        case = CASES[name]
        np.testing.assert_array_equal(matrices(case, np.zeros(2 * case.n + 2)).E, expected)


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


ONE_FOOT = (CompassBiped, Hopper, KneedWalker, TorsoWalker)
SEVERAL = (Crawler, FlatFoot, HeelToe, SlipWalker)
FRICTION = 0.3


def passive(walker: type[Walker], law: ImpactLaw = ImpactLaw.COULOMB) -> HybridSystem:
    friction = shared_friction(walker.contacts, COULOMB)
    return HybridSystem(walker, NoControl(), law, friction)


@pytest.mark.parametrize("walker", sampled([*ONE_FOOT, *SEVERAL], 2), ids=lambda walker: walker.model)
def test_the_motion_of_every_mode_satisfies_newtons_law_and_its_constraints(walker: type[Walker]) -> None:
    """M ddq + B + G + springs = J' f, J ddq + dJ dq = 0, and f_t = -s mu f_n of contacts that slip."""
    system, rng = passive(walker), np.random.default_rng(0)
    eom, names = system.expressions.eom, (*walker.shape, "x", "y")
    order = [walker.coordinates().index(name) if name in walker.coordinates() else -1 for name in names]
    n_p, n = len(walker.model_fields), len(walker.coordinates())
    contacts = walker.contact_names()
    modes = [mode for mode in system.transitions.modes if constraint_structure(walker, mode).is_determined]
    for mode in [modes[k] for k in rng.permutation(len(modes))[:12]]:
        structure = constraint_structure(walker, mode)
        kept = {structure.constraints[k] for k in structure.kept}  # the others follow where the contacts are on ground
        gradient = eom.force_of(system.expressions.potential_of(mode))
        points = [densify(eom.contacts[name].J) for name in contacts]
        convective = [densify(eom.contacts[name].convective) for name in contacts]
        locked = [densify(eom.gaps[name]) for name in mode.locked]
        parts = [densify(part) for part in (eom.M, eom.B + eom.G + gradient, vertcat(*points), vertcat(*convective))]
        evaluated = Function("parts", [eom.z, eom.p], [*parts, densify(vertcat(*locked, eom.M[:0, :]))])
        p, z = rng.uniform(0.5, 1.5, n_p), rng.uniform(-0.3, 0.3, system.n_z)
        M, load, J, dJdq, L = (np.asarray(value) for value in evaluated(z, p))
        known = [*p, FRICTION]
        dz = np.asarray(system.flow(mode)(0, z, known, [])).ravel()
        force = np.asarray(system.observation(mode)(0, z, known, [])[0]).ravel()
        ddq = np.array([0.0 if k < 0 else dz[n + k] for k in order])
        rest = M @ ddq + load.ravel() - J.T @ force  # forces of the stops
        size = np.abs(load).max() + np.abs(J.T @ force).max() + 1
        moving = [k for k, name in enumerate(names) if np.abs(M[k]).max() > 0 and (name != "y" or order[k] >= 0)]
        if mode.locked:
            multipliers = np.linalg.lstsq(L.T, rest, rcond=None)[0]
            rest = rest - L.T @ multipliers
            assert np.abs(L @ ddq).max() < 1e-9 * size
        if not (walker.massless_feet or walker.massless_contacts):
            assert np.abs(rest[moving]).max() < 1e-9 * size
        for k, name in enumerate(contacts):
            f_t, f_n = force[2 * k], force[2 * k + 1]
            if name not in mode.touching:
                assert f_t == f_n == 0
                continue
            acceleration = J[2 * k : 2 * k + 2] @ ddq + dJdq[2 * k : 2 * k + 2].ravel()
            for kind in (TANGENTIAL, NORMAL):
                assert (name, kind) not in kept or abs(acceleration[kind]) < 1e-9 * size
            if mode.directions[name]:
                assert f_t == pytest.approx(-mode.directions[name] * FRICTION * f_n, rel=1e-12, abs=1e-9 * size)


def test_the_compass_is_measured_by_its_leg_weight_and_fall() -> None:
    walker = CompassBiped(leg_length=1.6, leg_mass=4, leg_com=0.8, hip_mass=2, gravity=9.8, slope=0.02)
    system = HybridSystem(CompassBiped, NoControl())
    scales = Dynamics(system, np.array([*walker.model_dump().values(), 0.2])).scales
    assert scales.length == pytest.approx(1.6, rel=1e-15)
    assert scales.time == pytest.approx(np.sqrt(1.6 / 9.8), rel=1e-15)
    assert scales.mass == pytest.approx(10, rel=1e-15)
    assert scales.force == pytest.approx(98, rel=1e-14)
    assert scales.energy == pytest.approx(98 * 1.6, rel=1e-14)
    assert scales.impulse == pytest.approx(10 * scales.speed, rel=1e-14)


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
