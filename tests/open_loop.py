"""A compass whose torques are found with its motion, and the program of a design in the hands of a user."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from gaitopt import NonlinearProgram

COMPASS = """
name: compass-open-loop
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 0}
friction: 0.12
control: {type: open_loop, intervals: 1, order: constant, bounds: {ankle: [-5, 5], hip: [-5, 5]}}
gait:
  phases: [slip_forward, stick]
  impact: slip_forward
  guess: {state: {theta1: -0.087, dtheta1: 0.445, dtheta2: -0.492, dx: 0.084}}
objective: cost_of_transport
constraints: {speed: 0.4}
"""


def solved_by_casadi(program: NonlinearProgram) -> NDArray[np.float64]:
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0}
    solver = ca.nlpsol("solver", "ipopt", program.casadi(), options | program.derivatives)
    return np.asarray(solver(**program.arguments())["x"]).ravel()
