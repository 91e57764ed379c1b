"""More intervals until the estimated integration error of a solution is small."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.integrator import ORDER
from gaitopt.nlp.newton import Linearisation, integration_error, polish
from gaitopt.nlp.transcription import Transcription
from gaitopt.nlp.trial import overflow_allowed

ERROR_TOLERANCE = 1e-12
"""Integration error of states and durations in natural units that is aimed at: proofs find a gait within 3e-12."""
LARGEST_ERROR = 4e-11
"""The same beyond which a solution is no gait: more than a digit below the nine that are promised."""
SAFETY = 4.0
"""Factor by which a refinement aims below the tolerance."""
MAX_REFINEMENTS = 4
MAX_INTERVALS = 800
"""A step that is not accurate on so many is no walking step: its motion is singular."""
Equations = TypeVar("Equations", bound=Transcription)
Own = TypeVar("Own", bound=Transcription, covariant=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refined(Generic[Own]):
    """A solution and its estimated error.

    Attributes
    ----------
    transcription : on as many intervals as it took.
    at : the equalities at the solution.
    errors : ndarray, shape (n_phases,) - largest estimated error of the states in each phase, and of its duration.
    """

    transcription: Own
    at: Linearisation
    errors: Array

    @property
    def accurate(self) -> bool:
        """Whether the errors are small enough for a gait."""
        return bool(self.errors.max() < LARGEST_ERROR)


@overflow_allowed()
def refine(transcription: Equations, at: Linearisation) -> Refined[Equations]:
    """Cut phases with too large an error finer, and polish, until the errors are below the tolerance or at rounding.

    Freed parameters stay where they are.
    """
    current = Refined(transcription=transcription, at=at, errors=phase_errors(transcription, at))
    for _ in range(MAX_REFINEMENTS):
        if current.errors.max() < ERROR_TOLERANCE:
            break
        growth = np.maximum((SAFETY * current.errors / ERROR_TOLERANCE) ** (1 / ORDER), 1.0)
        layout = current.transcription.layout
        if layout.intervals * growth.max() > MAX_INTERVALS:
            break
        counts = [int(np.ceil(arc.intervals * growth[arc.phase])) for arc in layout.arcs]
        refined = _on(current.transcription, current.at, current.transcription.on(layout.refined(counts)))
        if not refined.errors.max() < current.errors.max():
            break
        current = refined
    return current


@overflow_allowed()
def halved(transcription: Equations, at: Linearisation) -> Refined[Equations]:
    """The same solution with every interval cut in two, down to rounding; freed parameters stay where they are."""
    layout = transcription.layout
    return _on(transcription, at, transcription.on(layout.refined([2 * arc.intervals for arc in layout.arcs])))


def _on(coarse: Equations, at: Linearisation, finer: Equations) -> Refined[Equations]:
    """A solution on a finer layout."""
    at = polish(finer, _resample(coarse, finer, at), at.p).at
    return Refined(transcription=finer, at=at, errors=phase_errors(finer, at))


@overflow_allowed()
def phase_errors(transcription: Transcription, at: Linearisation) -> Array:
    """Largest estimated error of the states in each phase, and of its duration, in natural units; shape (n_phases,).

    Infinite where the equations are singular.
    """
    try:
        nodes, durations = integration_error(transcription, at)
    except RuntimeError:
        return np.full(transcription.n_phases, np.inf)
    node_units, duration_units, _ = transcription.unpack(at.units.unknowns)
    nodes, errors = nodes / node_units, np.abs(durations / duration_units)
    for arc, first in zip(transcription.layout.arcs, transcription.layout.first_nodes, strict=True):
        largest = np.abs(nodes[:, first : first + arc.intervals + 1]).max()
        errors[arc.phase] = max(errors[arc.phase], largest)
    return errors


def _resample(coarse: Transcription, finer: Transcription, at: Linearisation) -> Array:
    """The solution on a finer layout, each new node by one partial step from the node before it."""
    nodes, durations, freed = coarse.unpack(at.w)
    resampled = np.empty((nodes.shape[0], finer.n_nodes))
    for index, (arc, first) in enumerate(zip(finer.layout.arcs, finer.layout.first_nodes, strict=True)):
        fractions = np.linspace(0, 1, arc.intervals + 1)[:-1]
        resampled[:, first : first + arc.intervals] = coarse.states_at(at.w, at.p, index, fractions).T
    resampled[:, finer.layout.reset_nodes] = nodes[:, coarse.layout.reset_nodes]
    return finer.pack(resampled, durations, freed)
