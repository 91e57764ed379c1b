"""From the unknowns of a solved NLP to a step with arcs, impact and shooting nodes."""

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Arc, ImpactRecord, Step, curves
from gaitopt.mechanics import HybridSystem, Mode
from gaitopt.nlp.transcription import Transcription

Array = NDArray[np.float64]

COUNTS = (33, 65, 129, 257)
"""Chebyshev points tried in turn until an arc is resolved."""


def assemble_step(problem: Transcription, w: Array, p: Array) -> Step:
    """The step that ``w`` describes."""
    nodes, _, freed = problem.unpack(w)
    arcs = tuple(_arc(problem, w, p, index) for index in range(len(problem.layout.arcs)))
    full = problem.full_parameters(p, freed)
    return Step(arcs=arcs, impact=impact_record(problem.system, problem.layout.sequence.impact, nodes[:, -1], full))


def impact_record(system: HybridSystem, mode: Mode, z_minus: Array, p: Array) -> ImpactRecord:
    """The impact in ``mode`` that follows ``z_minus``."""
    z_plus, impulse, *_ = (np.asarray(value).ravel() for value in system.impact(mode)(z_minus, p))
    stick_impulse = np.asarray(system.impact(Mode.STICK)(z_minus, p)[1]).ravel()
    x = system.n_shape
    state = z_plus.copy()
    state[x] = 0.0
    return ImpactRecord(
        mode=mode, state=state, step_length=float(z_plus[x]), impulse=impulse, stick_impulse=stick_impulse
    )


def _arc(problem: Transcription, w: Array, p: Array, index: int) -> Arc:
    layout = problem.layout.arcs[index]
    for count in COUNTS:
        times, states = problem.sample(w, p, index, count)
        if curves.tail(states) < curves.RESOLVED:
            break
    return Arc(mode=layout.mode, segment=layout.segment, times=times, states=states)
