"""Start states of the walks of a search: in a box of section coordinates, or around the state of a guess.

A walker whose class states its section has a box of start states. For other walkers the section depends on the states
of the contacts, so that starts are sampled around the state of the guess, or in given ranges of its section. Without a
guess they are sampled around the typical posture, with the lowest contact at rest on the ground.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import RowMap
from gaitopt.model.checks import swing_foot
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.section import Section
from gaitopt.problem.problem import Problem

Within = Mapping[str, tuple[float, float]]

ANGLE, RATE, SLIP = 0.4, 0.6, 0.3
"""Half widths of the default box of start states, in rad and natural units."""
RATE_OF_FLIGHT = 2.0
"""Half width of rates for walkers that fly; it is larger because they land from some height."""
FASTEST = 5.0
"""Largest rate and slip velocity in a growing box, in natural units; a running person reaches three."""
REACH = 2.0
"""Largest length of a shape coordinate, in natural units: two feet are at most two legs apart."""
BOX_MARGIN, SMALLEST_BOX_MARGIN = 0.5, 5e-3
"""Distance between a box and the gaits inside, relative to their largest angle or rate; and its smallest value, in
natural units."""
SMALLEST_SCALE = 0.3
"""Smallest size of the sampled boxes relative to the default box, because walkers also make small steps."""
NEAR_COORDINATE, NEAR_RATE = 0.1, 0.3
"""Half widths of the range of starts around a guess, in natural units of coordinates and rates."""
TOUCHING = 1e-3
"""A contact of the guess touches the ground if its height and velocity are below this, in natural units."""
FALL = 0.02
"""Height above the ground from which a massless foot falls in a start without a guess, in natural units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBox:
    """Ranges of the start states by section coordinate, chosen by the user or the ``default`` of the walker."""

    names: tuple[str, ...]
    lower: Array
    upper: Array
    default: bool

    @property
    def sizes(self) -> Array:
        """Widths of the ranges, shape (n_xi,)."""
        return self.upper - self.lower

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Minimum and maximum by name."""
        return dict(zip(self.names, zip(self.lower.tolist(), self.upper.tolist(), strict=True), strict=True))


def start_box(problem: Problem, dynamics: Dynamics, within: Within) -> StartBox:
    """The box of start states: that of the walker, changed by ``within``."""
    names = problem.walker.section_names(slipping=True)
    units = dict(zip(dynamics.system.state_names, dynamics.state_units, strict=True))
    sizes = {"dx": SLIP} | dict.fromkeys(type(problem.walker).section, ANGLE)
    rate = RATE_OF_FLIGHT if problem.walker.leaves_ground() else RATE
    half = np.array([sizes.get(name, rate) * units[name] for name in names])
    centre = np.array([problem.walker.posture.get(name, 0.0) for name in names])
    lower, upper = centre - half, centre + half
    for name, span in within.items():
        lower[names.index(name)], upper[names.index(name)] = span
    return StartBox(names=names, lower=lower, upper=upper, default=not within)


def box_around(problem: Problem, dynamics: Dynamics, states: Array) -> StartBox:
    """A box that surrounds section states with a margin; its bounds are rounded to two digits.

    The rounding makes the box, and the search in it, independent of rounding errors of the states.

    Parameters
    ----------
    states : ndarray, shape (n, n_xi), n > 0 - section states.
    """
    walker = problem.walker
    units = dynamics.state_units[dynamics.system.section(Mode.SLIP_FORWARD).indices]
    natural, n = states / units, len(type(walker).section)
    margins = np.repeat(
        [
            BOX_MARGIN * max(np.abs(columns).max(initial=0.0), SMALLEST_BOX_MARGIN / BOX_MARGIN)
            for columns in np.split(natural, [n], axis=1)
        ],
        [n, units.size - n],
    )
    lower, upper = (natural.min(axis=0) - margins) * units, (natural.max(axis=0) + margins) * units
    for k, width in enumerate(upper - lower):
        digits = 1 - floor(log10(width))
        lower[k] = round(floor(lower[k] * 10.0**digits) / 10.0**digits, digits)
        upper[k] = round(ceil(upper[k] * 10.0**digits) / 10.0**digits, digits)
    names = walker.section_names(slipping=True)
    return StartBox(names=names, lower=lower, upper=upper, default=False)


def natural_limits(dynamics: Dynamics, section: Section) -> Array:
    """Largest absolute value of every coordinate of a section in a growing box, shape (n_xi,)."""
    walker, lengths = dynamics.system.walker, {*dynamics.system.walker.lengths, "x", "y"}
    limits = [
        FASTEST if k >= dynamics.system.n_z // 2 else REACH if name in lengths else walker.largest_angle
        for name, k in zip(section.names, section.indices.tolist(), strict=True)
    ]
    return dynamics.state_units[section.indices] * limits


def box_samples(dynamics: Dynamics, box: StartBox, count: int, rng: np.random.Generator) -> Array:
    """Start states in a box, every other one at rest; shape (count, n_xi). The default box is sampled at all sizes."""
    walker = dynamics.system.walker
    xi = rng.uniform(box.lower, box.upper, (count, box.lower.size))
    if box.default:
        xi *= rng.uniform(SMALLEST_SCALE, 1.0, (count, 1))
        if not walker.leaves_ground():
            _turn_forward(dynamics, xi)
    if not any(mode.slips for mode in walker.foot_modes()):
        xi[:, -1] = 0.0
    elif box.lower[-1] <= 0 <= box.upper[-1]:
        xi[::2, -1] = 0.0
    return xi


def _turn_forward(dynamics: Dynamics, xi: Array) -> None:
    """Mirror those postures in ``xi``, shape (n, n_xi), from which the walker would step backward."""
    system, walker, p = dynamics.system, dynamics.system.walker, dynamics.p
    (lifted,) = RowMap(system.lift)(xi, p)
    shapes, parameters = lifted[:, : system.n_shape], p[: len(walker.model_fields)]
    feet = np.array([swing_foot(walker, shape, parameters) for shape in shapes])
    xi[feet[:, 0] > 0, : len(walker.section)] *= -1


def around_guess(
    problem: Problem, dynamics: Dynamics, count: int, rng: np.random.Generator, *, exact: bool, within: Within
) -> Array:
    """Start states around that of the guess, shape (count, n_z); NaN if there is no such state.

    The first one is the state of the guess itself if ``exact``. Without a guess they surround the typical posture.

    Parameters
    ----------
    within : ranges of section coordinates, see ``section_near``, instead of those around the guess.
    """
    guess, names = guess_of(problem, dynamics), dynamics.system.state_names
    if problem.start is None and not within:
        return _around_posture(dynamics, guess, count, rng)
    spread = dynamics.state_units * np.repeat([NEAR_COORDINATE, NEAR_RATE], guess.size // 2)
    states = np.empty((count, guess.size))
    for k in range(count):
        size = 0.0 if exact and k == 0 else rng.uniform(SMALLEST_SCALE, 1.0)
        change = size * spread * rng.uniform(-1, 1, guess.size)
        for name, span in within.items() if size else ():
            index = names.index(name)
            change[index] = rng.uniform(*span) - guess[index]
        states[k] = on_ground(dynamics, guess, change)
    return states


def guess_of(problem: Problem, dynamics: Dynamics) -> Array:
    """The state of the guess of a problem, shape (n_z,); without a guess, rest in the typical posture of the walker."""
    names, posture = dynamics.system.state_names, problem.walker.posture
    if problem.start is None:
        return _on_lowest_contact(dynamics, np.array([posture.get(name, 0.0) for name in names]))
    return np.array([problem.start.state[name] for name in names])


def _around_posture(dynamics: Dynamics, rest: Array, count: int, rng: np.random.Generator) -> Array:
    """Start states around rest in a posture, with all shapes and rates changed; shape (count, n_z)."""
    n, n_shape = rest.size // 2, len(dynamics.system.walker.shape)
    rate = RATE_OF_FLIGHT if dynamics.system.walker.weightless() else RATE
    spread = dynamics.state_units * np.repeat([ANGLE, 0.0, rate], [n_shape, n - n_shape, n])
    sizes = rng.uniform(SMALLEST_SCALE, 1.0, (count, 1))
    return np.array(
        [_on_lowest_contact(dynamics, z) for z in rest + sizes * spread * rng.uniform(-1, 1, (count, 2 * n))]
    )


def _on_lowest_contact(dynamics: Dynamics, state: Array) -> Array:
    """A state that is moved and slowed as a whole until its lowest contact rests on the ground.

    A massless foot has no state of rest: it is put a little above the ground, and its walker keeps its velocity.
    """
    system, names, z = dynamics.system, dynamics.system.state_names, state.copy()
    walker, contacts = system.walker, system.walker.contact_names()
    heights, velocities, counts = (np.array(value).ravel() for value in system.contact_points(z, dynamics.p))
    heights, counts = heights[: len(contacts)], counts[: len(contacts)]  # a swing foot follows them
    flight = walker.released(walker.contact_mode(dict.fromkeys(contacts, OFF)))
    margins = dict(
        zip(system.transitions.margin_names(flight), dynamics.margins(flight, 0, np.zeros(1), z[None])[0], strict=True)
    )
    for k, name in enumerate(contacts):
        if name in walker.placed_contacts():  # it is placed where it lands
            heights[k] = margins.get(system.transitions.name("gap", name), np.inf)
    lowest = int(np.argmin(np.where(counts > 0, heights, np.inf)))
    light = contacts[lowest] in walker.weightless()
    if "y" in names:
        z[names.index("y")] += light * FALL * dynamics.scales.length - heights[lowest]
    for name, velocity in zip(("dx", "dy"), velocities.reshape(-1, 2)[lowest], strict=True):
        if name in names and not light:
            z[names.index(name)] -= velocity
    if light and "energy" in walker.model_fields:  # nothing changes the energy of a walk
        rates = slice(len(names) // 2, None)
        moving, resting = (
            float(system.observation(flight)(0.0, state, dynamics.p, system.data(0))[4])
            for state in (z, np.where(np.arange(z.size) < z.size // 2, z, 0.0))
        )
        kinetic = dynamics.parameter("walker.energy") - resting
        z[rates] *= np.sqrt(kinetic / (moving - resting)) if kinetic > 0 and moving > resting else 1.0
    return z


def on_ground(dynamics: Dynamics, state: Array, change: Array) -> Array:
    """A state with changed coordinates, in which the same contacts touch the ground; NaN if there is none.

    Contacts that stick or slip in ``state`` do the same in the new state.
    """
    section = section_near(dynamics, state)
    if section is None:
        return np.full(state.size, np.nan)
    near = state.copy()
    near[section.indices] += change[section.indices]
    return section.lift(near[section.indices], dynamics.p, near)


def section_near(dynamics: Dynamics, state: Array) -> Section | None:
    """The section of states in which contacts do what they do in ``state``; None if they cannot do so together."""
    system, scales, p = dynamics.system, dynamics.scales, dynamics.p
    heights, velocities, _ = (np.asarray(value).ravel() for value in system.contact_points(state, p))
    states = dict[str, str]()
    points = zip(heights, velocities.reshape(-1, 2), strict=True)
    for name, (height, (v_t, v_n)) in zip(system.walker.contact_names(), points, strict=False):
        touches = abs(height) < TOUCHING * scales.length and abs(v_n) < TOUCHING * scales.speed
        slip = "stick" if abs(v_t) < TOUCHING * scales.speed else str(Mode.slip(v_t))
        states[name] = ("stick" if name in system.walker.weightless() else slip) if touches else OFF
    mode = system.walker.contact_mode(states)
    try:
        return system.section(mode)
    except ProblemError:  # the contacts cannot reach the ground together
        return None
