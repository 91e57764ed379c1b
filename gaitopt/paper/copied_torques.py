"""Torques that make a walker on level ground copy the joint angles of a walk down a slope, as in Fig. 10.

The slope enters the equations of motion (2) only through G, and the contact force only the rows of x and y, so that

    E_s u = G_s(q; level) - G_s(q; slope)             rows s of the shape coordinates
"""

import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.gait import Gait
from gaitopt.gait.curves import integral
from gaitopt.mechanics.lagrangian import equations_of_motion


def copied_torques(gait: Gait) -> list[tuple[Array, Array]]:
    """Times (m,) [s] and torques (m, n_u) [N m] on every arc of a gait of a walker with as many motors as angles."""
    walker = gait.problem.walker
    equations = equations_of_motion(type(walker))
    shape = gait.system.n_shape
    terms = Function("terms", [equations.z, equations.p], [equations.G[:shape], equations.E[:shape, :]])
    fields = {name: getattr(walker, name) for name in type(walker).model_fields}
    sloping, level = list(fields.values()), list({**fields, "slope": 0.0}.values())

    def torque(z: Array) -> Array:
        (there, E), (here, _) = terms(z, sloping), terms(z, level)
        return np.linalg.solve(np.asarray(E), np.asarray(here - there)).ravel()

    return [(arc.times, np.array([torque(z) for z in arc.states])) for arc in gait.arcs]


def mean_torques(gait: Gait) -> Array:
    """Their means over the step; shape (n_u,) [N m]."""
    sums = [
        [integral(column, float(times[-1] - times[0])) for column in torques.T]
        for times, torques in copied_torques(gait)
    ]
    return np.asarray(np.sum(sums, axis=0) / gait.period)
