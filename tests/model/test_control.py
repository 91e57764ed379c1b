"""Control laws: what they ask of the motors, and when."""

import numpy as np
import pytest
from oracles import CASES, numbers

from gaitopt.model.control import ConstantTorque, Control, NoControl
from gaitopt.model.curve import BeyondEnd, Piece, continued
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.walkers.compass_biped import CompassBiped

KP, KD = 12.0, 3.0
STATE = np.array([0.1, -0.2, 0.0, 0.7, -0.4, 0.0])


def law(beyond_end: BeyondEnd) -> ProportionalDerivative:
    """theta1 follows 0.2 + t and theta2 follows -0.1, for half a second."""
    piece = Piece(start=0.0, end=0.5, rows=((0.45, 0.25), (-0.1, 0.0)))
    return ProportionalDerivative(kp=KP, kd=KD, reference=continued(CompassBiped.tracked, [piece], 0.5, beyond_end))


def torque(control: Control, t: float, segment: int = 0) -> np.ndarray:
    """Torques of a law at ``STATE``."""
    system = HybridSystem(CompassBiped, control)
    p = [*CASES["compass_biped"].p, *control.parameters.values()]
    _, u, *_ = numbers(system.observation(Mode.STICK)(t, STATE, p, control.data(segment)))
    return u


def test_passive_walker_has_no_torque_and_no_parameters() -> None:
    np.testing.assert_array_equal(torque(NoControl(), 0.3), [0, 0])
    assert not NoControl().parameters


def test_constant_torques_are_the_parameters_by_actuator() -> None:
    control = ConstantTorque(ankle=1.65, hip=0.54)
    assert control.parameters == {"ankle": 1.65, "hip": 0.54}
    np.testing.assert_array_equal(torque(control, 0.1), [1.65, 0.54])


def test_pd_law_pulls_each_joint_towards_its_reference() -> None:
    t = 0.3
    expected = [-KP * (0.1 - (0.2 + t)) - KD * (0.7 - 1.0), -KP * (-0.2 + 0.1) - KD * (-0.4)]
    np.testing.assert_allclose(torque(law(BeyondEnd.HOLD), t), expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("beyond_end", "angle", "rate"), [(BeyondEnd.HOLD, 0.7, 0.0), (BeyondEnd.LINEAR, 0.7 + 0.4, 1.0)]
)
def test_pd_law_past_the_end_follows_its_setting(beyond_end: BeyondEnd, angle: float, rate: float) -> None:
    expected = [-KP * (0.1 - angle) - KD * (0.7 - rate), -KP * (-0.2 + 0.1) - KD * (-0.4)]
    np.testing.assert_allclose(torque(law(beyond_end), 0.9, segment=1), expected, rtol=1e-13)


def test_pd_law_switched_off_past_the_end_has_no_torque() -> None:
    np.testing.assert_array_equal(torque(law(BeyondEnd.OFF), 0.9, segment=1), [0, 0])


def test_breakpoints_are_those_of_the_reference() -> None:
    assert law(BeyondEnd.HOLD).breakpoints == (0.5,)
    assert NoControl().breakpoints == ()
    assert NoControl().horizon == np.inf


def test_gains_and_torques_are_parameters_of_the_system() -> None:
    case = CASES["compass_biped"]
    system = HybridSystem(CompassBiped, law(BeyondEnd.HOLD))
    data = system.control.data(0)
    for kp, kd in ((KP, KD), (0.0, 0.0)):
        p = np.concatenate([case.p, [kp, kd]])
        _, u, *_ = numbers(system.observation(Mode.STICK)(0.3, STATE, p, data))
        np.testing.assert_allclose(u, torque(law(BeyondEnd.HOLD), 0.3) if kp else [0, 0], rtol=1e-12)


def test_ankle_turns_the_stance_leg_and_hip_spreads_both_legs_against_the_ground() -> None:
    """Q_theta1 = ankle + hip and Q_theta2 = hip: read from the change of M ddq when the foot sticks."""
    case = CASES["compass_biped"]
    system = HybridSystem(CompassBiped, ConstantTorque(ankle=0.0, hip=0.0))
    q, _ = case.coordinates(STATE)
    M = case.oracle.M(q)[:2, :2]

    def acceleration(ankle: float, hip: float) -> np.ndarray:
        (dz,) = numbers(system.flow(Mode.STICK)(0, STATE, np.concatenate([case.p, [ankle, hip]]), []))
        return dz[3:5]

    still = acceleration(0, 0)
    np.testing.assert_allclose(M @ (acceleration(1, 0) - still), [1, 0], atol=1e-12)
    np.testing.assert_allclose(M @ (acceleration(0, 1) - still), [1, 1], atol=1e-12)
