"""The sticking compass gait in rockit: gaitopt's equations of motion and guess, rockit's multiple shooting."""

import contextlib
import io

import numpy as np
from rockit import FreeTime, MultipleShooting, Ocp

from gaitopt import Mode, Problem
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.solver.rollout import roll_out

INTERVALS, SUBSTEPS = 20, 4


def period(problem: Problem, system: HybridSystem) -> float:
    """Period of the gait [s]."""
    p, data = system.values(problem.parameters), system.control.data(0)
    start = np.array([problem.guess.state[name] for name in system.state_names])
    rolled = roll_out(Dynamics(system, p), problem.cycle, start)
    ocp = Ocp(T=FreeTime(rolled.durations[0]))
    z = ocp.state(system.n_z)
    ocp.set_der(z, system.flow(Mode.STICK)(ocp.t, z, p, data))
    first, last = ocp.at_t0(z), ocp.at_tf(z)
    after = system.impact(system.walker.swapped(Mode.STICK), Mode.STICK)(last, p)[0]
    x = system.n_shape
    kept = [k for k in range(system.n_z) if k not in (x, system.n_z - 1)]
    ocp.subject_to(first[kept] == after[kept])
    ocp.subject_to(first[x] == 0)
    ocp.subject_to(first[system.n_z - 1] == 0)
    ocp.subject_to(rolled.durations[0] / 2 <= ocp.T)
    ocp.subject_to(last[1] - last[0] == 0)
    ocp.set_initial(z, rolled(0, np.linspace(0, rolled.durations[0], INTERVALS + 1)))
    ocp.solver("ipopt", {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}, "print_time": False})
    ocp.method(MultipleShooting(N=INTERVALS, M=SUBSTEPS, intg="rk"))
    with contextlib.redirect_stdout(io.StringIO()):
        solution = ocp.solve()
    return float(solution.value(ocp.T))
