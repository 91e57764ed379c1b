"""A walker on a floor: the parameters of its hybrid system step by step, from the tiles under its contacts.

Every contact has the friction of the tile under it, and on an uneven floor also the tile's height and slope. All of
these are parameters of the hybrid system:

    p = (walker, friction of every contact, control, height and slope of every contact)

A foot that stands alone is on tile n in step n, and lands on tile n + 1, whose height is measured from the tile under
it. Named contacts keep the tile of the step in which they landed. The state is always that on the nominal floor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.gait.trajectory import Arc
from gaitopt.model.buffered import RowMap, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import ContactFriction, Friction
from gaitopt.model.lagrangian import TRAILING
from gaitopt.model.modes import FOOT, SWING_FOOT, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.system import FLOOR, HybridSystem
from gaitopt.problem.floor import Floor
from gaitopt.threads import cached_property

LEVEL = 1e-9
"""A height below this number, in natural units, is attributed to rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tiles:
    """The tiles under one contact in m walks.

    Attributes
    ----------
    friction : ndarray, shape (m, 2) - static and kinetic coefficient; None for those of the problem.
    height, slope : ndarray, shape (m,) - heights [m] and slopes [rad] of the tiles.
    """

    friction: Array | None
    height: Array
    slope: Array

    @classmethod
    def of(cls, floor: Floor, n: int, height: float) -> "Tiles":
        """Tile ``n`` of the floor of one walk, at another height."""
        tile = floor.tile(n)
        friction = None if tile.friction is None else np.array([tile.friction])
        return cls(friction=friction, height=np.array([height]), slope=np.array([tile.slope]))


@built_once(maxsize=16)
def floor_system(system: HybridSystem, drops: bool, uneven: bool) -> HybridSystem:
    """A system on a floor.

    Parameters
    ----------
    drops : whether its tiles have two coefficients of friction.
    uneven : whether they have heights and slopes.
    """
    is_viscous = any(key.endswith(".viscous") for key in system.friction.parameters)

    def law(name: str) -> Friction:
        key = f"{FLOOR}.{name}"
        static, kinetic = ("static", "kinetic") if drops else ("friction", "friction")
        return Friction(f"{key}.{static}", f"{key}.{kinetic}", f"{key}.viscous" if is_viscous else None)

    laws = ContactFriction(tuple((name, law(name)) for name in system.walker.landing_points()), of_ground=True)
    return HybridSystem(system.walker, system.control, system.law, laws, system.cycle_end, uneven)


class OnTiles:
    """The hybrid system of a walker on tiles, and its parameters from theirs.

    Parameters
    ----------
    dynamics : the walker on the nominal floor, in its first step.
    drops, uneven : see ``floor_system``.

    Attributes
    ----------
    nominal : the walker on the nominal floor, in its first step.
    system : the hybrid system on tiles.
    """

    def __init__(self, dynamics: Dynamics, *, drops: bool, uneven: bool) -> None:
        self.nominal, nominal = dynamics, dynamics.system
        system = floor_system(nominal.shared, nominal.friction.may_drop or drops, uneven)
        self.system = system if nominal.control is nominal.shared.control else system.retimed(nominal.control)
        self._index_of = {key: k for k, key in enumerate(self.system.parameters)}
        shared = [key for key in nominal.parameters if key in self._index_of]
        self._from, self._to = (
            [nominal.parameters.index(key) for key in shared],
            [self._index_of[key] for key in shared],
        )
        self._steps, self._coefficients = dynamics.steps, list[dict[str, tuple[float, ...]]]()
        for step in dynamics.steps:
            of = nominal.contact_coefficients(step.p)
            values = {name: of.get(name, of.get(FOOT, ())) for name in nominal.walker.landing_points()}
            self._coefficients.append({name: tuple(map(float, value)) for name, value in values.items()})

    @property
    def nominal_friction(self) -> tuple[float, ...]:
        """Static and kinetic coefficient of the problem under a lone foot."""
        return self._coefficients[0][FOOT][:2]

    def is_nominal(self, n: int, name: str, friction: tuple[float, float] | None) -> bool:
        """Whether the friction of the tile under a contact in step ``n`` is that of the problem."""
        return friction in (None, self._coefficients[n % len(self._steps)][name][:2])

    def parameter_index(self, name: str) -> int:
        """Index among the parameters of a number of a tile, such as ``foot.slope`` or ``swing_foot.static``.

        Where a tile has one coefficient, its index is that of both.
        """
        key, (contact, _, what) = f"{FLOOR}.{name}", name.rpartition(".")
        if what in ("static", "kinetic") and key not in self._index_of:
            key = f"{FLOOR}.{contact}.friction"
        return self._index_of[key]

    def parameters(self, n: int, tiles: Mapping[str, Tiles], states: Array) -> Array:
        """Parameters in step ``n``, shape (m, n_p).

        Parameters
        ----------
        tiles : the tiles under each contact, with their heights relative to the tile of this step; a contact that is
            left out has level ground of nominal friction.
        states : ndarray, shape (m, n_z) - states in which the step begins.
        """
        at, m = n % len(self._steps), len(states)
        p = np.zeros((m, len(self._index_of)))
        p[:, self._to] = self._steps[at].p[self._from]
        level = Tiles(friction=None, height=np.zeros(m), slope=np.zeros(m))
        tiles = {name: tiles.get(name, level) for name in self.system.walker.landing_points()}
        for name, tile in tiles.items():
            static, kinetic, viscous = self._coefficients[at][name]
            pair = np.array([[static, kinetic]]) if tile.friction is None else tile.friction
            columns: dict[str, Array | float] = {"height": tile.height, "slope": tile.slope, "viscous": viscous}
            columns |= {"friction": pair[:, 0], "static": pair[:, 0], "kinetic": pair[:, 1]}
            for what, column in columns.items():
                if (index := self._index_of.get(f"{FLOOR}.{name}.{what}")) is not None:
                    p[:, index] = column
        if self.system.uneven and self.system.walker.base_contact():
            is_higher = (tiles[SWING_FOOT].height != 0) | (tiles[FOOT].slope != 0)
            p[:, self._index_of[f"{FLOOR}.{SWING_FOOT}.is_higher"]] = is_higher
            p[:, self._index_of[f"{FLOOR}.{TRAILING}"]] = self.trailing(states)
        return p

    def trailing(self, states: Array) -> Array:
        """Heights of the feet that have just left the ground, shape (m,) [m]; heights of rounding size are zero."""
        if not self._trailing_foot:
            return np.zeros(len(states))
        heights = self._trailing_foot(states, self.nominal.p)[0][:, 0]
        return np.where(np.abs(heights) > LEVEL * self.nominal.scales.length, heights, 0.0)

    @cached_property
    def _trailing_foot(self) -> RowMap | None:
        function = self.nominal.system.trailing_foot
        return RowMap(function) if self.system.uneven and function.numel_out(0) else None


class Ground:
    """The floor of one walk under a walker.

    Parameters
    ----------
    dynamics : the walker on the nominal floor, in its first step.
    floor : the tiles.

    Raises
    ------
    ProblemError
        If the walker cannot walk on this floor, see ``check_floor``.
    """

    def __init__(self, dynamics: Dynamics, floor: Floor) -> None:
        check_floor(dynamics.system, floor)
        self.floor, self._nominal, self._walker = floor, dynamics, dynamics.system.walker
        self.on_tiles = OnTiles(dynamics, drops=floor.drops, uneven=not floor.is_even)

    def start(self, z: Array) -> dict[str, int]:
        """The tiles of the contacts that are on the ground where a walk begins with the state ``z``, shape (n_z,)."""
        if base := self._walker.base_contact():
            return {base: 0}
        low = LEVEL * self._nominal.scales.length
        return {name: 0 for name, height in self._heights(z).items() if height <= low}

    def following(self, n: int, tiles: Mapping[str, int], after: Mode) -> dict[str, int]:
        """The tiles of the contacts that are on the ground after step ``n``, from those in it.

        Parameters
        ----------
        after : the contacts just after the step.
        """
        swaps = self._nominal.system.cycle_end == TOUCHDOWN
        partner = self._walker.partners() if swaps else {}
        before = ((name, partner.get(name, name)) for name in after.touching)
        return {name: tiles.get(was, self._next(n, was)) for name, was in before}

    def within(self, n: int, tiles: Mapping[str, int], after: Mode) -> dict[str, int]:
        """The tiles of the contacts that are on the ground after an event within step ``n``."""
        return {name: tiles.get(name, self._next(n, name)) for name in after.touching}

    def dynamics(self, n: int, on_ground: Mapping[str, int], z: Array) -> Dynamics:
        """The dynamics in step ``n``, counted from 0, for a motion from the state ``z``, shape (n_z,).

        They are those of the nominal floor if its tiles have nominal friction and are level with the tile before them.

        Parameters
        ----------
        on_ground : the tiles of the contacts that are on the ground. Every other contact is above the tile on which it
            may land.
        """
        floor, on_tiles, states = self.floor, self.on_tiles, z[None]
        tiles = {name: on_ground.get(name, self._next(n, name)) for name in self._walker.landing_points()}
        first = floor.tile(n if self._walker.base_contact() else 0).height
        heights = {name: floor.tile(tile).height - first for name, tile in tiles.items()}
        if not self._walker.base_contact() and on_tiles.system.uneven:  # they may have slid along their tiles
            heights |= {name: height for name, height in self._heights(z).items() if name in on_ground}
        before = floor.tile(max(n - 1, 0))
        level = [*heights.values(), first - before.height if self._walker.base_contact() else 0.0]
        flat = not any(level) and not any(tile.slope for tile in (before, *map(floor.tile, tiles.values())))
        same = all(on_tiles.is_nominal(n, name, floor.tile(tile).friction) for name, tile in tiles.items())
        if flat and same and not on_tiles.trailing(states).any():
            steps = self._nominal.steps
            return steps[n % len(steps)]
        under = {name: Tiles.of(floor, tile, heights[name]) for name, tile in tiles.items()}
        return Dynamics(on_tiles.system, on_tiles.parameters(n, under, states)[0])

    def of_step(self, n: int, on_ground: dict[str, int], arcs: Sequence[Arc]) -> list[Arc]:
        """The arcs of step ``n`` with the dynamics that follow from their modes and states.

        Parameters
        ----------
        on_ground : see ``dynamics``; it is updated to the tiles at the end of the step.
        """
        found, touching, first = list[Arc](), tuple[str, ...](), arcs[0].states[0]
        for arc in arcs:
            dynamics = found[-1].dynamics if found else self.dynamics(n, on_ground, arc.states[0]).acting(first)
            if found and not self._walker.base_contact() and arc.mode.touching != touching:
                now = self.within(n, on_ground, arc.mode)
                on_ground.clear()
                on_ground.update(now)
                dynamics = self.dynamics(n, on_ground, arc.states[0]).acting(first)
            found.append(replace(arc, dynamics=dynamics))
            touching = arc.mode.touching
        return found

    def _next(self, n: int, contact: str) -> int:
        """The tile on which a contact lands next in step ``n``."""
        return n + (contact in self._walker.step_ends())

    def _heights(self, z: Array) -> dict[str, float]:
        heights, _, _ = buffered(self._nominal.system.contact_points)(z, self._nominal.p)
        return dict(zip(self._walker.contact_names(), heights.tolist(), strict=True))


def comes_down(dynamics: Dynamics, z: Array) -> bool:
    """Whether a foot at the height of its tile lands there: its height falls, and so does the walker's own guard.

    Before mid-swing one of the two rises: just after the impact it is the foot, while the guard falls; later it is the
    guard, while the foot passes through the height of a lower tile. The foot does not land at either instant, just as
    it does not land on level ground when the legs pass each other.
    """
    return not dynamics.system.uneven or bool((buffered(dynamics.system.descent)(z, dynamics.p)[0] < 0).all())


def check_floor(system: HybridSystem, floor: Floor) -> None:
    """Check that a walker may walk on a floor.

    Raises
    ------
    ProblemError
        If none of the walker's steps ends with a landing; if the floor is uneven, and the walker lands with a given
        energy; if the floor has slopes, and the walker's feet roll.
    """
    walker = system.walker
    never = system.cycle_end == CLOCK or not (walker.step_ends() or system.cycle_end != TOUCHDOWN)
    if never or (walker.base_contact() and system.cycle_end != TOUCHDOWN):
        raise ProblemError(
            f"floor: no landing ends a step of the {walker.model}, so that no tile is under a foot; "
            "set the friction of its contacts instead"
        )
    if "energy" in walker.model_fields and not floor.is_even:
        raise ProblemError(
            f"floor: the {walker.model} lands with a given energy above level ground; leave height and slope out"
        )
    if "foot_radius" in walker.model_fields and any(floor.tile(n).slope for n in range(len(floor))):
        raise ProblemError(
            f"floor: the feet of the {walker.model} roll, so that a tile has no one landing point to tilt about; "
            "leave slope out"
        )


def may_vary(system: HybridSystem, quantity: str) -> bool:
    """Whether a walker may walk on tiles that differ in friction, height or slope, see ``check_floor``."""
    try:
        check_floor(system, Floor(**{quantity: 0.01}))
    except ProblemError:
        return False
    return True
