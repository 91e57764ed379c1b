"""The compiled hybrid system: margins and flow against their own central differences, the section, the parameters."""

from collections.abc import Callable

import numpy as np
import pytest
from oracles import CASES, Case, differences, directional, numbers, state_for

from gaitopt.model.curve import BeyondEnd, Piece, continued
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.walkers.compass_biped import CompassBiped

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


@pytest.mark.parametrize("mode", MODES)
def test_variational_flow_is_linear_in_the_deviations(mode: Mode) -> None:
    case, system, p, r = systems()["tracking_compass"]
    deviations = np.random.default_rng(7).normal(size=(6, 2))
    for z in case.states(3):
        z = state_for(mode, z)
        (dy,) = numbers(system.variational(mode, 2)(0.2, np.concatenate([z, deviations.T.ravel()]), p, r))
        (units,) = numbers(system.variational(mode, 6)(0.2, np.concatenate([z, np.eye(6).ravel()]), p, r))
        A = units[6:].reshape(6, 6).T
        np.testing.assert_allclose(dy[6:].reshape(2, 6).T, A @ deviations, rtol=1e-10, atol=1e-10)


def test_lift_has_the_jacobian_of_its_central_differences() -> None:
    for case in CASES.values():
        xi = np.random.default_rng(3).normal(size=case.system.lift.size1_in(0))
        expected = differences(lambda xi, case=case: numbers(case.system.lift(xi, case.p))[0], xi)
        np.testing.assert_allclose(case.system.lift_jacobian(xi, case.p), expected, atol=1e-9)


def test_parameters_are_named_by_dotted_keys_in_order() -> None:
    system = CASES["compass_biped"].system
    fields = tuple(f"walker.{name}" for name in CompassBiped.model_fields)
    assert system.parameters == (*fields, "friction")
    assert tracking_compass()[0].parameters == (*fields, "friction", "control.kp", "control.kd")
    values = {name: float(k) for k, name in enumerate(system.parameters)}
    np.testing.assert_array_equal(system.values(values), np.arange(len(values)))


def test_section_after_a_slipping_impact_has_the_slip_velocity_last() -> None:
    system = CASES["compass_biped"].system
    assert [system.state_names[k] for k in system.section(Mode.STICK).indices] == ["theta1", "dtheta1", "dtheta2"]
    assert [system.state_names[k] for k in system.section(Mode.SLIP_FORWARD).indices] == [
        "theta1",
        "dtheta1",
        "dtheta2",
        "dx",
    ]
