"""Natural units: what they are for the walkers of the paper, and that they follow a change of units."""

import numpy as np
import pytest

from gaitopt import Mode
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel


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


@pytest.mark.parametrize("mode", CONTACTS)
def test_margins_in_natural_units_do_not_depend_on_the_units_of_the_problem(mode: Mode) -> None:
    system = HybridSystem(RimlessWheel, NoControl())
    length, time, mass = 1e3, 3e-2, 7e2
    wheel = RimlessWheel(spokes=10, radius=0.5, mass=2, inertia_ratio=0.2, gravity=9.8, slope=0.2)
    other = wheel.model_copy(update={"radius": 0.5 * length, "mass": 2 * mass, "gravity": 9.8 * length / time**2})
    z = np.array([-0.1, 0.0, 1.2, 0.3])
    dimensionless = []
    for w in (wheel, other):
        p = np.array([*w.model_dump().values(), 0.4])
        dynamics = Dynamics(system, p)
        state = z * dynamics.state_units
        margins = np.asarray(system.margins(mode)(0, state, p, [])).ravel()
        dimensionless.append(margins / dynamics.margin_units(mode))
    assert len(system.transitions.of(mode)) == dimensionless[0].size
    np.testing.assert_allclose(dimensionless[0], dimensionless[1], rtol=1e-13)
