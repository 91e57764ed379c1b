"""The first disturbance from which a walk does not return to its gait: patches of tiles, steps, slopes and pushes.

Values are tried in equal steps away from the nominal floor. The limit lies between the last value that survives and
the first one that fails; bisection refines it. Larger values may survive again. A walk returns if within 400 steps the
state just after the impact is that of the gait again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.gait.gait import Gait
from gaitopt.requests import Engine
from gaitopt.verification.tiled_walks import Floors, returning

MOST_STEPS, DISTANCE = 400, 1e-6
"""A walk has returned if, within this number of steps, its section coordinates are this close, in natural units."""
LENGTHS = (1, 2, 4)
"""Lengths of the patches that are examined, in tiles."""
WIDTH = 1e-9
"""Bisection ends when the bracket of a limit is narrower than this."""
BLOCK = 64
"""Number of values that are tried at once."""
SECTIONS = 16
"""Number of sections into which each refinement divides a bracket."""
LARGEST_FRICTION, FRICTION_STEP = 3.0, 0.001
"""Largest friction that is tried, and distance between tried values."""
LARGEST_STEP, STEP_STEP = 0.2, 0.001
"""Largest change of height [m] or slope [rad] that is tried, and distance between tried values."""
LARGEST_PUSH, PUSH_STEP = 3.0, 0.002
"""Largest change of a rate that is tried, in SI, and distance between tried values."""
DIRECTIONS, SHRINKS, NEAREST_STEP, GROWTH, FARTHEST = 128, 4, 0.002, 1.25, 1.0
"""Random directions of the search for the nearest state, its refinements, its first and last radius in natural units,
and the ratio of successive radii."""

Survives = Callable[[Array], NDArray[np.bool_]]
KINDS = ("friction_low", "friction_high", "step_up", "step_down", "slope_up", "slope_down")
"""Kinds of patches; they are keys of a result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """The largest disturbance after which walks return, with the values that were tried.

    Attributes
    ----------
    value : the last value before the first failure, to within ``WIDTH``; None if none of the values tried fails.
    tried, survived : the values tried at equal distances, in order, and which of them the walk survived.
    """

    value: float | None
    tried: tuple[float, ...]
    survived: tuple[bool, ...]


def limit(survives: Survives, start: float, step: float, end: float, *, should_stop: Stop = None) -> Limit:
    """Find the first value that fails, in steps from ``start`` towards ``end``.

    Parameters
    ----------
    survives : tells which of an array of values a walk survives. It must survive ``start``.
    step : signed distance of the values.
    """
    count = int(np.floor(abs(end - start) / abs(step) * (1 + 1e-12)))
    grid: Array = start + step * np.arange(1, count + 1, dtype=float)
    tried, found = list[float](), list[bool]()
    for first in range(0, count, BLOCK):
        raise_if_stopped(should_stop)
        block = grid[first : first + BLOCK]
        survived = survives(block)
        tried += block.tolist()
        found += survived.tolist()
        if not survived.all():
            break
    if all(found):
        return Limit(value=None, tried=tuple(tried), survived=tuple(found))
    k = found.index(False)
    good, bad = tried[k - 1] if k else start, tried[k]
    while abs(bad - good) > WIDTH:
        inner = np.linspace(good, bad, SECTIONS + 1)[1:-1]
        ok = survives(inner)
        failed = int(np.argmin(ok)) if not ok.all() else len(inner)
        bad = float(inner[failed]) if failed < len(inner) else bad
        good = float(inner[failed - 1]) if failed else good
    return Limit(value=good, tried=tuple(tried), survived=tuple(found))


def patch_floors(kind: str, length: int, values: Array, nominal: float) -> dict[str, Array]:
    """Floors with one nominal tile, a patch, then nominal tiles; one floor per value.

    A patch of steps consists of ``length`` equal steps, after which the ground keeps its height.

    Parameters
    ----------
    nominal : friction of the other tiles.
    """
    if kind in ("step_up", "step_down"):
        return {"height": values[:, None] * np.minimum(np.arange(length + 2), length)}
    quantity, rest = ("slope", 0.0) if kind.startswith("slope") else ("friction", nominal)
    tiles = np.full((len(values), length + 2), rest)
    tiles[:, 1 : length + 1] = values[:, None]
    return {quantity: tiles}


def patch_limit(
    gait: Gait, kind: str, length: int, engine: Engine, *, whole: bool = False, should_stop: Stop = None
) -> Limit:
    """The limit of patches of ``length`` tiles.

    Parameters
    ----------
    kind : one of ``KINDS``.
    whole : try all values of a friction below the nominal one, also beyond the first failure.
    """
    nominal = gait.dynamics.static_friction
    start, step, end = {
        "friction_low": (nominal, -FRICTION_STEP, 0.0),
        "friction_high": (nominal, FRICTION_STEP, LARGEST_FRICTION),
    }.get(kind, (0.0, STEP_STEP, LARGEST_STEP))
    if kind.endswith("down"):
        step, end = -step, -end

    def survives(values: Array) -> NDArray[np.bool_]:
        lowest = 0.0 if kind.startswith("friction") else -LARGEST_STEP  # the last value may be below by rounding
        return survive(gait, patch_floors(kind, length, np.maximum(values, lowest), nominal), engine)

    found = limit(survives, start, step, end, should_stop=should_stop)
    if whole and found.tried and abs(found.tried[-1] - end) > abs(step):
        last = int(abs(end - start) / abs(step)) + 1
        rest: Array = start + step * np.arange(len(found.tried) + 1, last, dtype=float)
        more = survives(rest)
        found = replace(
            found, tried=(*found.tried, *rest.tolist()), survived=(*found.survived, *map(bool, more.tolist()))
        )
    return found


def survive(gait: Gait, floors: Floors, engine: Engine) -> NDArray[np.bool_]:
    """Whether a walk that begins on the gait returns to it, for each of some floors."""
    count = len(next(iter(floors.values())))
    states = np.tile(gait.state, (count, 1))
    return returning(gait, states, floors, engine, steps=MOST_STEPS, distance=DISTANCE)


def survive_states(gait: Gait, xi: Array, engine: Engine) -> NDArray[np.bool_]:
    """Whether walks from section coordinates, shape (m, n_xi), return to the gait."""
    section = gait.system.section(gait.cycle)
    states = np.array([section.lift(row, gait.dynamics.p, gait.state) for row in xi]).reshape(len(xi), -1)
    good = np.isfinite(states).all(axis=1)
    back = np.zeros(len(xi), dtype=bool)
    back[good] = returning(gait, states[good], None, engine, steps=MOST_STEPS, distance=DISTANCE)
    return back


def pushed_rates(gait: Gait) -> tuple[str, ...]:
    """Names of the rates that a push may change, which are the rates among the section coordinates."""
    section = gait.system.section(gait.cycle)
    return tuple(name for name in section.names if name.startswith("d"))


def push_limit(gait: Gait, rate: str, direction: int, engine: Engine, *, should_stop: Stop = None) -> Limit:
    """The largest instantaneous change of a rate just after the impact, in one direction."""
    section = gait.system.section(gait.cycle)
    at, k = gait.state[section.indices], section.names.index(rate)

    def survives(values: Array) -> NDArray[np.bool_]:
        xi = np.tile(at, (len(values), 1))
        xi[:, k] += values
        return survive_states(gait, xi, engine)

    return limit(survives, 0.0, direction * PUSH_STEP, direction * LARGEST_PUSH, should_stop=should_stop)


def nearest_failure(
    gait: Gait, engine: Engine, *, seed: int = 0, should_stop: Stop = None
) -> tuple[float, Mapping[str, float]] | None:
    """The state nearest to the gait that does not return, with its distance; None if the search finds none.

    The distance is the Euclidean one of the section coordinates in natural units. The search follows rays along the
    axes and in random directions, then varies the best direction by smaller and smaller amounts.
    """
    section, units = gait.system.section(gait.cycle), gait.dynamics.state_units
    at, unit = gait.state[section.indices], units[section.indices]
    random, n = np.random.default_rng(seed), len(section.names)
    rays = DIRECTIONS if n > 1 else 0
    directions: Array = np.vstack([np.eye(n), -np.eye(n), random.standard_normal((rays, n))])
    best: tuple[float, Array] | None = None
    for k in range(SHRINKS + 1 if rays else 1):
        raise_if_stopped(should_stop)
        if k and best is not None:
            directions = best[1] + random.standard_normal((DIRECTIONS // 4, n)) / (2 * 3 ** (k - 1))
        elif k:
            break
        directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        reach = FARTHEST if best is None else best[0]
        found = _first_failures(gait, at, unit, directions, reach, engine)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        return None
    state = at + best[0] * best[1] * unit
    return best[0], dict(zip(section.names, state.tolist(), strict=True))


def _first_failures(
    gait: Gait, at: Array, unit: Array, directions: Array, reach: float, engine: Engine
) -> tuple[float, Array] | None:
    """The smallest radius at which a state on a ray fails, and the direction of the ray; None if none fails."""

    def ok(radii: Array, rays: Array) -> NDArray[np.bool_]:
        return survive_states(gait, at + radii[:, None] * rays * unit, engine)

    radius, low = NEAREST_STEP, 0.0
    while radius < reach:
        failed = ~ok(np.full(len(directions), radius), directions)
        if failed.any():
            return _refined(ok, directions[failed], low, radius)
        low, radius = radius, radius * GROWTH
    return _refined(ok, directions, low, reach)


def _refined(
    ok: Callable[[Array, Array], NDArray[np.bool_]], rays: Array, low: float, high: float
) -> tuple[float, Array] | None:
    """The smallest radius from ``low`` to ``high`` at which a ray fails; bisection drops rays that fail farther out."""
    failed = ~ok(np.full(len(rays), high), rays)
    if not failed.any():
        return None
    rays, bottom = rays[failed], low
    while high - bottom > WIDTH:
        middle = (bottom + high) / 2
        failed = ~ok(np.full(len(rays), middle), rays)
        if failed.any():
            rays, high = rays[failed], middle
        else:
            bottom = middle
    return high, rays[0]
