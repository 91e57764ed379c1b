"""The simulated cycle against that of the NLP: times, states, impact and every measure, in natural units."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import Arc, Gait, ImpactRecord, Step, curves, measure
from gaitopt.gait.measures import measure_scales
from gaitopt.nlp.assembly import impact_record
from gaitopt.study.claims import Claim, claim

AGREEMENT = 1e-9
"""Period, switching times and states just after the impact."""
INTERIOR_AGREEMENT = 1e-8
"""States inside an arc, where the simulator interpolates, and all that is measured along arcs."""
RECOMPUTED = 1e-9
"""Relative agreement of a stated scalar with its value along the gait's own motion; rounding alone differs."""
SMALL = 1e-4
"""In natural units: smaller scalars are compared as if they were this large, since rounding is 1e-15 of the unit."""


def motion_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """Times and states of the simulated steps ``walked`` against those of the gait."""
    scales, unit, growth = gait.dynamics.scales, gait.dynamics.state_units, magnification(gait)
    durations = ([duration for step in steps for _, duration in step.phases] for steps in (gait.steps, walked))
    ours, theirs = (np.cumsum(own) / scales.time for own in durations)
    yield claim("period", abs(ours[-1] - theirs[-1]), growth * AGREEMENT, "in units of sqrt(l / g)")
    yield claim("switching times", np.abs(ours - theirs).max(), growth * AGREEMENT, "in units of sqrt(l / g)")
    returned = np.abs((_impacts(walked)[-1].state - gait.state) / unit).max()
    yield claim("periodicity", returned, growth * AGREEMENT, "state after one cycle")
    inside = _state_error(gait, walked)
    yield claim("states inside", inside, growth * INTERIOR_AGREEMENT, "largest difference along the cycle")


def record_claims(gait: Gait, walked: Sequence[Step]) -> Iterator[Claim]:
    """The scalars that the gait states, and what it records of its impacts.

    Both are compared with the simulated steps and, where these confirm the gait's states, far more closely with their
    values along the gait's own motion. The claim has the figure and the tolerance of the comparison that is worse.
    """
    units, tolerance = measure_scales(gait.dynamics.scales), magnification(gait) * INTERIOR_AGREEMENT
    own = _recomputed(gait) if _state_error(gait, walked) <= tolerance else ()
    errors = {k: _error(gait.measures.get(k), value, units[k]) for k, value in measure(gait.dynamics, walked).items()}
    closely = {k: _relative_error(gait.measures.get(k), v, units[k]) for k, v in _measured(gait, own).items()}
    yield _worst("measures", (errors, tolerance), (closely | _parameter_errors(gait), RECOMPUTED))
    errors = _impact_errors(gait, _impacts(walked), _error)
    closely = _impact_errors(gait, _impacts(own), _relative_error) if own else {}
    yield _worst("impact", (errors, tolerance), (closely, RECOMPUTED))


def _recomputed(gait: Gait) -> tuple[Step, ...]:
    """The steps of the gait with impacts computed again from the states before them."""
    return tuple(
        replace(
            step,
            impact=impact_record(
                gait.dynamics.standing(step.arcs[-1].side), step.final_impact.mode, step.arcs[-1].states[-1]
            ),
        )
        for step in gait.steps
    )


def _measured(gait: Gait, steps: Sequence[Step]) -> dict[str, float | None]:
    return measure(gait.dynamics, steps) if steps else {}


def _parameter_errors(gait: Gait) -> dict[str, float]:
    """Stated parameters, solved or given by the problem, against those with which the gait moves."""
    given = {key: value for key, value in gait.problem.parameters.items() if key not in gait.problem.free}
    moving = gait.dynamics.parameters
    return {key: _relative_error(value, moving[key], 0.0) for key, value in {**given, **gait.freed}.items()}


def _impacts(steps: Sequence[Step]) -> list[ImpactRecord]:
    return [step.impact for step in steps if step.impact is not None]


def magnification(gait: Gait) -> float:
    """By how much an unstable step magnifies what the two methods differ by."""
    return max(1.0, gait.spectral_radius or 0.0)


def _state_error(gait: Gait, walked: Sequence[Step]) -> float:
    """Largest difference of the states along the cycle, in natural units."""
    pairs = [(step, arc) for step, own in zip(walked, gait.steps, strict=True) for arc in own.arcs]
    return max(
        float(np.abs((_states(step, arc) - arc.states) / gait.dynamics.state_units).max()) for step, arc in pairs
    )


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


def _impact_errors(
    gait: Gait, others: Sequence[ImpactRecord], error: Callable[[float, float, float], float]
) -> dict[str, float]:
    """Errors of what the gait records of its impacts; ``error`` is that of one number in its natural unit."""
    scales, units = gait.dynamics.scales, gait.dynamics.state_units
    errors: dict[str, float] = {}

    def worst(one: Array, other: Array, unit: Array) -> float:
        return max(map(error, one.tolist(), other.tolist(), unit.tolist()))

    impulse = np.full(2, scales.impulse)
    for number, (ours, theirs) in enumerate(zip(_impacts(gait.steps), others, strict=True), start=1):
        of_step = {
            "impulse": worst(ours.impulse, theirs.impulse, impulse),
            "stick impulse": worst(ours.stick_impulse, theirs.stick_impulse, impulse),
            "step length": error(ours.step_length, theirs.step_length, scales.length),
            "push work": error(ours.push_work, theirs.push_work, scales.energy),
            "state": worst(ours.state, theirs.state, units),
            "mode": 0.0 if ours.mode is theirs.mode else np.inf,
        }
        place = f" of step {number}" if len(gait.steps) > 1 else ""
        errors |= {f"{name}{place}": value for name, value in of_step.items()}
    return errors


def _error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference in units of ``unit``; infinite where only one of the two is defined."""
    if ours is None or theirs is None:
        return 0.0 if ours is theirs else np.inf
    return abs(ours - theirs) / unit


def _relative_error(ours: float | None, theirs: float | None, unit: float) -> float:
    """Difference relative to ``theirs``, or to ``SMALL`` units where that is larger."""
    if ours == theirs:
        return 0.0
    return _error(ours, theirs, max(abs(theirs or 0.0), SMALL * unit) or np.inf)


def _worst(name: str, *comparisons: tuple[dict[str, float], float]) -> Claim:
    """The claim about the largest of several errors, relative to the tolerance of its comparison; its note names it.

    An error that is no number counts as the largest.
    """
    errors = [(error, key, tolerance) for own, tolerance in comparisons for key, error in own.items()]
    error, key, tolerance = max(errors, key=lambda row: row[0] / row[2] if np.isfinite(row[0]) else np.inf)
    return claim(name, error, tolerance, f"worst: {key}")
