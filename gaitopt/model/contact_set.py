"""Motion and plastic impacts of a walker with several contacts, each of which sticks, slips or is off.

With the positions r_i of the closed contacts, J_i = dr_i/dq with rows t and n, and their forces,

    M ddq + B + G = E u + sum J_i' f_i
    J_n,i ddq + dJ_n,i dq = 0                                  of every closed contact
    J_t,i ddq + dJ_t,i dq = 0                                  if it sticks
    f_t,i = -s_i mu_i f_n,i - c_i v_t,i,   s_i = sgn v_t,i      if it slips

This is one linear system in ddq, the normal forces and the forces of sticking contacts. The impact that leads to a mode
has impulses in place of forces and J dq_plus in place of the accelerations; contacts that are off afterwards have none.

**Redundant constraints.** The derivatives of the closed contacts may depend on each other where the contacts are on the
ground: two sticking contacts of one rigid part have the same tangential constraint. They are recognised by their pivots
at a posture of the mode. A constraint that depends on the ones before it is left out: its force is one of a family

    lambda = lambda_0 + N a,      J' N = 0

all members of which move the walker alike. The mode holds as long as one of them lies in all friction cones. The
margins of the mode do not contain a: Fourier and Motzkin's elimination leaves the sums in which it cancels, such as

    (mu_1 f_n,1 + f_t,1) + (mu_2 f_n,2 + f_t,2) > 0

of two contacts that stick together. Where forces of the family would move the walker differently (contacts of different
friction that slip as one), the mode has no determined motion.

**Massless contacts.** A contact at the end of a massless part has coordinates of its own, without inertia. While it is
closed their equations give its force; while it is off they keep their values. It sticks, or is off.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from casadi import SX, Function, densify, horzcat, jacobian, jtimes, vertcat
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.model.lagrangian import EquationsOfMotion, equations_of_motion
from gaitopt.model.modes import Mode
from gaitopt.model.walker import Walker

SAMPLES = 5
"""Postures at which pivots are compared; they have the same ones unless a posture is singular."""
DEPENDENT = 1e-7
"""A constraint whose remainder is this small, relative to itself, depends on those before it."""
SMALL_PIVOT = 0.1
"""Smallest pivot relative to the largest entry of its row."""
ON_GROUND = 1e-12
"""Largest height of a closed contact of a sampled posture, relative to the walker's size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """What the constraints of a mode depend on; the same in every posture of the mode.

    Attributes
    ----------
    constraints : (contact, row) of all constraints in order, row 0 tangential, 1 normal; the normal ones first.
    kept : indices of the independent ones.
    dropped : indices of those that depend on the ones before them.
    is_determined : whether the motion is the same whatever the shares of the forces, if all have the same friction.
    nulls : ndarray, shape (n, len(dropped)) - a sample of N: the signs of its entries hold in every posture.
    drags : ndarray, shape (n_q, n) - sampled tangential directions of the constraints whose forces cause friction.
    group : the contacts whose forces are undetermined.
    posture : index of the posture that was sampled for it.
    """

    constraints: tuple[tuple[str, int], ...]
    kept: tuple[int, ...]
    dropped: tuple[int, ...]
    is_determined: bool
    nulls: Array
    drags: Array
    group: tuple[str, ...]
    posture: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A margin of a group of contacts whose shares of the forces are undetermined: a sum of margins of its contacts.

    Attributes
    ----------
    parts : (name of the margin, contact) of each term: ``cone_forward``, ``cone_backward`` or ``normal_force``.
    value : SX - the sum with positive weights in which the shares cancel.
    """

    parts: tuple[tuple[str, str], ...]
    value: SX


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactMotion:
    """Accelerations and contact forces in one mode.

    Attributes
    ----------
    dz : SX, shape (n_z,) - rate of the state; NaN where the motion of the mode is undetermined.
    forces : SX, shape (2,), by contact - (f_t, f_n) [N]; zero if it is off, one of many where it is undetermined.
    separations : SX by contact - normal acceleration of a contact that is off [m/s^2].
    regularity : SX - determinant of the linear system relative to that without friction; not positive in the paradox of
        Painleve.
    shares : margins of the groups of contacts whose forces are undetermined.
    undetermined : the contacts of these groups.
    """

    dz: SX
    forces: Mapping[str, SX]
    separations: Mapping[str, SX]
    regularity: SX
    shares: tuple[Share, ...]
    undetermined: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactImpact:
    """One impact as a function of the state just before it.

    Attributes
    ----------
    z_plus : SX, shape (n_z,) - state just after it, before any relabelling.
    impulses : SX, shape (2,), by contact - (F_t, F_n) [N s]; zero if it is off afterwards.
    velocities : SX, shape (2,), by contact - (v_t, v_n) just after it [m/s].
    regularity, shares, undetermined : see ``ContactMotion``.
    """

    z_plus: SX
    impulses: Mapping[str, SX]
    velocities: Mapping[str, SX]
    regularity: SX
    shares: tuple[Share, ...]
    undetermined: tuple[str, ...]


class _System:
    """The linear system of one mode: accelerations or changes of the rates, and the independent forces or impulses."""

    def __init__(self, eom: EquationsOfMotion, mode: Mode, friction: Mapping[str, SX]) -> None:
        self.eom, self.mode = eom, mode
        contacts = eom.mechanism.contacts
        names = (*eom.walker.shape, "x", "y")
        self.active = active_coordinates(eom.walker, mode)
        self.J = {name: jacobian(contacts[name].position, eom.q) for name in mode.touching}
        self.structure = constraint_structure(eom.walker, mode)
        rows, columns = [], []
        for contact, row in self.structure.constraints:
            rows.append(self.J[contact][row, :])
            slip = mode.directions[contact] * friction[contact] * self.J[contact][0, :]
            columns.append(self.J[contact][row, :] - (slip if row else 0))
        self.rows, self.columns = vertcat(SX(0, len(names)), *rows), horzcat(SX(len(names), 0), *(c.T for c in columns))

    def solve(self, force: SX, rhs: SX) -> tuple[SX, SX, SX, SX]:
        """Change of the rates (n_q,), forces (n,) of all constraints, a basis N of their family, and regularity.

        Parameters
        ----------
        force : SX, shape (n_q,) - generalised force besides those of the contacts.
        rhs : SX, shape (n,) - required value of each constraint.
        """
        s, a, pivots = self.structure, self.active, _pivots(self.eom.walker, self.mode)
        kept, n = [*s.kept], len(self.active)
        J, G = self.rows[kept, a], self.columns[a, kept]
        M = self.eom.M[a, a]
        K = _bordered(M, J, G)
        solution, determinant = _eliminated(K, vertcat(force[a], rhs[kept]), pivots)
        _, frictionless = _eliminated(_bordered(M, J, self.rows[kept, a].T), SX.zeros(K.shape[0]), pivots)
        change, forces = SX.zeros(self.eom.M.shape[0]), SX.zeros(len(s.constraints))
        for k, index in enumerate(a):
            change[index] = solution[k]
        for k, index in enumerate(kept):
            forces[index] = solution[n + k]
        nulls = SX.zeros(len(s.constraints), len(s.dropped))
        if s.dropped:
            dropped = self.rows[[*s.dropped], :]
            J_all = self.rows[kept, :]
            weights, _ = _eliminated(J_all @ J_all.T, J_all @ dropped.T, [(k, k) for k in range(len(kept))])
            for j, index in enumerate(s.dropped):
                nulls[index, j] = 1
                for k, other in enumerate(kept):
                    nulls[other, j] = -weights[k, j]
        return change, forces, nulls, determinant / frictionless


def contact_motion(
    eom: EquationsOfMotion,
    mode: Mode,
    *,
    static: Mapping[str, SX],
    kinetic: Mapping[str, SX],
    viscous: Mapping[str, SX],
    springs: SX,
    torque: SX,
) -> ContactMotion:
    """Motion of the walker in a mode of its contacts.

    Parameters
    ----------
    static, kinetic, viscous : SX by contact - coefficients of friction; drag [N s/m].
    springs : SX, shape (n_q,) - gradient of the potential energy that acts in this mode only.
    torque : SX, shape (n_u,) - actuator torques u [N m].
    """
    system, contacts = _System(eom, mode, kinetic), eom.mechanism.contacts
    velocity = {name: jacobian(contacts[name].position, eom.q) @ eom.dq for name in eom.walker.contacts}
    convective = {name: jtimes(v, eom.q, eom.dq) for name, v in velocity.items()}
    drag = {name: -viscous[name] * velocity[name][0] for name in mode.touching if mode.directions[name]}
    force = eom.E @ torque - eom.B - eom.G - springs
    force += sum((system.J[name][0, :].T * value for name, value in drag.items()), SX.zeros(force.numel()))
    required = vertcat(SX(0, 1), *(-convective[name][row] for name, row in system.structure.constraints))
    ddq, values, nulls, regularity = system.solve(force, required)
    forces = _pairs(system, values, kinetic, drag)
    rates = SX(eom.dq)
    for k in set(range(rates.numel())) - {*system.active}:
        rates[k] = 0
    separations = {
        name: (jacobian(contacts[name].position[1], eom.q) @ ddq)[0] + convective[name][1]
        for name in eom.walker.contacts
        if name not in mode.touching
    }
    shares, undetermined = _shares(system, forces, nulls, static)
    return ContactMotion(
        dz=vertcat(_ordered(eom, rates), _ordered(eom, ddq)) * (1 if system.structure.is_determined else SX.nan()),
        forces=forces,
        separations=separations,
        regularity=regularity,
        shares=shares,
        undetermined=undetermined,
    )


def friction_of_shares(walker: type[Walker], mode: Mode, kinetic: Mapping[str, float]) -> Array:
    """What friction does to the walker where the shares of the forces change, shape (n_q, n): zero if nothing."""
    structure = constraint_structure(walker, mode)
    coefficients = np.array([kinetic[name] for name, _ in structure.constraints])
    return np.asarray((structure.drags * coefficients) @ structure.nulls)


def contact_impact(
    eom: EquationsOfMotion, mode: Mode, *, static: Mapping[str, SX], kinetic: Mapping[str, SX], landing: Sequence[str]
) -> ContactImpact:
    """The impact after which the contacts are in a mode; contacts that leave the ground have no impulse.

    Parameters
    ----------
    mode : just after the impact.
    static, kinetic : SX by contact - coefficients of friction.
    landing : the massless contacts that land: their coordinates take the values of ``Contact.places``.
    """
    system, contacts = _System(eom, mode, kinetic), eom.mechanism.contacts
    # coordinates without inertia have no momentum: their rates follow from the constraints alone
    required = -system.rows @ eom.dq
    change, values, nulls, regularity = system.solve(SX.zeros(eom.dq.numel()), required)
    impulses = _pairs(system, values, kinetic, {})
    after, names = eom.dq + change, (*eom.walker.shape, "x", "y")
    q = SX(eom.q)
    for name in landing:
        for key, value in contacts[name].places.items():
            q[names.index(key)] = value
    shares, undetermined = _shares(system, impulses, nulls, static)
    return ContactImpact(
        z_plus=vertcat(_ordered(eom, q), _ordered(eom, after)),
        impulses=impulses,
        velocities={name: jacobian(contacts[name].position, eom.q) @ after for name in eom.walker.contacts},
        regularity=regularity,
        shares=shares,
        undetermined=undetermined,
    )


def _ordered(eom: EquationsOfMotion, values: SX) -> SX:
    """Coordinates or rates (shape, x, y) in the order of the state."""
    n = len(eom.walker.shape)
    return eom.state(values[:n], values[n], values[n + 1])


def _pairs(system: _System, values: SX, kinetic: Mapping[str, SX], drag: Mapping[str, SX]) -> dict[str, SX]:
    """(f_t, f_n) by contact from the forces of the constraints; friction and drag give f_t of a slip."""
    pairs = {name: SX.zeros(2) for name in system.eom.walker.contacts}
    for k, (name, row) in enumerate(system.structure.constraints):
        pairs[name][row] = values[k]
        direction = system.mode.directions[name]
        if row and direction:
            pairs[name][0] = -direction * kinetic[name] * values[k] + drag.get(name, 0)
    return pairs


def _shares(
    system: _System, forces: Mapping[str, SX], nulls: SX, static: Mapping[str, SX]
) -> tuple[tuple[Share, ...], tuple[str, ...]]:
    """Margins of the groups of contacts whose forces are undetermined, and the contacts of these groups."""
    rows = share_margins(system.eom.walker, system.mode, forces, nulls, static)
    return tuple(Share(parts=parts, value=value) for parts, value in rows), system.structure.group


def share_margins(
    walker: type[Walker], mode: Mode, forces: Mapping[str, Any], nulls: Any, static: Mapping[str, Any]
) -> list[tuple[tuple[tuple[str, str], ...], Any]]:
    """Parts and value of the margins of contacts whose forces are undetermined, from numbers or symbols; see ``Share``.

    Parameters
    ----------
    forces : (f_t, f_n) by contact, one member of the family.
    nulls : basis N of the family, shape (n, number of dropped constraints), in the order of the constraints.
    static : coefficients of friction by contact.
    """
    structure = constraint_structure(walker, mode)
    rows = [
        row.with_values(*_row_of(structure, row.parts[0], forces[row.name], nulls, static[row.name]))
        for row in _inequalities(walker, mode)
    ]
    return [(row.parts, row.value) for row in _without_shares(structure, rows)]


@dataclass(frozen=True, slots=True)
class _Inequality:
    """g + c a > 0 in the shares a.

    Attributes
    ----------
    parts : see ``Share``.
    value, coefficients : g and c, numbers or symbols.
    sample, unlike : c at a sampled posture, with equal and with different coefficients of friction.
    """

    parts: tuple[tuple[str, str], ...]
    value: Any
    coefficients: Any
    sample: Array
    unlike: Array

    @property
    def name(self) -> str:
        """The first contact."""
        return self.parts[0][1]

    def with_values(self, value: Any, coefficients: Any) -> "_Inequality":
        """The same with g and c."""
        return replace(self, value=value, coefficients=coefficients)


@lru_cache(maxsize=256)
def _inequalities(walker: type[Walker], mode: Mode) -> tuple[_Inequality, ...]:
    """The inequalities of the contacts that share their forces, at the sampled posture, without their values."""
    structure = constraint_structure(walker, mode)
    kinds = {0: ("cone_forward", "cone_backward"), 1: ("normal_force",), -1: ("normal_force",)}
    rows = []
    for k, name in enumerate(structure.group):
        for kind in kinds[mode.directions[name]]:
            part = kind, name
            value, sample = _row_of(structure, part, (0.0, 0.0), structure.nulls, FRICTION_SAMPLE)
            _, unlike = _row_of(structure, part, (0.0, 0.0), structure.nulls, FRICTION_SAMPLE + 0.1 * k)
            rows.append(_Inequality((part,), value, sample, sample, unlike))
    return tuple(rows)


def _row_of(structure: Structure, part: tuple[str, str], force: Any, nulls: Any, mu: Any) -> tuple[Any, Any]:
    """Value and coefficients of one inequality, numbers or symbols."""
    index = {constraint: k for k, constraint in enumerate(structure.constraints)}
    kind, name = part
    normal = nulls[index[name, 1], :]
    if kind == "normal_force":
        return force[1], normal
    sign = 1 if kind == "cone_forward" else -1
    return mu * force[1] + sign * force[0], mu * normal + sign * nulls[index[name, 0], :]


def _without_shares(structure: Structure, rows: Sequence[_Inequality]) -> list[_Inequality]:
    """What remains of the inequalities when the shares are eliminated.

    One share after the other: in place of each pair of inequalities in which it has opposite signs comes the sum in
    which it cancels. Where its sign depends on which coefficient of friction is larger, the inequality must hold at
    that end of the share's range where it is easier to meet: the contact with more friction takes the load.
    """
    for k in range(len(structure.dropped)):
        rising, falling = ([row for row in rows if sign * row.sample[k] > DEPENDENT] for sign in (1, -1))
        turning = [row for row in rows if abs(row.sample[k]) <= DEPENDENT < abs(row.unlike[k])]
        rows = [row for row in rows if max(abs(row.sample[k]), abs(row.unlike[k])) <= DEPENDENT]
        for one, other in product(rising, falling):
            parts = _joined(one.parts, other.parts)
            (kind, name), (other_kind, other_name) = parts[0], parts[-1]
            if len(parts) == 2 and name == other_name and kind != other_kind:
                parts = (("normal_force", name),)  # the two edges of a cone: twice the friction that it provides
            c, other_c = one.coefficients, other.coefficients
            rows.append(
                _Inequality(
                    parts,
                    c[k] * other.value - other_c[k] * one.value,
                    c[k] * other_c - other_c[k] * c,
                    one.sample[k] * other.sample - other.sample[k] * one.sample,
                    one.unlike[k] * other.unlike - other.unlike[k] * one.unlike,
                )
            )
        for row, one, other in product(turning, rising, falling):
            c = row.coefficients[k]
            size = (c**2 + TINY) ** 0.5  # the absolute value, whose derivative is zero at zero
            low, high = (each.value / each.coefficients[k] for each in (one, other))  # less the ends of the range
            by_low, by_high = (each.coefficients / each.coefficients[k] for each in (one, other))
            ends, unlike = [one.unlike / one.unlike[k], other.unlike / other.unlike[k]], row.unlike[k]
            rows.append(
                _Inequality(
                    _joined(row.parts, (*one.parts, *other.parts)),
                    row.value - (c * (low + high) + size * (high - low)) / 2,
                    row.coefficients - (c * (by_low + by_high) + size * (by_high - by_low)) / 2,
                    row.sample,
                    row.unlike - (unlike * sum(ends) + abs(unlike) * (ends[1] - ends[0])) / 2,
                )
            )
    return list(rows)


def _joined(parts: tuple[tuple[str, str], ...], others: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """All parts, once each."""
    return tuple(dict.fromkeys((*parts, *others)))


def undetermined(walker: type[Walker], mode: Mode) -> tuple[str, ...]:
    """The contacts whose forces are undetermined in a mode, because they share them."""
    return constraint_structure(walker, mode).group


def shares_of(walker: type[Walker], mode: Mode) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Parts of the margins of the groups of contacts whose forces are undetermined; see ``Share``."""
    structure = constraint_structure(walker, mode)
    return tuple(row.parts for row in _without_shares(structure, _inequalities(walker, mode)))


FRICTION_SAMPLE = 0.37
"""Coefficient of friction at which the structure of a mode is examined."""
TINY = 1e-300


def _bordered(M: SX, J: SX, G: SX) -> SX:
    return vertcat(horzcat(M, -G), horzcat(J, SX.zeros(J.shape[0], J.shape[0])))


def _eliminated(K: SX, b: SX, pivots: Sequence[tuple[int, int]]) -> tuple[SX, SX]:
    """K^-1 b, and the determinant of K up to its sign, by elimination with given pivots."""
    A, rest, determinant = SX(K), SX(b), SX(1)
    remaining = [row for row, _ in pivots]
    for k, (row, column) in enumerate(pivots):
        determinant *= A[row, column]
        for other in remaining[k + 1 :]:
            if not A[other, column].is_zero():
                factor = A[other, column] / A[row, column]
                A[other, :] = A[other, :] - factor * A[row, :]
                A[other, column] = 0
                rest[other, :] = rest[other, :] - factor * rest[row, :]
    x = SX.zeros(*b.shape)
    for k, (row, column) in reversed(list(enumerate(pivots))):
        known = sum((A[row, later] * x[later, :] for _, later in pivots[k + 1 :] if not A[row, later].is_zero()), SX(0))
        x[column, :] = (rest[row, :] - known) / A[row, column]
    return x, determinant


def active_coordinates(walker: type[Walker], mode: Mode) -> list[int]:
    """Indices of the coordinates that move in a mode: all but those of massless contacts that are off."""
    contacts = equations_of_motion(walker).mechanism.contacts
    resting = {key for name in walker.contacts if name not in mode.touching for key in contacts[name].places}
    return [k for k, name in enumerate((*walker.shape, "x", "y")) if name not in resting]


@built_once(maxsize=64)
def _sampled(walker: type[Walker]) -> tuple[Function, NDArray[np.bool_]]:
    """(q, p) -> heights of all contacts, J with their rows t and n in turn, M; and which entries of J are constant."""
    eom = equations_of_motion(walker)
    positions = [contact.position for contact in eom.mechanism.contacts.values()]
    heights = vertcat(SX(0, 1), *(position[1] for position in positions))
    J = vertcat(SX(0, eom.q.numel()), *(jacobian(position, eom.q) for position in positions))
    fixed = np.array([[J[row, k].is_constant() for k in range(J.shape[1])] for row in range(J.shape[0])])
    return Function("contacts", [eom.q, eom.p], [densify(x) for x in (heights, J, eom.M)]), fixed


@lru_cache(maxsize=256)
def _postures(walker: type[Walker], touching: tuple[str, ...]) -> tuple[tuple[Array, Array], ...]:
    """J of all contacts and M at sampled postures in which some contacts are on the ground.

    Raises
    ------
    ProblemError
        If the contacts cannot be on the ground together, or a coordinate has no inertia.
    """
    sampled, fixed = _sampled(walker)
    places = [walker.contacts.index(name) for name in touching]
    rows = [row for k in places for row in (2 * k, 2 * k + 1)]
    (n_p,), n_q = sampled.size_in(1)[:1], fixed.shape[1]
    random, found = np.random.default_rng(0), list[tuple[Array, Array]]()
    for _ in range(20 * SAMPLES):
        p, place = random.uniform(0.5, 1.5, n_p), random.uniform(-0.3, 0.3, n_q)
        for _ in range(50):
            height, J, M = (np.asarray(value) for value in sampled(place, p))
            height, slope = height[places], J[[2 * k + 1 for k in places]]
            if not np.all(np.isfinite(slope)) or np.abs(height).max(initial=0.0) < ON_GROUND:
                break
            place = place - np.linalg.pinv(slope) @ height.ravel()
        if np.all(np.isfinite(J[rows])) and np.all(np.isfinite(M)) and np.abs(height).max(initial=0.0) < ON_GROUND:
            found.append((J, M))
        if len(found) == SAMPLES:
            break
    if not found:
        words = f"its contacts {', '.join(touching)} do not reach the ground together"
        raise ProblemError(f"{walker.__name__}: {words}")
    return tuple(found)


def _constraints(mode: Mode) -> tuple[tuple[str, int], ...]:
    """(contact, row) of the constraints of a mode, the normal ones first."""
    return (
        *((name, 1) for name in mode.touching),
        *((name, 0) for name in mode.touching if not mode.directions[name]),
    )


def _rows_and_columns(walker: type[Walker], mode: Mode, J: Array) -> tuple[Array, Array]:
    """Rows of the constraints of a mode, shape (n, n_q), and the columns of their forces with sampled friction."""
    place = {name: 2 * k for k, name in enumerate(walker.contacts)}
    constraints = _constraints(mode)
    rows = np.array([J[place[name] + row] for name, row in constraints]).reshape(-1, J.shape[1])
    slips = [row * mode.directions[name] * FRICTION_SAMPLE * J[place[name]] for name, row in constraints]
    return rows, (rows - np.array(slips).reshape(rows.shape)).T


@lru_cache(maxsize=1024)
def constraint_structure(walker: type[Walker], mode: Mode) -> Structure:
    """What the constraints of a mode depend on, from sampled postures in which its contacts are on the ground.

    Raises
    ------
    ProblemError
        If the contacts cannot be on the ground together, or a coordinate has no inertia.
    """
    active = active_coordinates(walker, mode)
    found = []
    for k, (J_all, _) in enumerate(_postures(walker, mode.touching)):
        J, G = _rows_and_columns(walker, mode, J_all)
        found.append(_dependence(_constraints(mode), J[:, active], G[active], k))
    return max(found, key=lambda one: sum(one.kept == other.kept for other in found))


def _dependence(constraints: tuple[tuple[str, int], ...], J: Array, G: Array, posture: int) -> Structure:
    """The structure at one posture.

    Parameters
    ----------
    J, G : rows, shape (n, n_q), and columns (n_q, n) of all constraints.
    """
    kept: list[int] = []
    basis = np.zeros((0, J.shape[1]))
    for k, row in enumerate(J):
        rest = row - basis.T @ (basis @ row)
        rest = rest - basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > DEPENDENT * np.linalg.norm(row):
            kept.append(k)
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
    dropped = [k for k in range(len(constraints)) if k not in kept]
    nulls = np.zeros((len(constraints), len(dropped)))
    for j, k in enumerate(dropped):
        nulls[k, j] = 1
        nulls[kept, j] = -np.linalg.lstsq(J[kept].T, J[k], rcond=None)[0]
    size = np.abs(G).max(initial=1.0)
    return Structure(
        constraints=constraints,
        kept=tuple(kept),
        dropped=tuple(dropped),
        is_determined=bool(np.abs(G @ nulls).max(initial=0.0) <= DEPENDENT * size),
        nulls=nulls,
        drags=(J.T - G) / FRICTION_SAMPLE,
        group=tuple(dict.fromkeys(constraints[k][0] for k in np.flatnonzero(np.abs(nulls).max(axis=1, initial=0.0)))),
        posture=posture,
    )


@lru_cache(maxsize=256)
def _pivots(walker: type[Walker], mode: Mode) -> tuple[tuple[int, int], ...]:
    """(row, column) of the entries by which the linear system of a mode is eliminated, in order.

    The pivots vanish in no posture. First come entries of J that are the same everywhere, each with its partner in G;
    what is left of M then is the mass matrix of a walker with fewer joints, whose pivots on the diagonal are positive.
    Those of the other constraints are effective masses, which vanish at redundant constraints and in the paradox of
    Painleve alone.
    """
    structure, active = constraint_structure(walker, mode), active_coordinates(walker, mode)
    kept, place = [*structure.kept], {name: 2 * k for k, name in enumerate(walker.contacts)}
    J_all, M_all = _postures(walker, mode.touching)[structure.posture]
    J, G = _rows_and_columns(walker, mode, J_all)
    J, G, M = J[:, active], G[active], M_all[np.ix_(active, active)]
    fixed = _sampled(walker)[1][[place[name] + row for name, row in structure.constraints]][:, active]
    K = np.block([[M, -G[:, kept]], [J[kept], np.zeros((len(kept), len(kept)))]])
    pivots, A, n = list[tuple[int, int]](), K.copy(), len(M)

    def eliminate(row: int, column: int) -> None:
        pivots.append((row, column))
        left = [other for other in range(len(A)) if other not in {row for row, _ in pivots}]
        A[left] -= np.outer(A[left, column] / A[row, column], A[row])

    def fill(row: int, column: int) -> int:  # Markowitz
        filled = np.abs(A[np.ix_(left, left)]) > DEPENDENT
        return int((filled[left.index(row)].sum() - 1) * (filled[:, left.index(column)].sum() - 1))

    left = list(range(len(K)))
    no_inertia = [c for c in range(n) if abs(M[c, c]) <= DEPENDENT * np.abs(M).max()]
    for columns in (no_inertia, range(n)):
        for force, k in enumerate(kept, start=n):
            if force not in left or not np.array_equal(J[k], G[:, k]):
                continue
            free = [c for c in columns if c in left and fixed[k, c] and A[force, c] == J[k, c] != 0]
            if len(kept) == n:  # the walker cannot move: its posture stays
                free = [
                    c for c in columns if c in left and abs(A[force, c]) > SMALL_PIVOT * np.abs(A[force, left]).max()
                ]
            if free:
                c = min(free, key=lambda c: fill(force, c))
                eliminate(force, c)
                eliminate(c, force)
                left = [other for other in left if other not in (force, c)]
    for coordinates in (True, False):
        while rest := [k for k in left if (k < n) is coordinates]:
            k = min(rest, key=lambda k: fill(k, k))
            eliminate(k, k)
            left.remove(k)
    return tuple(pivots)
