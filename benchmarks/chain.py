"""Walkers of 2 to 12 straight links in a row, to see how cost grows with their number; none of them is a gait's."""

from types import SimpleNamespace
from typing import Any

from casadi import cos, sin, vertcat

from gaitopt import Body, Mechanism, Walker
from gaitopt.model.mechanism import polar


def chain(links: int) -> type[Walker]:
    """A walker of so many links of length 1/links m and mass 1/links kg, from foot to foot."""
    names = tuple(f"theta{k}" for k in range(1, links + 1))

    class Chain(Walker):
        model = f"chain-{links}"
        shape = names
        section = names[:-1]
        gravity: float = 9.8
        slope: float = 0.02

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            joint, bodies = vertcat(q.x, q.y), []
            for name in names:
                step = polar(1 / links, getattr(q, name))
                bodies.append(Body(mass=1 / links, position=joint + step / 2))
                joint = joint + step
            first, last = getattr(q, names[0]), getattr(q, names[-1])
            return Mechanism(
                bodies=tuple(bodies),
                gravity=p.gravity * vertcat(sin(p.slope), -cos(p.slope)),
                swing_foot=joint,
                touchdown=first - last,
                upright=cos(first),
                relabel=vertcat(*(getattr(q, name) for name in reversed(names))),
            )

        @classmethod
        def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
            return (*(getattr(free, name) for name in names[:-1]), free.theta1)

    return Chain
