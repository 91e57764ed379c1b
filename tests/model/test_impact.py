"""Impact: eqs (8)-(11) in NumPy, momentum and energy balance, and the swap of the feet."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import Function
from foot_impacts import around, foot_impact
from oracles import FRICTION, SLIPS, Case, differences, numbers

from gaitopt import ImpactLaw, Mode
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem

Array = np.ndarray
MODES = CONTACTS
LAWS = tuple(ImpactLaw)
IMPULSE_RATIOS = {law: (FRICTION if law is ImpactLaw.COULOMB else 0.0) for law in LAWS}


@cache
def impact_of(walker: type, mode: Mode, law: ImpactLaw) -> Function:
    return foot_impact(HybridSystem(walker, NoControl(), law), mode)


def collide(case: Case, mode: Mode, law: ImpactLaw, z: Array) -> SimpleNamespace:
    """One impact as the package computes it, and the velocities of all coordinates that its impulse implies."""
    z_plus, impulse, slip, lift, painleve = numbers(impact_of(type(case.walker), mode, law)(z, case.p))
    q, dq = case.coordinates(z)
    W = case.oracle.swing_foot.jacobian(q)
    dq_plus = dq + np.linalg.solve(case.oracle.M(q), W.T @ impulse)  # eq. (8)
    found = {"q": q, "dq_minus": dq, "dq_plus": dq_plus, "v_plus": W @ dq_plus, "z_plus": z_plus, "impulse": impulse}
    scalars = {"slip_velocity": slip.item(), "lift_velocity": lift.item(), "painleve": painleve.item()}
    return SimpleNamespace(**found, **scalars)


def touching(case: Case, count: int = 8) -> list[Array]:
    """States just before an impact: both feet on the ground, the swing foot coming down."""
    states = []
    for z in case.states(40 * count):
        z[1 if case.n > 1 else 0] = z[0] if case.n > 1 else np.pi / case.walker.spokes
        q, dq = case.coordinates(z)
        if case.oracle.swing_foot.velocity(q, dq)[1] < 0 and (case.n == 1 or z[0] > 0.05):
            states.append(z)
    return states[:count]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mode", MODES)
def test_impulses_are_those_of_equations_9_and_11(case: Case, mode: Mode, law: ImpactLaw) -> None:
    for z in case.states():
        needed, _ = case.oracle.impulse(*case.coordinates(z), mode.direction, IMPULSE_RATIOS[law])
        np.testing.assert_allclose(collide(case, mode, law, z).impulse, needed, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mode", MODES)
def test_colliding_foot_neither_rebounds_nor_sinks_and_moves_only_where_it_slips(case, mode, law):
    for z in case.states():
        hit = collide(case, mode, law, z)
        assert hit.v_plus[1] == pytest.approx(0, abs=1e-11)
        assert hit.slip_velocity == pytest.approx(hit.v_plus[0], abs=1e-11)
        assert hit.lift_velocity == pytest.approx(hit.dq_plus[-1], abs=1e-11)
        if mode is Mode.STICK:
            assert hit.v_plus[0] == pytest.approx(0, abs=1e-11)
            assert hit.z_plus[-1] == 0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mode", MODES)
def test_impact_never_adds_energy(case: Case, mode: Mode, law: ImpactLaw) -> None:
    for z in touching(case, 30):
        hit = collide(case, mode, law, z)
        if mode is not Mode.STICK and hit.slip_velocity * mode.direction <= 0:
            continue  # the friction would push along the slip: such an impact is inconsistent
        assert case.oracle.energy(hit.q, hit.dq_plus) < case.oracle.energy(hit.q, hit.dq_minus)


@pytest.mark.parametrize("mode", MODES)
def test_swap_of_the_feet_moves_no_mass(case: Case, mode: Mode) -> None:
    """The same bodies are in the same places with the same velocities, seen from the new stance foot."""
    for z in touching(case):
        hit = collide(case, mode, ImpactLaw.COULOMB, z)
        q, dq = case.coordinates(hit.z_plus)
        seen_before = sorted(
            (m.mass, *m.point.position(hit.q), *m.point.velocity(hit.q, hit.dq_plus)) for m in case.oracle.masses
        )
        seen_after = sorted((m.mass, *m.point.position(q), *m.point.velocity(q, dq)) for m in case.oracle.masses)
        np.testing.assert_allclose(seen_after, seen_before, rtol=1e-10, atol=1e-10)
        assert case.oracle.energy(q, dq) == pytest.approx(case.oracle.energy(hit.q, hit.dq_plus), rel=1e-11)
        if case.n > 1:  # the next swing foot of a wheel is another spoke
            np.testing.assert_allclose(case.oracle.swing_foot.position(q), hit.q[-2:], atol=1e-14)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mode", SLIPS)
def test_painleve_denominator_belongs_to_the_colliding_foot(case: Case, mode: Mode, law: ImpactLaw) -> None:
    for z in case.states():
        q, _ = case.coordinates(z)
        W = case.oracle.swing_foot.jacobian(q)
        A = W @ np.linalg.solve(case.oracle.M(q), W.T)
        denominator = A[1] @ [-IMPULSE_RATIOS[law] * mode.direction, 1]
        painleve = collide(case, mode, law, z).painleve
        assert painleve == pytest.approx(denominator / np.linalg.det(A), rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mode", MODES)
def test_jacobian_agrees_with_central_differences(case: Case, mode: Mode, law: ImpactLaw) -> None:
    system = HybridSystem(type(case.walker), NoControl(), law)
    for z in case.states(4):
        jacobian = system.reset_jacobian(*around(system, mode))(z, case.p)
        expected = differences(lambda z: numbers(system.reset(*around(system, mode))(z, case.p))[0], z)
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-7)


def test_state_after_an_impact_is_on_the_section_and_back(case: Case) -> None:
    """Lifting the section coordinates of a state after an impact gives the state again, x counted from the foot."""
    for mode in MODES:
        for z in touching(case, 3):
            z_plus = collide(case, mode, ImpactLaw.COULOMB, z).z_plus
            z_plus[case.n] = 0.0
            xi = z_plus[case.system.section(mode).indices]
            np.testing.assert_allclose(Dynamics(case.system, case.p).lift(xi), z_plus, atol=1e-14)
