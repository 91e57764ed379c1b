"""Problems of walkers with several contacts."""

from functools import cache

from contact_walkers import HeelToe, SpringMassWalker

from gaitopt.gait.gait import Gait
from gaitopt.problem.problem import Problem, parse_problem
from gaitopt.search.solve import solve


class SpringMassWalking(SpringMassWalker):
    """A spring-mass walker of a given energy."""

    model = "slip_walking"

    energy: float


WALKERS = [HeelToe, SpringMassWalking]
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
TEXTS = {**HEEL_TOES, "slip-walk": SLIP_WALK}


@cache
def contact_problem(name: str) -> Problem:
    return parse_problem(TEXTS[name], walkers=WALKERS)


@cache
def contact_gait(name: str) -> Gait:
    """The gait of a problem, solved once."""
    gait = solve(contact_problem(name))
    assert gait.converged, gait.message
    return gait
