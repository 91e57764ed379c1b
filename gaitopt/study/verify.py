"""Claim by claim: does the forward simulator, which chooses the modes itself, confirm a gait of the NLP?"""

from collections.abc import Iterator

import numpy as np

from gaitopt.errors import SolveError
from gaitopt.gait import Ending, Gait, Trajectory, curves, observe
from gaitopt.gait.measures import friction_ratio
from gaitopt.mechanics import ModeSequence
from gaitopt.orbit import ReturnMap
from gaitopt.simulation import Engine, Simulator, make_stepper
from gaitopt.study.claims import Claim, Verification, claim, failed_claim
from gaitopt.study.comparison import AGREEMENT, motion_claims, record_claims
from gaitopt.study.perturbation import return_map_claims

FORCE_SLACK = 1e-8
"""Excess over the friction coefficient that rounding at the edge of the cone can cause."""
ENERGY_AGREEMENT = 1e-9
"""Relative to the largest change of energy or the weight times the length of a leg, whichever is larger."""


def verify(gait: Gait, *, engine: str = Engine.AUTO) -> Verification:
    """Examine a gait by forward simulation from its state after impact.

    Parameters
    ----------
    gait : a converged gait.
    engine : integrator of the simulation: ``auto``, ``scipy`` or ``heyoka``.

    Raises
    ------
    SolveError
        If ``gait`` is a failed attempt.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    check_gait(gait)
    simulator = Simulator(gait.dynamics, stepper=make_stepper(gait.dynamics, engine))
    cycle = gait.problem.cycle
    walked = simulator.run(gait.state, steps=len(cycle.steps), dense=True)
    claims = [_sequence_claim(gait, walked), *_margin_claims(gait), _energy_claim(gait)]
    if claims[0].passed:
        claims += motion_claims(gait, walked.steps)
        claims += record_claims(gait, walked.steps)
        claims += return_map_claims(gait, ReturnMap(simulator, cycle.impact, len(cycle.steps)))
    return Verification(claims=tuple(claims))


def confirm(gait: Gait) -> Verification:
    """A short examination: the simulator walks one cycle through the same modes back to the same state."""
    check_gait(gait)
    walked = Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True)
    claims = [_sequence_claim(gait, walked)]
    if claims[0].passed:
        claims += motion_claims(gait, walked.steps)
    return Verification(claims=tuple(claims))


def check_gait(gait: Gait) -> None:
    """Refuse a failed attempt."""
    if not gait.steps:
        raise SolveError(f"{gait.problem.name} is {gait.status}, there is no gait to verify: {gait.message}")


def _sequence_claim(gait: Gait, walked: Trajectory) -> Claim:
    """The simulator goes through the same modes and the same impacts."""
    if walked.ending is not Ending.COMPLETED:
        return failed_claim("mode sequence", 0.0, walked.message)
    sequences = [
        ModeSequence(tuple(mode for mode, _ in step.phases), step.impact.mode)
        for step in walked.steps
        if step.impact is not None
    ]
    note = f"simulator: {' | '.join(map(str, sequences))}"
    return claim("mode sequence", 0.0 if tuple(sequences) == gait.problem.cycle.steps else np.inf, 0.0, note)


def _margin_claims(gait: Gait) -> Iterator[Claim]:
    """The margins of each mode, between the nodes too."""
    friction, scales = gait.dynamics.static_friction, gait.dynamics.scales
    cone, backward, lowest = -np.inf, 0.0, np.inf
    for arc in gait.arcs:
        if arc.mode.flies:
            continue
        force = observe(gait.dynamics, arc).force
        lowest = min(lowest, -curves.maximum(-force[:, 1])[1])
        if arc.mode.sticks:
            ratio = friction_ratio(force)
            needed = max(curves.maximum(ratio)[1], curves.maximum(-ratio)[1])
            cone = max(cone, needed - friction)
        else:
            backward = max(backward, curves.maximum(-arc.mode.direction * arc.states[:, -1])[1])
    if np.isfinite(cone):
        yield claim("friction cone", cone, FORCE_SLACK, "needed minus available friction while sticking")
    yield claim("slip direction", backward / scales.speed, AGREEMENT, "against the mode, in units of sqrt(g l)")
    pull = FORCE_SLACK if gait.system.walker.massless_feet else 0.0  # their force falls to zero in every step
    yield claim("normal force", -lowest / scales.force, pull, f"at least {lowest:.4g} N")


def _energy_claim(gait: Gait) -> Claim:
    """Energy gained equals work of motors and friction less what dampers take, phase by phase."""
    worst, scale = 0.0, gait.dynamics.scales.energy
    for arc in gait.arcs:
        o = observe(gait.dynamics, arc)
        power = o.power.sum(axis=1) + o.force[:, 0] * arc.states[:, -1] - o.loss
        worst = max(worst, abs(o.energy[-1] - o.energy[0] - curves.integral(power, arc.duration)))
        scale = max(scale, abs(o.energy[-1] - o.energy[0]))
    return claim("energy balance", worst / scale, ENERGY_AGREEMENT, "relative")
