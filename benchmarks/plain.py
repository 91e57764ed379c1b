"""The plain way: the compass biped in NumPy, ``solve_ivp`` with event functions, finite differences and ``fsolve``.

What a careful script does: hand-written Jacobians of the three point masses, one saddle point system per evaluation
of the accelerations and contact forces, DOP853 with terminal events and the same tolerance as the scipy engine.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

Array = NDArray[np.float64]

RTOL, ATOL = 1e-12, 1e-12
DIFFERENCE = 1e-6
"""Step of central differences: the cube root of the rounding of a step."""
DIRECTION = {"stick": 0, "slip_forward": 1, "slip_backward": -1}


class PlainCompass:
    """The passive compass biped of one parameter set; ``q = (theta1, theta2, x, y)``."""

    def __init__(self, leg_length: float, leg_mass: float, leg_com: float, hip_mass: float, gravity: float,
                 slope: float, friction: float) -> None:  # fmt: skip
        self.length, self.com, self.mu = leg_length, leg_com, friction
        self.masses = np.array([leg_mass, hip_mass, leg_mass])
        self.gravity = gravity * np.array([np.sin(slope), -np.cos(slope)])

    def terms(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Mass matrix (4, 4) and bias B + G (4,)."""
        M, bias = np.zeros((4, 4)), np.zeros(4)
        s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
        arms = ((self.com, 0.0), (self.length, 0.0), (self.length, self.length - self.com))
        for mass, (a, b) in zip(self.masses, arms, strict=True):
            J = np.array([[a * c1, b * c2, 1.0, 0.0], [-a * s1, b * s2, 0.0, 1.0]])
            curvature = np.array(
                [-a * s1 * dq[0] ** 2 - b * s2 * dq[1] ** 2, -a * c1 * dq[0] ** 2 + b * c2 * dq[1] ** 2]
            )
            M += mass * J.T @ J
            bias += mass * J.T @ (curvature - self.gravity)
        return M, bias

    def motion(self, z: Array, mode: str) -> tuple[Array, Array]:
        """Accelerations (4,) and contact force (2,) of the state z = (theta1, theta2, x, rates)."""
        q, dq = np.array([*z[:3], 0.0]), np.array([*z[3:], 0.0])
        M, bias = self.terms(q, dq)
        s = DIRECTION[mode]
        A = np.zeros((6, 6))
        A[:4, :4] = M
        A[2, 4] = A[3, 5] = -1.0
        A[5, 3] = 1.0
        if s:
            A[4, 4], A[4, 5] = 1.0, s * self.mu
        else:
            A[4, 2] = 1.0
        solution = np.linalg.solve(A, np.concatenate([-bias, [0.0, 0.0]]))
        return solution[:4], solution[4:]

    def rate(self, t: float, z: Array, mode: str) -> Array:
        """dz/dt."""
        return np.concatenate([z[3:], self.motion(z, mode)[0][:3]])

    def events(self, mode: str) -> list:
        """Terminal event functions of a mode."""

        def touchdown(t, z, *_):
            return z[1] - z[0] if t > 0.1 else -1.0

        def upright(t, z, *_):
            return np.cos(z[0])

        def normal_force(t, z, *_):
            return self.motion(z, mode)[1][1]

        found = [touchdown, upright, normal_force]
        if mode == "stick":

            def cone_forward(t, z, *_):
                f_t, f_n = self.motion(z, mode)[1]
                return self.mu * f_n + f_t

            def cone_backward(t, z, *_):
                f_t, f_n = self.motion(z, mode)[1]
                return self.mu * f_n - f_t

            found += [cone_forward, cone_backward]
        else:

            def slip_velocity(t, z, *_):
                return DIRECTION[mode] * z[5] + (1e-9 if t == self.start else 0.0)

            found.append(slip_velocity)
        for event in found:
            event.terminal, event.direction = True, -1
        return found

    def first_mode(self, z: Array) -> str:
        """Mode of a state just after an impact."""
        if z[5] != 0:
            return "slip_forward" if z[5] > 0 else "slip_backward"
        f_t, f_n = self.motion(z, "stick")[1]
        return "stick" if abs(f_t) <= self.mu * f_n else "slip_forward" if f_t < 0 else "slip_backward"

    def step(self, z: Array) -> tuple[Array, float, list[str]]:
        """State after one step, its period and modes."""
        z, t, mode, modes = z.copy(), 0.0, self.first_mode(z), []
        while True:
            modes.append(mode)
            self.start = t
            solution = solve_ivp(self.rate, (t, 5.0), z, "DOP853", events=self.events(mode), args=(mode,),
                                 rtol=RTOL, atol=ATOL)  # fmt: skip
            z, t = solution.y[:, -1], solution.t[-1]
            fired = next(k for k, times in enumerate(solution.t_events) if len(times))
            if fired == 0:
                return self.impact(z), t, modes
            if fired in (1, 2):
                raise RuntimeError("the motion ends")
            if mode == "stick":
                mode = "slip_forward" if fired == 3 else "slip_backward"
            else:
                z[5] = 0.0
                mode = self.first_mode(z)

    def impact(self, z: Array) -> Array:
        """State after the impact."""
        q, dq = np.array([*z[:3], 0.0]), np.array([*z[3:], 0.0])
        M, _ = self.terms(q, dq)
        W = np.array([
            [self.length * np.cos(z[0]), self.length * np.cos(z[1]), 1.0, 0.0],
            [-self.length * np.sin(z[0]), self.length * np.sin(z[1]), 0.0, 1.0],
        ])  # fmt: skip
        MW = np.linalg.solve(M, W.T)
        impulse = -np.linalg.solve(W @ MW, W @ dq)
        if abs(impulse[0]) > self.mu * impulse[1]:
            for s in (1, -1):
                cone = np.array([-s * self.mu, 1.0])
                impulse = -cone * (W[1] @ dq) / (W[1] @ MW @ cone)
                if s * (W[0] @ (dq + MW @ impulse)) > 0:
                    break
        rates = dq + MW @ impulse
        v = W @ rates
        slip = 0.0 if abs(v[0]) < 1e-12 else v[0]
        return np.array([-z[1], -z[0], 0.0, -rates[1], -rates[0], slip])

    def section(self, xi: Array) -> Array:
        """The state of section coordinates (theta1, dtheta1, dtheta2[, dx])."""
        return np.array([xi[0], xi[0], 0.0, xi[1], xi[2], xi[3] if len(xi) > 3 else 0.0])

    def return_map(self, xi: Array) -> Array:
        """Section coordinates after one step."""
        z = self.step(self.section(xi))[0]
        return z[[0, 3, 4, 5]][: len(xi)]

    def multipliers(self, xi: Array) -> Array:
        """Eigenvalues of the return map's derivative by central differences."""
        columns = [
            (self.return_map(xi + h) - self.return_map(xi - h)) / (2 * DIFFERENCE) for h in DIFFERENCE * np.eye(len(xi))
        ]
        return np.linalg.eigvals(np.column_stack(columns))

    def gait(self, xi: Array) -> Array:
        """The fixed point by ``fsolve`` and its finite differences."""
        return fsolve(lambda x: self.return_map(x) - x, xi, xtol=1e-12)
