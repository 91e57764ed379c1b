"""The optimal gait of RABBIT by gaitopt, plain CasADi collocation, rockit and Drake, cold and warm, in fresh processes.

Least integral of squared torques at 0.8 m/s with steps of 0.4 m, see ``problems/rabbit-optimal.yaml``; warm is the same
at 0.79 m/s from that optimum. The equations of motion of the plain way and of rockit are derived here, without gaitopt.
"""

import contextlib
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from timing import Row

INTERVALS, DEGREE = 20, 5
STEP, SPEEDS, FRICTION, BENT, G = 0.4, (0.8, 0.79), 0.6, 0.05, 9.81
ROUNDS = 2
SETTLED = 0.5
"""Time after the imports until the threads of NumPy's OpenBLAS have ceased to wait actively, which is no work [s]."""
QUIET = {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 1000}
SWAPPED = [0, 3, 4, 1, 2]
AFTER = np.array([0.05, -0.35, -0.15, 0.1, 0.4])
"""First guess of the angles just after the impact; those before it are the same with the legs swapped."""


def equations() -> tuple[ca.Function, ca.Function, ca.Function]:
    """(q, v, u) -> accelerations, ground force; (q, v) -> both after the impact, impulse; (q) -> swing foot."""
    q, v, u = ca.SX.sym("q", 7), ca.SX.sym("v", 7), ca.SX.sym("u", 4)
    torso, thigh, shin, swing_thigh, swing_shin, x, y = ca.vertsplit(q)

    def along(length: float, angle: ca.SX) -> ca.SX:
        return length * ca.vertcat(ca.sin(angle), ca.cos(angle))

    foot = ca.vertcat(x, y)
    knee = foot + along(0.4, shin)
    hip = knee + along(0.4, thigh)
    swing_knee = hip - along(0.4, swing_thigh)
    swing_foot = swing_knee - along(0.4, swing_shin)
    bodies = (
        (12, hip + along(0.24, torso), 1.33, torso),
        (6.8, hip - along(0.11, thigh), 0.47, thigh),
        (3.2, knee - along(0.24, shin), 0.2, shin),
        (6.8, hip - along(0.11, swing_thigh), 0.47, swing_thigh),
        (3.2, swing_knee - along(0.24, swing_shin), 0.2, swing_shin),
    )
    kinetic = sum(m * ca.sumsqr(ca.jtimes(c, q, v)) / 2 + J * ca.jtimes(a, q, v) ** 2 / 2 for m, c, J, a in bodies)
    potential = sum(m * G * c[1] for m, c, _, _ in bodies)
    M = ca.hessian(kinetic, v)[0]
    bias = ca.jtimes(M @ v, q, v) - ca.gradient(kinetic, q) + ca.gradient(potential, q)
    motors = ca.vertcat(thigh - torso, shin - thigh, swing_thigh - torso, swing_shin - swing_thigh)
    right = ca.jacobian(motors, q).T @ u - bias
    W = ca.jacobian(swing_foot, q)
    full = ca.solve(ca.blockcat([[M, -W.T], [W, ca.SX(2, 2)]]), ca.vertcat(M @ v, 0, 0))
    acc = ca.solve(M[:5, :5], right[:5])
    force = M[5:, :5] @ acc - right[5:]
    results = [acc, force, full[:5][SWAPPED], full[7:], swing_foot]
    pinned = ca.substitute(results, [q[5:], v[5:]], [ca.SX.zeros(2), ca.SX.zeros(2)])
    q, v = q[:5], v[:5]
    acc, force, after, impulse, swing_foot = pinned
    return (
        ca.Function("motion", [q, v, u], [acc, force], {"cse": True}),
        ca.Function("impact", [q, v], [q[SWAPPED], after, impulse], {"cse": True}),
        ca.Function("foot", [q], [swing_foot]),
    )


def holds(force: Any) -> Any:
    """What the ground takes without slip, not negative."""
    return ca.vertcat(force[1], FRICTION * force[1] - force[0], FRICTION * force[1] + force[0])


def plain() -> Callable[[float], float]:
    """Radau collocation with ``casadi.Opti``; margins hold at the collocation points."""
    motion, impact, foot = equations()
    opti, tau = ca.Opti(), [0.0, *ca.collocation_points(DEGREE, "radau")]
    C, _, B = ca.collocation_coeff(tau[1:])
    speed, n = opti.parameter(), INTERVALS
    T = STEP / speed
    u, first, cost = opti.variable(4, n + 1), opti.variable(10), 0
    before, states = first, [(first, 0.0)]
    for k in range(n):
        inner = opti.variable(10, DEGREE)
        slopes = ca.horzcat(before, inner) @ C
        for j, c in enumerate(tau[1:]):
            z, torque = inner[:, j], (1 - c) * u[:, k] + c * u[:, k + 1]
            acc, force = motion(z[:5], z[5:], torque)
            opti.subject_to(slopes[:, j] == T / n * ca.vertcat(z[5:], acc))
            opti.subject_to(holds(force) >= 0)
            opti.subject_to(ca.vertcat(z[2] - z[1], z[4] - z[3]) >= BENT)
            states.append((z, (k + c) / n))
            if states[-1][1] < 1 - 1e-9:
                opti.subject_to(foot(z[:5])[1] >= 0)
            cost += T / n * B[j] * ca.sumsqr(torque)
        before = inner[:, -1]
    opti.subject_to(holds(motion(first[:5], first[5:], u[:, 0])[1]) >= 0)
    angles, rates, impulse = impact(before[:5], before[5:])
    opti.subject_to(first == ca.vertcat(angles, rates))
    opti.subject_to(foot(before[:5]) == ca.vertcat(STEP, 0))
    opti.subject_to(holds(impulse) >= 0)
    opti.minimize(cost)
    for z, s in states:
        opti.set_initial(z, np.concatenate([AFTER + s * (AFTER[SWAPPED] - AFTER), (AFTER[SWAPPED] - AFTER) / 0.5]))
    opti.solver("ipopt", {"print_time": False, "expand": True}, QUIET)

    def solved(value: float) -> float:
        opti.set_value(speed, value)
        solution = opti.solve()
        opti.set_initial(solution.value_variables())
        return float(solution.value(cost))

    return solved


def by_rockit() -> Callable[[float], float]:
    """The same in rockit, with margins at the ends of the intervals."""
    from rockit import MultipleShooting, Ocp

    motion, impact, foot = equations()
    ocp = Ocp(T=1.0)
    q, v, u, speed = ocp.state(5), ocp.state(5), ocp.control(4, order=1), ocp.parameter()
    T = STEP / speed
    acc, force = motion(q, v, u)
    ocp.set_der(q, T * v)
    ocp.set_der(v, T * acc)
    angles, rates, impulse = impact(ocp.at_tf(q), ocp.at_tf(v))
    ocp.subject_to(ocp.at_t0(q) == angles)
    ocp.subject_to(ocp.at_t0(v) == rates)
    ocp.subject_to(ocp.at_tf(foot(q)) == ca.vertcat(STEP, 0))
    ocp.subject_to(holds(impulse) >= 0)
    for row in (*ca.vertsplit(holds(force)), q[2] - q[1] - BENT, q[4] - q[3] - BENT):
        ocp.subject_to(row >= 0)
    ocp.subject_to(foot(q)[1] >= 0, include_first=False, include_last=False)
    ocp.add_objective(ocp.integral(T * ca.sumsqr(u)))
    ocp.set_initial(q, AFTER + (ocp.t) * (AFTER[SWAPPED] - AFTER))
    ocp.set_initial(v, (AFTER[SWAPPED] - AFTER) / 0.5)
    ocp.solver("ipopt", {"ipopt": QUIET, "print_time": False, "expand": True})
    ocp.method(MultipleShooting(N=INTERVALS, M=4, intg="rk"))  # its collocation fails on guesses over time (0.6.7)
    last: list[Any] = []

    def solved(value: float) -> float:
        ocp.set_value(speed, value)
        for solution in last:
            for each in (q, v):
                ocp.set_initial(each, solution.sample(each, grid="control")[1].T)
        with contextlib.redirect_stdout(io.StringIO()):
            last[:] = [ocp.solve()]
        return float(last[0].value(ocp.objective))

    return solved


def by_drake() -> Callable[[float], float]:
    """The same in Drake, see ``drake_rabbit.py``."""
    import drake_rabbit

    return drake_rabbit.solver(intervals=INTERVALS, step=STEP, friction=FRICTION, bent=BENT, after=AFTER.tolist())


def ours() -> Callable[[float], float]:
    """gaitopt, with verification and multipliers."""
    import gaitopt as go

    problem, last = go.load_problem("rabbit-optimal"), list[Any]()

    def solved(value: float) -> float:
        gait = go.solve(problem.replace({"constraints.speed": value}), start=last[0] if last else None, progress=False)
        assert go.verify(gait, engine="scipy").passed
        last[:] = [gait]
        return float(gait.solver["objective"])

    return solved


WAYS = {
    "gaitopt.solve and verify": ours,
    "plain CasADi, Radau collocation": plain,
    "rockit, multiple shooting": by_rockit,
    "pydrake, DirectCollocation": by_drake,
}
MODULES = {
    "gaitopt.solve and verify": ("gaitopt.api.verbs", "gaitopt.design.open_loop", "gaitopt.verification.verify"),
    "plain CasADi, Radau collocation": (),
    "rockit, multiple shooting": ("rockit",),
    "pydrake, DirectCollocation": ("pydrake", "drake_rabbit"),
}
"""Imported before the time is taken; a way is left out where one of them is not there."""


def rows() -> list[Row]:
    """Processor time of the first solution in a process without imports, and of the next at a neighbouring speed."""
    ways = [way for way, modules in MODULES.items() if all(find_spec(module) for module in modules)]
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
    for _ in range(ROUNDS):
        for way in ways:
            output = subprocess.run([sys.executable, __file__, way], check=True, capture_output=True, text=True).stdout
            found[way].append(json.loads(output.splitlines()[-1]))
    measured = list[Row]()
    for k, what in enumerate(("optimal gait of RABBIT, first in a process", "the next one, 0.01 m/s slower")):
        best = {way: min(float(times[k][0]) for times in found[way]) for way in ways}
        first = next(iter(best.values()))
        measured += [
            Row(
                what=what,
                way=way,
                seconds=best[way],
                ratio=first / best[way],
                note=f"{found[way][0][k][1]:.3f} N^2 m^2 s",
            )
            for way in ways
        ]
    return measured


if __name__ == "__main__":
    for module in MODULES[sys.argv[1]]:
        import_module(module)
    time.sleep(SETTLED)
    began, results = time.process_time(), []
    solver = WAYS[sys.argv[1]]()
    for speed in SPEEDS:
        value = solver(speed)
        results.append((time.process_time() - began, value))
        began = time.process_time()
    sys.stdout.write("\n" + json.dumps(results) + "\n")
