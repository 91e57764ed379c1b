"""A slow, plain time-stepping simulator of walkers with dry friction, as an oracle for the event-driven one.

    M (v_plus - v) = h (Q - B - G) + sum J' P     P_n >= 0 perpendicular to J_n v_plus >= 0 where a gap is not positive
    |P_t| <= mu P_n,  P_t = -mu P_n sgn(v_t_plus) where v_t_plus is not zero

Impulses P come from Gauss-Seidel iterations over the contacts, projected on the friction cones. There are no modes and
no events. The error is of first order in the time step. J. J. Moreau (1988), Unilateral contact and dry friction in
finite freedom dynamics.

Feet at the end of massless springs have no momentum, and no friction law that moves them: ``bounce`` holds them where
they land while the spring is shorter than at rest, and integrates the body by the semi-implicit rule of Euler.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from oracles import Oracle, Point

Array = NDArray[np.float64]
REACH = 1e-6
"""Gap of a contact that is closed; the gaps of contacts that stay closed drift by the square of the time step [m]."""


def walk(
    oracle: Oracle,
    points: Mapping[str, Point],
    friction: Mapping[str, float],
    state: tuple[Array, Array],
    duration: float,
    steps: int,
    *,
    counts: Callable[[str, Array], bool] = lambda name, q: True,
    force: Callable[[float, Array, Array], Array] = lambda t, q, v: np.zeros_like(q),
    sweeps: int = 2000,
) -> tuple[Array, Array, list[tuple[str, ...]]]:
    """Coordinates and rates after a time, and what the contacts did in every step.

    Parameters
    ----------
    state : coordinates (shape, x, y) and rates at the start.
    counts : whether a contact may touch the ground at these coordinates.
    force : generalised force Q of motors, springs and dampers.
    """
    (q, v), h, history = (state[0].copy(), state[1].copy()), duration / steps, list[tuple[str, ...]]()
    for k in range(steps):
        middle = q + h / 2 * v
        M, bias = oracle.M(middle), oracle.B(middle, v) + oracle.G(middle) - force((k + 0.5) * h, middle, v)
        free = v - h * np.linalg.solve(M, bias)
        closed = [n for n, point in points.items() if point.position(middle)[1] <= REACH and counts(n, middle)]
        v = _projected(M, free, [points[n].jacobian(middle) for n in closed], [friction[n] for n in closed], sweeps)
        q = middle + h / 2 * v
        history.append(tuple(_word(points[n].jacobian(middle) @ v, n in closed) for n in points))
    return q, v, history


def bounce(
    mass: float,
    inertia: float,
    hips: Mapping[str, float],
    leg: tuple[float, float, Mapping[str, float]],
    state: tuple[Array, Array, dict[str, Array]],
    duration: float,
    steps: int,
) -> tuple[Array, Array, list[tuple[str, ...]]]:
    """Coordinates (x, y, pitch) and rates of a body on massless springs after a time, and the legs down in every step.

    Parameters
    ----------
    hips : distance of each leg's hip ahead of the centre of mass.
    leg : length, stiffness, and by leg the angle ahead of the vertical at which it lands.
    state : coordinates and rates at the start, and the feet on the ground.
    """
    length, stiffness, angles = leg
    (q, v), feet, h, history = (state[0].copy(), state[1].copy()), dict(state[2]), duration / steps, []
    for _ in range(steps):
        total = np.array([0.0, -mass * 9.81, 0.0])
        for name, ahead in hips.items():
            hip = q[:2] + ahead * np.array([np.cos(q[2]), -np.sin(q[2])])
            J = np.array([[1, 0, -ahead * np.sin(q[2])], [0, 1, -ahead * np.cos(q[2])]])
            placed = hip + length * np.array([np.sin(angles[name]), -np.cos(angles[name])])
            if name not in feet and placed[1] <= 0 and (J @ v)[1] < 0:
                feet[name] = np.array([placed[0], 0.0])
            if name in feet:
                along = hip - feet[name]
                size = np.linalg.norm(along)
                if size > length and along @ J @ v > 0:
                    del feet[name]
                else:
                    total += stiffness * (length - size) / size * along @ J
        v = v + h * total / np.array([mass, mass, inertia])
        q = q + h * v
        history.append(tuple(name for name in hips if name in feet))
    return q, v, history


def _projected(M: Array, v: Array, jacobians: Sequence[Array], friction: Sequence[float], sweeps: int) -> Array:
    """The velocity after impulses that satisfy both laws of every contact."""
    impulses = [np.zeros(2) for _ in jacobians]
    responses = [np.linalg.solve(M, J.T) for J in jacobians]
    for _ in range(sweeps):
        largest = 0.0
        for J, response, mu, P in zip(jacobians, responses, friction, impulses, strict=True):
            D = J @ response
            for row in (1, 0):
                limit = (0.0, np.inf) if row else (-mu * P[1], mu * P[1])
                new = np.clip(P[row] - (J @ v)[row] / D[row, row], *limit)
                change, P[row] = new - P[row], new
                v = v + response[:, row] * change
                largest = max(largest, abs(change))
        if largest < 1e-14:
            break
    return v


def _word(velocity: Array, closed: bool) -> str:
    if not closed or velocity[1] > 1e-9:
        return "off"
    return "stick" if abs(velocity[0]) < 1e-9 else "slip_forward" if velocity[0] > 0 else "slip_backward"
