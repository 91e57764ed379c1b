"""The steps of a gait, a simulated walk or a stored record, sampled as figures and pages draw them.

The motion of a record is integrated from its state after impact. Two motions, as of the NLP and of the simulation, are
compared arc by arc at equal fractions of each arc.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.walker import Walker
from gaitopt.show.style import Label, label
from gaitopt.simulation.simulator import Simulator
from gaitopt.store.gaits import POINTS, integrated_steps
from gaitopt.verification.walk import Walk

POINTS_SHOWN = 20
"""Markers of the gait's points; more would hide the curve."""
SMOOTH = 120
"""Points of an arc that is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Steps to be drawn, one after the other; of a gait the first begins where the last one ends.

    Attributes
    ----------
    name : what legends call it.
    dynamics : the hybrid system that moves, at its parameters.
    steps : each with arcs at Chebyshev points, and the impact at their end; the last one of a walk may have none.
    periodic : whether it repeats itself.
    """

    name: str
    dynamics: Dynamics
    steps: tuple[Step, ...]
    periodic: bool = True

    @property
    def walker(self) -> type[Walker]:
        """What moves."""
        return self.dynamics.system.walker

    @property
    def modes(self) -> list[Mode]:
        """Modes of all phases in order."""
        return [mode for step in self.steps for mode, _ in step.phases]

    @property
    def period(self) -> float:
        """Time of the whole cycle [s]."""
        return sum(step.period for step in self.steps)

    def state_index(self, name: str) -> int:
        """Column of a state in ``Arc.states``."""
        return self.dynamics.system.state_names.index(name)


def motion_of(gait: Gait, name: str = "") -> Motion:
    """The steps of a converged gait."""
    return Motion(name=name or gait.problem.name, dynamics=gait.dynamics, steps=gait.motion)


def motion_of_walk(walk: Walk) -> Motion:
    """All steps of a simulated walk, the last of which may end without an impact.

    Raises
    ------
    ValueError
        If the walk ended before anything moved.
    """
    if not walk.trajectory.steps:
        raise ValueError(f"{walk.problem.name}: the walk ended before it began: {walk.trajectory.message}")
    steps = walk.trajectory.steps
    return Motion(name=walk.problem.name, dynamics=walk.dynamics, steps=steps, periodic=False)


def motion_from_record(dynamics: Dynamics, record: Mapping[str, Any], name: str = "", points: int = POINTS) -> Motion:
    """The steps that a JSON record describes by a state after impact, their modes and durations.

    The motion is integrated from the state, so that a record needs to hold no more than that.

    Parameters
    ----------
    dynamics : at the parameters for which the record holds.
    record : a gait or a point of a branch, with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : Chebyshev points of every phase.
    """
    steps = integrated_steps(dynamics, record, points)
    return Motion(name=name or str(record["problem"]), dynamics=dynamics, steps=steps)


def resampled(arc: Arc, count: int) -> Arc:
    """The same arc at ``count`` equidistant times."""
    if len(arc.times) == 2:  # too short to be anything but straight
        s = np.linspace(0, 1, count)[:, None]
        states = arc.states[0] + s * (arc.states[-1] - arc.states[0])
    else:
        states = np.asarray(chebyshev.chebval(np.linspace(-1, 1, count), curves.coefficients(arc.states)).T)
    return replace(arc, times=np.linspace(arc.start, arc.end, count), states=states)


def smooth(steps: Sequence[Step]) -> Iterator[tuple[float, Arc]]:
    """Time before its step [s] and every arc, at so many points that a line through them looks smooth."""
    for began, step in running(steps):
        yield from ((began, resampled(arc, SMOOTH)) for arc in step.arcs)


def running(steps: Sequence[Step]) -> Iterator[tuple[float, Step]]:
    """Time from the start of the first step to that of each step [s], and the step."""
    return zip(accumulate((step.period for step in steps[:-1]), initial=0.0), steps, strict=True)


def time_label(motions: Sequence[Motion]) -> str:
    """What the time axis counts from: the one impact, or the start of several steps."""
    single = all(len(motion.steps) == 1 for motion in motions)
    return str(label("time") if single else Label(words="time since the start", unit="s"))


def position_label(motions: Sequence[Motion]) -> str:
    """Label of an axis with shape coordinates: angles, and lengths where a walker has them."""
    lengths = any(motion.walker.lengths for motion in motions)
    return "angle [rad], length [m]" if lengths else "angle [rad]"


def simulated(gait: Gait) -> tuple[Step, ...]:
    """The steps that the forward simulator walks from the gait's state, choosing its modes by itself."""
    return Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps


def positions_of(motion: Motion) -> tuple[str, ...]:
    """The shape coordinates, and the height of a foot that flies."""
    return tuple(name for name in motion.dynamics.system.state_names if name in (*motion.walker.shape, "y"))


def differences(ours: Sequence[Step], theirs: Sequence[Step]) -> Iterator[tuple[Array, Array]]:
    """Times since the start and differences of the states on each arc, compared at equal fractions of it."""
    pairs = zip(running(ours), theirs, strict=False)
    arcs = ((began, *pair) for (began, step), other in pairs for pair in zip(step.arcs, other.arcs, strict=False))
    for began, mine, other in arcs:
        if mine.mode is not other.mode or mine.duration <= 0:
            return
        fractions = 2 * (mine.times - mine.start) / mine.duration - 1
        states = chebyshev.chebval(fractions, curves.coefficients(other.states)).T
        yield began + mine.times, mine.states - np.asarray(states, dtype=np.float64)


def points_of(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Times since the start of the first step (n,) and states (n, n_z) at all points of some steps."""
    arcs = [(began, arc) for began, step in running(steps) for arc in step.arcs]
    return np.concatenate([began + arc.times for began, arc in arcs]), np.vstack([arc.states for _, arc in arcs])


def thinned(times: Array, states: Array) -> tuple[Array, Array]:
    """At most twenty of many points, evenly among them, the first and the last with them."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(len(times), POINTS_SHOWN)).round().astype(int))
    return times[shown], states[shown]
