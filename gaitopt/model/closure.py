"""Closure of the legs: the posture just after an impact of the foot, from the coordinates that are free there.

At touchdown the guard is zero, and the gaps of the stops that are locked then are zero as well. For the posture s_minus
before the feet swap roles,

    c(s_plus) = (touchdown(s_minus), gaps(s_minus)) = 0,      s_plus = relabel(s_minus)

These equations determine as many coordinates of s_plus as there are equations; the others are the section. If a walker
has no ``after_impact``, its posture is computed here, by Newton's method in symbols from ``Walker.posture``.
"""

from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np
from casadi import (
    DM,
    SX,
    Function,
    densify,
    depends_on,
    fabs,
    fmax,
    fmin,
    if_else,
    inv,
    jacobian,
    mmax,
    solve,
    substitute,
    vertcat,
)

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import buffered_map
from gaitopt.model.foreign import calling
from gaitopt.model.mechanism import Mechanism

NEWTON_STEPS = 12
"""Number of Newton steps; from a typical posture five are needed."""
LONGEST_CLOSING_STEP = 0.3
"""Longest Newton step [rad, or units of a length]. Longer steps might lead to a leg that is bent the other way."""
CLOSED = 1e-10
"""The posture is closed if the last step is smaller; otherwise all coordinates are nan."""
SAMPLES = 32
"""Number of random touchdowns at which the condition of a section is judged."""
SPREAD = 0.3
"""Largest deviation of the coordinates from ``Walker.posture`` in these touchdowns [rad]: about the half-angle between
walking legs."""
SMALLEST_ENTRY = 0.9
"""Each equation of the closure is solved for the last coordinate whose coefficient exceeds this fraction of the
largest coefficient in the equation."""
LARGEST_REMAINDER = 1e-7
"""An equation follows from the ones before it if elimination leaves no coefficient above this fraction of its size."""


class Closing(Protocol):
    """A class of walkers whose legs close at touchdown."""

    shape: ClassVar[tuple[str, ...]]
    posture: ClassVar[Mapping[str, float]]
    section: ClassVar[tuple[str, ...]]
    largest_angle: ClassVar[float]
    flies: ClassVar[bool]
    massless_feet: ClassVar[bool]
    __pydantic_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """See ``Walker.mechanism``."""


def closed_posture(walker: type[Closing], free: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, ...]:
    """All shape coordinates just after an impact, from those of ``walker.section``; nan if the legs do not close.

    Raises
    ------
    ProblemError
        If the closure does not determine the coordinates that are not in the section.
    """
    equations, slopes = closure(walker)
    section = walker.section
    solved = [name for name in walker.shape if name not in section]
    if len(solved) != equations.size1_out(0):
        system = f"{equations.size1_out(0)} equations for {', '.join(solved) or 'no coordinate'}"
        raise ProblemError(f"{walker.__name__}: section leaves {system} just after an impact; leave section out")
    values = {name: SX(getattr(free, name)) for name in section}
    parameters = vertcat(SX(0, 1), *(getattr(p, name) for name in walker.__pydantic_fields__))
    columns = [walker.shape.index(name) for name in solved]
    unknown = SX([float(walker.posture.get(name, 0.0)) for name in solved])

    def posture(unknowns: SX) -> SX:
        everything = values | {name: unknowns[k] for k, name in enumerate(solved)}
        return vertcat(*(everything[name] for name in walker.shape))

    if is_linear(walker):  # one step is exact
        c, J = equations(posture(unknown), parameters), slopes(posture(unknown), parameters)[:, columns]
        s = posture(unknown - solve(J, c))
        return tuple(s[k] for k in range(s.numel()))
    size = SX(0)
    for _ in range(NEWTON_STEPS):
        c, J = equations(posture(unknown), parameters), slopes(posture(unknown), parameters)[:, columns]
        step = solve(J, c)
        size = mmax(fabs(step))
        unknown = unknown - fmax(fmin(step, LONGEST_CLOSING_STEP), -LONGEST_CLOSING_STEP)
    s = posture(unknown)
    return tuple(if_else(size < CLOSED, s[k], np.nan) for k in range(s.numel()))


def is_linear(walker: type[Closing]) -> bool:
    """Whether the closure is linear in the coordinates that are solved for, and has a solution in closed form."""
    _, slopes = closure(walker)
    s, p = SX.sym("s", len(walker.shape)), SX.sym("p", len(walker.__pydantic_fields__))
    solved = [k for k, name in enumerate(walker.shape) if name not in walker.section]
    return not depends_on(slopes(s, p)[:, solved], s[solved])


@built_once(maxsize=8)
def closure(walker: type[Closing]) -> tuple[Function, Function]:
    """(s_plus, p) -> residuals of the closure, shape (m,), and their derivatives, shape (m, n_shape).

    Raises
    ------
    ProblemError
        If the walker does not land on one foot after the other, or ``relabel`` is not affine.
    """
    if walker.massless_feet:
        raise ProblemError(f"{walker.__name__}: has massless feet: define section and after_impact")
    n, p = len(walker.shape), SX.sym("p", len(walker.__pydantic_fields__))
    s, s_plus = SX.sym("s", n), SX.sym("s_plus", n)
    named = SimpleNamespace(**{name: s[k] for k, name in enumerate(walker.shape)}, x=SX(0), y=SX(0))
    with calling(walker, "mechanism"):
        mechanism = walker.mechanism(
            named, SimpleNamespace(**{name: p[k] for k, name in enumerate(walker.__pydantic_fields__)})
        )
    relabel = SX(mechanism.relabel)
    swap = jacobian(relabel, s)
    if depends_on(swap, s):
        raise ProblemError(f"{walker.__name__}: relabel is not affine: define section and after_impact")
    touchdown = [] if walker.flies else [SX(mechanism.touchdown)]  # a foot in flight lands in any posture
    conditions = vertcat(SX(0, 1), *touchdown, *mechanism.stops.values())
    offset = substitute(relabel, s, SX.zeros(n))
    before = DM(swap) if swap.is_constant() else swap
    c = substitute(conditions, s, inv(before) @ (s_plus - offset))
    return Function("closure", [s_plus, p], [c]), Function("slopes", [s_plus, p], [densify(jacobian(c, s_plus))])


@built_once(maxsize=64)
def chosen_section(walker: type[Closing]) -> tuple[str, ...]:
    """The section of a walker whose class names none: the coordinates for which the closure is not solved.

    Each equation of the closure is solved for the last coordinate whose coefficient in it is not much smaller than the
    largest one: a coordinate of the swing foot if ``Walker.shape`` lists these after those of its leg. Coefficients are
    compared at random touchdowns around ``Walker.posture``; parameters without a default are one.

    Raises
    ------
    ProblemError
        If the closure determines no coordinates, or the feet do not land as ``closure`` assumes.
    """
    equations, slopes = closure(walker)
    n, m = len(walker.shape), equations.size1_out(0)
    fields = walker.__pydantic_fields__.values()
    p = [float(field.default) if isinstance(field.default, int | float) else 1.0 for field in fields]
    centre = np.array([float(walker.posture.get(name, 0.0)) for name in walker.shape])
    random, spread = np.random.default_rng(0), min(SPREAD, walker.largest_angle)
    residuals, derivatives = buffered_map(equations, SAMPLES), buffered_map(slopes, SAMPLES)
    s = centre + spread * random.uniform(-1, 1, (SAMPLES, n))

    def jacobians() -> Array:
        return np.asarray(derivatives(s, p)[0].reshape(SAMPLES, n, m).transpose(0, 2, 1))

    for _ in range(NEWTON_STEPS):  # to the nearest touchdown
        s = s - (np.linalg.pinv(jacobians()) @ residuals(s, p)[0].reshape(SAMPLES, m, 1))[:, :, 0]
    J = jacobians()
    J = J[np.isfinite(J).all(axis=(1, 2)) & (np.abs(J).max(axis=(1, 2), initial=0.0) > 0)]
    J = J / np.linalg.norm(J, axis=2, keepdims=True)
    solved = solved_columns(J, [(range(m), range(n)[::-1], SMALLEST_ENTRY)])[0] if len(J) or not m else []
    if len(solved) < m:
        raise ProblemError(
            f"{walker.__name__}: touchdown and stops determine no posture just after an impact near its posture "
            f"({', '.join(f'{name} = {value:g}' for name, value in zip(walker.shape, centre, strict=True))}): "
            "define posture, or section and after_impact"
        )
    return tuple(name for k, name in enumerate(walker.shape) if k not in solved)


def solved_columns(
    J: Array, groups: Iterable[tuple[Sequence[int], Sequence[int], float]]
) -> tuple[list[int], list[int]]:
    """Choose by elimination the coordinates for which linear equations are solved.

    Parameters
    ----------
    J : ndarray, shape (n_samples, n_equations, n) - coefficients of the equations at samples, which are compared by
        their medians.
    groups : for each group the indices of its equations, the indices of the coordinates for which they may be solved,
        the preferred ones first, and the smallest coefficient of such a coordinate relative to the largest one in the
        equation. If no coefficient is large enough, the first one that exceeds rounding is taken.

    Returns
    -------
    columns, rows : indices of the chosen coordinates, and of the independent equations that determine them.
    """
    A, columns, rows = J.copy(), list[int](), list[int]()
    for group, order, size in groups:
        for smallest in (size, LARGEST_REMAINDER):
            for column in order:
                left = [k for k in group if k not in rows]
                if column in columns or not left:
                    continue
                entries = np.median(np.abs(A), axis=0)
                row = max(left, key=lambda k: float(entries[k, column]))
                if entries[row, column] > smallest * max(entries[row, [*order]].max(), LARGEST_REMAINDER):
                    columns.append(column)
                    rows.append(row)
                    for other in (k for k in range(A.shape[1]) if k not in rows):
                        A[:, other] -= A[:, other, [column]] / A[:, row, [column]] * A[:, row]
                        A[:, other][np.abs(A[:, other]) < LARGEST_REMAINDER * 1e-3] = 0.0
    return columns, rows
