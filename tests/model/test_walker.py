"""Walkers: their names, their parameters and what is refused, and the registry."""

import math

import numpy as np
import pytest
from oracles import CASES, COMPASS, TorsoCompass
from pydantic import ValidationError

from gaitopt import Cycle, Mode, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.units import parse_angle
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel


def test_state_is_named_shape_then_foot_then_their_rates_and_the_section_has_the_slip_velocity_of_a_slip() -> None:
    assert RimlessWheel.state_names() == ("theta", "x", "dtheta", "dx")
    assert CompassBiped.state_names() == ("theta1", "theta2", "x", "dtheta1", "dtheta2", "dx")
    assert RimlessWheel.section_names(slipping=False) == ("dtheta",)
    assert RimlessWheel.section_names(slipping=True) == ("dtheta", "dx")
    assert CompassBiped.section_names(slipping=False) == ("theta1", "dtheta1", "dtheta2")
    assert TorsoCompass.section_names(slipping=False) == ("theta1", "torso", "dtheta1", "dtheta2", "dtorso")
    system = CASES["compass_biped"].system
    names = [system.state_names[k] for k in system.section(Mode.SLIP_FORWARD).indices]
    assert names == ["theta1", "dtheta1", "dtheta2", "dx"]


def test_walker_cannot_be_changed() -> None:
    walker = CompassBiped(**COMPASS)
    with pytest.raises(ValidationError, match="frozen"):
        walker.leg_mass = 5.0


@pytest.mark.parametrize(
    ("text", "angle"),
    [("1 deg", math.pi / 180), ("-3.5deg", -3.5 * math.pi / 180), ("1e-1 rad", 0.1), (" .5 rad ", 0.5)],
)
def test_angles_may_have_units(text: str, angle: float) -> None:
    assert parse_angle(text) == pytest.approx(angle, rel=1e-15)
    assert CompassBiped(**{**COMPASS, "slope": text}).slope == pytest.approx(angle, rel=1e-15)


@pytest.mark.parametrize("text", ["1", "deg", "1 grad", "1 deg 2", "9**9 deg", "nan deg", "1,5 deg", ""])
def test_text_that_is_no_angle_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"1 deg, 0\.1 rad"):
        parse_angle(text)


def test_both_feet_are_on_the_ground_after_an_impact() -> None:
    for case in CASES.values():
        xi = np.linspace(0.1, 0.2, case.system.lift.size1_in(0))
        q, _ = case.coordinates(Dynamics(case.system, case.p).lift(xi))
        other = case.oracle.swing_foot.position(q)
        if case.n == 1:  # the wheel stands on the spoke that it came from, one before the stance spoke
            q[0] += 2 * np.pi / case.walker.spokes
            other = case.oracle.swing_foot.position(q)
        assert other[1] == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize(
    ("phases", "impact", "words"),
    [
        ((), Mode.STICK, "at least one phase"),
        ((Mode.STICK, Mode.STICK), Mode.STICK, "phases 1 and 2 are both stick"),
        ((Mode.STICK,), Mode.SLIP_FORWARD, "the first phase must be slip_forward, not stick"),
        ((Mode.SLIP_BACKWARD, Mode.STICK), Mode.SLIP_FORWARD, "must be slip_forward, not slip_backward"),
    ],
)
def test_sequence_that_contradicts_itself_is_refused(phases: tuple[Mode, ...], impact: Mode, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Cycle.of_one_step(phases, impact)
    sequence = ModeSequence(phases=(Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD, Mode.STICK), impact=Mode.STICK)
    assert str(sequence) == "slip_forward, slip_backward, stick; stick"
