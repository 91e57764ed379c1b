"""A walker on a floor: the parameters of its hybrid system step by step, from the tiles under its contacts.

On a floor every contact has the friction of the ground under it, and on an uneven one its height and slope:

    p = (walker, friction of every contact, control, height and slope of every contact)

A foot that stands alone is on tile n in step n, and lands on tile n + 1, whose height is measured from the tile under
it. Named contacts keep the tile of the step in which they landed. The state is always that on the nominal floor.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import RowMap, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import ContactFriction, Friction
from gaitopt.model.lagrangian import TRAILING
from gaitopt.model.modes import FOOT, SWING_FOOT
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.system import FLOOR, HybridSystem
from gaitopt.problem.floor import Floor
from gaitopt.threads import cached_property

LEVEL = 1e-9
"""A height that is smaller, in natural units, is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tiles:
    """The tiles of m walks that are under one contact.

    Attributes
    ----------
    friction : ndarray, shape (m, 2) - static and kinetic coefficient; None for those of the problem.
    height, slope : ndarray, shape (m,) - [m], [rad].
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
        kinds = ("static", "kinetic") if drops else ("friction", "friction")
        return Friction(*(f"{key}.{kind}" for kind in kinds), f"{key}.viscous" if is_viscous else None)

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
    nominal : as given.
    system : the system on tiles.
    """

    def __init__(self, dynamics: Dynamics, *, drops: bool, uneven: bool) -> None:
        self.nominal, nominal = dynamics, dynamics.system
        system = floor_system(nominal.shared, nominal.friction.may_drop or drops, uneven)
        self.system = system if nominal.control is nominal.shared.control else system.retimed(nominal.control)
        self._place = {key: k for k, key in enumerate(self.system.parameters)}
        shared = [key for key in nominal.parameters if key in self._place]
        self._from, self._to = [nominal.parameters.index(key) for key in shared], [self._place[key] for key in shared]
        self._steps, self._coefficients = dynamics.steps, list[dict[str, tuple[float, ...]]]()
        for step in dynamics.steps:
            of = nominal.contact_coefficients(step.p)
            values = {name: of.get(name, of.get(FOOT, ())) for name in nominal.walker.landing_points()}
            self._coefficients.append({name: tuple(map(float, value)) for name, value in values.items()})

    def is_nominal(self, n: int, name: str, friction: tuple[float, float] | None) -> bool:
        """Whether the friction of the tile under a contact in step ``n`` is that of the problem."""
        return friction in (None, self._coefficients[n % len(self._steps)][name][:2])

    def place(self, name: str) -> int:
        """Index among the parameters of a number of a tile, such as ``foot.slope`` or ``swing_foot.static``.

        Where a tile has one coefficient, its index is that of both.
        """
        key, (contact, _, what) = f"{FLOOR}.{name}", name.rpartition(".")
        if what in ("static", "kinetic") and key not in self._place:
            key = f"{FLOOR}.{contact}.friction"
        return self._place[key]

    def parameters(self, n: int, tiles: Mapping[str, Tiles], states: Array) -> Array:
        """Parameters in step ``n``, shape (m, n_p).

        Parameters
        ----------
        tiles : those under each contact, at the heights that they have there; nominal ones by default.
        states : ndarray, shape (m, n_z) - states in which the step begins.
        """
        at, m = n % len(self._steps), len(states)
        p = np.zeros((m, len(self._place)))
        p[:, self._to] = self._steps[at].p[self._from]
        level = Tiles(friction=None, height=np.zeros(m), slope=np.zeros(m))
        tiles = {name: tiles.get(name, level) for name in self.system.walker.landing_points()}
        for name, tile in tiles.items():
            static, kinetic, viscous = self._coefficients[at][name]
            pair = np.array([[static, kinetic]]) if tile.friction is None else tile.friction
            columns = {"friction": pair[:, 0], "static": pair[:, 0], "kinetic": pair[:, 1], "viscous": viscous}
            for what, column in {**columns, "height": tile.height, "slope": tile.slope}.items():
                if (place := self._place.get(f"{FLOOR}.{name}.{what}")) is not None:
                    p[:, place] = column
        if self.system.uneven and self.system.walker.stands_on_one():
            is_higher = (tiles[SWING_FOOT].height != 0) | (tiles[FOOT].slope != 0)
            p[:, self._place[f"{FLOOR}.{SWING_FOOT}.is_higher"]] = is_higher
            p[:, self._place[f"{FLOOR}.{TRAILING}"]] = self.trailing(states)
        return p

    def trailing(self, states: Array) -> Array:
        """Heights of the feet that have just left the ground, as far as they are more than rounding, (m,) [m]."""
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
        self.floor, self._nominal = floor, dynamics
        self.on_tiles = OnTiles(dynamics, drops=floor.drops, uneven=not floor.is_even)

    def of_step(self, n: int, z: Array) -> Dynamics:
        """A walker on one foot in step ``n``, counted from 0, which begins with the state ``z``; shape (n_z,).

        It is the nominal one where the tiles are nominal, and no tile before them had another height.
        """
        here, following = self.floor.tile(n), self.floor.tile(n + 1)
        rise, on_tiles, states = following.height - here.height, self.on_tiles, z[None]
        same = all(not tile.slope and on_tiles.is_nominal(n, FOOT, tile.friction) for tile in (here, following))
        if same and not rise and not on_tiles.trailing(states).any():
            steps = self._nominal.steps
            return steps[n % len(steps)]
        tiles = {FOOT: Tiles.of(self.floor, n, 0.0), SWING_FOOT: Tiles.of(self.floor, n + 1, rise)}
        return Dynamics(on_tiles.system, on_tiles.parameters(n, tiles, states)[0])


def comes_down(dynamics: Dynamics, z: Array) -> bool:
    """Whether a foot at the height of its tile lands there: the walker's own guard falls, too.

    Before mid-swing the guard rises. A foot that passes through the height of a lower tile then does not land, as it
    does not land on level ground where the legs pass each other.
    """
    if not dynamics.system.uneven:
        return True
    _, rate = buffered(dynamics.system.guard)(z, dynamics.p)
    return bool(rate[0] < 0)


def check_floor(system: HybridSystem, floor: Floor) -> None:
    """Check that a walker may walk on a floor.

    Raises
    ------
    ProblemError
        If no step of it ends with a landing; if the floor is uneven, and the walker lands with a given energy; if it
        has slopes, and the feet of the walker roll.
    """
    walker = system.walker
    if system.cycle_end != TOUCHDOWN or not walker.step_ends():
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
