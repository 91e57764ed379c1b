"""Lines that walkers draw themselves with, for ``Walker.outline``."""

from typing import Any

from casadi import SX, vertcat

TURNS = 6
"""Of a spring."""
WIDTH = 0.04
"""Half width of a spring."""


def spring(start: SX, end: SX, length: Any) -> tuple[SX, ...]:
    """Points of a spring as a zigzag between two points, shape (2,) each [m].

    Parameters
    ----------
    length : full length of the spring, which its width goes by [m].
    """
    along = end - start
    across = WIDTH * length * vertcat(-along[1], along[0]) / (along[0] ** 2 + along[1] ** 2).sqrt()
    sides = [(k + 0.5) / TURNS * along + (-1) ** k * across for k in range(TURNS)]
    return (start, *(start + side for side in sides), end)
