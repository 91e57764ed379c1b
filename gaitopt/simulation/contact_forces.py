"""Forces and accelerations, or impulses, in every mode that some contacts may have, by dense linear algebra.

    [ M   -G ] [ ddq ]   [ force + E u ]        G = J' of the kept rows, minus s mu J_t' for a contact that slips
    [ J    0 ] [  f  ] = [   - dJ dq   ]

in natural units, for all candidate modes at once. M, the forces and J are evaluated once at a state; no mode is
compiled. Coordinates and constraints that a mode does not have remain as equations x = 0, so that all systems have one
size. The model states which constraints depend on others (``constraint_structure``).

Rates of margins along the motion of a mode follow from the same equations with complex numbers: for small e,

    margin(K + i e K', b + i e b') = margin + i e margin'

with the directional derivatives K', b' of the mechanics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.model.buffered import Buffers
from gaitopt.model.contacts import (
    LARGEST_REMAINDER,
    active_coordinates,
    constraint_rows,
    constraint_structure,
    friction_of_shares,
    share_margins,
)
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, Mode
from gaitopt.model.transitions import CONE, share_name
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_method

IMAGINARY = 1e-50
"""Size of the imaginary parts, whose squares are negligible compared with the real parts."""


class Mechanics(NamedTuple):
    """A walker at one instant in natural units; complex numbers also contain rates, see the module.

    Attributes
    ----------
    M : mass matrix, shape (n, n).
    force : generalised forces, shape (n,), without motors, contacts, and springs that act in some modes only.
    E : generalised forces of the motors, shape (n, n_u); torques are in SI.
    springs : generalised forces of the springs that act in some modes only, one column each, shape (n, n_s).
    J : rows t and n of every contact, then a row of every stop, shape (2 k + n_l, n).
    convective : dJ/dt dq, shape (2 k + n_l,).
    contacts : the rows of the contacts.
    dq : rates of the coordinates, shape (n,).
    """

    M: Array
    force: Array
    E: Array
    springs: Array
    J: Array
    convective: Array
    dq: Array
    contacts: slice

    @property
    def velocities(self) -> Array:
        """(v_t, v_n) of every contact, shape (k, 2)."""
        return (self.J[self.contacts] @ self.dq).reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """Friction coefficients of every contact, shape (k,) each; the viscous coefficient is in natural units."""

    static: Array
    kinetic: Array
    viscous: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Some modes of a walker as arrays.

    Attributes
    ----------
    modes : the m modes.
    slip : slip direction of every contact, shape (m, k).
    closed : whether each contact touches the ground, shape (m, k).
    shared : whether the force of each contact is undetermined, shape (m, k).
    own : whether each contact is closed and its force is determined.
    sticks : whether each contact is ``own`` and at rest.
    rows : 1 if a mode has the constraint of a row of J and keeps it, shape (m, 2 k + n_l).
    moves : 1 if a coordinate moves, shape (m, n).
    springs : 1 if a spring acts, shape (m, n_s).
    slides : whether a contact slips in any mode.
    blank : the matrices of the module without M, J and G, shape (m, n + 2 k + n_l, n + 2 k + n_l).
    pairs, kept : 1 for the entries of M, and of J, that a mode has, shape (m, n, n) and (m, 2 k + n_l, n).
    """

    modes: tuple[Mode, ...]
    slip: Array
    closed: NDArray[np.bool_]
    shared: NDArray[np.bool_]
    own: NDArray[np.bool_]
    sticks: NDArray[np.bool_]
    rows: Array
    moves: Array
    springs: Array
    slides: bool
    blank: Array
    pairs: Array
    kept: Array


@lru_cache(maxsize=256)
def candidates(walker: type[Walker], springs: tuple[str, ...], modes: tuple[Mode, ...]) -> Candidates:
    """Modes as arrays; ``springs`` are the states in which springs act."""
    names, n = walker.landing_points(), len(walker.shape) + 2
    number = {name: k for k, name in enumerate(names)}
    shape = len(modes), len(names)
    rows = np.zeros((shape[0], 2 * shape[1] + len(walker.stops)))
    moves, shared = np.zeros((shape[0], n)), np.zeros(shape, bool)
    for j, mode in enumerate(modes):
        structure = constraint_structure(walker, mode)
        rows[j, constraint_rows(walker, [structure.constraints[k] for k in structure.kept])] = 1
        moves[j, active_coordinates(walker, mode)] = 1
        shared[j, [number[name] for name in structure.group]] = True
    slip = np.array([[mode.directions.get(name, 0) for name in names] for mode in modes], float).reshape(shape)
    closed = np.array([[name in mode.touching for name in names] for mode in modes], bool).reshape(shape)
    blank = np.zeros((len(modes), n + rows.shape[1], n + rows.shape[1]))
    diagonal = np.arange(blank.shape[1])
    blank[:, diagonal, diagonal] = 1 - np.concatenate([moves, rows], axis=1)
    return Candidates(
        modes=modes,
        slip=slip,
        closed=closed,
        shared=shared,
        own=closed & ~shared,
        sticks=closed & ~shared & (slip == 0),
        rows=rows,
        moves=moves,
        springs=np.array([[mode.has(state) for state in springs] for mode in modes], float).reshape(len(modes), -1),
        slides=bool(slip.any()),
        blank=blank,
        pairs=moves[:, :, None] * moves[:, None, :],
        kept=rows[:, :, None] * moves[:, None, :],
    )


def systems(M: Array, J: Array, modes: Candidates, kinetic: Array) -> Array:
    """The matrices of all modes, shape (m, n + 2 k + n_l, n + 2 k + n_l)."""
    n, k, K = M.shape[0], 2 * modes.slip.shape[1], modes.blank.astype(M.dtype)
    K[:, :n, :n] += modes.pairs * M
    K[:, n:, :n] = G = modes.kept * J
    if modes.slides:
        G = G.copy()
        G[:, 1:k:2] -= (modes.slip * kinetic)[:, :, None] * modes.kept[:, 1:k:2] * J[:k:2]
    K[:, :n, n:] -= G.swapaxes(1, 2)
    return K


def inverses(K: Array) -> Array:
    """The inverses of some matrices; NaN for singular ones."""
    try:
        return np.asarray(np.linalg.inv(K))
    except np.linalg.LinAlgError:
        result, regular = np.full(K.shape, np.nan), [bool(np.linalg.det(each)) for each in K]
        result[regular] = np.linalg.inv(K[regular])
        return result


def solve(K: Array, inverse: Array, modes: Candidates, loads: Array, required: Array) -> tuple[Array, Array]:
    """Accelerations, shape (m, n, r), and forces of the constraints, (m, 2 k + n_l, r).

    Parameters
    ----------
    K, inverse : the matrices, see ``systems``, and the inverses of their real parts.
    modes : the m modes.
    loads : generalised forces without those of the contacts, shape (m, n, r).
    required : acceleration along every row of J, shape (2 k + n_l, r).
    """
    n = modes.moves.shape[1]
    b = np.concatenate([modes.moves[:, :, None] * loads, modes.rows[:, :, None] * required], axis=1)
    x = inverse @ b
    x += inverse @ (b - K @ x)  # one refinement corrects rounding errors, and adds the imaginary part
    return x[:, :n], x[:, n:]


def regularity(M: Array, J: Array, modes: Candidates, kinetic: Array) -> Array:
    """Determinant of the system of every mode relative to that without friction, shape (m,)."""
    with_friction = np.linalg.slogdet(systems(M, J, modes, kinetic))
    without = np.linalg.slogdet(systems(M, J, modes, np.zeros_like(kinetic)))
    return np.asarray(with_friction[0] / without[0] * np.exp(with_friction[1] - without[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Solutions:
    """Motions in some modes, or impacts, in natural units.

    Attributes
    ----------
    modes : the m modes.
    motion : accelerations, or changes of the rates by an impact, shape (m, n).
    tangential, normal : forces or impulses, shape (m, k); undetermined ones have one of many possible values.
    contact : tangential and normal acceleration of every contact, or its velocity after an impact, shape (m, k, 2).
    """

    modes: Candidates
    motion: Array
    tangential: Array
    normal: Array
    contact: Array


class ContactForces:
    """Forces of one walker's contacts at fixed parameters; used by one thread at a time.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics, system, scales = dynamics, dynamics.system, dynamics.scales
        self._system, self.walker = system, system.walker
        names = (*self.walker.shape, "x", "y")
        lengths = {*self.walker.lengths, "x", "y"}
        self._unit = np.array([scales.length if name in lengths else 1.0 for name in names])
        self._time = scales.time
        state, points = self.walker.coordinates(), self.walker.landing_points()
        self._kept = [k for k, name in enumerate(names) if name in state]  # without flight, y is not a state
        self._order = [state.index(names[k]) for k in self._kept]
        self._rates = [len(state) + k for k in self._order]
        shapes, u, k = system.mechanics_shapes, self._unit, len(points)
        n_l, self._contacts = len(self.walker.stops), slice(0, 2 * k)
        of_row = np.concatenate([np.full(2 * k, 1 / scales.length), np.ones(n_l)])  # gaps of stops have no unit
        per_force = u / scales.energy
        sizes = {
            "M": np.outer(u, u) / (scales.mass * scales.length**2),
            "force": per_force,
            "E": np.broadcast_to(per_force[:, None], shapes["E"]),
            "springs": np.broadcast_to(per_force[:, None], shapes["springs"]),
            "J": np.outer(of_row, u),
            "convective": scales.time**2 * of_row,
        }
        self._scale = np.concatenate([sizes[term].ravel() for term in shapes])
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
        self._terms = [(slice(*span), shape) for span, shape in zip(pairwise(ends), shapes.values(), strict=True)]
        of = system.contact_coefficients(dynamics.p)
        values = [of[name if name in of else FOOT] for name in points]
        static, kinetic, viscous = np.array(values, dtype=float).reshape(-1, 3).T
        self.friction = Friction(static=static, kinetic=kinetic, viscous=viscous * scales.speed / scales.force)
        self.springs = system.springs_while
        self.law_uses = system.law_uses if self.walker.actuators else (False, False)
        self._mechanics = Buffers(system.mechanics)
        self._mechanics_rate: Buffers | None = None
        self._law: tuple[Buffers, Buffers] | None = None

    @property
    def law_assumes_sticking(self) -> bool:
        """Whether the control law computes its torques for a motion in which all contacts stick."""
        return self.law_uses[0]

    def of(self, modes: Sequence[Mode]) -> Candidates:
        """Modes of this walker as arrays."""
        return candidates(self.walker, self.springs, tuple(modes))

    @cached_method
    def is_undetermined(self, mode: Mode) -> bool:
        """Whether the motion in a mode depends on undetermined shares of forces."""
        of = dict(zip(self.walker.landing_points(), self.friction.kinetic.tolist(), strict=True))
        return bool(np.linalg.norm(friction_of_shares(self.walker, mode, of)) > LARGEST_REMAINDER)

    def mechanics(self, z: Array) -> Mechanics:
        """The walker at a state in SI."""
        (values,) = self._mechanics(z, self.dynamics.p)
        dq = np.zeros(self._unit.size)
        dq[self._kept] = z[self._rates] * (self._time / self._unit[self._kept])
        return self._mechanics_from(values * self._scale, dq)

    def natural_rates(self, dq: Array) -> Array:
        """Rates of (shape, x, y) in natural units, from those in SI."""
        return np.asarray(dq * (self._time / self._unit))

    def stopped(self, z: Array, rows: Sequence[int], others: Sequence[int]) -> Array:
        """The nearest state in which the velocities of some rows of J are zero, and those of others are unchanged."""
        mechanics = self.mechanics(z)
        J = mechanics.J[[*rows, *others]]
        required = np.concatenate([-mechanics.J[[*rows]] @ mechanics.dq, np.zeros(len(others))])
        change = np.linalg.lstsq(J, required, rcond=LARGEST_REMAINDER)[0]
        z = z.copy()
        z[self._rates] += (change * self._unit / self._time)[self._kept]
        return z

    def at(self, t: float, z: Array, segment: int) -> "ContactInstant":
        """The contacts at one instant, in SI."""
        return ContactInstant(self, t, z, segment)

    def impacts(self, mechanics: Mechanics, modes: Sequence[Mode], kinetic: Array) -> Solutions:
        """The impacts that lead to each of some modes, with kinetic friction coefficients of shape (k,)."""
        of, J, k = self.of(modes), mechanics.J, self._contacts.stop
        loads = np.zeros((len(of.modes), mechanics.dq.size, 1))
        K = systems(mechanics.M, J, of, kinetic)
        change, impulses = solve(K, inverses(K), of, loads, -(J @ mechanics.dq)[:, None])
        normal = impulses[:, 1:k:2, 0]
        tangential = np.where(of.slip != 0, -of.slip * kinetic * normal, impulses[:, :k:2, 0])
        after = (change[:, :, 0] + mechanics.dq) @ J[self._contacts].T
        return Solutions(
            modes=of,
            motion=change[:, :, 0],
            tangential=tangential,
            normal=normal,
            contact=after.reshape(len(of.modes), -1, 2),
        )

    def regularity(self, mechanics: Mechanics, modes: Sequence[Mode], kinetic: Array) -> Array:
        """See ``regularity``."""
        return regularity(mechanics.M, mechanics.J, self.of(modes), kinetic)

    def margins(self, mode: Mode, tangential: Array, normal: Array, J: Array) -> tuple[list[str], list[Any]]:
        """Names and values of the margins of the forces, or impulses, in a mode."""
        structure, names = constraint_structure(self.walker, mode), self.walker.landing_points()
        static = self.friction.static
        margin_names, values = list[str](), list[Any]()
        for k, name in enumerate(names):
            if name not in mode.touching or name in structure.group:
                continue
            margin_names.append(f"normal_force.{name}")
            values.append(normal[k])
            if not mode.directions[name]:
                margin_names += [f"{cone}.{name}" for cone in CONE.values()]
                values += [static[k] * normal[k] + sign * tangential[k] for sign in (1, -1)]
        if structure.dropped:
            number = {name: k for k, name in enumerate(names)}
            rows = constraint_rows(self.walker, structure.constraints)
            kept, dropped = [rows[k] for k in structure.kept], [rows[k] for k in structure.dropped]
            nulls = np.zeros((len(rows), len(dropped)), dtype=J.dtype)
            nulls[[*structure.dropped], range(len(dropped))] = 1
            nulls[[*structure.kept]] = -np.linalg.solve(J[kept] @ J[kept].T, J[kept] @ J[dropped].T)
            forces = {name: (tangential[number[name]], normal[number[name]]) for name in structure.group}
            shares = share_margins(self.walker, mode, forces, nulls, dict(zip(names, static, strict=True)))
            margin_names += [share_name(names_of_share) for names_of_share, _ in shares]
            values += [value for _, value in shares]
        return margin_names, values

    def _mechanics_from(self, values: Array, dq: Array) -> Mechanics:
        M, force, E, springs, J, convective = (values[span].reshape(shape) for span, shape in self._terms)
        return Mechanics(M, force, E, springs, J, convective, dq, self._contacts)

    def _rate(self, z: Array, mode: Mode, ddq: Array) -> Array:
        """Rate of the state in SI; coordinates that a mode does not have are constant."""
        dz = np.empty(z.size)
        dz[self._order] = z[self._rates] * self.of((mode,)).moves[0, self._kept]
        dz[self._rates] = (ddq * self._unit)[self._kept] / self._time**2
        return dz

    def _moving(self, z: Array, dz: Array, mechanics: Mechanics, ddq: Array) -> Mechanics:
        """The walker with its rates along a motion as imaginary parts."""
        if self._mechanics_rate is None:
            self._mechanics_rate = Buffers(self._system.mechanics_rate)
        (rates,) = self._mechanics_rate(z, dz, self.dynamics.p)
        values = np.concatenate([term.ravel() for term in mechanics[:-2]])
        moving = values + (1j * IMAGINARY * self._time) * (rates * self._scale)
        return self._mechanics_from(moving, mechanics.dq + 1j * IMAGINARY * ddq)

    def torques(self, t: float, z: Array, segment: int, assumed: Array, actual: Array, dz: Array | None) -> Array:
        """Torques [N m] from the accelerations that the law may use; with rates as imaginary parts if ``dz`` is given.

        Parameters
        ----------
        assumed, actual : shape accelerations without torques and per torque, in natural units, shape (n_s, 1 + n_u),
            of the motion in which the contacts stick, which the law may assume, and of the actual one.
        dz : rate of the state.
        """
        if self._law is None:
            self._law = Buffers(self._system.law_torques), Buffers(self._system.law_torques_rate)
        unit, p, data = self._unit[: len(self.walker.shape), None] / self._time**2, self.dynamics.p, self._system.data
        h, a = ((values * unit).ravel(order="F") for values in (assumed, actual))
        torques = self._law[0](t, z, h.real, a.real, p, data(segment))[0].copy()
        if dz is None:
            return torques
        rates = np.concatenate([dz, h.imag / IMAGINARY / self._time, a.imag / IMAGINARY / self._time])
        (rate,) = self._law[1](t, z, h.real, a.real, rates, p, data(segment))
        return np.asarray(torques + 1j * IMAGINARY * self._time * rate)


class ContactInstant:
    """The contacts at one instant, made by ``ContactForces.at``.

    Attributes
    ----------
    mechanics : the walker at this instant.
    velocities : (v_t, v_n) of every contact, shape (k, 2).
    """

    def __init__(self, forces: ContactForces, t: float, z: Array, segment: int) -> None:
        self._forces, self._t, self._z, self._segment = forces, t, z, segment
        self.mechanics = forces.mechanics(z)
        self.velocities = self.mechanics.velocities
        self._inverses: dict[Mode, Array] = {}
        self._margins: dict[tuple[Mode, Mode], tuple[list[str], list[Any]]] = {}
        self._rates: dict[tuple[Mode, Mode], list[float]] = {}

    def motions(self, modes: Sequence[Mode], law_mode: Mode) -> Solutions:
        """Motions in some modes.

        Parameters
        ----------
        law_mode : the mode for which a control law that assumes sticking contacts computes its torques.
        """
        return self._motions(self.mechanics, self._forces.of(modes), law_mode, None)

    def margins(self, mode: Mode, law_mode: Mode, found: Solutions, k: int) -> tuple[list[str], list[Any]]:
        """The margins of the k-th of some motions, which is in ``mode``; see ``ContactForces.margins``."""
        if (mode, law_mode) not in self._margins:
            values = self._forces.margins(mode, found.tangential[k], found.normal[k], self.mechanics.J)
            self._margins[mode, law_mode] = values
        return self._margins[mode, law_mode]

    def rates(self, mode: Mode, law_mode: Mode, ddq: Array) -> list[float]:
        """Rates of the margins of a mode along its motion with the accelerations ``ddq``, shape (n,)."""
        if (mode, law_mode) not in self._rates:
            forces = self._forces
            dz = forces._rate(self._z, mode, ddq)
            moving = forces._moving(self._z, dz, self.mechanics, ddq)
            found = self._motions(moving, forces.of((mode,)), law_mode, dz)
            _, values = forces.margins(mode, found.tangential[0], found.normal[0], moving.J)
            self._rates[mode, law_mode] = [float(np.imag(value)) / IMAGINARY for value in values]
        return self._rates[mode, law_mode]

    def after(self, duration: float, mode: Mode, ddq: Array) -> "ContactInstant":
        """The contacts after a short time in natural units, to first order."""
        forces, time = self._forces, duration * self._forces._time
        z = self._z + time * forces._rate(self._z, mode, ddq)
        return ContactInstant(forces, self._t + time, z, self._segment)

    def _motions(self, mechanics: Mechanics, modes: Candidates, law_mode: Mode, dz: Array | None) -> Solutions:
        """Motions in some modes; with complex mechanics along the motion dz/dt."""
        forces, friction, J = self._forces, self._forces.friction, mechanics.J
        loads = mechanics.force + modes.springs @ mechanics.springs.T
        drag, (assumes_sticking, responds) = None, forces.law_uses
        if modes.slides and friction.viscous.any():
            drag = -1.0 * (modes.slip != 0) * friction.viscous * mechanics.velocities[:, 0]
            loads = loads + drag @ J[mechanics.contacts][::2]
        n_u, n_shape = mechanics.E.shape[1], len(forces.walker.shape)
        assumed = np.zeros((n_shape, 1 + n_u)) if n_u else mechanics.E
        if assumes_sticking:
            one = forces.of((law_mode,))
            load = mechanics.force + one.springs @ mechanics.springs.T
            assumed = self._accelerations(mechanics, one, load)[0][0, :n_shape]
        if responds:
            ddq, lambdas = self._accelerations(mechanics, modes, loads)
            each = [forces.torques(self._t, self._z, self._segment, assumed, a[:n_shape], dz) for a in ddq]
            weights = np.array([[1, *torque] for torque in each])[:, :, None]
            motion, lambdas = (ddq @ weights)[:, :, 0], (lambdas @ weights)[:, :, 0]
        else:
            if n_u:
                torque = forces.torques(self._t, self._z, self._segment, assumed, np.zeros_like(assumed.real), dz)
                loads = loads + mechanics.E @ torque
            K, inverse = self._systems(mechanics, modes)
            ddq, lambdas = solve(K, inverse, modes, loads[:, :, None], -mechanics.convective[:, None])
            motion, lambdas = ddq[:, :, 0], lambdas[:, :, 0]
        normal, tangential = lambdas[:, mechanics.contacts][:, 1::2], lambdas[:, mechanics.contacts][:, ::2]
        if modes.slides:
            tangential = np.where(modes.slip != 0, -modes.slip * friction.kinetic * normal, tangential)
        if drag is not None:
            tangential = tangential + drag
        accelerations = motion @ J[mechanics.contacts].T + mechanics.convective[mechanics.contacts]
        return Solutions(
            modes=modes,
            motion=motion,
            tangential=tangential,
            normal=normal,
            contact=accelerations.reshape(len(motion), -1, 2),
        )

    def _accelerations(self, mechanics: Mechanics, modes: Candidates, loads: Array) -> tuple[Array, Array]:
        """Accelerations and forces of the constraints without torques, and per torque, as columns."""
        columns = np.concatenate([loads[:, :, None], np.tile(mechanics.E, (len(loads), 1, 1))], axis=2)
        required = np.zeros((mechanics.convective.size, columns.shape[2]), dtype=columns.dtype)
        required[:, 0] = -mechanics.convective
        return solve(*self._systems(mechanics, modes), modes, columns, required)

    def _systems(self, mechanics: Mechanics, modes: Candidates) -> tuple[Array, Array]:
        """The matrices of some modes, and the inverses of their real parts, which are computed once."""
        K = systems(mechanics.M, mechanics.J, modes, self._forces.friction.kinetic)
        if len(modes.modes) == 1 and modes.modes[0] in self._inverses:
            return K, self._inverses[modes.modes[0]][None]
        inverse = inverses(K.real)
        self._inverses |= dict(zip(modes.modes, inverse, strict=True))
        return K, inverse
