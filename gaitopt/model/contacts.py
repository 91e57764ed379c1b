"""Motion and plastic impacts of a walker whose contacts stick, slip or are off, and whose stops are free or locked.

r_i are the positions of the closed contacts, J_i = dr_i/dq with rows t and n, f_i their forces; g_j are the gaps of the
locked stops, which are affine in the shape, and l_j their forces:

    M ddq + B + G = E u + sum J_i' f_i + sum (dg_j/dq)' l_j                     Gamus & Or (2013), eq. (2)
    J_n,i ddq + dJ_n,i dq = 0                                  of every closed contact
    J_t,i ddq + dJ_t,i dq = 0                                  if it sticks      eq. (3)
    f_t,i = -s_i mu_i f_n,i - c_i v_t,i,   s_i = sgn v_t,i      if it slips       eq. (5)
    dg_j/dq ddq = 0                                            of every locked stop

This is one linear system in ddq, the normal forces, the forces of sticking contacts and those of the stops. With an s
between -1 and 1 its solution is the motion of a foot whose mode is unknown.

**One foot.** A walker that stands on one foot at a time has the contacts ``foot``, at (x, y), and ``swing_foot``, which
swap roles at touchdown. With the shape eliminated, its equation along the ground while it slips is

    (C_tt + mu s C_nt) ddx = -(f_t + mu s f_n)_stick - c dx         C = (W M^-1 W')^-1, the apparent mass of the foot

The factor, det(C) w_n' M^-1 Gamma of eq. (6), is the last pivot of the elimination. If it is not positive, the slip has
no unique solution (Painleve's paradox).

**Impacts.** The equations of an impact that leads to a mode have impulses instead of forces, and J dq_plus instead of
accelerations:

    M (dq_plus - dq_minus) = sum J_i' F_i + sum (dg_j/dq)' L_j                  eq. (8)

    stick               v_plus = 0                                         eq. (9)
    slip, coulomb       F_t = -mu s F_n,  v_n_plus = 0,  s = sgn v_t_plus  eq. (11)
    slip, frictionless  F_t = 0,          v_n_plus = 0

Contacts that are off afterwards have no impulse. The unknowns of the equations contain the velocity v of a closed
contact instead of that of (x, y), so that the mass matrix is a sum over positions relative to this contact. Then no
inverse of M is needed, which is singular for walkers with a single point mass, and the inertia of a light leg is not
lost in the rounding of a heavy hip.

**Redundant constraints.** The derivatives of the closed contacts may depend on each other while the contacts are on the
ground: two sticking contacts of one rigid part have the same tangential constraint. They are recognised by their pivots
at a posture of the mode. A constraint that depends on the ones before it is left out. The forces then are a family

    lambda = lambda_0 + N a,      J' N = 0

all members of which move the walker alike. The mode holds as long as one of them lies in all friction cones. The
margins of the mode do not contain a: Fourier and Motzkin's elimination leaves the sums in which it cancels, such as

    (mu_1 f_n,1 + f_t,1) + (mu_2 f_n,2 + f_t,2) > 0

of two contacts that stick together. If forces of the family would move the walker differently (contacts of different
friction that slip as one), the motion of the mode is not determined.

**Massless contacts.** A contact at the end of a massless part has coordinates of its own, without inertia. While it is
closed, the equations of these coordinates determine its force; while it is off, the coordinates keep their values. It
sticks, or is off. In the flight of a walker with massless feet its bodies fall, but (x, y) do not change.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from casadi import (
    DM,
    SX,
    Function,
    densify,
    det,
    dot,
    horzcat,
    jacobian,
    solve,
    sparsify,
    substitute,
    triu,
    triu2symm,
    vertcat,
    vertsplit,
)

from gaitopt.arrays import Array
from gaitopt.building import building, built_once
from gaitopt.errors import ProblemError
from gaitopt.model.declaration import is_default, parameter_namespace, state_landing
from gaitopt.model.lagrangian import EquationsOfMotion, equations_of_motion
from gaitopt.model.modes import FOOT, Mode
from gaitopt.model.walker import Walker

TANGENTIAL, NORMAL, LOCKED = 0, 1, 2
"""Kinds of constraints: the rows t and n of a contact, and the constraint of a stop."""
SAMPLES = 5
"""Number of postures at which dependent constraints are sought; they are the same ones unless a posture is singular."""
LARGEST_REMAINDER = 1e-7
"""A constraint whose remainder is no larger than this, relative to itself, depends on those before it."""
ON_GROUND = 1e-12
"""Largest height of a closed contact of a sampled posture, relative to the walker's size."""
Constraint: TypeAlias = tuple[str, int]
"""Name of the contact or stop, and kind of the constraint."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """The dependence of the constraints of a mode on each other, which is the same in every posture of the mode.

    Attributes
    ----------
    constraints : constraints of the mode in order: normal ones, tangential ones, those of stops.
    kept : indices of the independent constraints.
    dropped : indices of the constraints that depend on the ones before them.
    is_determined : whether the motion does not depend on the shares of the forces, if all contacts have the same
        friction.
    nulls : ndarray, shape (n, len(dropped)) - a sample of N: the signs of its entries hold in every posture.
    drags : ndarray, shape (n_q, n) - sampled tangential directions of the constraints whose forces cause friction.
    group : the contacts whose forces are undetermined.
    """

    constraints: tuple[Constraint, ...]
    kept: tuple[int, ...]
    dropped: tuple[int, ...]
    is_determined: bool
    nulls: Array
    drags: Array
    group: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A margin of a group of contacts whose shares of the forces are undetermined: a sum of margins of its contacts.

    Attributes
    ----------
    parts : (kind of margin, contact) of each term; the kind is ``cone_forward``, ``cone_backward`` or ``normal_force``.
    value : SX - the sum with positive weights in which the shares cancel.
    """

    parts: tuple[tuple[str, str], ...]
    value: SX


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """Coefficients of friction by contact, as numbers or symbols.

    Attributes
    ----------
    static, kinetic : coefficients of a sticking and of a slipping contact.
    viscous : additional drag of a slipping contact [N s/m].
    """

    static: Mapping[str, SX]
    kinetic: Mapping[str, SX]
    viscous: Mapping[str, SX]


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Accelerations and contact forces in one mode.

    Attributes
    ----------
    dz : SX, shape (n_z,) - rate of the state; NaN if the motion of the mode is not determined.
    forces : SX, shape (2,), by contact - (f_t, f_n) [N]; zero if it is off, one of many if it is not determined.
    regularity : SX - determinant of the linear system relative to that without friction. It is not positive in the
        paradox of Painleve. For a single foot that slips, the apparent mass takes its place.
    apparent_mass : SX - C_tt + mu s C_nt of the single foot that slips [kg]; NaN otherwise.
    shares : margins of the groups of contacts whose forces are undetermined.
    """

    dz: SX
    forces: Mapping[str, SX]
    regularity: SX
    apparent_mass: SX
    shares: tuple[Share, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """One impact as a function of the state just before it.

    Attributes
    ----------
    q, dq : SX, shape (n_q,) - coordinates (shape, x, y) and rates just after it, before any relabelling.
    impulses : SX, shape (2,), by contact - (F_t, F_n) [N s]; zero if it is off afterwards.
    velocities : SX, shape (2,), by contact - (v_t, v_n) just after it [m/s].
    regularity, apparent_mass, shares : see ``Motion``.
    """

    q: SX
    dq: SX
    impulses: Mapping[str, SX]
    velocities: Mapping[str, SX]
    regularity: SX
    apparent_mass: SX
    shares: tuple[Share, ...]


@dataclass(frozen=True, slots=True)
class _Solution:
    """Change of the rates (n_q,), forces (n,) of all constraints and a basis N of their family; see ``Motion``."""

    change: SX
    forces: SX
    nulls: SX
    regularity: SX
    apparent_mass: SX


class _Constraints:
    """The closed contacts and locked stops of one mode, and the friction of those that slip.

    Parameters
    ----------
    base : the contact whose velocity is an unknown instead of that of (x, y); None for (x, y).
    """

    def __init__(
        self,
        eom: EquationsOfMotion,
        mode: Mode,
        kinetic: Mapping[str, SX],
        *,
        base: str | None = None,
    ) -> None:
        self.eom, self.mode, self.structure = eom, mode, constraint_structure(eom.walker, mode)
        self.friction = {name: mode.directions[name] * kinetic[name] for name in mode.touching}
        self.slipping = tuple(name for name in mode.touching if mode.directions[name])
        n, self.M = len(eom.walker.shape), eom.M
        self.J = {name: eom.contacts[name].J for name in mode.touching}
        if base is not None:
            self.M = _inertia_about(eom, base)
            relative = horzcat(eom.contacts[base].nominal_J[:, :n], SX.zeros(2, 2))
            self.J = {
                name: horzcat(SX.zeros(2, n), eom.contacts[name].R)
                if name == base
                else J - (eom.contacts[name].R @ relative if eom.contacts[name].is_tilted else relative)
                for name, J in self.J.items()
            }
        rows, columns = [SX(0, n + 2)], [SX(n + 2, 0)]
        for name, kind in self.structure.constraints:
            row = eom.gaps[name] if kind == LOCKED else self.J[name][kind, :]
            rows.append(row)
            columns.append((row - self.friction[name] * self.J[name][0, :] if kind == NORMAL else row).T)
        self.rows, self.columns = vertcat(*rows), horzcat(*columns)

    def solve(self, force: SX, required: SX) -> _Solution:
        """Accelerations or changes of the rates, and forces or impulses.

        Parameters
        ----------
        force : SX, shape (n_q,) - generalised force without those of the constraints.
        required : SX, shape (n,) - required value of each constraint.
        """
        s, active = self.structure, active_coordinates(self.eom.walker, self.mode)
        kept, n = [*s.kept], len(active)
        M, J, G = self.M[active, active], self.rows[kept, active], self.columns[active, kept]
        change, forces = SX.zeros(self.M.shape[0]), SX.zeros(len(s.constraints))
        b = vertcat(force[active], required[kept])
        if len(kept) == n:  # the walker cannot move
            found = solve(J, required[kept])
            multipliers, pivots = solve(G, M @ found - force[active]), list[SX]()
            regularity = det(G) / det(J)
        else:
            bilateral = [k for k, index in enumerate(kept, start=n) if s.constraints[index][1] == LOCKED]
            sliding = {k: s.constraints[index][0] for k, index in enumerate(kept, start=n) if self._slides(index)}
            steady = {
                k: [c for c in range(n) if not self.J[name][TANGENTIAL, active[c]].is_zero()]
                for k, name in sliding.items()
                if self.J[name].is_constant()
            }
            K = _bordered(M, J, G)
            order, symmetric = _pivots(K, n, bilateral, [*sliding], steady)
            solution, pivots = _eliminated(K, b, order, symmetric)
            found, multipliers, regularity = solution[:n], solution[n:], SX(1)
            if sliding and self.eom.walker.contacts:
                _, frictionless = _eliminated(_bordered(M, J, J.T), b, order, symmetric)
                for pivot, other in zip(pivots, frictionless, strict=True):
                    regularity *= pivot / other
        for k, index in enumerate(active):
            change[index] = found[k]
        for k, index in enumerate(kept):
            forces[index] = multipliers[k]
        is_one_foot = not self.eom.walker.contacts and self.mode.slips
        return _Solution(change, forces, self._family(kept), regularity, pivots[-1] if is_one_foot else SX.nan())

    def pairs(self, values: SX, drag: Mapping[str, SX]) -> dict[str, SX]:
        """(f_t, f_n) by contact from the forces of the constraints; f_t of a slip is that of friction and drag."""
        pairs = {name: SX.zeros(2) for name in self.eom.contacts}
        for k, (name, kind) in enumerate(self.structure.constraints):
            if kind == LOCKED:
                continue
            pairs[name][kind] = values[k]
            if self._slides(k):
                pairs[name][TANGENTIAL] = -self.friction[name] * values[k] + drag.get(name, 0)
        return pairs

    def _slides(self, index: int) -> bool:
        """Whether a constraint is the normal one of a contact that slips."""
        name, kind = self.structure.constraints[index]
        return kind == NORMAL and name in self.slipping

    def shares(self, forces: Mapping[str, SX], nulls: SX, static: Mapping[str, SX]) -> tuple[Share, ...]:
        """Margins of the groups of contacts whose forces are undetermined."""
        rows = share_margins(self.eom.walker, self.mode, forces, nulls, static)
        return tuple(Share(parts=parts, value=value) for parts, value in rows)

    def _family(self, kept: list[int]) -> SX:
        """A basis N of the forces that move the walker alike, shape (n, number of dropped constraints)."""
        s = self.structure
        nulls = SX.zeros(len(s.constraints), len(s.dropped))
        if s.dropped:
            J = self.rows[kept, :]
            gram = J @ J.T
            dropped = self.rows[[*s.dropped], :]
            weights, _ = _eliminated(gram, J @ dropped.T, [(k, k) for k in range(len(kept))], range(len(kept)))
            for j, index in enumerate(s.dropped):
                nulls[index, j] = 1
                for k, other in enumerate(kept):
                    nulls[other, j] = -weights[k, j]
        return nulls


def motion(
    eom: EquationsOfMotion,
    mode: Mode,
    friction: Friction,
    *,
    springs: SX,
    torque: SX,
) -> Motion:
    """Motion of the walker in a mode.

    Parameters
    ----------
    springs : SX, shape (n_q,) - gradient of the potential energy that acts in this mode only.
    torque : SX, shape (n_u,) - actuator torques u [N m].
    """
    walker = eom.walker
    system = _Constraints(eom, mode, friction.kinetic)
    drag = {name: -friction.viscous[name] * eom.contacts[name].velocity[0] for name in system.slipping}
    force = eom.E @ torque - eom.B - eom.G - springs
    force += sum((system.J[name][0, :].T * value for name, value in drag.items()), SX.zeros(force.numel()))
    kinds = system.structure.constraints
    convective = (SX(0) if kind == LOCKED else eom.contacts[name].convective[kind] for name, kind in kinds)
    found = system.solve(force, -vertcat(SX(0, 1), *convective))
    forces, rates = system.pairs(found.forces, drag), SX(eom.dq)
    for k in {*range(rates.numel())} - {*active_coordinates(walker, mode)}:
        rates[k] = 0
    if mode.touching and not walker.contacts:  # rounding of the rates must not move the foot off the ground
        R = eom.contacts[FOOT].R
        rates[-2] = rates[-2] if system.slipping else 0
        rates[-1] = -R[1, 0] / R[1, 1] * rates[-2] if eom.contacts[FOOT].is_tilted else 0
    dz = vertcat(ordered(eom, rates), ordered(eom, found.change))
    return Motion(
        dz=dz if system.structure.is_determined else dz * SX.nan(),
        forces=forces,
        regularity=found.regularity,
        apparent_mass=found.apparent_mass,
        shares=system.shares(forces, found.nulls, friction.static),
    )


def friction_of_shares(walker: type[Walker], mode: Mode, kinetic: Mapping[str, float]) -> Array:
    """Generalised forces of friction by a change of the shares, shape (n_q, n); zero if they do not depend on these."""
    structure = constraint_structure(walker, mode)
    coefficients = np.array([0.0 if kind == LOCKED else kinetic[name] for name, kind in structure.constraints])
    return np.asarray((structure.drags * coefficients) @ structure.nulls)


def impact(
    eom: EquationsOfMotion,
    mode: Mode,
    friction: Friction,
    *,
    before: SX | None = None,
    places: Sequence[str] = (),
) -> Impact:
    """The impact after which the walker is in a mode; contacts that leave the ground, and free stops, have no impulse.

    Parameters
    ----------
    mode : mode just after the impact, with the names that the contacts have before it.
    before : SX, shape (n_q,) - rates just before it; by default those of the state.
    places : the massless contacts that land; their coordinates take the values of ``Contact.places``.
    """
    n, dq = len(eom.walker.shape), eom.dq if before is None else before
    base = next((name for name in mode.touching if name not in eom.walker.placed_contacts()), None)
    system = _Constraints(eom, mode, friction.kinetic, base=base)
    v = dq if base is None else vertcat(dq[:n], eom.contacts[base].nominal_J @ dq)
    # coordinates without inertia have no momentum: their rates follow from the constraints only
    found = system.solve(SX.zeros(v.numel()), -system.rows @ v)
    impulses, after = system.pairs(found.forces, {}), v + found.change
    velocities = dict[str, SX]()
    if base is not None:
        of_base, at_rest = eom.contacts[base], [kind for name, kind in system.structure.constraints if name == base]
        velocity = of_base.R @ after[n:] if of_base.is_tilted else after[n:]
        for kind in at_rest:
            velocity[kind] = 0  # without the rounding of the sum
        velocities[base] = velocity
        nominal = of_base.R.T @ velocity if of_base.is_tilted else velocity
        after = vertcat(after[:n], nominal - of_base.nominal_J[:, :n] @ after[:n])
    for name, contact in eom.contacts.items():
        velocities.setdefault(name, contact.J @ after)
    q, names = SX(eom.q), (*eom.walker.shape, "x", "y")
    for name in places:
        for key, value in eom.mechanism.contacts[name].places.items():
            q[names.index(key)] = value
    return Impact(
        q=q,
        dq=after,
        impulses=impulses,
        velocities=velocities,
        regularity=found.regularity,
        apparent_mass=found.apparent_mass,
        shares=system.shares(impulses, found.nulls, friction.static),
    )


def push_off(eom: EquationsOfMotion, mode: Mode, pushing: Sequence[str]) -> tuple[SX, SX]:
    """Rates just after the walker has pushed off with some contacts, shape (n_q,), and the work of the push [J].

    M (dq_plus - dq_minus) = sum J_i' P_i + sum (dg_j/dq)' L_j

    No other contact has an impulse: those that the push drives into the ground take part in the impact that follows.

    Parameters
    ----------
    mode : mode with all contacts off, and the stops that are locked during the push.
    pushing : the contacts that push off.
    """
    if not pushing:
        return eom.dq, SX(0)
    system, points, pushes = _Constraints(eom, mode, {}), eom.contacts, eom.mechanism.pushes
    force = sum((points[name].nominal_J.T @ pushes[name] for name in pushing), SX.zeros(eom.q.numel()))
    change = system.solve(force, SX.zeros(len(system.structure.constraints))).change
    work = sum((dot(pushes[name], points[name].nominal_J @ (eom.dq + change / 2)) for name in pushing), SX(0))
    return eom.dq + change, work


def massless_landing(eom: EquationsOfMotion) -> tuple[SX, SX]:
    """Shape and its rates just after a massless foot has landed, which sticks.

    Unless the class defines ``Walker.landing``, the bodies move on as they did, as those of walkers with massless
    contacts do: with their velocities v and the new shape s,  J' m J ds/dt = J' m v.
    """
    names, n = (*eom.walker.shape, "x", "y"), len(eom.walker.shape)
    if not is_default(eom.walker, "landing"):
        q, dq = (SimpleNamespace(**dict(zip(names, vertsplit(values), strict=True))) for values in (eom.q, eom.dq))
        return state_landing(eom.walker, q, dq, parameter_namespace(eom.walker, eom.p))
    shape, inertia, momentum = SX(eom.mechanism.relabel), SX.zeros(n, n), SX.zeros(n)
    for body in eom.mechanism.bodies:
        for mass, coordinate in ((body.mass, body.position), (body.inertia, SX(body.angle))):
            before = jacobian(coordinate, eom.q[:n])
            after = substitute(before, eom.q[:n], shape)
            inertia += mass * (after.T @ after)
            momentum += mass * (after.T @ (before @ eom.dq[:n]))
    return shape, solve(inertia, momentum)


def ordered(eom: EquationsOfMotion, values: SX) -> SX:
    """Coordinates or rates (shape, x, y) in the order of the state."""
    n = len(eom.walker.shape)
    return eom.state(values[:n], values[n], values[n + 1])


def _inertia_about(eom: EquationsOfMotion, contact: str) -> SX:
    """Mass matrix in the shape rates and the velocity of a contact, shape (n_q, n_q)."""
    n = len(eom.walker.shape)
    shape = eom.q[:n]
    coupling, inertia = SX.zeros(2, n), SX.zeros(n, n)
    for body in eom.mechanism.bodies:
        arm = jacobian(body.position - eom.contacts[contact].position, shape)
        turn = jacobian(SX(body.angle), shape)
        coupling += body.mass * arm
        inertia += body.mass * (arm.T @ arm) + body.inertia * (turn.T @ turn)
    return triu2symm(triu(vertcat(horzcat(inertia, coupling.T), horzcat(coupling, eom.mass * SX.eye(2)))))


def share_margins(
    walker: type[Walker], mode: Mode, forces: Mapping[str, Any], nulls: Any, static: Mapping[str, Any]
) -> list[tuple[tuple[tuple[str, str], ...], Any]]:
    """Parts and value of the margins of contacts whose forces are undetermined, from numbers or symbols; see ``Share``.

    Parameters
    ----------
    forces : (f_t, f_n) by contact of one member of the family.
    nulls : basis N of the family, shape (n, number of dropped constraints), in the order of the constraints.
    static : coefficients of friction by contact.
    """
    structure = constraint_structure(walker, mode)
    rows = list[_Inequality]()
    for row in _inequalities(walker, mode):
        name = row.parts[0][1]
        value, coefficients = _row_of(structure, row.parts[0], forces[name], nulls, static[name])
        rows.append(replace(row, value=value, coefficients=coefficients))
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


@lru_cache(maxsize=256)
def _inequalities(walker: type[Walker], mode: Mode) -> tuple[_Inequality, ...]:
    """The inequalities of the contacts that share their forces at the sampled posture, without their values."""
    structure = constraint_structure(walker, mode)
    kinds = {0: ("cone_forward", "cone_backward"), 1: ("normal_force",), -1: ("normal_force",)}
    rows = []
    for k, name in enumerate(structure.group):
        for kind in kinds[mode.directions[name]]:
            margin = kind, name
            value, sample = _row_of(structure, margin, (0.0, 0.0), structure.nulls, FRICTION_SAMPLE)
            _, unlike = _row_of(structure, margin, (0.0, 0.0), structure.nulls, FRICTION_SAMPLE + 0.1 * k)
            rows.append(_Inequality((margin,), value, sample, sample, unlike))
    return tuple(rows)


def _row_of(structure: Structure, margin: tuple[str, str], force: Any, nulls: Any, mu: Any) -> tuple[Any, Any]:
    """Value and coefficients of one inequality, numbers or symbols."""
    index = {constraint: k for k, constraint in enumerate(structure.constraints)}
    kind, name = margin
    normal = nulls[index[name, 1], :]
    if kind == "normal_force":
        return force[1], normal
    sign = 1 if kind == "cone_forward" else -1
    return mu * force[1] + sign * force[0], mu * normal + sign * nulls[index[name, 0], :]


def _without_shares(structure: Structure, rows: Sequence[_Inequality]) -> list[_Inequality]:
    """The inequalities that remain when the shares are eliminated, one share after the other.

    The sum in which a share cancels replaces each pair of inequalities in which it has opposite signs. If its sign
    depends on which coefficient of friction is larger, the inequality must hold at that end of the share's range at
    which it is easier to meet: the contact with more friction takes the load.
    """
    for k in range(len(structure.dropped)):
        rising, falling = ([row for row in rows if sign * row.sample[k] > LARGEST_REMAINDER] for sign in (1, -1))
        turning = [row for row in rows if abs(row.sample[k]) <= LARGEST_REMAINDER < abs(row.unlike[k])]
        rows = [row for row in rows if max(abs(row.sample[k]), abs(row.unlike[k])) <= LARGEST_REMAINDER]
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
            low, high = (each.value / each.coefficients[k] for each in (one, other))  # minus the ends of the range
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
    """The parts of both groups in order, without repetitions."""
    return tuple(dict.fromkeys((*parts, *others)))


def undetermined(walker: type[Walker], mode: Mode) -> tuple[str, ...]:
    """The contacts whose forces are undetermined in a mode, because they share them."""
    return constraint_structure(walker, mode).group


def undetermined_groups(walker: type[Walker], mode: Mode) -> tuple[tuple[str, ...], ...]:
    """The contacts whose forces are undetermined in a mode, in groups that share no forces with each other."""
    structure, groups = constraint_structure(walker, mode), list[set[str]]()
    for column in structure.nulls.T:
        names = {structure.constraints[k][0] for k in np.flatnonzero(column)}
        names |= set().union(*(group for group in groups if group & names))
        groups = [*(group for group in groups if not group & names), names]
    touching = (tuple(name for name in mode.touching if name in group) for group in groups)
    return tuple(names for names in touching if names)  # stops may share forces among themselves


def sharing_contacts(walker: type[Walker], mode: Mode) -> tuple[tuple[str, ...], ...]:
    """The contacts on the ground, each alone but for those that share undetermined forces, which come first."""
    groups = undetermined_groups(walker, mode)
    alone = [name for name in mode.touching if not any(name in group for group in groups)]
    return (*groups, *((name,) for name in alone))


def shares_of(walker: type[Walker], mode: Mode) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Margins that each margin of a group with undetermined forces combines; see ``Share``."""
    structure = constraint_structure(walker, mode)
    return tuple(row.parts for row in _without_shares(structure, _inequalities(walker, mode)))


FRICTION_SAMPLE = 0.37
"""Coefficient of friction at which the structure of a mode is examined."""
TINY = 1e-300
"""Number that is added to a square so that its root has a derivative at zero."""


def _bordered(M: SX, J: SX, G: SX) -> SX:
    return vertcat(horzcat(M, -G), horzcat(J, SX.zeros(J.shape[0], J.shape[0])))


def _pivots(
    K: SX, n: int, bilateral: Sequence[int], sliding: Sequence[int], steady: Mapping[int, Sequence[int]]
) -> tuple[list[tuple[int, int]], list[int]]:
    """(row, column) of the pivots with which the linear system of a mode is eliminated, in order.

    The pivots vanish in no posture. First come entries of J that are the same in all postures, each with its partner in
    G. The rest of M is then the mass matrix of a walker with fewer joints, whose pivots on the diagonal are positive.
    The pivots of the other constraints are effective masses, which vanish only at redundant constraints and in the
    paradox of Painleve. If the normal constraint of a slipping contact is the same in all postures, the coordinate
    along which it slips comes last: its pivot is the apparent mass of the contact.

    Parameters
    ----------
    n : number of coordinates; the constraints come after them.
    bilateral, sliding : indices of the constraints of stops, and of the normal constraints of contacts that slip.
    steady : the constraints of ``sliding`` whose contact has the same Jacobian in all postures, each with the
        coordinates along which it slips.

    Returns
    -------
    order : the pivots.
    symmetric : the coordinates whose block remains symmetric.
    """
    N = K.shape[0]
    filled = np.asarray(DM.ones(sparsify(K).sparsity())).astype(bool)
    constant = np.array([[K[row, column].is_constant() for column in range(N)] for row in range(N)])
    order, left, late = list[tuple[int, int]](), list(range(N)), set[int]()

    def eliminate(row: int, column: int) -> None:
        order.append((row, column))
        changed = np.ix_(filled[:, column], filled[row])
        filled[changed], constant[changed] = True, False
        filled[row] = filled[:, column] = False

    def fill(row: int, column: int) -> int:  # Markowitz
        return int((filled[:, column].sum() - 1) * (filled[row].sum() - 1))

    def are_partners(force: int, c: int) -> bool:
        is_fixed = filled[force, c] and constant[force, c] and constant[c, force]
        return bool(is_fixed and float(K[force, c]) == -float(K[c, force]) != 0)

    no_inertia = [c for c in range(n) if not filled[c, c]]
    for columns in (no_inertia, range(n)):
        for force in (k for k in range(n, N) if k in left):
            if force in sliding and force not in steady:
                continue
            free = [c for c in columns if c in left and are_partners(force, c)]
            if free:
                c = min(free, key=lambda c: fill(force, c))
                late |= {*steady.get(force, ())} - {c}
                eliminate(force, c)
                eliminate(c, force)
                left = [other for other in left if other not in (force, c)]
    symmetric = [k for k in range(n) if k not in late]
    for group in (symmetric, bilateral, sorted(late), range(n, N)):
        while rest := [k for k in left if k in group]:
            k = min(rest, key=lambda k: fill(k, k))
            eliminate(k, k)
            left.remove(k)
    return order, symmetric


def _eliminated(K: SX, b: SX, order: Sequence[tuple[int, int]], symmetric: Sequence[int]) -> tuple[SX, list[SX]]:
    """K^-1 b by elimination, and the pivots; for ``order`` and ``symmetric`` see ``_pivots``."""
    A, rest, pivots, changed = SX(K), SX(b), list[SX](), set[int]()
    for k, (row, column) in enumerate(order):
        pivots.append(A[row, column])
        left = [other for _, other in order[k + 1 :]]
        others = [other for other, _ in order[k + 1 :] if not A[other, column].is_zero()]
        if others:
            factors = A[others, column] / A[row, column]
            A[others, left] = A[others, left] - factors @ A[row, left]
            rest[others, :] = rest[others, :] - factors @ rest[row, :]
        changed |= {other for other in others if other in symmetric}
        if row == column or (k and order[k - 1] == (column, row)):  # otherwise its partner follows
            block = sorted(changed - {row})
            A[block, block] = triu2symm(triu(A[block, block]))  # the same expressions on both sides
            changed = set()
    x = SX.zeros(*b.shape)
    for k, (row, column) in reversed(list(enumerate(order))):
        left = [other for _, other in order[k + 1 :]]
        known = A[row, left] @ x[left, :] if left else SX(0)
        x[column, :] = (rest[row, :] - known) / A[row, column]
    return x, pivots


def active_coordinates(walker: type[Walker], mode: Mode) -> list[int]:
    """Indices of the coordinates that move in a mode: all but those of massless contacts that are off."""
    contacts, off = equations_of_motion(walker).mechanism.contacts, {*walker.weightless()} - {*mode.touching}
    resting = {key for name in off & {*walker.placed_contacts()} for key in contacts[name].places}
    if walker.base_contact() in off:
        resting = {"x", "y"}
    return [k for k, name in enumerate((*walker.shape, "x", "y")) if name not in resting]


@built_once(maxsize=64)
def _sampled(walker: type[Walker]) -> Function:
    """(q, p) -> heights of all contacts, and J with their rows t and n in turn, followed by those of the stops."""
    eom = equations_of_motion(walker)
    heights = vertcat(SX(0, 1), *(contact.position[1] for contact in eom.contacts.values()))
    J = vertcat(SX(0, eom.q.numel()), *(contact.J for contact in eom.contacts.values()), *eom.gaps.values())
    q = SX.sym("q", eom.q.numel())
    at = [substitute(densify(x), eom.z[: len(walker.coordinates())], ordered(eom, q)) for x in (heights, J)]
    return Function("contacts", [q, eom.p], at)


@lru_cache(maxsize=256)
def _postures(walker: type[Walker], touching: tuple[str, ...]) -> tuple[Array, ...]:
    """J of all contacts and stops at sampled postures in which some contacts are on the ground.

    Raises
    ------
    ProblemError
        If the contacts cannot be on the ground together.
    """
    sampled, names = _sampled(walker), [*equations_of_motion(walker).contacts]
    chosen = [names.index(name) for name in touching]
    rows = [row for k in chosen for row in (2 * k, 2 * k + 1)]
    n_q, n_p = sampled.size1_in(0), sampled.size1_in(1)
    random, found = np.random.default_rng(0), list[Array]()
    for _ in range(20 * SAMPLES):
        p, posture = random.uniform(0.5, 1.5, n_p), random.uniform(-0.3, 0.3, n_q)
        for _ in range(50):
            height, J = (np.asarray(value) for value in sampled(posture, p))
            height, slope = height[chosen], J[[2 * k + 1 for k in chosen]]
            if not np.all(np.isfinite(slope)) or np.abs(height).max(initial=0.0) < ON_GROUND:
                break
            posture = posture - np.linalg.pinv(slope) @ height.ravel()
        if np.all(np.isfinite(J[rows])) and np.abs(height).max(initial=0.0) < ON_GROUND:
            found.append(J)
        if len(found) == SAMPLES:
            break
    if not found:
        raise ProblemError(f"{walker.__name__}: its contacts {', '.join(touching)} do not reach the ground together")
    return tuple(found)


def constraint_rows(walker: type[Walker], constraints: Iterable[Constraint]) -> list[int]:
    """Indices of the rows of constraints in the Jacobian of all contacts (t and n in turn), followed by stops."""
    names = walker.landing_points()
    contacts = {name: 2 * k for k, name in enumerate(names)}
    stops = {name: 2 * len(names) + k for k, name in enumerate(walker.stops)}
    return [stops[name] if kind == LOCKED else contacts[name] + kind for name, kind in constraints]


def _constraints(mode: Mode) -> tuple[Constraint, ...]:
    """The constraints of a mode, the normal ones first."""
    return (
        *((name, NORMAL) for name in mode.touching),
        *((name, TANGENTIAL) for name in mode.touching if not mode.directions[name]),
        *((name, LOCKED) for name in mode.locked),
    )


@lru_cache(maxsize=1024)
def constraint_structure(walker: type[Walker], mode: Mode) -> Structure:
    """The dependence of the constraints of a mode on each other, from sampled postures with its contacts on the ground.

    Raises
    ------
    ProblemError
        If the contacts cannot be on the ground together.
    """
    active, eom, constraints = active_coordinates(walker, mode), equations_of_motion(walker), _constraints(mode)
    is_point = len(mode.touching) == 1 and not mode.locked  # which can move in every direction
    if is_point or _is_independent(eom, constraints, active):
        n = len(constraints)
        return Structure(
            constraints=constraints,
            kept=tuple(range(n)),
            dropped=(),
            is_determined=True,
            nulls=np.zeros((n, 0)),
            drags=np.zeros((len(active), n)),
            group=(),
        )
    names, stops = [*eom.contacts], [*eom.gaps]
    found = list[Structure]()
    for J_all in _postures(walker, mode.touching):
        at = [
            J_all[2 * len(names) + stops.index(name) if kind == LOCKED else 2 * names.index(name) + kind]
            for name, kind in constraints
        ]
        J = np.array(at).reshape(len(constraints), -1)
        drags = [
            mode.directions[name] * J_all[2 * names.index(name)] if kind == NORMAL else np.zeros(J.shape[1])
            for name, kind in constraints
        ]
        found.append(_dependence(constraints, J[:, active], np.array(drags).reshape(J.shape)[:, active].T))
    return max(found, key=lambda one: sum(one.kept == other.kept for other in found))


@building
def _is_independent(eom: EquationsOfMotion, constraints: Sequence[Constraint], active: Sequence[int]) -> bool:
    """Whether constraints are independent in every posture, because their entries that are constant already are.

    This is true for stops with constant derivatives. Velocities are taken relative to the first contact.
    """
    base = next((name for name, kind in constraints if kind == NORMAL), None)
    n = len(eom.walker.shape)
    rows = [SX(0, n + 2)]
    for name, kind in constraints:
        row = eom.gaps[name] if kind == LOCKED else eom.contacts[name].J[kind, :]
        if base is not None and kind != LOCKED:
            reach = SX.zeros(1, n) if name == base else row[:n] - eom.contacts[base].J[kind, :n]
            row = horzcat(reach, row[n:])
        rows.append(row)
    J = vertcat(*rows)
    columns = [k for k in active if J[:, k].is_constant()]
    rank = np.linalg.matrix_rank(np.asarray(DM(J[:, columns]))) if constraints and columns else 0
    return bool(rank == len(constraints))


def _dependence(constraints: tuple[Constraint, ...], J: Array, drags: Array) -> Structure:
    """The structure at one posture.

    Parameters
    ----------
    J : rows of all constraints, shape (n, n_q).
    drags : see ``Structure``.
    """
    kept: list[int] = []
    for k, row in enumerate(J):
        rest = row - np.linalg.lstsq(J[kept].T, row, rcond=None)[0] @ J[kept]
        if np.linalg.norm(rest) > LARGEST_REMAINDER * np.linalg.norm(row):
            kept.append(k)
    dropped = [k for k in range(len(constraints)) if k not in kept]
    nulls = np.zeros((len(constraints), len(dropped)))
    for j, k in enumerate(dropped):
        nulls[k, j] = 1
        weights = np.linalg.lstsq(J[kept].T, J[k], rcond=None)[0]
        nulls[kept, j] = -np.where(np.abs(weights) > LARGEST_REMAINDER, weights, 0.0)
    G = J.T - FRICTION_SAMPLE * drags
    size = np.abs(G).max(initial=1.0)
    return Structure(
        constraints=constraints,
        kept=tuple(kept),
        dropped=tuple(dropped),
        is_determined=bool(np.abs(G @ nulls).max(initial=0.0) <= LARGEST_REMAINDER * size),
        nulls=nulls,
        drags=drags,
        group=tuple(dict.fromkeys(constraints[k][0] for k in np.flatnonzero(np.abs(nulls).max(axis=1, initial=0.0)))),
    )
