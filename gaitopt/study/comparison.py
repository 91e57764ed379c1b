"""The simulated cycle against that of the NLP: times, states, impact and every measure, in natural units."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import Arc, Gait, ImpactRecord, Step, curves, measure
from gaitopt.gait.measures import measure_scales
from gaitopt.mechanics import Scales
from gaitopt.study.claims import Claim, claim

AGREEMENT = 1e-9
"""Period, switching times and states just after the impact."""
INTERIOR_AGREEMENT = 1e-8
"""States inside an arc, where the simulator interpolates, and all that is measured along arcs."""


def motion_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """Times and states of the simulated steps ``walked`` against those of the gait."""
    scales, unit, growth = gait.dynamics.scales, gait.dynamics.state_units, _growth(gait)
    durations = ([duration for step in steps for _, duration in step.phases] for steps in (gait.steps, walked))
    ours, theirs = (np.cumsum(own) / scales.time for own in durations)
    yield claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "in units of sqrt(l / g)")
    yield claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "in units of sqrt(l / g)")
    returned = np.abs((_impacts(walked)[-1].state - gait.state) / unit).max()
    yield claim("periodicity", returned, growth * AGREEMENT, "state after one cycle")
    pairs = [(step, arc) for step, own in zip(walked, gait.steps, strict=True) for arc in own.arcs]
    inside = max(np.abs((_states(step, arc) - arc.states) / unit).max() for step, arc in pairs)
    yield claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the cycle")


def record_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The scalars that the gait states, and what it records of its impacts, against the simulated steps."""
    scales, tolerance = gait.dynamics.scales, _growth(gait) * INTERIOR_AGREEMENT
    theirs, units = measure(gait.dynamics, walked), measure_scales(scales)
    errors = {name: _error(gait.measures.get(name), value, units[name]) for name, value in theirs.items()}
    yield _worst("measures", errors, tolerance)
    errors = {}
    for number, (ours, simulated) in enumerate(zip(_impacts(gait.steps), _impacts(walked), strict=True), start=1):
        place = f" of step {number}" if len(gait.steps) > 1 else ""
        errors |= {f"{name}{place}": e for name, e in _impact_errors(gait, ours, simulated, scales).items()}
    yield _worst("impact", errors, tolerance)


def _impacts(steps: Sequence[Step]) -> list[ImpactRecord]:
    return [step.impact for step in steps if step.impact is not None]


def _growth(gait: Gait) -> float:
    """By how much an unstable step magnifies what the two methods differ by."""
    return max(1.0, gait.spectral_radius or 0.0)


def _states(step: Step, ours: Arc) -> Array:
    """States (m, n_z) of a step at the times of an arc (m,).

    Arcs are found by time, among those with the same stops locked: where a switch falls on a breakpoint of the control,
    rounding decides which comes first.
    """
    arcs = [arc for arc in step.arcs if arc.mode.locked == ours.mode.locked and arc.mode.flies == ours.mode.flies]
    times = ours.times
    index = np.searchsorted([arc.end for arc in arcs[:-1]], times)
    states = np.empty((times.size, ours.states.shape[1]))
    for k, arc in enumerate(arcs):
        fractions = np.clip(2 * (times[index == k] - arc.start) / arc.duration - 1, -1, 1)
        states[index == k] = chebyshev.chebval(fractions, curves.coefficients(arc.states)).T
    return states


def _impact_errors(gait: Gait, ours: ImpactRecord, theirs: ImpactRecord, scales: Scales) -> dict[str, float]:
    unit = gait.dynamics.state_units
    return {
        "impulse": float(np.abs(ours.impulse - theirs.impulse).max() / scales.impulse),
        "stick impulse": float(np.abs(ours.stick_impulse - theirs.stick_impulse).max() / scales.impulse),
        "step length": abs(ours.step_length - theirs.step_length) / scales.length,
        "state": float(np.abs((ours.state - theirs.state) / unit).max()),
        "mode": 0.0 if ours.mode is theirs.mode else np.inf,
    }


def _error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference in units of ``unit``; infinite where only one of the two is defined."""
    if ours is None or theirs is None:
        return 0.0 if ours is theirs else np.inf
    return abs(ours - theirs) / unit


def _worst(name: str, errors: dict[str, float], tolerance: float) -> Claim:
    """The claim about the largest of several errors, which its note names; one that is no number counts as largest."""
    worst = max(errors, key=lambda key: errors[key] if np.isfinite(errors[key]) else np.inf)
    return claim(name, errors[worst], tolerance, f"worst: {worst}")
