"""Forces of contacts by dense linear algebra, against the compiled equations of each mode."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from contact_problems import contact_gait, with_point_feet
from contact_walkers import Frame, dynamics_of
from oracles import directional, numbers
from samples import sampled

from gaitopt import Control, Instant, Mode
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import COULOMB, shared_friction
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending
from gaitopt.model.walkers.inchworm import Inchworm
from gaitopt.search.solve import solve
from gaitopt.simulation.contact_forces import ContactForces
from gaitopt.simulation.simulator import Simulator

CASES = {  # a gait, and modes of its contacts at its first state
    "heel-toe-slip": [{"heel": "slip_forward"}, {"heel": "stick", "toe": "stick"}, {"toe": "slip_backward"}, {}],
    "slip-walk": [{"front": "stick", "back": "stick"}, {"back": "stick"}, {}],
    "crawler": [{"rear": "stick", "front": "slip_forward"}, {"rear": "slip_backward", "front": "slip_backward"}],
    "inchworm": [{"rear": "stick", "front": "slip_forward"}, {"rear": "stick"}, {"front": "slip_backward"}],
}

SOON = 1e-6
"""A short time, in natural units."""


def compare(dynamics: Dynamics, mode: Mode, t: float, z: np.ndarray) -> None:
    """Rates of the state, accelerations of the contacts, margins of the forces and their rates, in natural units."""
    system, forces = dynamics.system, ContactForces(dynamics)
    held = mode.with_states(dict.fromkeys(mode.touching, "stick"))
    instant = forces.at(t, z, 0)
    found = instant.motions([mode], held)
    dz = np.asarray(system.flow(mode)(t, z, dynamics.p, system.data(0))).ravel() / dynamics.state_units
    n, order = len(dz) // 2, [system.state_names.index(name) for name in (*system.walker.shape, "x", "y")]
    expected = dz[n:][order] * dynamics.scales.time
    size = 1 + np.abs(expected).max()
    assert found.motion[0] == pytest.approx(expected, rel=1e-10, abs=1e-11 * size)
    moved = directional(lambda z: numbers(system.contact_points(z, dynamics.p))[1], z, dz * dynamics.state_units)
    contact = moved / dynamics.scales.length * dynamics.scales.time**2
    assert found.contact[0].ravel() == pytest.approx(contact, rel=1e-7, abs=1e-8 * size)
    names = system.transitions.margin_names(mode)
    units = dynamics.margin_units(mode)
    values, rates = (np.asarray(v).ravel() / units for v in system.events(mode)(t, z, dynamics.p, system.data(0)))
    known, margins = instant.margins(mode, held, found, 0)
    assert {*known} == {name for name in names if name.startswith(("normal_force", "cone"))}
    places = [names.index(name) for name in known]
    assert margins == pytest.approx(values[places], rel=1e-10, abs=1e-11 * size)
    along = np.array(instant.rates(mode, held, found.motion[0]))
    assert along == pytest.approx(rates[places] * dynamics.scales.time, rel=1e-8, abs=1e-9 * size)
    later = instant.after(SOON, mode, found.motion[0])
    _, ahead = later.margins(mode, held, later.motions([mode], held), 0)
    assert (np.array(ahead) - margins) / SOON == pytest.approx(along, rel=1e-3, abs=1e-4 * size)


@pytest.mark.parametrize("name", CASES)
def test_forces_and_their_rates_are_those_of_the_compiled_equations(name: str) -> None:
    gait = contact_gait(name)
    for words in CASES[name]:
        mode = Mode.of_contacts(dict.fromkeys(gait.system.walker.contacts, "off") | words)
        compare(gait.dynamics, mode, 0.02, gait.state)


@pytest.mark.parametrize(("name", "model"), sampled([("rabbit-hzd-slip", "stick"), ("rabbit-hzd", "actual")], 2))
def test_torques_that_depend_on_accelerations_are_those_of_the_compiled_equations(name: str, model: str) -> None:
    gait = solve(with_point_feet(name, model))
    for words in ({"foot": "stick", "other": "off"}, {"foot": "slip_forward", "other": "off"}):
        compare(gait.dynamics, Mode.of_contacts(words), 0.0, gait.arcs[0].states[2])


class Answering(Control):
    """A hinge that answers what the links would do without it while their feet are held."""

    type = "answering"

    offset: float
    gain: float

    def torques(self, now: Instant) -> dict[str, Any]:
        drift, _ = now.accelerations()
        return {"hinge": now.p.offset + now.p.gain * (drift[0] + drift[1])}


LAW = Answering(offset=0.0, gain=0.0)


@pytest.mark.slow
def test_the_chosen_mode_agrees_with_the_torques_that_the_law_has_in_it() -> None:
    """Where a foot lifts, the law holds one foot fewer, and its torque jumps: the mode is decided with both."""
    walker = Inchworm(
        link_length=0.5, link_mass=0.5, link_com=0.25, link_inertia=0.0104, hinge_mass=0.5, gravity=9.81, slope=0.08
    )
    system = HybridSystem(Inchworm, LAW, friction=shared_friction(Inchworm.contacts, COULOMB))
    rng, lifted, refused = np.random.default_rng(3), 0, 0
    for _ in range(15):
        offset, gain = rng.uniform(-8, 8), rng.uniform(-0.3, 0.3)
        dynamics = Dynamics.of(
            system,
            {f"walker.{name}": float(value) for name, value in walker}
            | {"friction": 0.6, "control.offset": offset, "control.gain": gain},
        )
        lean = rng.uniform(0.3, 1.2)
        z = np.array([lean, lean, 0.5 * np.cos(lean), 0.0, 0.0, 0.0, 0.0, 0.0])
        chosen = Simulator(dynamics).step(z)
        if chosen.step is None:
            refused += chosen.ending in (Ending.CONTACT_INCONSISTENT, Ending.CONTACT_AMBIGUOUS, Ending.PAINLEVE)
            continue
        mode = chosen.step.arcs[0].mode
        margins, rates = (np.asarray(v).ravel() for v in system.events(mode)(0.0, z, dynamics.p, []))
        for name, margin, rate in zip(system.transitions.margin_names(mode), margins, rates, strict=True):
            if name.startswith(("normal_force", "cone", "slip_velocity")):
                assert margin > -1e-9
                assert margin > 1e-9 or rate > 0
        ddq = np.asarray(system.flow(mode)(0.0, z, dynamics.p, [])).ravel()[4:]
        for k, name in enumerate(Inchworm.contacts):
            if name not in mode.touching:
                lifted += 1  # the foot is at hinge - l (sin, cos) of its link: it rises with the hinge and the lean
                assert ddq[2] + 0.5 * np.sin(lean) * ddq[k] > 0
    assert lifted > 5
    assert refused < 30


def test_a_state_is_decided_alike_to_the_last_bit_whatever_was_decided_before() -> None:
    dynamics = dynamics_of(Frame(half=0.3, height=0.5, mass=1, inertia=0.1, gravity=9.81, slope=0.2), 0.3)
    words = product(("stick", "slip_forward", "slip_backward", "off"), repeat=2)
    modes = [Mode.of_contacts({"left": left, "right": right}) for left, right in words]
    states = np.random.default_rng(0).normal(size=(5, 6))
    used = ContactForces(dynamics)
    first = [used.at(0.0, z, 0).motions(modes, modes[0]).motion for z in states]
    again = [ContactForces(dynamics).at(0.0, z, 0).motions(modes, modes[0]).motion for z in states[::-1]]
    assert np.array_equal(first, again[::-1], equal_nan=True)
