"""Contact of the stance foot: eqs (2)-(6) and their margins in NumPy, and the balance of energy."""

import numpy as np
import pytest
from combined_walkers import FEET, NamedCompass, NamedUnequal
from contact_walkers import passive
from oracles import CASES, COMPASS, FRICTION, SLIPS, Case, compass_oracle, directional, numbers, state_for

from gaitopt import Mode
from gaitopt.model.control import ConstantTorque
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped

Array = np.ndarray
MODES = CONTACTS


def flow_and_force(case: Case, mode: Mode, z: Array) -> tuple[Array, Array]:
    (dz,) = numbers(case.system.flow(mode)(0, z, case.p, []))
    return dz, numbers(case.system.observation(mode)(0, z, case.p, []))[0]


@pytest.mark.parametrize("mode", MODES)
def test_force_and_acceleration_are_those_of_equations_2_to_6(case: Case, mode: Mode) -> None:
    for z in case.states():
        z = state_for(mode, z)
        dz, force = flow_and_force(case, mode, z)
        f, ddq = case.oracle.force(*case.coordinates(z), mode.direction, FRICTION)
        np.testing.assert_allclose(force, f, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(dz[: case.n + 1], z[case.n + 1 :], atol=0)
        np.testing.assert_allclose(dz[case.n + 1 :], ddq[:-1], rtol=1e-10, atol=1e-10)
        assert ddq[-1] == pytest.approx(0, abs=1e-10)


UNEQUAL = {**COMPASS, "other_leg_mass": 5.1, "other_leg_com": 0.9}
NAMED = [(NamedCompass, COMPASS), (NamedUnequal, UNEQUAL)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("walker", "parameters"), NAMED)
def test_named_contacts_have_the_forces_and_impulses_of_equations_2_to_11(walker, parameters, mode):
    system, oracle = passive(walker, ()), compass_oracle(**parameters)
    p, rng, n = [*walker(**parameters).model_dump().values(), FRICTION], np.random.default_rng(3), 4
    stance, swing = (Mode.of_contacts({**dict.fromkeys(FEET, "off"), foot: mode}) for foot in FEET)
    names = [walker.coordinates().index(name) for name in (*walker.shape, "x", "y")]
    for _ in range(4):
        z = np.zeros(2 * n)
        z[names[:3]], z[[n + k for k in names[:2]]] = rng.uniform(-0.4, 0.4, 3), rng.uniform(-1.5, 1.5, 2)
        z[n + names[2]] = mode.direction * rng.uniform(0.1, 1)
        q, dq = z[names], z[[n + k for k in names]]
        f, ddq = oracle.force(q, dq, mode.direction, FRICTION)
        dz, force = numbers(system.flow(stance)(0, z, p, []))[0], numbers(system.observation(stance)(0, z, p, []))[0]
        np.testing.assert_allclose(force, [*f, 0, 0], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(dz[[n + k for k in names]], ddq, rtol=1e-10, atol=1e-10)
        F, dq_plus = oracle.impulse(q, dq, mode.direction, FRICTION)
        z_plus, impulses = numbers(system.impact(swing, stance, ends_step=False)(z, p))
        np.testing.assert_allclose(impulses, [0, 0, *F], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(z_plus[[n + k for k in names]], dq_plus, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("mode", MODES)
def test_energy_changes_by_the_work_of_motors_and_friction(mode: Mode) -> None:
    case, torque = CASES["compass_biped"], np.array([1.3, -0.7])
    system = HybridSystem(CompassBiped, ConstantTorque(ankle=torque[0], hip=torque[1]))
    p = np.append(case.p, torque)
    for z in case.states():
        z = state_for(mode, z)
        (dz,) = numbers(system.flow(mode)(0, z, p, []))
        force, u, power, foot, energy, rates, *_ = numbers(system.observation(mode)(0, z, p, []))
        q, dq = case.coordinates(z)
        generalised = np.array([torque.sum(), torque[1]])
        rate = directional(lambda z: case.oracle.energy(*case.coordinates(z)), z, dz)
        np.testing.assert_array_equal(u, torque)
        assert power.sum() == pytest.approx(generalised @ dq[:2], rel=1e-12)
        np.testing.assert_allclose(rates, [dq[0], dq[0] + dq[1]], rtol=1e-14)
        assert rate == pytest.approx(power.sum() + force[0] * dq[2], rel=1e-8, abs=1e-7)
        np.testing.assert_allclose(foot, case.oracle.swing_foot.position(q), atol=1e-14)
        assert energy == pytest.approx(case.oracle.energy(q, dq), rel=1e-13)


@pytest.mark.parametrize("mode", SLIPS)
def test_painleve_margin_is_the_determinant_of_the_apparent_mass_times_equation_6s_denominator(case, mode):
    index = case.system.transitions.margin_names(mode).index("painleve")
    for z in case.states():
        q, _ = case.coordinates(z)
        inverse = np.linalg.inv(case.oracle.M(q))
        C = np.linalg.inv(inverse[-2:, -2:])
        denominator = inverse[-1, -2:] @ [-FRICTION * mode.direction, 1]
        (margins,) = numbers(case.system.margins(mode)(0, z, case.p, []))
        assert margins[index] == pytest.approx(np.linalg.det(C) * denominator, rel=1e-9)


@pytest.mark.parametrize("mode", MODES)
def test_margins_are_the_quantities_they_are_named_after(case: Case, mode: Mode) -> None:
    for z in case.states():
        z = state_for(mode, z)
        _, (f_t, f_n) = flow_and_force(case, mode, z)
        (margins,) = numbers(case.system.margins(mode)(0, z, case.p, []))
        named = dict(zip(case.system.transitions.margin_names(mode), margins, strict=True))
        assert named["normal_force"] == pytest.approx(f_n)
        if mode is Mode.STICK:
            assert named["cone_forward"] == pytest.approx(FRICTION * f_n + f_t)
            assert named["cone_backward"] == pytest.approx(FRICTION * f_n - f_t)
        else:
            assert named["slip_velocity"] == abs(z[-1])
