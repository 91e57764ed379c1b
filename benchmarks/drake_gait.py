"""The sticking compass gait in pydrake: ``DirectCollocation`` of a hand-written system, momentum balance at impact.

Drake asks for a system of its own; this is what its user writes for a passive compass biped whose foot is a pin. Its
state is (theta1, theta2, dtheta1, dtheta2). With l the leg, c the distance of its mass from the foot, b = l - c:

    M11 = m c^2 + (m_hip + m) l^2     M12 = m l b cos(theta1 + theta2)     M22 = m b^2
"""

from typing import Any

import numpy as np
from pydrake.math import cos, sin
from pydrake.planning import DirectCollocation
from pydrake.solvers import Solve
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem
from pydrake.trajectories import PiecewisePolynomial

from gaitopt.model.dynamics import Dynamics
from gaitopt.model.walker import Walker
from gaitopt.problem.problem import Problem
from gaitopt.solver.rollout import roll_out
from gaitopt.systems import build_system

SAMPLES = 41


@TemplateSystem.define("PinnedCompass_")
def PinnedCompass_(T: Any) -> Any:
    """The passive compass biped on a foot that does not slip."""

    class Implementation(LeafSystem_[T]):
        def _construct(self, walker: Walker, converter: Any = None) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.walker = walker
            self.DeclareContinuousState(4)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Implementation._construct(self, other.walker, converter=converter)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            z = context.get_continuous_state_vector().CopyToVector()
            derivatives.get_mutable_vector().SetFromVector(np.array([z[2], z[3], *acceleration(self.walker, z)]))

    return Implementation


def acceleration(walker: Walker, z: Any) -> tuple[Any, Any]:
    """Angular accelerations of both legs."""
    length, c, m, hip = walker.leg_length, walker.leg_com, walker.leg_mass, walker.hip_mass
    b, g_x, g_y = length - c, walker.gravity * np.sin(walker.slope), -walker.gravity * np.cos(walker.slope)
    M11, M22, k = m * c**2 + (hip + m) * length**2, m * b**2, m * length * b
    M12, slope = k * cos(z[0] + z[1]), -k * sin(z[0] + z[1])
    first = m * c + (hip + m) * length
    f1 = -slope * z[3] * z[3] + first * (g_x * cos(z[0]) - g_y * sin(z[0]))
    f2 = -slope * z[2] * z[2] + m * b * (g_x * cos(z[1]) + g_y * sin(z[1]))
    determinant = M11 * M22 - M12 * M12
    return (M22 * f1 - M12 * f2) / determinant, (M11 * f2 - M12 * f1) / determinant


def momentum(walker: Walker, z: Any, about_swing_foot: bool) -> tuple[Any, Any]:
    """Angular momentum of the walker about a foot, and of the leg that has just left about the hip."""
    length, c, m, hip_mass = walker.leg_length, walker.leg_com, walker.leg_mass, walker.hip_mass
    up1, up2 = np.array([sin(z[0]), cos(z[0])]), np.array([sin(z[1]), -cos(z[1])])
    turn1, turn2 = z[2] * np.array([cos(z[0]), -sin(z[0])]), z[3] * np.array([cos(z[1]), sin(z[1])])
    hip, v_hip = length * up1, length * turn1
    masses = (
        (m, c * up1, c * turn1),
        (hip_mass, hip, v_hip),
        (m, hip + (length - c) * up2, v_hip + (length - c) * turn2),
    )
    foot = hip + length * up2 if about_swing_foot else np.zeros(2)
    whole = sum(mass * _cross(r - foot, v) for mass, r, v in masses)
    mass, r, v = masses[0 if about_swing_foot else 2]
    return whole, mass * _cross(r - hip, v)


def period(problem: Problem) -> float:
    """Period of the gait [s]."""
    walker, system = problem.walker, build_system(problem)
    start = np.array([problem.guess.state[name] for name in system.state_names])
    rolled = roll_out(Dynamics.of(system, problem.parameters), problem.cycle, start)
    duration = rolled.durations[0]
    compass = PinnedCompass_[None](walker)
    step = duration / (SAMPLES - 1)
    collocation = DirectCollocation(compass, compass.CreateDefaultContext(), SAMPLES, 0.5 * step, 2 * step)
    program = collocation.prog()
    collocation.AddEqualTimeIntervalsConstraints()
    first, last = collocation.initial_state(), collocation.final_state()
    program.AddLinearConstraint(last[0] == last[1])
    program.AddLinearConstraint(first[0] == -last[1])
    program.AddLinearConstraint(first[1] == -last[0])

    def balance(values: Any) -> Any:
        before, after = momentum(walker, values[4:], True), momentum(walker, values[:4], False)
        return np.array([before[0] - after[0], before[1] - after[1]])

    program.AddConstraint(balance, np.zeros(2), np.zeros(2), np.concatenate([first, last]))
    times = np.linspace(0, duration, SAMPLES)
    guess = PiecewisePolynomial.FirstOrderHold(times, rolled(0, times)[[0, 1, 3, 4]])
    collocation.SetInitialTrajectory(PiecewisePolynomial(), guess)
    result = Solve(program)
    assert result.is_success(), "Drake found no gait"
    return float(sum(result.GetSolution(collocation.time_step(k))[0] for k in range(SAMPLES - 1)))


def _cross(a: Any, b: Any) -> Any:
    return a[0] * b[1] - a[1] * b[0]
