"""Contact of the stance foot: eqs (3)-(6) in NumPy, the wheel's closed forms, Newton's law on the masses, energy."""

import numpy as np
import pytest
from combined_walkers import FEET, NamedCompass, NamedUnequal
from contact_walkers import passive
from oracles import CASES, COMPASS, FRICTION, SLIPS, WHEEL, Case, compass_oracle, directional, numbers, state_for

from gaitopt import Mode
from gaitopt.model.control import ConstantTorque
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

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


def test_wheel_forces_in_stick_are_equations_17_and_18() -> None:
    case = CASES["rimless_wheel"]
    m, R, kappa, g, alpha = (WHEEL[key] for key in ("mass", "radius", "inertia_ratio", "gravity", "slope"))
    for z in case.states():
        theta, dtheta = z[0], z[2]
        _, (f_t, f_n) = flow_and_force(case, Mode.STICK, state_for(Mode.STICK, z))
        squared = dtheta**2 * (1 + kappa) * R / g  # of the rate in the time unit of eq. (13)
        pull = np.cos(alpha + theta) - squared
        normal = m * g / (1 + kappa) * (pull * np.cos(theta) + kappa * np.cos(alpha))
        tangential = m * g / (1 + kappa) * (pull * np.sin(theta) - kappa * np.sin(alpha))
        assert f_n == pytest.approx(normal, rel=1e-12)
        assert f_t / f_n == pytest.approx(tangential / normal, rel=1e-11)


@pytest.mark.parametrize("mode", SLIPS)
def test_wheel_slips_as_in_equation_20(mode: Mode) -> None:
    case = CASES["rimless_wheel"]
    m, R, kappa, g, alpha = (WHEEL[key] for key in ("mass", "radius", "inertia_ratio", "gravity", "slope"))
    mu = mode.direction * FRICTION
    for z in case.states():
        z = state_for(mode, z)
        theta, dtheta = z[0], z[2]
        s, c = np.sin(theta), np.cos(theta)
        dz, (_, f_n) = flow_and_force(case, mode, z)
        normal = kappa * m * (g * np.cos(alpha) - R * c * dtheta**2) / (s * (mu * c + s) + kappa)
        swing = mu * c * normal + m * s * (g * np.cos(alpha) - R * c * dtheta**2)
        slip = R * m * s * (1 + kappa) * dtheta**2 - mu * normal * (1 + kappa)
        slip += g * m * (kappa * np.sin(alpha) - np.cos(alpha + theta) * s)
        assert f_n == pytest.approx(normal, rel=1e-11)
        assert dz[2] == pytest.approx(swing / (m * R * (s**2 + kappa)), rel=1e-11)
        assert dz[3] == pytest.approx(slip / (m * (s**2 + kappa)), rel=1e-10)


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


def test_painleve_margin_can_be_lost() -> None:
    """A slender wheel on a steep spoke: beyond a friction of (s^2 + kappa) / |s c| the slip has no unique solution."""
    wheel = RimlessWheel(spokes=4, radius=1.0, mass=1.0, inertia_ratio=0.05, gravity=1.0, slope=0.0)
    case = Case(wheel, CASES["rimless_wheel"].oracle)
    theta = -0.4
    critical = (np.sin(theta) ** 2 + 0.05) / abs(np.sin(theta) * np.cos(theta))
    index = case.system.transitions.margin_names(Mode.SLIP_FORWARD).index("painleve")
    for mu, sign in ((0.999 * critical, 1), (1.001 * critical, -1)):
        p = np.append(case.numbers, mu)
        (margins,) = numbers(case.system.margins(Mode.SLIP_FORWARD)(0, [theta, 0, 0.5, 0.1], p, []))
        assert np.sign(margins[index]) == sign


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


def test_touchdown_margin_is_minus_the_guard_and_zero_when_the_swing_foot_meets_the_ground(case: Case) -> None:
    touching = np.full(case.n, 0.15) if case.n > 1 else np.array([np.pi / WHEEL["spokes"]])
    z = np.concatenate([touching, [0.0], np.ones(case.n), [0.0]])
    (margins,) = numbers(case.system.margins(Mode.STICK)(0, z, case.p, []))
    assert margins[0] == pytest.approx(0, abs=1e-15)
    assert case.oracle.swing_foot.position(case.coordinates(z)[0])[1] == pytest.approx(0, abs=1e-15)
    z[0] += 0.01
    (margins,) = numbers(case.system.margins(Mode.STICK)(0, z, case.p, []))
    assert margins[0] < 0


def test_compass_stands_by_the_weight_of_its_masses() -> None:
    """At rest with both legs along the normal of level ground the normal force is the weight."""
    level = Case(CompassBiped(**{**COMPASS, "slope": 0.0}), CASES["compass_biped"].oracle)
    _, force = flow_and_force(level, Mode.STICK, np.zeros(6))
    np.testing.assert_allclose(force, [0.0, (2 * COMPASS["leg_mass"] + COMPASS["hip_mass"]) * COMPASS["gravity"]])
