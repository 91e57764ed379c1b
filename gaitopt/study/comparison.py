"""The simulated step against that of the NLP: times, states, impact and every measure, in natural units."""

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.gait import Gait, ImpactRecord, Step, curves, measure, measure_scales
from gaitopt.mechanics import Scales
from gaitopt.study.claims import Claim, claim

Array = NDArray[np.float64]

AGREEMENT = 1e-9
"""Period, switching times and states just after the impact."""
INTERIOR_AGREEMENT = 1e-8
"""States inside an arc, where the simulator interpolates, and all that is measured along arcs."""


def step_claims(gait: Gait, step: Step, walked: Step, impact: ImpactRecord) -> Iterator[Claim]:
    """Times and states of the simulated step ``walked`` and of its ``impact``, against those of ``step``."""
    scales, growth = gait.system.scales(gait.p), _growth(gait)
    unit = gait.system.state_scales(scales)
    ours, theirs = (np.cumsum([duration for _, duration in s.phases]) / scales.time for s in (step, walked))
    yield claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "in units of sqrt(l / g)")
    yield claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "in units of sqrt(l / g)")
    returned = np.abs((impact.state - gait.state) / unit).max()
    yield claim("periodicity", returned, growth * AGREEMENT, "state after one step")
    inside = max(np.abs((_states(walked, arc.times) - arc.states) / unit).max() for arc in step.arcs)
    yield claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the step")


def record_claims(gait: Gait, step: Step, walked: Step, impact: ImpactRecord) -> Iterator[Claim]:
    """The scalars that the gait states, and what it records of its impact, against the simulated step."""
    scales, tolerance = gait.system.scales(gait.p), _growth(gait) * INTERIOR_AGREEMENT
    theirs, units = measure(gait.system, gait.p, walked), measure_scales(scales)
    errors = {name: _error(gait.measures.get(name), value, units[name]) for name, value in theirs.items()}
    yield _worst("measures", errors, tolerance)
    assert step.impact is not None  # a gait is a complete step
    yield _worst("impact", _impact_errors(gait, step.impact, impact, scales), tolerance)


def _growth(gait: Gait) -> float:
    """By how much an unstable step magnifies what the two methods differ by."""
    return max(1.0, gait.spectral_radius or 0.0)


def _states(step: Step, times: Array) -> Array:
    """States (m, n_z) of a step at times since impact (m,).

    Arcs are found by time: where a switch falls on a breakpoint of the control, rounding decides which comes first.
    """
    index = np.searchsorted([arc.end for arc in step.arcs[:-1]], times)
    states = np.empty((times.size, step.arcs[0].states.shape[1]))
    for k, arc in enumerate(step.arcs):
        fractions = np.clip(2 * (times[index == k] - arc.start) / arc.duration - 1, -1, 1)
        states[index == k] = chebyshev.chebval(fractions, curves.coefficients(arc.states)).T
    return states


def _impact_errors(gait: Gait, ours: ImpactRecord, theirs: ImpactRecord, scales: Scales) -> dict[str, float]:
    unit = gait.system.state_scales(scales)
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
