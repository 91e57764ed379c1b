"""The section of a gait: the states just after the event that ends its cycle, and the coordinates that are free there.

    c(z, p) = 0,        z = lift(xi),        xi = z[indices]

c follows from the states of contacts and stops just before and just after the event:

    height of every contact that touches before or after it             = 0
    velocity of every contact that touches after it                     = 0       normal; tangential if it sticks
    coordinates of a massless contact that lands less their values      = 0
    gap of every stop that is locked before it                          = 0       and its rate, if it stays locked
    the margin that ends the cycle, if one is stated                    = 0
    energy less the parameter ``energy``, if the walker has one         = 0       which removes the multiplier of one

If the state is continuous at the event, the velocities before it count as well. The equations are solved for as many
coordinates as there are independent equations, by Newton's method from a state nearby; the other coordinates are those
of the section. Coordinates of a massless contact that is off have no influence on the motion, and are not section
coordinates either.

If a foot lands on which the walker then stands alone, the class of the walker states the coordinates of the section and
its lift (``Walker.section``, ``Walker.after_impact``), or the closure of the legs does. Such a section is the same
after every impact.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Protocol

import numpy as np
from casadi import (
    DM,
    SX,
    Function,
    cse,
    densify,
    depends_on,
    inv,
    jacobian,
    jtimes,
    solve,
    substitute,
    vertcat,
    vertsplit,
)
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building, built_once
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import RowMap, buffered
from gaitopt.model.closure import LARGEST_REMAINDER, closure, is_linear, solved_columns
from gaitopt.model.declaration import is_default, parameter_namespace, state_after_impact
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.model.modes import Mode
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_property

TOUCHDOWN, CLOCK = "touchdown", "clock"
"""Events that end a cycle: the landing of a foot, and the end of a period of the control law. All others are
margins."""
SAMPLES = 5
"""Number of random states that are tried, times 20, until one at which the conditions are regular is found."""
SMALLEST_ENTRY = 0.1
"""An equation is solved for a coordinate only if its derivative by this coordinate exceeds this fraction of its largest
derivative, unless it can be solved for no other coordinate."""
NEWTON_STEPS = 50
"""Largest number of Newton steps. About five are needed, and some damped steps before if the state is distant."""
LONGEST_CLOSING_STEP = 0.3
"""Longest Newton step in rad and SI units. Longer steps might lead to another posture."""
CLOSED, ROUNDING = 1e-9, 1e-13
"""Newton's method ends after a step that is smaller than the first number. A step that is smaller than the second is a
rounding error, and is not taken."""


class Section:
    """The section of one kind of event; see ``section_of``.

    Attributes
    ----------
    names : names of the section coordinates.
    indices : indices of the section coordinates in the state, shape (n_xi,).
    contacts_after : the states of the contacts just after the event, for messages.
    stated : whether the walker's class states coordinates and lift. The coordinates then determine a state.
    """

    names: tuple[str, ...]
    indices: NDArray[np.intp]
    contacts_after: str

    @building
    def __init__(self, walker: type[Walker], before: Mode, after: Mode, event: str) -> None:
        self._walker, self._event, self.stated = walker, event, has_stated_sections(walker, event)
        self._before, self._after, self.contacts_after = before, after, after.brief
        self._n_p = len(walker.model_fields)
        state = walker.state_names()
        if self.stated:
            self.names = walker.section_names(slipping=after.slips)
            self.contacts_after = "slip" if after.slips else "stick"
            self.indices = np.array([state.index(name) for name in self.names], dtype=np.intp)
            return
        eom = equations_of_motion(walker)
        self._z, self._p = eom.z, eom.p  # the equations of a walker may be built again, with other symbols
        self._c, counts, stale = _equations(walker, before, after, event)
        self._solved, self._rows = _solved_coordinates(walker, self._c, counts, stale)
        left_out = {*self._solved, *stale}
        self.indices = np.array([k for k in _in_order(walker) if k not in left_out], dtype=np.intp)
        self.names = tuple(state[k] for k in self.indices)
        BUILT.watch(vars(self))

    @property
    def every_step(self) -> "Section":
        """The section from which any step starts: this one, with the slip velocity if the class states it."""
        return _section(self._walker, Mode.STICK, Mode.SLIP_FORWARD, self._event) if self.stated else self

    @property
    def defining_names(self) -> tuple[str, ...]:
        """Names of the coordinates that determine a state: those of the section, or all if these are not enough."""
        return self.names if self.stated else self._walker.state_names()

    def lift(self, xi: Array, p: Array, near: Array | None = None) -> Array:
        """The state with these section coordinates, shape (n_z,), next to the state ``near``; NaN if there is none.

        Parameters
        ----------
        xi : the section coordinates; for a stated section, dx may be left out.
        p : the walker's parameters; others may follow them.
        near : a state nearby, which is needed unless the section is stated.
        """
        if self.stated:
            lift = stated_lift(self._walker)
            return buffered(lift)(_filled(xi, lift.size1_in(0)), p[: self._n_p])[0].copy()
        assert near is not None
        step = buffered(self._step)
        return self._solved_near(xi[None], near, lambda z: step(z[0], p[: self._n_p])[0][None])[0]

    def row_lift(self) -> Callable[[Array, Array, Array | None], Array]:
        """A function like ``lift`` for many states, (n, n_xi) to (n, n_z), which one thread at a time may call."""
        if self.stated:
            lift = RowMap(stated_lift(self._walker))
            return lambda xi, p, near: lift(_filled(xi, self.every_step.indices.size), p[: self._n_p])[0]
        step = RowMap(self._step)

        def lift_near(xi: Array, p: Array, near: Array | None) -> Array:
            assert near is not None
            return self._solved_near(xi, near, lambda z: step(z, p[: self._n_p])[0])

        return lift_near

    def _solved_near(self, xi: Array, near: Array, step: Callable[[Array], Array]) -> Array:
        """The states (n, n_z) of ``lift`` by Newton's method; ``step`` maps m states to the steps (m, n_solved)."""
        z, rows = np.tile(near, (len(xi), 1)), np.arange(len(xi))
        z[:, self.indices] = xi
        for _ in range(NEWTON_STEPS):
            change = step(z[rows])
            size = np.abs(change).max(axis=1, initial=0.0)
            moves = (size >= ROUNDING) & (size < np.inf)  # a state of the section is not changed
            if not moves.all():
                z[rows[~np.isfinite(size)]] = np.nan
                rows, change, size = rows[moves], change[moves], size[moves]
            z[rows[:, None], self._solved] -= change * np.minimum(1.0, LONGEST_CLOSING_STEP / size)[:, None]
            rows = rows[size >= CLOSED]  # one more step would be rounding: convergence is quadratic
            if not rows.size:
                break
        z[rows] = np.nan
        return z

    def tangent(self, z: Array, p: Array) -> Array:
        """Derivative of ``lift`` at a state of the section, shape (n_z, n_xi)."""
        (flat,) = buffered(self.tangents)(z, p[: self._n_p])
        return flat.reshape(z.size, -1, order="F").copy()

    @cached_property
    @building
    def tangents(self) -> Function:
        """(z, p) -> ``tangent``, where p are the walker's parameters."""
        n = self.indices.size
        if self.stated:
            z, p = SX.sym("z", len(self._walker.state_names())), SX.sym("p", self._n_p)
            matrix = _stated(self._walker, "tangent")(z[self.every_step.indices.tolist()], p)[:, :n]
        else:
            z, p, J = self._z, self._p, jacobian(self._c[self._rows], self._z)
            matrix = SX.zeros(z.numel(), n)
            matrix[self.indices.tolist(), :] = SX.eye(n)
            matrix[self._solved, :] = -solve(J[:, self._solved], densify(J[:, self.indices.tolist()]))
        return BUILT.watch(Function("section_tangents", [z, p], [densify(matrix)]))

    def by_parameters(self, z: Array, p: Array) -> Array:
        """Derivative of ``lift`` by the walker's parameters at fixed section coordinates, shape (n_z, n_p)."""
        if self.stated:
            (flat,) = buffered(_stated(self._walker, "by_parameters"))(z[self.every_step.indices], p[: self._n_p])
            return flat.reshape(z.size, -1, order="F").copy()
        matrix = np.zeros((z.size, self._n_p))
        (slopes,) = buffered(self._slopes_by_parameters)(z, p[: self._n_p])
        matrix[self._solved] = slopes.reshape(len(self._solved), -1, order="F")
        return matrix

    def holds(self, before: Mode, impact: Mode) -> bool:
        """Whether a step leads to this section if it ends in the mode ``before`` with the contacts ``impact``."""
        if self.stated:
            return impact.slips is self._after.slips
        before = self._walker.swapped(before) if self._event == TOUCHDOWN else before
        return impact.contact is self._after.contact and before.touching == self._before.touching

    @property
    def is_explicit(self) -> bool:
        """Whether the lift is a closed form; otherwise ``conditions`` determines the coordinates ``solved``."""
        return self.stated and (not is_default(self._walker, "after_impact") or is_linear(self._walker))

    @property
    def solved(self) -> tuple[int, ...]:
        """Indices of the coordinates for which ``conditions`` is solved; none if the section is explicit."""
        if self.is_explicit:
            return ()
        shape = enumerate(self._walker.shape)
        return tuple([k for k, name in shape if name not in self.names] if self.stated else self._solved)

    @property
    @building
    def conditions(self) -> Function:
        """(z, p) -> independent conditions c, one for each of the coordinates ``solved``; p are the walker's."""
        if not self.stated:
            return Function("conditions", [self._z, self._p], [densify(self._c[self._rows])])
        z, p = SX.sym("z", len(self._walker.state_names())), SX.sym("p", self._n_p)
        equations, _ = closure(self._walker)
        return Function("conditions", [z, p], [densify(equations(z[: len(self._walker.shape)], p))])

    @property
    @building
    def left_out(self) -> Function:
        """(z, p) -> the conditions that ``conditions`` leaves out, because at a sample they depend on the others."""
        rows = [] if self.stated else [k for k in range(self._c.numel()) if k not in self._rows]
        z, p, c = (SX.sym("z"), SX.sym("p"), SX(0, 1)) if self.stated else (self._z, self._p, self._c[rows])
        return Function("left_out", [z, p], [densify(c)])

    @cached_property
    @building
    def projected(self) -> Function:
        """(z, p) -> z_plus: the state after one Newton step towards the section; p are the walker's parameters.

        States of the section are not changed. If the class states the section, z_plus has the same coordinates there.
        """
        if self.stated:
            z, p = SX.sym("z", len(self._walker.state_names())), SX.sym("p", self._n_p)
            lifted = stated_state(self._walker, z[self.every_step.indices.tolist()], p)
            return Function("projected", [z, p], [lifted], ["z", "p"], ["z_plus"])
        z, change = SX(self._z), self._change
        for k, index in enumerate(self._solved):
            z[index] -= change[k]
        return Function("projected", [self._z, self._p], [z], ["z", "p"], ["z_plus"])

    @property
    def _change(self) -> SX:
        c = self._c[self._rows]
        return solve(jacobian(c, self._z)[:, self._solved], c)

    @cached_property
    @building
    def _step(self) -> Function:
        return BUILT.watch(Function("section_step", [self._z, self._p], [densify(self._change)]))

    @cached_property
    @building
    def _slopes_by_parameters(self) -> Function:
        c = self._c[self._rows]
        slopes = -solve(jacobian(c, self._z)[:, self._solved], densify(jacobian(c, self._p)))
        return BUILT.watch(Function("section_by_parameters", [self._z, self._p], [densify(slopes)]))


class Cyclic(Protocol):
    """A problem or a hybrid system, of which the end of a cycle matters."""

    @property
    def walker(self) -> Walker | type[Walker]:
        """The walker or its class."""

    @property
    def cycle_end(self) -> str:
        """Event that ends a cycle: ``touchdown``, ``clock`` or the name of a margin."""


def cycle_start(of: Cyclic) -> str:
    """The time of the first state of a cycle, for messages: just after an impact or a landing, or at its start."""
    end = cycle_end(of)
    return "at the start of the cycle" if end == "end of cycle" else f"just after the {end}"


def cycle_end(of: Cyclic) -> str:
    """The end of a cycle, for messages: an impact, the landing of a massless foot, or the end by a clock or margin."""
    if of.cycle_end != TOUCHDOWN:
        return "end of cycle"
    return "landing" if of.walker.weightless() else "impact"


def section_of(walker: type[Walker], before: Mode, after: Mode, event: str) -> Section:
    """The section just after the event that ends a cycle.

    Parameters
    ----------
    before : the mode in which the cycle ends.
    after : the contacts just after the event, relabelled.
    event : the event that ends the cycle.

    Raises
    ------
    ProblemError
        If the contacts cannot be on the ground together.
    """
    if has_stated_sections(walker, event):
        return _section(walker, Mode.STICK, Mode.SLIP_FORWARD if after.slips else Mode.STICK, event)
    before = walker.swapped(before) if event == TOUCHDOWN else before
    return _section(walker, before, after.contact, event)


@built_once(maxsize=64)
def _section(walker: type[Walker], before: Mode, after: Mode, event: str) -> Section:
    return Section(walker, before, after, event)


def has_stated_sections(walker: type[Walker], event: str) -> bool:
    """Whether the class of a walker, or the closure of its legs, states the coordinates that are free at this event."""
    return walker.stands_on_one() and event == TOUCHDOWN


def stated_state(walker: type[Walker], xi: SX, p: SX) -> SX:
    """z just after a landing, with x = 0, from the section coordinates with dx; ``p`` are the walker's parameters."""
    free = SimpleNamespace(**{name: xi[k] for k, name in enumerate(walker.section_names(slipping=True))})
    halves = zip(state_after_impact(walker, free, parameter_namespace(walker, p)), (SX(0), xi[-1]), strict=True)
    named = ({**dict(zip(walker.shape, vertsplit(shape), strict=True)), "x": x, "y": SX(0)} for shape, x in halves)
    return vertcat(*(values[name] for values in named for name in walker.coordinates()))


def stated_lift(walker: type[Walker]) -> Function:
    """(xi, p) -> z of ``stated_state``."""
    return _stated(walker, "lift")


@built_once(maxsize=24)
def _stated(walker: type[Walker], what: str) -> Function:
    """(xi, p) -> z of ``stated_state``, its derivative by xi, ``tangent``, or by p, ``by_parameters``."""
    xi, p = SX.sym("xi", len(walker.section_names(slipping=True))), SX.sym("p", len(walker.model_fields))
    z = stated_state(walker, xi, p)
    value = z if what == "lift" else jacobian(z, xi if what == "tangent" else p)
    return Function(what, [xi, p], [cse(densify(value))])


def _filled(xi: Array, size: int) -> Array:
    """Section coordinates with zeros for those that are left out at the end."""
    full = np.zeros((*xi.shape[:-1], size))
    full[..., : xi.shape[-1]] = xi
    return full


def _equations(walker: type[Walker], before: Mode, after: Mode, event: str) -> tuple[SX, tuple[int, int], list[int]]:
    """The equations c(z, p).

    Returns
    -------
    c : SX - rows for positions, then rows for velocities, then further ones.
    counts : number of rows for positions and of rows for velocities.
    stale : indices of the coordinates and rates of massless contacts that are off.
    """
    eom, state, n = equations_of_motion(walker), walker.state_names(), len(walker.coordinates())
    contacts, massless, q, dq = eom.contacts, eom.mechanism.contacts, eom.q, eom.dq
    gaps, gap_rates = _closed_stops(walker, before) if event == TOUCHDOWN else ([], [])
    names = (*walker.shape, "x", "y")
    on_ground = [name for name in walker.contact_names() if name in before.touching or name in after.touching]
    places = [q[names.index("x")], *(contacts[name].position[1] for name in on_ground)]
    for name in walker.placed_contacts():
        if name in after.touching and name not in before.touching:
            places += [q[names.index(key)] - value for key, value in massless[name].places.items()]
    places += gaps
    modes, rates, others = (after,) if event == TOUCHDOWN else (before, after), list[SX](), list[SX]()
    for name in on_ground:
        # always as a directional derivative, whose rounding enters a lifted guess and so the digests
        velocity = jtimes(contacts[name].position, eom.z, vertcat(eom.z[n:], SX.zeros(n)))
        touching = [mode for mode in modes if name in mode.touching]
        rates += [velocity[1]] if touching else []
        rates += [velocity[0]] if any(not mode.directions[name] for mode in touching) else []
    rates += gap_rates
    if walker.base_contact() in walker.weightless() and not on_ground:  # a massless foot does not move in flight
        rates.append(dq[names.index("x")])
    places, rates = ([row for row in rows if not SX(row).is_zero()] for rows in (places, rates))
    if event not in (TOUCHDOWN, CLOCK):
        others.append(eom.sections[event])
    if "energy" in walker.model_fields:
        springs = (energy for name, energy in eom.mechanism.potential_while.items() if after.has(name))
        others.append(eom.energy + sum(springs, SX(0)) - eom.parameters.energy)
    off = [key for name in walker.placed_contacts() if name not in after.touching for key in massless[name].places]
    stale = [k for key in off for k in (state.index(key), state.index(key) + n)]
    return vertcat(*places, *rates, *others), (len(places), len(rates)), stale


def _closed_stops(walker: type[Walker], before: Mode) -> tuple[list[SX], list[SX]]:
    """Gaps of the stops that are locked before a relabelling, and gap rates of those that the impact holds.

    They are functions of the state after the impact.

    Raises
    ------
    ProblemError
        If the relabelling is not affine.
    """
    if not before.locked:
        return [], []
    eom, n = equations_of_motion(walker), len(walker.shape)
    shape, relabel = eom.q[:n], eom.mechanism.relabel
    swap, offset = jacobian(relabel, shape), substitute(relabel, shape, SX.zeros(n))
    if depends_on(swap, shape):
        raise ProblemError(f"{walker.__name__}: relabel is not affine: the postures after an impact are unknown")
    unswapped = inv(DM(swap) if swap.is_constant() else swap)
    gaps = [substitute(eom.mechanism.stops[name], shape, unswapped @ (shape - offset)) for name in before.locked]
    closed = (gap for name, gap in zip(before.locked, gaps, strict=True) if name not in walker.open_in_impact)
    return gaps, [jtimes(gap, shape, eom.dq[:n]) for gap in closed]


def _in_order(walker: type[Walker]) -> list[int]:
    """Indices of the state in the order of section coordinates: the shape, y, then their rates, with dx last."""
    names = walker.state_names()
    order = [name for name in (*walker.shape, "y", "x") if name in names]
    return [names.index(name) for name in (*order, *(f"d{name}" for name in order))]


def _solved_coordinates(
    walker: type[Walker], c: SX, counts: tuple[int, int], stale: Sequence[int]
) -> tuple[list[int], list[int]]:
    """Indices of the coordinates for which the equations are solved, and of the independent equations.

    Coordinates of massless contacts are preferred, then those of the base point, then the shape from its end;
    coordinates that the class names in ``section`` and ``section_rates`` come last. Equations for velocities and for
    the energy are solved for rates; the margin that ends a cycle may be solved for a coordinate or a rate.
    """
    eom, names, n = equations_of_motion(walker), walker.state_names(), len(walker.coordinates())
    of_contacts = [key for name in walker.placed_contacts() for key in eom.mechanism.contacts[name].places]
    shape = [name for name in reversed(walker.shape) if name not in of_contacts]

    def preferred(stated: Sequence[str]) -> list[int]:
        order = sorted([*of_contacts, "x", "y", *shape], key=lambda name: name in stated)
        return [names.index(name) for name in order if name in names and names.index(name) not in stale]

    places, rates = preferred(walker.section), [k + n for k in preferred(walker.section_rates or ())]
    evaluated = Function("section", [eom.z, eom.p], [densify(c), densify(jacobian(c, eom.z))])
    random, n_places, n_rates = np.random.default_rng(0), *counts
    for _ in range(20 * SAMPLES):
        p, z = random.uniform(0.5, 1.5, eom.p.numel()), random.uniform(-0.3, 0.3, eom.z.numel())
        for _ in range(NEWTON_STEPS):
            values, J = (np.asarray(value) for value in evaluated(z, p))
            if not (np.all(np.isfinite(J)) and np.all(np.isfinite(values))) or np.abs(values).max() < 1e-12:
                break
            step = np.linalg.pinv(J) @ values.ravel()
            z = z - step * min(1.0, LONGEST_CLOSING_STEP / max(np.abs(step).max(), 1e-300))
        if np.all(np.isfinite(J)) and np.abs(values).max() < 1e-10:
            break
    else:
        raise ProblemError(f"{walker.__name__}: no state satisfies the conditions of its section")
    groups = [(range(n_places), places, SMALLEST_ENTRY), (range(n_places, n_places + n_rates), rates, SMALLEST_ENTRY)]
    for k in range(n_places + n_rates, len(J)):
        is_energy = "energy" in walker.model_fields and k == len(J) - 1
        groups.append(
            (
                range(k, k + 1),
                rates if is_energy else places + rates,
                LARGEST_REMAINDER if is_energy else SMALLEST_ENTRY,
            )
        )
    return solved_columns((J / np.abs(J).max(axis=1, keepdims=True))[None], groups)
