"""The optimal gait of RABBIT in pydrake: ``DirectCollocation`` of a ``MultibodyPlant`` whose stance foot is a pin.

The plant, its dynamics and the transcription are Drake's. ``DirectCollocation`` knows no impact, no exchange of the
legs and no contact force: these are constraints in Python, evaluated with Drake's automatic differentiation on a second
plant whose stance foot can move. Margins hold at the points; the torques are linear between them.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    MultibodyForces_,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.planning import DirectCollocation
from pydrake.solvers import IpoptSolver, SolverOptions
from pydrake.trajectories import PiecewisePolynomial

LEANS = np.tril(np.ones((5, 5)))[[2, 1, 0, 3, 4]]
"""Leans of torso, stance thigh and shin, swing thigh and shin, from the joints in the order of the chain."""
SWAPPED = [0, 3, 4, 1, 2]
ALONG = np.array([0.0, 1.0, 0.0])
LINKS = (
    # name, mass, inertia about the centre of mass, height of that above the joint, of the next joint, motor
    ("stance_shin", 3.2, 0.2, 0.16, 0.4, False),
    ("stance_thigh", 6.8, 0.47, 0.29, 0.4, True),
    ("torso", 12.0, 1.33, 0.24, 0.0, True),
    ("swing_thigh", 6.8, 0.47, -0.11, -0.4, True),
    ("swing_shin", 3.2, 0.2, -0.24, -0.4, True),
)


def plant(*, pinned: bool) -> MultibodyPlant:
    """RABBIT as a chain from its stance foot, which is a pin or moves along x and z."""
    model = MultibodyPlant(time_step=0.0)
    parent, height = model.world_body(), 0.0
    if not pinned:
        for axis in np.eye(3)[[0, 2]]:
            body = model.AddRigidBody(f"base_{axis}", SpatialInertia.Zero())
            model.AddJoint(PrismaticJoint(f"base_{axis}", parent.body_frame(), body.body_frame(), axis))
            parent = body
    for name, mass, inertia, centre, length, driven in LINKS:
        about = inertia / mass
        com = np.array([0.0, 0.0, centre])
        unit = UnitInertia(about, about, about).ShiftFromCenterOfMass(com)
        body = model.AddRigidBody(name, SpatialInertia(mass, com, unit))
        hinge = model.AddFrame(
            FixedOffsetFrame(f"joint of {name}", parent.body_frame(), RigidTransform([0.0, 0.0, height]))
        )
        joint = model.AddJoint(RevoluteJoint(name, hinge, body.body_frame(), ALONG))
        if driven:
            model.AddJointActuator(name, joint)
        parent, height = body, length
    model.Finalize()
    return model


def solver(
    *, intervals: int, step: float, friction: float, bent: float, after: Sequence[float]
) -> Callable[[float], float]:
    """A function that solves for a speed, from the last solution if there is one; it returns the squared torques.

    Parameters
    ----------
    after : guessed leans just after the impact; those before it are the same with the legs swapped.
    """
    pinned, loose = plant(pinned=True), plant(pinned=False)
    numbers = {"f": (pinned, loose), "O": (pinned.ToAutoDiffXd(), loose.ToAutoDiffXd())}
    kinds = {
        kind: (*both, *(each.CreateDefaultContext() for each in both), MultibodyForces_[scalar](both[1]))
        for (kind, both), scalar in zip(numbers.items(), (float, AutoDiffXd), strict=True)
    }
    tip, joints = np.array([0.0, 0.0, -0.4]), np.linalg.inv(LEANS)

    collocation = DirectCollocation(
        pinned, pinned.CreateDefaultContext(), intervals + 1, 0.2 * step / intervals, 5 * step / intervals,
        pinned.get_actuation_input_port().get_index(),
    )  # fmt: skip
    program = collocation.prog()
    collocation.AddEqualTimeIntervalsConstraints()
    whole = program.AddLinearConstraint(
        np.full((1, intervals), 1.0), [1.0], [1.0], [collocation.time_step(k)[0] for k in range(intervals)]
    )

    def foot_position(q: Any) -> Any:
        _, loose, _, at, _ = kinds[q.dtype.kind]
        loose.SetPositions(at, np.concatenate([[0.0, 0.0], q]))
        return loose.CalcPointsPositions(at, loose.GetFrameByName("swing_shin"), tip, loose.world_frame())[[0, 2], 0]

    def ground_force(z: Any) -> Any:
        """Normal force, and its distances from both edges of the friction cone."""
        pinned, loose, pinned_state, at, forces = kinds[z.dtype.kind]
        pinned.SetPositionsAndVelocities(pinned_state, z[:10])
        pinned.get_actuation_input_port().FixValue(pinned_state, z[10:])
        rates = pinned.EvalTimeDerivatives(pinned_state).get_generalized_velocity().CopyToVector()
        loose.SetPositions(at, np.concatenate([[0.0, 0.0], z[:5]]))
        loose.SetVelocities(at, np.concatenate([[0.0, 0.0], z[5:10]]))
        loose.CalcForceElementsContribution(at, forces)
        f = loose.CalcInverseDynamics(at, np.concatenate([[0.0, 0.0], rates]), forces)[:2]
        return np.array([f[1], friction * f[1] - f[0], friction * f[1] + f[0]])

    def impact(z: Any) -> Any:
        """Momentum balance, and the foot that lands at rest, from (state before, velocities after, impulse)."""
        _, loose, _, at, _ = kinds[z.dtype.kind]
        loose.SetPositions(at, np.concatenate([[0.0, 0.0], z[:5]]))
        world, foot = loose.world_frame(), loose.GetFrameByName("swing_shin")
        J = loose.CalcJacobianTranslationalVelocity(at, JacobianWrtVariable.kV, foot, tip, world, world)[[0, 2]]
        change = z[10:17] - np.concatenate([[0.0, 0.0], z[5:10]])
        return np.concatenate([loose.CalcMassMatrix(at) @ change - J.T @ z[17:], J @ z[10:17]])

    states = [collocation.state(k) for k in range(intervals + 1)]
    inputs = [collocation.input(k) for k in range(intervals + 1)]
    for k, (z, u) in enumerate(zip(states, inputs, strict=True)):
        program.AddConstraint(ground_force, np.zeros(3), np.full(3, np.inf), np.concatenate([z, u]))
        program.AddBoundingBoxConstraint(-np.inf, -bent, z[1])
        program.AddBoundingBoxConstraint(bent, np.inf, z[4])
        if 0 < k < intervals:
            program.AddConstraint(lambda q: foot_position(q)[1:], [0.0], [np.inf], z[:5])
    first, last = states[0], states[-1]
    program.AddConstraint(foot_position, [step, 0.0], [step, 0.0], last[:5])
    rates, impulse = program.NewContinuousVariables(7, "after"), program.NewContinuousVariables(2, "impulse")
    program.AddConstraint(impact, np.zeros(9), np.zeros(9), np.concatenate([last, rates, impulse]))
    program.AddLinearConstraint(
        np.vstack([[0, 1], [-1, friction], [1, friction]]), np.zeros(3), np.full(3, np.inf), impulse
    )
    for start, end in ((first[:5], last[:5]), (first[5:], rates[2:])):
        program.AddLinearEqualityConstraint(
            np.hstack([LEANS, -LEANS[SWAPPED]]), np.zeros(5), np.concatenate([start, end])
        )
    h = collocation.time_step(0)[0]
    program.AddCost(
        h / 3 * sum(a @ a + a @ b + b @ b for a, b in pairwise(inputs))  # linear torques
    )

    before = np.asarray(after)[SWAPPED]
    turning = joints @ (before - np.asarray(after)) / 0.5
    guess = np.zeros(program.num_vars())
    options, found = SolverOptions(), list[Any]()
    options.SetOption(IpoptSolver.id(), "tol", 1e-9)
    options.SetOption(IpoptSolver.id(), "max_iter", 1000)

    def solved(speed: float) -> float:
        period = step / speed
        whole.evaluator().UpdateLowerBound([period])
        whole.evaluator().UpdateUpperBound([period])
        if not found:
            ends = np.column_stack([[*(joints @ np.asarray(after)), *turning], [*(joints @ before), *turning]])
            motion = PiecewisePolynomial.FirstOrderHold([0.0, period], ends)
            collocation.SetInitialTrajectory(PiecewisePolynomial(), motion)
            guess[:] = np.nan_to_num(program.initial_guess())
        result = IpoptSolver().Solve(program, found[-1] if found else guess, options)
        if not result.is_success():
            raise RuntimeError(f"Drake: {result.get_solution_result()}")
        found[:] = [result.GetSolution(program.decision_variables())]
        return float(result.get_optimal_cost())

    return solved
