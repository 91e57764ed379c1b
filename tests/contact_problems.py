"""Problems of walkers with several contacts."""

from functools import cache
from types import SimpleNamespace

from casadi import SX, cos, norm_2, sin, vertcat
from contact_walkers import Crawler, HeelToe, SpringMassWalker

from gaitopt.gait.gait import Gait
from gaitopt.model.walker import Body, Contact, Mechanism, Walker, inclined
from gaitopt.problem.problem import Problem, parse_problem
from gaitopt.search.solve import solve


class SpringMassWalking(SpringMassWalker):
    """A spring-mass walker of a given energy."""

    model = "slip_walking"

    energy: float


class Inchworm(Walker):
    """Two links with a hinge, whose ends are both on the ground; (x, y) is the hinge."""

    model = "inchworm"
    shape = ("rear_angle", "front_angle")
    contacts = ("rear", "front")
    actuators = ("hinge",)

    link_length: float
    link_com: float
    link_mass: float
    link_inertia: float
    hinge_mass: float
    gravity: float
    slope: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        hinge = vertcat(q.x, q.y)
        angles = {"rear": -q.rear_angle, "front": q.front_angle}

        def along(length: SX, angle: SX) -> SX:
            return hinge + length * vertcat(sin(angle), -cos(angle))

        return Mechanism(
            bodies=(
                Body(mass=p.hinge_mass, position=hinge),
                *(
                    Body(mass=p.link_mass, position=along(p.link_com, angle), inertia=p.link_inertia, angle=angle)
                    for angle in angles.values()
                ),
            ),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.rear_angle),
            motors=(q.rear_angle + q.front_angle,),
            contacts={name: Contact(position=along(p.link_length, angle)) for name, angle in angles.items()},
            length=SX(p.link_length),
        )


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


WALKERS = [Crawler, HeelToe, Inchworm, Runner, SpringMassWalking]
HEEL_TOE = """
name: heel-toe
walker:
  {{model: heel_toe, leg_length: 1, leg_mass: 5, leg_com: 0.5, hip_mass: 10, heel: 0.02, toe: 0.04, gravity: 9.81,
   slope: 0.0524}}
friction: {friction}
gait:
  phases: [{phases}]
  impact: {{heel: {impact}}}
  guess:
    state: {{theta1: -0.2949, theta2: -0.317, dtheta1: 1.156, dtheta2: -0.344{slip}}}
"""
SLIPS = "{heel: slip_forward}, {heel: stick}, {toe: stick}, {toe: slip_backward}"
HEEL_TOES = {
    "heel-toe": HEEL_TOE.format(friction=0.3, phases="{heel: stick}, {toe: stick}", impact="stick", slip=""),
    "heel-toe-slip": HEEL_TOE.format(friction=0.265, phases=SLIPS, impact="stick", slip=""),
    "heel-toe-slip-strike": HEEL_TOE.format(friction=0.255, phases=SLIPS, impact="slip_forward", slip=", dx: 0.01"),
}
SLIP_WALK = """
name: slip-walk
walker:
  {model: slip_walking, mass: 80, leg_length: 1, stiffness: 14000, attack: 1.2042771838760873, gravity: 9.81,
   energy: 816}
friction: 1
gait:
  phases: [{front: stick, back: stick}, {front: stick}]
  impact: {front: stick, back: stick}
  guess:
    state: {back_x: -0.10337, dy: -0.395, y: 0.93, front_x: 0.36, front_y: -0.93, back_y: -0.93, dx: 1.13}
"""
CRAWLER = """
name: crawler
walker:
  {model: crawler, rear_mass: 1, front_mass: 1.5, stiffness: 20, damping: 1.5, rest: 0.5, gravity: 9.81, slope: 0.1}
friction: {rear: 0.6, front: 0.4}
control: {type: alternating, cycle: 2, first: {drive: 4.95}, second: {drive: -4.95}}
gait:
  section: clock
  phases: [{rear: stick, front: slip_forward}, {rear: stick, front: stick}, {rear: slip_forward, front: stick},
           {rear: stick, front: stick}]
  guess:
    state: {gap: 0.45}
"""
INCHWORM = """
name: inchworm
walker:
  {model: inchworm, link_length: 0.5, link_com: 0.25, link_mass: 0.5, link_inertia: 0.0104, hinge_mass: 0.5,
   gravity: 9.81, slope: 0.08}
friction: {rear: 0.5, front: 0.4}
control: {type: oscillating, cycle: 1, kp: 30, kd: 0.6, mean: {hinge: 1.2}, amplitude: {hinge: 0.3}}
gait:
  section: clock
  phases: [{rear: slip_backward, front: slip_forward}, {rear: stick, front: slip_forward},
           {rear: stick, front: stick}, {rear: slip_forward, front: stick},
           {rear: slip_forward, front: slip_backward}, {rear: slip_forward, front: stick},
           {rear: slip_forward, front: slip_forward}, {rear: stick, front: slip_forward},
           {rear: stick, front: stick}, {rear: stick, front: slip_forward},
           {rear: slip_backward, front: slip_forward}]
  guess:
    state: {rear_angle: 0.59917575, front_angle: 0.59917575, y: 0.4129, dx: 0.30342697, drear_angle: 0.99158137,
            dfront_angle: 0.99158, dy: -0.2796}
"""
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
TEXTS = {**HEEL_TOES, "slip-walk": SLIP_WALK, "crawler": CRAWLER, "inchworm": INCHWORM, "run": RUN}


@cache
def contact_problem(name: str) -> Problem:
    return parse_problem(TEXTS[name], walkers=WALKERS)


@cache
def contact_gait(name: str) -> Gait:
    """The gait of a problem, solved once."""
    gait = solve(contact_problem(name))
    assert gait.converged, gait.message
    return gait
