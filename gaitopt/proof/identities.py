"""Exact identities: expressions that vanish for all values of their symbols, and constraints that depend on others.

An expression becomes a polynomial with rational coefficients in its symbols, in pi, in the cosine and sine of every
angle in it and in the inverse of every divisor. Of all these, only c^2 + s^2 = 1 is used. If the polynomial is zero
modulo these relations, the expression vanishes wherever it is defined.

**Contacts of one rigid part.** If the distance of the contacts i and j does not depend on the posture, then

    (x_i - x_j) (J_t,i - J_t,j) + (h_i - h_j) (J_n,i - J_n,j) = 0

for their positions (x, h) and the rows J of their velocities. Where both are on the ground, h_i = h_j = 0, they have
the same tangential row, unless they coincide. While both stay there the part does not turn, so that their tangential
velocities and accelerations are equal too. If both stick, the constraint of the second one follows from that of the
first one, and only the sum of their tangential forces is determined: N = e_j - e_i.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import combinations, product
from math import prod
from typing import Any

import numpy as np
from casadi import SX, Function, densify, depends_on, det, is_equal, ldl, ldl_solve, reshape, symvar, vertcat, vertsplit
from flint import Ordering, fmpq, fmpq_mpoly_ctx

from gaitopt.building import building, built_once
from gaitopt.model.contacts import (
    LARGEST_REMAINDER,
    LOCKED,
    NORMAL,
    TANGENTIAL,
    constraint_rows,
    constraint_structure,
)
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.model.modes import CONTACTS, OFF, Mode
from gaitopt.model.section import Section
from gaitopt.model.system import HybridSystem
from gaitopt.model.walker import Walker
from gaitopt.proof.arithmetic import BallFunction, NotProved, ratio_to_pi

SMALL = 1e-9
"""An expression whose value at a sampled point is larger does not vanish."""


class _Ring:
    """Polynomials in the symbols of an expression, and in the functions that occur in it."""

    def __init__(self, n_symbols: int, n_functions: int) -> None:
        names = ["pi", *(f"x{k}" for k in range(n_symbols)), *(f"f{k}" for k in range(2 * n_functions))]
        self._context = fmpq_mpoly_ctx.get(names, Ordering.lex)
        self._pi, *generators = self._context.gens()
        self.symbols = [Polynomial(self, value) for value in generators[:n_symbols]]
        self._free, self._angles, self._divisors = generators[n_symbols:], list[Any](), list[Any]()

    def number(self, value: float) -> "Polynomial":
        """A constant of an expression; see ``arithmetic.exact_constant``."""
        ratio = ratio_to_pi(value)
        exact = fmpq(*((Fraction(value) if ratio is None else ratio).as_integer_ratio()))
        return Polynomial(self, self._context.constant(exact) * (1 if ratio is None else self._pi))

    def constant(self, value: int) -> Any:
        """A whole number as an element of the ring."""
        return self._context.constant(value)

    def sine_and_cosine(self, angle: Any) -> tuple["Polynomial", "Polynomial"]:
        """The sine and cosine of a polynomial; those of opposite angles have the same symbols."""
        if angle == 0:
            return Polynomial(self, self.constant(0)), Polynomial(self, self.constant(1))
        sign = 1 if angle.leading_coefficient() > 0 else -1
        found = next((pair for other, *pair in self._angles if other == sign * angle), None)
        if found is None:
            found = [self._free.pop(0), self._free.pop(0)]  # s^2 leads s^2 + c^2 - 1
            self._angles.append((sign * angle, *found))
        return Polynomial(self, sign * found[0]), Polynomial(self, found[1])

    def inverse(self, divisor: Any) -> "Polynomial":
        """1 / a polynomial."""
        if divisor == 0:
            raise NotProved("an identity contains a division by zero")
        size = divisor.leading_coefficient()
        if divisor.is_constant():
            return Polynomial(self, self.constant(1) / size)
        found = next((value for other, value in self._divisors if other == divisor / size), None)
        if found is None:
            found = self._free.pop(0)
            self._divisors.append((divisor / size, found))
        return Polynomial(self, found / size)

    def reduced(self, value: Any) -> Any:
        """A polynomial modulo all relations."""
        for _, sine, cosine in self._angles:
            value = divmod(value, sine**2 + cosine**2 - 1)[1]
        return value


class Polynomial:
    """An element of a ``_Ring`` with the operations of ``BallFunction``."""

    def __init__(self, ring: _Ring, value: Any) -> None:
        self.ring, self.value = ring, value

    def _with(self, other: Any) -> Any:
        return other.value if isinstance(other, Polynomial) else self.ring.constant(other)

    def __neg__(self) -> "Polynomial":
        return Polynomial(self.ring, -self.value)

    def __add__(self, other: Any) -> "Polynomial":
        return Polynomial(self.ring, self.value + self._with(other))

    def __sub__(self, other: Any) -> "Polynomial":
        return Polynomial(self.ring, self.value - self._with(other))

    def __mul__(self, other: Any) -> "Polynomial":
        return Polynomial(self.ring, self.ring.reduced(self.value * self._with(other)))

    def __truediv__(self, other: Any) -> "Polynomial":
        return self * self.ring.inverse(self._with(other))

    def __rtruediv__(self, other: int) -> "Polynomial":
        return self.ring.inverse(self.value) * other

    def sin(self) -> "Polynomial":
        """Sine."""
        return self.ring.sine_and_cosine(self.value)[0]

    def cos(self) -> "Polynomial":
        """Cosine."""
        return self.ring.sine_and_cosine(self.value)[1]


def vanishes_identically(expression: SX, symbols: SX) -> bool:
    """Whether all entries of an expression are zero for all values of the symbols; False if this is not shown."""
    function = Function("identity", [symbols], [densify(expression)])
    sample = np.asarray(function(np.random.default_rng(0).uniform(0.1, 0.9, symbols.numel())))
    if not np.abs(sample).max(initial=0.0) < SMALL:  # of such an expression the polynomial might be long
        return False
    ring = _Ring(symbols.numel(), function.n_instructions())
    try:
        (values,) = BallFunction(function, [], ring.number)(ring.symbols)
    except (NotProved, ValueError, TypeError):  # a comparison, or a function of another kind
        return False
    return all(value.value == 0 for value in values if isinstance(value, Polynomial))


@built_once(maxsize=64)
def rigid_pairs(walker: type[Walker]) -> frozenset[frozenset[str]]:
    """The pairs of contacts for which the identity of this module holds."""
    eom = equations_of_motion(walker)
    symbols, pairs = vertcat(eom.q, eom.p), list[frozenset[str]]()
    if not eom.q.is_valid_input():  # the base point stays on the ground
        return frozenset()
    for one, other in combinations(walker.contacts, 2):
        a, b = eom.contacts[one], eom.contacts[other]
        identity = (a.position - b.position).T @ (a.J - b.J)
        if vanishes_identically(identity, symbols):
            pairs.append(frozenset((one, other)))
    return frozenset(pairs)


def is_rigid(walker: type[Walker], names: Sequence[str]) -> bool:
    """Whether contacts belong to one rigid part: on the ground they have one tangential velocity."""
    return all(frozenset(pair) in rigid_pairs(walker) for pair in combinations(names, 2))


def dependent_contacts(walker: type[Walker], mode: Mode) -> tuple[str, ...]:
    """The contacts that stick in a mode and whose tangential constraint follows from that of an earlier contact.

    Raises
    ------
    NotProved
        If the model leaves out other constraints, or distributes the forces of these ones otherwise.
    """
    sticking, pairs = [name for name in mode.touching if not mode.directions[name]], rigid_pairs(walker)
    first = {
        name: next((other for other in sticking[:k] if frozenset((name, other)) in pairs), "")
        for k, name in enumerate(sticking)
    }
    dependent = tuple(name for name in sticking if first[name])
    structure = constraint_structure(walker, mode)
    constraints = structure.constraints
    N = np.zeros((len(constraints), len(dependent)))
    for column, name in enumerate(dependent):
        N[constraints.index((name, TANGENTIAL)), column] = 1
        N[constraints.index((first[name], TANGENTIAL)), column] = -1
    dropped = tuple(constraints[k] for k in structure.dropped)
    if dropped != tuple((name, TANGENTIAL) for name in dependent) or not np.allclose(
        structure.nulls, N, rtol=0, atol=LARGEST_REMAINDER
    ):
        sharing = f"{' and '.join(structure.group)} share their forces in {mode.brief}, without being one rigid part"
        raise NotProved(f"{walker.model}: {sharing}; proofs do not cover that")
    return dependent


def require_heights(walker: type[Walker]) -> None:
    """Require that the contacts land where their heights fall to zero.

    Raises
    ------
    NotProved
        If the gap of a contact is not shown to be its height.
    """
    for name, contact in equations_of_motion(walker).mechanism.contacts.items():
        difference = SX(0) if contact.gap is None else contact.gap - contact.position[1]
        if not vanishes_identically(difference, vertcat(SX(0, 1), *symvar(difference))):
            raise NotProved(f"{walker.model}: the gap of {name} is not its height; proofs do not cover that")


@building
def require_same_everywhere(walker: type[Walker], section: Section) -> None:
    """Require that the conditions for which a section is solved hold wherever the walker is: x returns to zero.

    Raises
    ------
    NotProved
        If a condition other than x = 0 depends on x.
    """
    z, p = SX.sym("z", len(walker.state_names())), SX.sym("p", len(walker.model_fields))
    x = z[walker.state_names().index("x")]
    for condition in vertsplit(section.conditions(z, p)) if section.solved else ():
        if depends_on(condition, x) and not is_equal(condition, x):
            raise NotProved(
                f"{walker.model}: the margin that ends its cycle depends on the place along the ground; "
                "proofs do not cover that"
            )


def require_conditions(walker: type[Walker], section: Section) -> None:
    """Require that the conditions of a section which are left out follow from the others.

    Each of them has to be the tangential velocity of a contact of a rigid part, for another contact of which it is a
    condition. The heights of both are conditions, as those of all contacts on the ground.

    Raises
    ------
    NotProved
        If another condition is left out.
    """
    left_out = section.left_out
    if not left_out.numel_out(0):
        return
    eom = equations_of_motion(walker)
    symbols = vertcat(eom.z, eom.p)

    def contacts_of(function: Function) -> list[set[str]]:
        """For each condition, the contacts whose tangential velocity it is."""
        return [
            {name for name in walker.contacts if vanishes_identically(row - eom.contacts[name].velocity[0], symbols)}
            for row in vertsplit(function(eom.z, eom.p))
        ]

    kept = [name for names in contacts_of(section.conditions) for name in names]
    for names in contacts_of(left_out):
        if not any(is_rigid(walker, (name, other)) for name in names for other in kept):
            raise NotProved(
                f"{walker.model}: a condition of its section is left out that is not shown to follow from the others; "
                "proofs do not cover that"
            )


def is_possible(walker: type[Walker], mode: Mode) -> bool:
    """Whether contacts of one rigid part, which have one velocity, stick together or slip in one direction."""
    pairs = (pair for pair in rigid_pairs(walker) if pair <= {*mode.touching})
    return all(len({mode.directions[name] for name in pair}) == 1 for pair in pairs)


def modes_of_contacts(system: HybridSystem, mode: Mode) -> list[Mode]:
    """All modes in which the contacts that touch the ground in a mode stick, slip or are off."""
    states = product((*CONTACTS, OFF), repeat=len(mode.touching))
    changed = (mode.with_states(dict(zip(mode.touching, each, strict=True))) for each in states)
    return [other for other in changed if other.contact in system.walker.foot_modes()]


def regularities(system: HybridSystem, mode: Mode, z: SX, p: SX) -> SX:
    """det J M^-1 G of every mode of the contacts on the ground.

    J are the independent constraints of a mode, and G the directions of their forces: a contact that slips has the
    column n - s mu t, with the static coefficient, which is not below the kinetic one.
    The regularity is det J M^-1 G / det J M^-1 J', whose denominator is positive. M has only positive pivots in any
    order, while those of the whole linear system may pass through zero.
    """
    blocks, values, first = dict[str, SX](), system.mechanics(z, p), 0
    for name, shape in system.mechanics_shapes.items():
        size = prod(shape)
        columns = shape[1] if len(shape) > 1 else 1
        blocks[name], first = reshape(values[first : first + size], columns, shape[0]).T, first + size
    M, J = blocks["M"], blocks["J"]
    inverse = ldl_solve(J.T, *ldl(M))
    W, coefficients, determinants = J @ inverse, system.contact_coefficients(p), [SX(1)]
    stops = constraint_rows(system.walker, [(name, LOCKED) for name in mode.locked])
    for other in (other for other in modes_of_contacts(system, mode) if other.touching):
        dependent = dependent_contacts(system.walker, other)
        sticking = [name for name in other.touching if not other.directions[name] and name not in dependent]
        normal, tangential = [(name, NORMAL) for name in other.touching], [(name, TANGENTIAL) for name in sticking]
        rows = [*constraint_rows(system.walker, [*normal, *tangential]), *stops]
        square = W[rows, rows]
        for column, (name, _) in enumerate(normal):
            (along,) = constraint_rows(system.walker, [(name, TANGENTIAL)])
            square[:, column] -= other.directions[name] * coefficients[name][0] * W[rows, along]
        determinants.append(det(square))
    return vertcat(*determinants)
