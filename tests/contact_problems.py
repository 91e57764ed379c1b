"""Problems of walkers with named contacts: those of the catalogue, and a runner that lands on a massless foot."""

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from casadi import SX, cos, norm_2, sin, vertcat
from named import named

from gaitopt import Cycle
from gaitopt.gait.gait import Gait
from gaitopt.model.mechanism import Body, Contact, Damper, Mechanism
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.rabbit import Rabbit
from gaitopt.problem.problem import Problem, load_problem, parse_problem
from gaitopt.search.solve import solve
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics


class Runner(Walker):
    """Spring-mass running: a point mass (x, y) on one massless springy leg that is placed anew for every step."""

    model = "one_leg"
    shape = ("leg_x", "leg_y")
    lengths = shape
    contacts = ("foot",)
    massless_contacts = contacts
    sections = ("apex",)

    mass: float
    leg_length: float
    stiffness: float
    attack: float
    energy: float
    gravity: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        leg, placed = vertcat(q.leg_x, q.leg_y), p.leg_length * vertcat(cos(p.attack), -sin(p.attack))
        foot = Contact(
            position=vertcat(q.x, q.y) + leg, gap=q.y + placed[1], places={"leg_x": placed[0], "leg_y": placed[1]}
        )
        return Mechanism(
            bodies=(Body(mass=p.mass, position=vertcat(q.x, q.y)),),
            gravity=vertcat(0, -p.gravity),
            upright=q.y / p.leg_length,
            potential_while={"foot": p.stiffness / 2 * (p.leg_length - norm_2(leg)) ** 2},
            contacts={"foot": foot},
            sections={"apex": lambda dq: dq.y},
            length=SX(p.leg_length),
        )


class Sled(Walker):
    """Three masses in a row on level ground, joined by two springs with a motor each."""

    model = "sled"
    shape = ("ahead", "behind", "front_rise", "rear_rise")
    lengths = shape
    contacts = ("rear", "middle", "front")
    actuators = ("pull", "push")

    rear_mass: float
    middle_mass: float
    front_mass: float
    stiffness: float
    damping: float
    rest: float
    gravity: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        positions = {
            "rear": vertcat(q.x - q.behind, q.y + q.rear_rise),
            "middle": vertcat(q.x, q.y),
            "front": vertcat(q.x + q.ahead, q.y + q.front_rise),
        }
        masses = {"rear": p.rear_mass, "middle": p.middle_mass, "front": p.front_mass}
        return Mechanism(
            bodies=tuple(Body(mass=masses[name], position=position) for name, position in positions.items()),
            gravity=vertcat(0, -p.gravity),
            upright=SX(1),
            motors=(q.ahead, q.behind),
            potential=p.stiffness / 2 * ((q.ahead - p.rest) ** 2 + (q.behind - p.rest) ** 2),
            dampers=tuple(Damper(coefficient=p.damping, across=gap) for gap in (q.ahead, q.behind)),
            contacts={name: Contact(position=position) for name, position in positions.items()},
            length=SX(p.rest),
        )


SLED = """
name: sled
walker: {model: sled, rear_mass: %s, middle_mass: %s, front_mass: %s, stiffness: %s, damping: 1.5, rest: 0.5,
  gravity: 9.81}
friction: 0.4
control: %s
gait:
  section: clock
  phases: [{rear: stick, middle: stick, front: stick}]
  guess: {state: {ahead: 0.5, behind: 0.5}}
"""


def sled(masses: tuple[float, float, float], stiffness: float, control: str) -> Problem:
    """A sled at rest; a walk from there finds the modes of its gait."""
    return parse_problem(SLED % (*masses, stiffness, control), walkers=[Sled])


RUN = """
name: run
walker: {model: one_leg, mass: 1, leg_length: 1, stiffness: 20, attack: 1.1868238913561442, energy: 1.7, gravity: 1}
friction: 0.6
gait:
  section: {margin: apex}
  phases: [{}, {foot: stick}, {}]
  guess:
    state: {y: 0.935, dx: 1.237}
"""
BOUNDERS = ("bounding", "bounding-overlap")
SPRINGS = ("slip-walk", "slip-walk-stable")
NAMES = ("heel-toe", "heel-toe-slip", "heel-toe-impact-slip", *SPRINGS, *BOUNDERS, "crawler", "inchworm", "run")


@cache
def contact_problem(name: str) -> Problem:
    return parse_problem(RUN, walkers=[Runner]) if name == "run" else load_problem(name)


@cache
def contact_gait(name: str) -> Gait:
    """The gait of a problem, solved once."""
    if name != "run":
        return named(name)
    gait = solve(contact_problem(name))
    assert gait.converged, gait.message
    return gait


class PointFeet(Rabbit):
    """RABBIT with the points of both feet as contacts."""

    model = "rabbit_contacts"
    contacts = ("foot", "other")
    landing_contacts = ("other",)
    exchanged_contacts = {"foot": "other"}  # noqa: RUF012

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        stated = super().mechanism(q, p)
        other = Contact(position=stated.swing_foot, counts=stated.phases["stance_leg"])
        return replace(stated, contacts={"foot": Contact(position=vertcat(q.x, q.y)), "other": other})


def with_point_feet(name: str, model: str = "stick") -> Problem:
    """A problem of RABBIT, restated with named contacts."""
    text = load_problem(name).text.replace("model: rabbit", "model: rabbit_contacts")
    phases = re.search(r"phases: \[(.*)\]", text).group(1).split(", ")
    text = re.sub(r"phases: .*", f"phases: [{', '.join(f'{{foot: {word}}}' for word in phases)}]", text)
    text = re.sub(r"impact: (\w+)", r"impact: {foot: \1}", text).replace("model: stick", f"model: {model}")
    return parse_problem(text, walkers=[PointFeet])


def settled(problem: Problem, steps: int) -> Gait:
    """The gait with the modes of a walk that has settled after some steps."""
    dynamics = problem_dynamics(problem)
    names = dynamics.system.state_names
    step = Simulator(dynamics).run(np.array([problem.guess.state.get(name, 0.0) for name in names]), steps).steps[-1]
    state, durations = step.arcs[0].states[0].tolist(), [duration for _, duration in step.phases]
    walking = problem.with_modes(Cycle((step.sequence,)), dict(zip(names, state, strict=True)), durations)
    return solve(walking.from_guess())
