"""Contact forces that the equations of motion do not determine: which ones they are, and their bounds.

If the constraints J of the contacts are dependent, the equations of motion allow all forces

    lambda = lambda_0 + N a,      N' J = 0

Friction allows those with f_n > 0 and |f_t| <= mu f_n at every contact. These inequalities bound a polytope in the
shares a, and every force has its smallest and largest value at corners of the polytope.
"""

from collections.abc import Iterable, Iterator
from itertools import combinations

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import Arc, along
from gaitopt.model.contacts import LARGEST_REMAINDER, LOCKED, constraint_rows, constraint_structure
from gaitopt.model.modes import Mode
from gaitopt.model.walker import Walker

CORNER_TOLERANCE = 1e-9
"""Rounding may let a corner violate an inequality by this fraction of the largest force; also the smallest determinant
of the equations of a corner."""


def undetermined_forces(arc: Arc) -> tuple[str, ...]:
    """Names of the undetermined forces along an arc; they are columns of ``trajectory_header``, like ``f_t.left``."""
    return undetermined_in(arc.dynamics.system.walker, arc.mode)


def undetermined_in(walker: type[Walker], mode: Mode) -> tuple[str, ...]:
    """Names of the forces that are undetermined in a mode, and of the impulses in an impact that leads to it."""
    structure, undetermined = constraint_structure(walker, mode), dict[str, None]()
    for (name, row), shares in zip(structure.constraints, structure.nulls, strict=True):
        if row != LOCKED and np.abs(shares).max(initial=0.0) > LARGEST_REMAINDER:
            slides = row == 1 and mode.directions[name]  # friction follows the normal force
            undetermined |= dict.fromkeys((f"f_t.{name}", f"f_n.{name}") if slides else (f"f_{'tn'[row]}.{name}",))
    return tuple(undetermined)


def share_bounds(arcs: Iterable[Arc]) -> dict[str, list[float]]:
    """Smallest and largest value [N] that each undetermined force can have anywhere along some arcs, by its name."""
    bounds: dict[str, list[float]] = {}
    for arc in arcs:
        for name, values in _possible_forces(arc):
            if not np.isnan(values).all():
                low, high = bounds.get(name, [np.inf, -np.inf])
                bounds[name] = [min(low, float(np.nanmin(values))), max(high, float(np.nanmax(values)))]
    return bounds


def _possible_forces(arc: Arc) -> Iterator[tuple[str, Array]]:
    """Each undetermined force at the corners of the polytope at all times, shape (m, corners); NaN outside of it."""
    names = undetermined_forces(arc)
    if not names:
        return
    system, mode, p = arc.dynamics.system, arc.mode, arc.dynamics.p
    walker, m = system.walker, arc.times.size
    structure, number = constraint_structure(walker, mode), {name: k for k, name in enumerate(walker.contact_names())}
    nulls = _null_spaces(arc)  # (m, n, d)
    force = along(arc, system.observation(mode))[0]
    index = {constraint: k for k, constraint in enumerate(structure.constraints)}

    def family(name: str, row: int) -> tuple[Array, Array]:
        """A force at all times, and its derivative with respect to the shares."""
        if row == 0 and mode.directions[name]:
            _, kinetic, _ = system.contact_coefficients(p)[name]
            return force[:, 2 * number[name]], -mode.directions[name] * float(kinetic) * nulls[:, index[name, 1]]
        return force[:, 2 * number[name] + row], nulls[:, index[name, row]]

    offsets, slopes = list[Array](), list[Array]()
    for name in structure.group:
        (f_n, by_n), mu = family(name, 1), arc.dynamics.contact_friction[name]
        if mode.directions[name]:
            offsets.append(f_n)
            slopes.append(by_n)
        else:
            f_t, by_t = family(name, 0)
            offsets += [mu * f_n + f_t, mu * f_n - f_t]
            slopes += [mu * by_n + by_t, mu * by_n - by_t]
    g, A = np.stack(offsets, axis=1), np.stack(slopes, axis=1)  # g + A a >= 0
    d, tolerance = nulls.shape[2], CORNER_TOLERANCE * np.abs(force).max()
    corners = list[Array]()
    for chosen in combinations(range(g.shape[1]), d):
        chosen_rows = [*chosen]
        regular = np.abs(np.linalg.det(A[:, chosen_rows])) > CORNER_TOLERANCE
        a = np.full((m, d), np.nan)
        a[regular] = np.linalg.solve(A[regular][:, chosen_rows], -g[regular][:, chosen_rows, None])[:, :, 0]
        inside = np.all(g + (A @ a[:, :, None])[:, :, 0] >= -tolerance, axis=1)
        corners.append(np.where(inside[:, None], a, np.nan))
    for name in names:
        kind, _, contact = name.partition(".")
        value, slope = family(contact, "tn".index(kind[-1]))
        yield name, np.stack([value + np.sum(slope * a, axis=1) for a in corners], axis=1)


def _null_spaces(arc: Arc) -> Array:
    """N at all times of an arc, shape (m, n, d); its n rows belong to the constraints of the mode."""
    system, mode = arc.dynamics.system, arc.mode
    structure, shapes = constraint_structure(system.walker, mode), system.mechanics_shapes
    terms = [*shapes]
    start = sum(int(np.prod(shapes[term])) for term in terms[: terms.index("J")])
    (values,) = along(arc, system.mechanics)
    J = values[:, start : start + int(np.prod(shapes["J"]))].reshape(-1, *shapes["J"])
    J = J[:, constraint_rows(system.walker, structure.constraints)]
    kept, dropped = J[:, [*structure.kept]], J[:, [*structure.dropped]]
    nulls = np.zeros((arc.times.size, len(structure.constraints), len(structure.dropped)))
    nulls[:, [*structure.dropped], range(len(structure.dropped))] = 1
    turned = kept.swapaxes(1, 2)
    nulls[:, [*structure.kept]] = -np.linalg.solve(kept @ turned, kept @ dropped.swapaxes(1, 2))
    return nulls
