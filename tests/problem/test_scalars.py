"""The table of scalars agrees with itself, and holds for every law of friction."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from named import named
from rich.console import Console

from gaitopt.model.units import Scales
from gaitopt.model.walkers.slip_runner import SlipRunner
from gaitopt.problem.problem import load_problem
from gaitopt.problem.scalars import MEASURES, SCALARS, scalar_values, state_unit, unit_of
from gaitopt.show.motion import motion_of
from gaitopt.show.pages import animation_page
from gaitopt.show.tables import print_gait, print_problem

SCALES = Scales(length=2.0, time=3.0, mass=5.0)
NEWTON = 5.0 * 2.0 / 3.0**2
SIZES = {"m": 2.0, "s": 3.0, "N": NEWTON, "J": 2.0 * NEWTON, "m/s": 2.0 / 3.0}


@pytest.mark.parametrize("name", SCALARS)
def test_the_natural_unit_of_a_scalar_has_the_dimension_of_its_unit(name):
    factors = [(word.partition("^")[0], int(word.partition("^")[2] or 1)) for word in SCALARS[name].unit.split()]
    expected = math.prod(SIZES[word] ** power for word, power in factors)
    assert SCALARS[name].within.size(SCALES) == pytest.approx(expected)


def test_a_gait_has_a_value_for_every_scalar():
    gait = named("rimless-wheel-slip")
    assert set(scalar_values(gait.to_record())) == {"friction", *SCALARS}
    assert set(MEASURES) == set(SCALARS) - {"spectral_radius"}
    assert gait.scalar("spectral_radius") == gait.spectral_radius
    assert gait.scalar("state.dtheta") == gait.state[2]
    never_sticks = replace(gait, measures={**gait.measures, "required_friction": None})
    assert math.isnan(never_sticks.scalar("required_friction"))
    with pytest.raises(KeyError):
        gait.scalar("elegance")


def test_several_coefficients_of_friction_are_printed_one_by_one(capsys):
    gait = named("rimless-wheel-stick")
    record = gait.to_record() | {"friction": {"static": 0.3, "kinetic": 0.2, "viscous": 0.1}}
    values = scalar_values(record)
    assert (values["friction.static"], values["friction.kinetic"]) == (0.3, 0.2)
    assert unit_of("friction.viscous") == "N s/m"
    print_gait(Console(width=100), record, gait.problem)
    assert "coefficient of kinetic friction" in capsys.readouterr().out


def test_a_motor_that_pushes_has_newtons_wherever_it_is_shown(capsys):
    gait = named("crawler")
    print_gait(Console(width=200), gait.to_record(), gait.problem)
    print_problem(Console(width=200), gait.problem)
    shown = capsys.readouterr().out
    assert "peak motor force" in shown
    assert not {"torque", "m^2"} & {*shown.split()}
    assert gait.to_frame().attrs["units"]["drive"] == "N"
    units = {"peak_torque": "N", "torque_cost": "N^2 s/m", "control.first.drive": "N", "work": "J", "f_n.rear": "N"}
    assert {key: unit_of(key, gait.problem) for key in units} == units
    assert unit_of("control.mean.hinge", load_problem("inchworm")) == "rad"


def test_a_cycle_without_an_impact_is_described_by_its_clock():
    page = animation_page(motion_of(named("crawler")))
    assert "after 2 s, a period of its control law." in page
    assert "impact" not in page.partition("<script")[0]


def test_a_length_of_a_class_that_is_not_registered_is_in_metres():
    class Longer(SlipRunner):
        model = "longer"
        lengths = ("shortening", "theta")

    problem = SimpleNamespace(walker=Longer, control=None)
    assert [state_unit(name, problem) for name in ("theta", "dtheta", "shortening", "x")] == ["m", "m/s", "m", "m"]
    assert state_unit("theta") == "rad"
