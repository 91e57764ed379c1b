"""Mechanics of walkers a second time, in NumPy and by hand, as an oracle for the package.

A point of a walker is the foot plus links, r (sin(a + s theta), cos(a + s theta)), so that its Jacobian and the part
of its acceleration that is free of accelerations are written down at once. Newton's law for every body, projected
on the coordinates, then gives M, B and G without a Lagrangian and without automatic differentiation. Forces of the
stance foot and impulses of the swing foot follow by the formulas of Gamus & Or (2013) for one foot.
"""

import importlib.util
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from gaitopt import Mode, Walker
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SLIPS = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
FRICTION = 0.23
IN_LINE_AFTER = 0.4
"""Time of a step in which the legs, in line at its start, have parted [s]."""


@cache
def example(module: str, name: str) -> type[Walker]:
    """A class out of a file in docs/examples."""
    spec = importlib.util.spec_from_file_location(module, EXAMPLES / f"{module}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return getattr(loaded, name)


TorsoCompass = example("torso_compass", "TorsoCompass")


@dataclass(frozen=True)
class Link:
    """A link from one joint to the next: ``length (sin phi, cos phi)`` with ``phi = offset + sign q[index]``."""

    length: float
    index: int
    sign: int = 1
    offset: float = 0.0

    def phi(self, q: Array) -> float:
        return self.offset + self.sign * q[self.index]


@dataclass(frozen=True)
class Point:
    links: tuple[Link, ...]

    def position(self, q: Array) -> Array:
        arms = [link.length * np.array([np.sin(link.phi(q)), np.cos(link.phi(q))]) for link in self.links]
        return q[-2:] + np.sum(arms, axis=0)

    def jacobian(self, q: Array) -> Array:
        J = np.zeros((2, q.size))
        J[:, -2:] = np.eye(2)
        for link in self.links:
            J[:, link.index] += link.sign * link.length * np.array([np.cos(link.phi(q)), -np.sin(link.phi(q))])
        return J

    def velocity(self, q: Array, dq: Array) -> Array:
        return self.jacobian(q) @ dq

    def centripetal(self, q: Array, dq: Array) -> Array:
        """Acceleration of the point where no coordinate accelerates."""
        arms = [
            -link.length * dq[link.index] ** 2 * np.array([np.sin(link.phi(q)), np.cos(link.phi(q))])
            for link in self.links
        ]
        return np.sum(arms, axis=0) if arms else np.zeros(2)


@dataclass(frozen=True)
class Mass:
    mass: float
    point: Point
    inertia: float = 0.0
    turns_with: int = 0


@dataclass(frozen=True)
class Oracle:
    """Hand-written mechanics of one walker with fixed parameters."""

    masses: tuple[Mass, ...]
    swing_foot: Point
    gravity: Array
    hip: Point
    spring: Callable[[Array], float] = lambda q: 0.0
    spring_gradient: Callable[[Array], Array] = np.zeros_like

    def M(self, q: Array) -> Array:
        total = np.zeros((q.size, q.size))
        for m in self.masses:
            J = m.point.jacobian(q)
            total += m.mass * J.T @ J
            total[m.turns_with, m.turns_with] += m.inertia
        return total

    def B(self, q: Array, dq: Array) -> Array:
        return sum(m.mass * m.point.jacobian(q).T @ m.point.centripetal(q, dq) for m in self.masses)

    def G(self, q: Array) -> Array:
        weight = sum(-m.mass * m.point.jacobian(q).T @ self.gravity for m in self.masses)
        return weight + self.spring_gradient(q)

    def energy(self, q: Array, dq: Array) -> float:
        kinetic = sum(
            m.mass * np.sum(m.point.velocity(q, dq) ** 2) / 2 + m.inertia * dq[m.turns_with] ** 2 / 2
            for m in self.masses
        )
        return kinetic - sum(m.mass * self.gravity @ m.point.position(q) for m in self.masses) + self.spring(q)

    def force(self, q: Array, dq: Array, slip: int, friction: float, drive: Array | float = 0.0) -> tuple[Array, Array]:
        """Force on the stance foot that sticks (``slip`` 0) or slips, and accelerations: eqs (2), (3), (5), (6)."""
        M, bias = self.M(q), self.B(q, dq) + self.G(q) - drive
        W = np.eye(q.size)[-2:]
        ratio = np.array([-friction * slip, 1])
        if slip:
            f = ratio * (W[1] @ np.linalg.solve(M, bias)) / (W[1] @ np.linalg.solve(M, W.T @ ratio))
        else:
            f = np.linalg.solve(W @ np.linalg.solve(M, W.T), W @ np.linalg.solve(M, bias))
        return f, np.linalg.solve(M, W.T @ f - bias)

    def impulse(self, q: Array, dq: Array, slip: int, friction: float) -> tuple[Array, Array]:
        """Impulse on the swing foot that lands and then sticks or slips, and rates after it: eqs (8), (9), (11)."""
        M, W = self.M(q), self.swing_foot.jacobian(q)
        ratio = np.array([-friction * slip, 1])
        if slip:
            F = -ratio * (W[1] @ dq) / (W[1] @ np.linalg.solve(M, W.T @ ratio))
        else:
            F = -np.linalg.solve(W @ np.linalg.solve(M, W.T), W @ dq)
        return F, dq + np.linalg.solve(M, W.T @ F)

    def swing(
        self, q: Sequence[float], dq: Sequence[float], drive: Callable[..., Array | float] = lambda q, dq, t: 0.0
    ) -> tuple[Array, Array, float]:
        """Coordinates, rates and time where the legs, of one length, are in line again; the stance foot sticks."""
        n = len(q)

        def rates(t: float, y: Array) -> Array:
            return np.concatenate([y[n:], self.force(y[:n], y[n:], 0, 0.0, drive(y[:n], y[n:], t))[1]])

        def in_line(t: float, y: Array) -> float:
            return y[0] - y[1] if t > IN_LINE_AFTER else -1.0

        in_line.terminal, in_line.direction = True, 1
        end = solve_ivp(rates, (0, 10), [*q, *dq], "DOP853", events=in_line, rtol=1e-12, atol=1e-13)
        return end.y[:n, -1], end.y[n:, -1], end.t[-1]


def up(angle: float) -> Array:
    """Unit vector at an angle from the normal of the ground."""
    return np.array([np.sin(angle), np.cos(angle)])


def jacobian(positions: Callable[[Array], Array], q: Array) -> Array:
    """Derivative of all positions, (x, y) in rows, by complex steps."""
    return np.array([positions(q + 1e-30j * e).imag.ravel() / 1e-30 for e in np.eye(len(q))]).T


def constrained(
    positions: Callable[[Array], Array],
    masses: Array,
    gravity: Array,
    q: Array,
    dq: Array,
    constraints: Array | Sequence = (),
    pushes: Array | None = None,
    loads: Array | float = 0.0,
    inertia: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Accelerations of point masses, and forces of constraints.

    J' m (J ddq + dJ dq - g) + inertia ddq = loads + pushes' forces and constraints @ ddq = 0, as one linear system.
    """
    constraints, m, h = np.reshape(constraints, (-1, len(q))), np.repeat(masses, 2), 1e-6
    pushes, J = constraints if pushes is None else pushes, jacobian(positions, q)
    bias = (jacobian(positions, q + h * dq) - jacobian(positions, q - h * dq)) @ dq / (2 * h)
    K = np.block([[J.T * m @ J + inertia, -pushes.T], [constraints, np.zeros((len(constraints), len(constraints)))]])
    right = J.T @ (m * (np.tile(gravity, len(masses)) - bias)) + loads
    return tuple(np.split(np.linalg.solve(K, [*right, *np.zeros(len(constraints))]), [len(q)]))


class Crawl(NamedTuple):
    """The cycle of a crawler whose masses slide in turn: smallest and largest gap, ratios and times of both slides."""

    smallest: Any
    largest: Any
    factors: tuple[Any, Any]
    times: tuple[Any, Any]


def crawl(front: Any, rear: Any, slope: Any, number: Callable[[str], Any] = float, functions: Any = np) -> Crawl:
    """Closed form of the named crawler with the frictions of its masses on a slope, in numbers of any kind.

    Each half one mass slides half an oscillation about where its forces balance, and then rests: gap = g + (gap_0 - g)
    (1, -e) at both ends of a slide, e = exp(-s pi / w). The gap pushes the front mass ahead, and pulls the rear one;
    friction is against the motion ahead.
    """
    k, c, rest, force, weight = map(number, ("20", "1.5", "0.5", "4.95", "9.81"))
    along, normal, slides = weight * functions.sin(slope), weight * functions.cos(slope), []
    for m, mu, sign in ((number("1.5"), front, 1), (number("1"), rear, -1)):
        s = c / (2 * m)
        w = functions.sqrt(k / m - s * s)
        balance = rest + sign * (force + m * along - mu * m * normal) / k
        slides.append((balance, functions.exp(-s * functions.pi / w), functions.pi / w))
    (g1, e1, t1), (g2, e2, t2) = slides
    smallest = (g2 * (1 + e2) - e2 * g1 * (1 + e1)) / (1 - e1 * e2)
    return Crawl(smallest, g1 + e1 * (g1 - smallest), (e1, e2), (t1, t2))


def slope_gravity(g: float, slope: float) -> Array:
    return g * np.array([np.sin(slope), -np.cos(slope)])


def wheel_oracle(spokes: int, radius: float, mass: float, inertia_ratio: float, gravity: float, slope: float) -> Oracle:
    hub = Point((Link(radius, 0),))
    return Oracle(
        masses=(Mass(mass, hub, inertia_ratio * mass * radius**2),),
        swing_foot=Point((Link(radius, 0), Link(-radius, 0, offset=-2 * np.pi / spokes))),
        gravity=slope_gravity(gravity, slope),
        hip=hub,
    )


def wheel_friction(alpha: float) -> float:
    """Least friction that keeps the rimless wheel of the paper from slipping between impacts, eqs (15), (17), (18)."""
    kappa, sigma = 1 / 3, 2 * math.pi / 10
    decrease, first, last = ((kappa + math.cos(sigma)) / (kappa + 1)) ** 2, -sigma / 2, sigma / 2
    gain = 2 / (kappa + 1) * (math.cos(first + alpha) - math.cos(last + alpha))
    start = decrease * gain / (1 - decrease)

    def ratio(theta: float) -> float:
        square = start + 2 / (kappa + 1) * (math.cos(first + alpha) - math.cos(theta + alpha))
        acceleration = math.sin(theta + alpha) / (kappa + 1)
        f_t = acceleration * math.cos(theta) - square * math.sin(theta) - math.sin(alpha)
        f_n = -acceleration * math.sin(theta) - square * math.cos(theta) + math.cos(alpha)
        return abs(f_t) / f_n

    found = minimize_scalar(lambda theta: -ratio(theta), bounds=(first, last), method="bounded")
    return max(ratio(first), ratio(last), -found.fun)


def compass_oracle(
    leg_length: float,
    leg_mass: float,
    leg_com: float,
    hip_mass: float,
    gravity: float,
    slope: float,
    other_leg_mass: float | None = None,
    other_leg_com: float | None = None,
) -> Oracle:
    other_mass, other_com = other_leg_mass or leg_mass, other_leg_com or leg_com
    stance = Link(leg_length, 0)
    hip = Point((stance,))
    return Oracle(
        masses=(
            Mass(leg_mass, Point((Link(leg_com, 0),))),
            Mass(hip_mass, hip),
            Mass(other_mass, Point((stance, Link(other_com - leg_length, 1, sign=-1)))),
        ),
        swing_foot=Point((stance, Link(-leg_length, 1, sign=-1))),
        gravity=slope_gravity(gravity, slope),
        hip=hip,
    )


def torso_oracle(
    leg_length: float,
    leg_mass: float,
    leg_com: float,
    torso_mass: float,
    torso_com: float,
    torso_inertia: float,
    stiffness: float,
    gravity: float,
    slope: float,
) -> Oracle:
    stance = Link(leg_length, 0)
    k = stiffness
    return Oracle(
        masses=(
            Mass(leg_mass, Point((Link(leg_com, 0),))),
            Mass(leg_mass, Point((stance, Link(leg_com - leg_length, 1, sign=-1)))),
            Mass(torso_mass, Point((stance, Link(torso_com, 2))), torso_inertia, turns_with=2),
        ),
        swing_foot=Point((stance, Link(-leg_length, 1, sign=-1))),
        gravity=slope_gravity(gravity, slope),
        hip=Point((stance,)),
        spring=lambda q: k * ((q[2] - q[0]) ** 2 + (q[2] + q[1]) ** 2) / 2,
        spring_gradient=lambda q: k * np.array([q[0] - q[2], q[1] + q[2], 2 * q[2] - q[0] + q[1], 0, 0]),
    )


@dataclass(frozen=True)
class Case:
    """A walker with numbers; its passive hybrid system and its oracle."""

    walker: Walker
    oracle: Oracle

    @property
    def n(self) -> int:
        return len(self.walker.shape)

    @property
    def numbers(self) -> Array:
        """Parameters of the walker in the order of its fields."""
        return np.array([float(value) for _, value in self.walker])

    @property
    def p(self) -> Array:
        """Parameters of the passive system."""
        return np.append(self.numbers, FRICTION)

    @property
    def system(self) -> HybridSystem:
        return passive_system(type(self.walker))

    def states(self, count: int = 8) -> list[Array]:
        """Random states, foot slipping."""
        rng = np.random.default_rng(20130522)
        scale = np.concatenate([np.full(self.n, 0.4), [1.0], np.full(self.n + 1, 1.5)])
        return [scale * rng.uniform(-1, 1, 2 * self.n + 2) for _ in range(count)]

    def coordinates(self, z: Array) -> tuple[Array, Array]:
        """q and dq, y included, from a state."""
        return np.append(z[: self.n + 1], 0.0), np.append(z[self.n + 1 :], 0.0)


@cache
def passive_system(walker: type[Walker]) -> HybridSystem:
    return HybridSystem(walker, NoControl())


WHEEL = {"spokes": 10, "radius": 0.9, "mass": 1.3, "inertia_ratio": 0.4, "gravity": 9.81, "slope": 0.22}
COMPASS = {"leg_length": 1.6, "leg_mass": 4.0, "leg_com": 0.7, "hip_mass": 2.0, "gravity": 9.8, "slope": 0.03}
TORSO = {
    "leg_length": 1.1,
    "leg_mass": 3.0,
    "leg_com": 0.6,
    "torso_mass": 5.0,
    "torso_com": 0.3,
    "torso_inertia": 0.8,
    "stiffness": 30.0,
    "gravity": 9.8,
    "slope": 0.05,
}

CASES = {
    "rimless_wheel": Case(RimlessWheel(**WHEEL), wheel_oracle(**WHEEL)),
    "compass_biped": Case(CompassBiped(**COMPASS), compass_oracle(**COMPASS)),
    "torso_compass": Case(TorsoCompass(**TORSO), torso_oracle(**TORSO)),
}


def state_for(mode: Mode, z: Array) -> Array:
    """A state that is possible in a mode: the foot at rest, or moving in the slip's direction."""
    z = z.copy()
    z[-1] = mode.direction * abs(z[-1])
    return z


def numbers(values: object) -> list[Array]:
    """Results of a compiled function as flat arrays, or as matrices where they have more than one column."""
    arrays = [np.asarray(value) for value in (values if isinstance(values, tuple | list) else (values,))]
    return [array.ravel() if 1 in array.shape or array.size == 0 else array for array in arrays]


def directional(function: Callable[[Array], Array | float], z: Array, direction: Array, h: float = 1e-5) -> Array:
    """Derivative of a function along a direction by central differences of fourth order."""
    f = [np.asarray(function(z + k * h * direction)) for k in (-2, -1, 1, 2)]
    return (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)


def differences(function: Callable[[Array], Array], z: Array, h: float = 1e-5) -> Array:
    """Jacobian by central differences of fourth order."""
    return np.column_stack([directional(function, z, e, h) for e in np.eye(z.size)])
