"""Walkers: the names of their states and sections, and angles with their units."""

import math

import pytest
from oracles import CASES, COMPASS, TorsoCompass
from pydantic import ValidationError

from gaitopt import Mode
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
