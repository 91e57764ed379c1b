"""Closure of the legs: the posture just after an impact of the foot, from the coordinates that are free there.

At touchdown the guard is zero, and the gaps of the stops that are locked then are zero as well. For the posture s_minus
before the feet swap roles,

    c(s_plus) = (touchdown(s_minus), gaps(s_minus)) = 0,      s_plus = relabel(s_minus)

These equations determine as many coordinates of s_plus as there are equations; the others are the section. If a walker
has no ``after_impact``, its posture is computed here, by Newton's method in symbols from ``Walker.posture``.
"""

from collections.abc import Mapping
from itertools import combinations
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
"""Range of the coordinates around ``Walker.posture`` in these touchdowns [rad]: the half-angles of walking legs."""
EQUAL_CONDITION = 0.9
"""Sections whose condition is at least this part of the best one are as good; then the last coordinates are solved
for."""


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
        words = f"{equations.size1_out(0)} equations for {', '.join(solved) or 'no coordinate'}"
        raise ProblemError(f"{walker.__name__}: section leaves {words} just after an impact; leave section out")
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
    """The section of a walker that names none: the closure is solved for the other coordinates.

    The closure is best conditioned in these: the smallest singular value of its derivative, in the median over random
    touchdowns around ``Walker.posture``, is largest. Parameters are one unless they have a default. If several choices
    are as good, the last coordinates are solved for: those of the swing foot if they come after its leg.

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
    choices = list(combinations(range(n), m))
    residuals, derivatives = buffered_map(equations, SAMPLES), buffered_map(slopes, SAMPLES)
    s = centre + spread * random.uniform(-1, 1, (SAMPLES, n))

    def jacobians() -> Array:
        return np.asarray(derivatives(s, p)[0].reshape(SAMPLES, n, m).transpose(0, 2, 1))

    for _ in range(NEWTON_STEPS):  # to the nearest touchdown
        s = s - (np.linalg.pinv(jacobians()) @ residuals(s, p)[0].reshape(SAMPLES, m, 1))[:, :, 0]
    J = jacobians()
    J = J[np.isfinite(J).all(axis=(1, 2)) & (np.abs(J).max(axis=(1, 2), initial=0.0) > 0)]
    J = J / np.linalg.norm(J, axis=2, keepdims=True)
    values = [np.linalg.svd(J[:, :, choice], compute_uv=False).min(axis=1, initial=1.0) for choice in choices]
    if m > n or not len(J) or not (middle := np.median(values, axis=1)).max() > 0:
        raise ProblemError(
            f"{walker.__name__}: touchdown and stops determine no posture just after an impact near its posture "
            f"({', '.join(f'{name} = {value:g}' for name, value in zip(walker.shape, centre, strict=True))}): "
            "define posture, or section and after_impact"
        )
    best = [choice for choice, value in zip(choices, middle, strict=True) if value >= EQUAL_CONDITION * middle.max()][
        -1
    ]
    return tuple(name for k, name in enumerate(walker.shape) if k not in best)
